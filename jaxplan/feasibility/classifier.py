"""P(the vehicle can follow a trajectory): a two-fidelity sparse Gaussian process on a learned feature.

The low fidelity is whether the rotors keep within their limits along the reference, the high one whether a rollout of
the vehicle with its controller, drag, rotor lag and sensor noise stays within 0.20 m and 15 degrees (MFRL, Sec. III).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.feasibility.features import INSTANTS, MOTION_FEATURES, FeatureConfig, FeatureNetwork, motion_features
from jaxplan.feasibility.gaussian_process import (
    Posterior,
    Process,
    marginals,
    new_process,
    predict,
    prepare,
    probability,
    rbf,
    related,
)
from jaxplan.minsnap.batch import SplineBatch


class Model(NamedTuple):
    """What is trained."""

    network: Any
    low: Process
    high: Process
    """On (z, posterior mean of the low fidelity)."""


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
    low: Posterior
    high: Posterior

    def predict(self, splines: SplineBatch) -> Prediction:
        """Probabilities for k trajectories (traced; float32)."""
        return self.judge(motion_features(splines))

    def judge(self, motion: Float[Array, "k p f"]) -> Prediction:
        """Probabilities from ``motion_features``."""
        features = FeatureNetwork(self.config).apply(self.network, motion)
        low, _ = predict(self.low, features)
        mean, variance = predict(self.high, jnp.concatenate([features, low[:, None]], axis=1))
        return Prediction(probability(mean, variance), jnp.sqrt(variance))


def new_model(config: FeatureConfig, inducing: int, seed: int) -> Model:
    """Random features, the priors of both processes, and inducing inputs spread where features lie."""
    keys = jax.random.split(jax.random.key(seed), 3)
    motion = jnp.zeros((1, INSTANTS, MOTION_FEATURES), jnp.float32)
    network = FeatureNetwork(config).init(keys[0], motion)
    width = config.latent
    low = jax.random.uniform(keys[1], (inducing, width), jnp.float32, -2.0, 2.0)
    high = jax.random.uniform(keys[2], (inducing, width + 1), jnp.float32, -2.0, 2.0)
    length = float(np.sqrt(width))
    kernel = related(width)._replace(own=rbf(width, length), correlation=rbf(width, 2.0 * length))
    return Model(network, new_process(rbf(width, length), low), new_process(kernel, high))


def make_classifier(config: FeatureConfig, model: Model) -> Classifier:
    """Ready a model for queries."""
    return Classifier(config, model.network, *_prepared(model.low, model.high))


def low_inputs(config: FeatureConfig, model: Model, motion: Float[Array, "n p f"]) -> Float[Array, "n z"]:
    """What the low fidelity's process sees, for training."""
    return FeatureNetwork(config).apply(model.network, motion)


def high_inputs(config: FeatureConfig, model: Model, motion: Float[Array, "n p f"]) -> Float[Array, "n z+1"]:
    """What the high fidelity's process sees, for training."""
    features = low_inputs(config, model, motion)
    return jnp.concatenate([features, marginals(model.low, features)[0][:, None]], axis=1)


@jax.jit
def _prepared(low: Process, high: Process) -> tuple[Posterior, Posterior]:
    return prepare(low), prepare(high)
