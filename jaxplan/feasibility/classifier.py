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

from jaxplan.arrays import AnyArray
from jaxplan.feasibility.features import LOW_FIDELITIES, low_fidelity, motion_features, summarise
from jaxplan.feasibility.gaussian_process import (
    Posterior,
    Process,
    Related,
    new_process,
    posterior,
    predict,
    probability,
    rbf,
    related,
)
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.vehicle.identity import VehicleId
from jaxplan.vehicle.params import Vehicle

LEAST_SPREAD = 1e-3
"""Added to each standard deviation, so that what never varies does not divide by 0."""
APART = 0.1
"""How far inducing inputs are moved, so that no two coincide."""


class Scales(NamedTuple):
    """Of what the process sees, over the flights that it was made for."""

    centre: Float[Array, "d"]
    spread: Float[Array, "d"]
    """Standard deviation."""


class Model(NamedTuple):
    """What is trained: the process; its kernel's lengths say what of a trajectory matters how much."""

    scales: Scales
    process: Process
    """On (z, f_low) if its kernel is ``Related``, on z alone otherwise."""

    def inputs(self, motion: Float[AnyArray, "f p n"]) -> Float[Array, "n d"]:
        """What the process sees of n flights, from their ``motion_features``."""
        return _inputs(self.scales, motion, isinstance(self.process.kernel, Related))


class Prediction(NamedTuple):
    """What a classifier says of k trajectories; float32."""

    probability: Float[Array, "k"]
    """Of the rollout to be tracked."""
    deviation: Float[Array, "k"]
    """Standard deviation of the latent function, in units of the probit: 0 is certain, 1 is ignorant."""


class Classifier(NamedTuple):
    """A trained model, ready for many queries; a pytree, so that it may be an argument of what is compiled.

    ``predict`` is the way in. Whoever brings it together with a vehicle on the host checks that it was made for it
    (``vehicle.identity.require_same_vehicle``), as ``build_planner`` does; within what is compiled there is no check.
    """

    scales: Scales
    posterior: Posterior
    vehicle: VehicleId | None = None
    """For which it was trained; None where that does not matter, as in measurements."""

    def predict(self, splines: SplineBatch, vehicle: Vehicle) -> Prediction:
        """The probability that a rollout tracks each of k trajectories, to 0.20 m and 15 degrees, and how sure that is.

        Traced, differentiable in the splines' durations and coefficients; float32 whatever comes in.

        Args:
            splines: the trajectories [m, rad, s; world], batch last; the motion's features come from it alone.
            vehicle: whose rotor limits and gravity the features are made with.
        """
        return self.predict_motion(motion_features(splines, vehicle))

    def predict_motion(self, motion: Float[AnyArray, "f p k"]) -> Prediction:
        """The same from ``motion_features`` (traced)."""
        seen = _inputs(self.scales, motion, isinstance(self.posterior.kernel, Related))
        mean, variance = predict(self.posterior, seen)
        return Prediction(probability(mean, variance), jnp.sqrt(variance))


def new_model(inducing: int, seed: int, motion: Float[AnyArray, "f p n"], *, related_to_low: bool = True) -> Model:
    """The prior, for flights like those of ``motion``, some of which are its inducing inputs.

    Args:
        inducing: number of inducing inputs.
        seed: of their choice.
        motion: ``motion_features`` of n flights.
        related_to_low: whether the process sees the low fidelity.
    """
    seen = _seen(jnp.asarray(motion), related_to_low)
    scales = Scales(jnp.mean(seen, axis=0), jnp.std(seen, axis=0) + LEAST_SPREAD)
    keys = jax.random.split(jax.random.key(seed), 2)
    chosen = jax.random.choice(keys[0], len(seen), (inducing,), replace=len(seen) < inducing)
    places = (seen[chosen] - scales.centre[None]) / scales.spread[None]
    dimensions = seen.shape[1] - (LOW_FIDELITIES if related_to_low else 0)
    length = float(np.sqrt(dimensions))
    kernel = related(dimensions, LOW_FIDELITIES, length) if related_to_low else rbf(dimensions, length)
    return Model(scales, new_process(kernel, places + APART * jax.random.normal(keys[1], places.shape, places.dtype)))


def make_classifier(model: Model, vehicle: VehicleId | None = None) -> Classifier:
    """Ready a model for queries: what does not depend on the query is computed.

    Args:
        model: trained, or a prior.
        vehicle: for which it was trained.
    """
    return Classifier(model.scales, _posterior(model.process), vehicle)


def _inputs(scales: Scales, motion: Float[AnyArray, "f p n"], related_to_low: bool) -> Float[Array, "n d"]:
    scales = jax.lax.stop_gradient(scales)
    return (_seen(motion, related_to_low) - scales.centre[None]) / scales.spread[None]


def _seen(motion: Float[AnyArray, "f p n"], related_to_low: bool) -> Float[Array, "n d"]:
    summary = summarise(motion)
    return (jnp.concatenate([summary, low_fidelity(motion)]) if related_to_low else summary).T


_posterior = jax.jit(posterior)
