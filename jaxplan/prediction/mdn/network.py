"""The network: from a view to a mixture of normal distributions over the coefficients of whole flights.

Residual layers look at all of the view. What is expected is linear in the positions seen, by one of several matrices or
by a blend of them, plus a correction for each component: straight lines and bends need no correction, and what is ahead
chooses the blend. The covariances are full, as Cholesky factors of their inverses, the diagonal apart
(Williams, Neural Computation 8(4), 1996):

    z = D (I + N) (c - mu),   p(c) = det D (2 pi)^(-c/2) exp(-|z|^2 / 2),   N strictly lower triangular.

One function serves training, in JAX and in batches, and the predictor, in NumPy: ``xp`` says which.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.arrays import AnyArray
from jaxplan.prediction.mdn.curves import COEFFICIENTS
from jaxplan.prediction.mdn.view import OBSERVATIONS, PROBES, View
from jaxplan.validation import require_within

LOCAL = 3 * (OBSERVATIONS - 1)
"""Coordinates of the positions seen."""
INPUTS = 2 * LOCAL + (OBSERVATIONS - 1) + 2 + len(PROBES)
PAIRS = COEFFICIENTS * (COEFFICIENTS - 1) // 2
LOG_PRECISION = (-3.0, 6.0)
"""Least and largest logarithm of a precision, of coefficients whose deviation over all flights is 1."""
_LOG_TWO_PI = float(np.log(2.0 * np.pi))


@dataclasses.dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the network."""

    width: int = 192
    """Of its hidden layers."""
    layers: int = 3
    """Hidden layers."""
    components: int = 8
    """Of the mixture."""
    matrices: int = 12
    """Linear continuations that are blended."""

    def __post_init__(self) -> None:
        require_within("mdn", self, 1, 1024, "width", "layers", "components", "matrices")


class FlightMixture(NamedTuple):
    """n mixtures of k components over c coefficients of a flight."""

    log_weights: Float[AnyArray, "n k"]
    """Normalised."""
    means: Float[AnyArray, "n k c"]
    log_precisions: Float[AnyArray, "n k c"]
    """Logarithms of the diagonal of D."""
    couplings: Float[AnyArray, "n k p"]
    """N below its diagonal, row by row."""


def initial_parameters(config: NetworkConfig, seed: int) -> dict[str, Any]:
    """Random weights, float32; the components' means differ, all else begins alike."""
    rng = np.random.default_rng(seed)
    k, c = config.components, COEFFICIENTS

    def layer(inputs: int, outputs: int, scale: float = 1.0) -> dict[str, Any]:
        kernel = rng.normal(scale=scale / np.sqrt(inputs), size=(inputs, outputs))
        return {"kernel": kernel.astype(np.float32), "bias": np.zeros(outputs, np.float32)}

    sizes = [INPUTS] + [config.width] * config.layers
    tree: dict[str, Any] = {f"hidden_{i}": layer(*sizes[i : i + 2]) for i in range(config.layers)}
    tree["blend"] = layer(config.width, config.matrices)
    tree["matrices"] = rng.normal(scale=0.02, size=(config.matrices, LOCAL, c)).astype(np.float32)
    heads = {"weights": k, "means": k * c, "precisions": k * c, "couplings": k * PAIRS}
    tree |= {name: layer(config.width, outputs, 0.1) for name, outputs in heads.items()}
    tree["means"]["bias"] = rng.normal(scale=0.1, size=k * c).astype(np.float32)
    return tree


