"""P(the vehicle can follow a trajectory): a sparse Gaussian process on a learned feature and on the low fidelity.

The low fidelity is how far the rotors stay from their limits along the reference, the high one whether a rollout of the
vehicle with its controller, drag, rotor lag and sensor noise stays within 0.20 m and 15 degrees (MFRL, Sec. III). The
low one is known exactly wherever the high one is asked, so that it needs no process of its own (decision 0015).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.feasibility.features import (
    INSTANTS,
    MOTION_FEATURES,
    FeatureConfig,
    FeatureNetwork,
    low_fidelity,
    motion_features,
)
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
from jaxplan.minsnap.batch import SplineBatch
from jaxplan.vehicle.params import Vehicle


class Model(NamedTuple):
    """What is trained."""

    network: Any
    process: Process
    """On (z, f_low) if its kernel is ``Related``, on z alone otherwise."""

    def inputs(self, config: FeatureConfig, motion: Float[Array, "f p n"]) -> Float[Array, "n d"]:
        """What the process sees."""
        return _inputs(config, self.network, self.process, motion)


class Prediction(NamedTuple):
    """What is believed of k trajectories."""

    probability: Float[Array, "k"]
    """Of the rollout to be tracked."""
    deviation: Float[Array, "k"]
    """Standard deviation of the latent function, in units of the probit: 0 is certain, 1 is ignorant."""


class Classifier(NamedTuple):
    """A trained model, ready for many queries."""

    config: FeatureConfig
    network: Any
    posterior: Posterior

    def predict(self, splines: SplineBatch, vehicle: Vehicle) -> Prediction:
        """Probabilities for k trajectories of a vehicle (traced; float32)."""
        return self.judge(motion_features(splines, vehicle))

    def judge(self, motion: Float[Array, "f p k"]) -> Prediction:
        """Probabilities from ``motion_features``."""
        mean, variance = predict(self.posterior, _inputs(self.config, self.network, self.posterior, motion))
        return Prediction(probability(mean, variance), jnp.sqrt(variance))


def new_model(config: FeatureConfig, inducing: int, seed: int, *, related_to_low: bool = True) -> Model:
    """Random features, the prior, and inducing inputs spread where features lie.

    Args:
        related_to_low: whether the process sees the low fidelity.
    """
    keys = jax.random.split(jax.random.key(seed), 2)
    network = FeatureNetwork(config).init(keys[0], jnp.zeros((MOTION_FEATURES, INSTANTS, 1), jnp.float32))
    width, length = config.latent, float(np.sqrt(config.latent))
    kernel = related(width, length) if related_to_low else rbf(width, length)
    dimensions = width + 1 if related_to_low else width
    spread = jax.random.uniform(keys[1], (inducing, dimensions), jnp.float32, -2.0, 2.0)
    return Model(network, new_process(kernel, spread))


def make_classifier(config: FeatureConfig, model: Model) -> Classifier:
    """Ready a model for queries."""
    return Classifier(config, model.network, _prepared(model.process))


def _inputs(
    config: FeatureConfig, network: Any, process: Process | Posterior, motion: Float[Array, "f p n"]
) -> Float[Array, "n d"]:
    features = FeatureNetwork(config).apply(network, motion)
    if not isinstance(process.kernel, Related):
        return features
    return jnp.concatenate([features, low_fidelity(motion)[:, None]], axis=1)


_prepared = jax.jit(prepare)
