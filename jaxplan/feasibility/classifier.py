"""P(the vehicle can follow a trajectory): a sparse Gaussian process on its summary and on the low fidelity.

The low fidelity is how far the rotors stay from their limits along the reference, the high one whether a rollout of the
vehicle with its controller, drag, rotor lag and sensor noise stays within 0.20 m and 15 degrees (MFRL, Sec. III). The
low one is known exactly wherever the high one is asked, so that it needs no process of its own (decision 0015).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.feasibility.features import LOW_FIDELITIES, low_fidelity, motion_features, summarise
from jaxplan.feasibility.gaussian_process import (
    Posterior,
    Process,
    Related,
    new_process,
    predict,
    prepare,
    probability,
    rbf,
    related,
)
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.vehicle.params import Vehicle

LEAST_SPREAD = 1e-3
"""Added to each spread, so that what never varies does no harm."""
APART = 0.1
"""How far inducing inputs are moved, so that no two coincide."""


class Scales(NamedTuple):
    """Of what the process sees, over the flights that it was made for."""

    centre: Float[Array, "d"]
    spread: Float[Array, "d"]


class Model(NamedTuple):
    """What is trained: the process; its kernel's lengths say what of a trajectory matters how much."""

    scales: Scales
    process: Process
    """On (z, f_low) if its kernel is ``Related``, on z alone otherwise."""

    def inputs(self, motion: Float[Array, "f p n"]) -> Float[Array, "n d"]:
        """What the process sees."""
        return _inputs(self.scales, motion, isinstance(self.process.kernel, Related))


class Prediction(NamedTuple):
    """What is believed of k trajectories."""

    probability: Float[Array, "k"]
    """Of the rollout to be tracked."""
    deviation: Float[Array, "k"]
    """Standard deviation of the latent function, in units of the probit: 0 is certain, 1 is ignorant."""


class Classifier(NamedTuple):
    """A trained model, ready for many queries."""

    scales: Scales
    posterior: Posterior

    def predict(self, splines: SplineBatch, vehicle: Vehicle) -> Prediction:
        """Probabilities for k trajectories of a vehicle (traced; float32)."""
        return self.judge(motion_features(splines, vehicle))

    def judge(self, motion: Float[Array, "f p k"]) -> Prediction:
        """Probabilities from ``motion_features``."""
        seen = _inputs(self.scales, motion, isinstance(self.posterior.kernel, Related))
        mean, variance = predict(self.posterior, seen)
        return Prediction(probability(mean, variance), jnp.sqrt(variance))


def new_model(inducing: int, seed: int, motion: Float[Array, "f p n"], *, related_to_low: bool = True) -> Model:
    """The prior, for flights like those of ``motion``, some of which are its inducing inputs.

    Args:
        related_to_low: whether the process sees the low fidelity.
    """
    seen = _seen(jnp.asarray(motion), related_to_low)
    scales = Scales(jnp.mean(seen, axis=0), jnp.std(seen, axis=0) + LEAST_SPREAD)
    keys = jax.random.split(jax.random.key(seed), 2)
    chosen = jax.random.choice(keys[0], len(seen), (inducing,), replace=len(seen) < inducing)
    places = (seen[chosen] - scales.centre) / scales.spread
    dimensions = seen.shape[1] - (LOW_FIDELITIES if related_to_low else 0)
    length = float(np.sqrt(dimensions))
    kernel = related(dimensions, LOW_FIDELITIES, length) if related_to_low else rbf(dimensions, length)
    return Model(scales, new_process(kernel, places + APART * jax.random.normal(keys[1], places.shape, places.dtype)))


def make_classifier(model: Model) -> Classifier:
    """Ready a model for queries."""
    return Classifier(model.scales, _prepared(model.process))


def _inputs(scales: Scales, motion: Float[Array, "f p n"], related_to_low: bool) -> Float[Array, "n d"]:
    scales = jax.lax.stop_gradient(scales)
    return (_seen(motion, related_to_low) - scales.centre) / scales.spread


def _seen(motion: Float[Array, "f p n"], related_to_low: bool) -> Float[Array, "n d"]:
    summary = summarise(motion)
    return (jnp.concatenate([summary, low_fidelity(motion)]) if related_to_low else summary).T


_prepared = jax.jit(prepare)