def mixture_of(parameters: dict[str, Any], view: View, xp: Any = jnp) -> FlightMixture:
    """What may follow each of n views; ``xp`` is ``jax.numpy`` or ``numpy``."""
    n = len(view.scale)
    local, scale = view.relative.reshape(n, LOCAL), view.scale[:, None]
    told = [local, local * scale, view.seen, xp.log(scale) - 1.0, xp.log(view.interval[:, None]) + 2.0, view.room - 0.5]
    hidden = _swish(_affine(parameters["hidden_0"], xp.concatenate(told, axis=1)), xp)
    for index in range(1, sum(name.startswith("hidden_") for name in parameters)):
        hidden = hidden + _swish(_affine(parameters[f"hidden_{index}"], _normalised(hidden, xp)), xp)
    hidden = _normalised(hidden, xp)
    blend = _normalised_exponents(_affine(parameters["blend"], hidden), xp)
    straight = _blended(parameters["matrices"], xp.exp(blend), 4.0 * local, xp)
    log_weights = _normalised_exponents(_affine(parameters["weights"], hidden), xp)
    shape = (n, log_weights.shape[1], COEFFICIENTS)
    return FlightMixture(
        log_weights=log_weights,
        means=straight[:, None] + _affine(parameters["means"], hidden).reshape(shape),
        log_precisions=xp.clip(_affine(parameters["precisions"], hidden).reshape(shape), *LOG_PRECISION),
        couplings=_affine(parameters["couplings"], hidden).reshape(n, shape[1], PAIRS),
    )


def log_densities(mixture: FlightMixture, coefficients: Float[Array, "n c"]) -> Float[Array, "n"]:
    """Logarithm of the density of a flight under each mixture (JAX)."""
    apart = coefficients[:, None] - mixture.means
    rows, columns = np.tril_indices(COEFFICIENTS, -1)
    shape = (*mixture.means.shape, COEFFICIENTS)
    coupling = jnp.zeros(shape, apart.dtype).at[:, :, rows, columns].set(mixture.couplings)
    white = jnp.exp(mixture.log_precisions) * (apart + (coupling * apart[:, :, None]).sum(axis=-1))
    exponent = mixture.log_weights + mixture.log_precisions.sum(axis=-1) - 0.5 * (white * white).sum(axis=-1)
    return jax.nn.logsumexp(exponent, axis=1) - 0.5 * COEFFICIENTS * _LOG_TWO_PI


def deviations(mixture: FlightMixture) -> Float[np.ndarray, "n k c c"]:
    """What independent standard normal numbers are multiplied by: (I + N)^-1 D^-1 (host)."""
    rows, columns = np.tril_indices(COEFFICIENTS, -1)
    factor = np.zeros((*np.shape(mixture.means), COEFFICIENTS), np.float32)
    factor[..., rows, columns] = mixture.couplings
    factor[..., np.arange(COEFFICIENTS), np.arange(COEFFICIENTS)] = 1.0
    return np.asarray(np.linalg.inv(factor) * np.exp(-np.asarray(mixture.log_precisions))[..., None, :])


def _affine(layer: dict[str, Any], x: Float[AnyArray, "n i"]) -> Any:
    return x @ layer["kernel"] + layer["bias"][None]


def _swish(x: Float[AnyArray, "n i"], xp: Any) -> Any:
    """x times its logistic function, which overflows nowhere."""
    return 0.5 * x * (1.0 + xp.tanh(0.5 * x))


def _normalised(x: Float[AnyArray, "n i"], xp: Any) -> Any:
    """To mean 0 and variance 1 (Ba and others, 2016); what follows is linear, and scales and shifts as it likes."""
    x = x - x.mean(axis=1, keepdims=True)
    return x / xp.sqrt((x * x).mean(axis=1, keepdims=True) + 1e-6)


def _normalised_exponents(x: Float[AnyArray, "n i"], xp: Any) -> Any:
    x = x - x.max(axis=1, keepdims=True)
    return x - xp.log(xp.exp(x).sum(axis=1, keepdims=True))


def _blended(
    matrices: Float[AnyArray, "j i c"], shares: Float[AnyArray, "n j"], x: Float[AnyArray, "n i"], xp: Any
) -> Any:
    """x times the blend of matrices."""
    products = x @ xp.swapaxes(matrices, 0, 1).reshape(matrices.shape[1], -1)
    return (shares[..., None] * products.reshape(len(x), *matrices.shape[::2])).sum(axis=1)
