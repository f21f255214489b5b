"""The predictors by name.

``PREDICTORS`` is the one table of them: how each is built, and what else is known of it.
"""

from collections.abc import Mapping
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxplan.errors import InputError
from jaxplan.precision import in_float64
from jaxplan.prediction.fusion import fused_proposer, learned_mixture
from jaxplan.prediction.imm_flights import imm_proposer
from jaxplan.prediction.kinematic import constant_acceleration, constant_velocity
from jaxplan.prediction.mdn.checkpoint import TrainedNetwork, load_network
from jaxplan.prediction.mdn.flights import learned_network, mdn_proposer
from jaxplan.prediction.mixture import Prediction, density_terms, draw, draw_randoms, log_density
from jaxplan.prediction.mixture_predictor import mixture_proposer
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.particles import particle_proposer
from jaxplan.prediction.protocol import Draws, PredictionConfig, Proposal, Proposer, StepPredictor
from jaxplan.prediction.target_model import TargetModel, shipped_model
from jaxplan.records import replace
from jaxplan.world.obstacles import World


@runtime_checkable
class Trajectory(Protocol):
    """A motion as a function of time, such as ``jaxplan.io.targets.Target.position``."""

    def __call__(self, times: Float[np.ndarray, "n"], /) -> Float[np.ndarray, "n 3"]:
        """Positions [m, world] at ``times`` [s]."""


class Sources(NamedTuple):
    """What a predictor may know besides its observations."""

    truth: Trajectory | None = None
    """The target's real motion."""
    model: TargetModel | None = None
    """A mixture of how targets move; a shipped one where it is None."""
    world: World | None = None
    """The room, to which the model must belong; None where it is unknown."""
    trained: TrainedNetwork | None = None
    """A network that foretells flights; the shipped one where it is None."""

    def motion(self) -> Trajectory:
        """The target's real motion; InputError where it was not given."""
        if self.truth is None:
            raise InputError("predictor: ground-truth and noisy need the target's real motion; give it as truth")
        return self.truth

    def mixture(self, dt: float) -> TargetModel:
        """The mixture of how targets move: that given, or the shipped one of the room or of any room.

        Raises InputError where none was given and none is shipped for steps of ``dt`` [s].
        """
        if self.model is not None:
            return self.model
        return shipped_model("" if self.world is None else self.world.name, dt)

    def network(self) -> TrainedNetwork:
        """The network that was given, or the shipped one."""
        return load_network() if self.trained is None else self.trained


@runtime_checkable
class ProposerBuilder(Protocol):
    """How a predictor is built."""

    def __call__(self, config: PredictionConfig, sources: Sources) -> Proposer:
        """Take from ``sources`` what this predictor knows; raises InputError where that is missing or does not fit."""


class PredictorKind(NamedTuple):
    """A predictor that a user can ask for."""

    build: ProposerBuilder
    sampling: bool = False
    """Proposes a batch of goals for every step; the others propose one."""
    learned: bool = False
    """Draws from a target model."""
    network: bool = False
    """Asks a network."""


def build_predictor(
    name: str,
    config: PredictionConfig,
    truth: Trajectory | None = None,
    seed: int = 0,
    model: TargetModel | None = None,
    world: World | None = None,
    network: TrainedNetwork | None = None,
) -> StepPredictor:
    """The predictor called ``name``.

    Args:
        name: one of ``PREDICTORS``.
        config: how far and how densely it looks ahead.
        truth: the target's real motion [m, world], for ``ground-truth`` and ``noisy``; the others do not look at it.
        seed: of all draws.
        model: the mixture for ``gmm``; its windows must be those of ``config``, its room that of ``world`` if given.
            The shipped one of that room, or the generic one, when omitted.
        world: the room.
        network: for ``mdn`` and ``ensemble``; the shipped one when omitted.

    Raises:
        InputError: ``name`` is not one of ``PREDICTORS``, what it needs is missing, or the model does not fit.
    """
    if name not in PREDICTORS:
        raise InputError(f"predictor: unknown name {name!r}, want one of {', '.join(PREDICTORS)}")
    return StepPredictor(config, seed, PREDICTORS[name].build(config, Sources(truth, model, world, network)))


def _none(config: PredictionConfig, sources: Sources) -> Proposer:
    """Where the target was seen last."""

    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        still = np.repeat(observations.positions[-1:], config.steps, axis=0)
        return Proposal(lambda: _certain(still, config.offsets), None)

    return propose


def _ground_truth(config: PredictionConfig, sources: Sources) -> Proposer:
    """Where the target will really be."""
    motion = sources.motion()

    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        return Proposal(lambda: _certain(motion(observations.times[-1] + config.offsets), config.offsets), None)

    return propose


def _noisy(config: PredictionConfig, sources: Sources) -> Proposer:
    """Where the target will really be, with noise whose variance grows with the step."""
    motion = sources.motion()

    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        deviations = config.sigma * np.sqrt(np.arange(1, config.steps + 1))
        certain = _certain(motion(observations.times[-1] + config.offsets), config.offsets)
        prediction = replace(certain, factors=deviations[:, None, None, None] * np.eye(3)[None, :, :, None])
        return Proposal(lambda: prediction, _draws(prediction, config.batch, rng))

    return propose


def _constant_velocity(config: PredictionConfig, sources: Sources) -> Proposer:
    """On the line through the newest positions."""

    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        return Proposal(lambda: constant_velocity(observations, config.offsets), None)

    return propose


def _constant_acceleration(config: PredictionConfig, sources: Sources) -> Proposer:
    """On the parabola through the newest positions."""

    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        return Proposal(lambda: constant_acceleration(observations, config.offsets), None)

    return propose


def _gmm(config: PredictionConfig, sources: Sources) -> Proposer:
    """Where a Gaussian mixture says, that was learned from random flights."""
    return mixture_proposer(config, sources.mixture(config.dt), sources.world)


def _particles(config: PredictionConfig, sources: Sources) -> Proposer:
    """Where the mixture's flights go that hit nothing."""
    return particle_proposer(config, sources.mixture(config.dt), sources.world)


def _imm(config: PredictionConfig, sources: Sources) -> Proposer:
    """Where the flights of an interacting-multiple-model filter go that hit nothing."""
    return imm_proposer(config, sources.world)


def _fused(config: PredictionConfig, sources: Sources) -> Proposer:
    """Flights of the mixture and of the filter, as many of each as they have deserved."""
    return fused_proposer(config, learned_mixture(config, sources.mixture(config.dt), sources.world), sources.world)


def _mdn(config: PredictionConfig, sources: Sources) -> Proposer:
    """Where a network says that is shown the room, on flights that hit nothing."""
    return mdn_proposer(config, sources.network(), sources.world)


def _ensemble(config: PredictionConfig, sources: Sources) -> Proposer:
    """Flights of the network and of the filter, as many of each as they have deserved."""
    return fused_proposer(config, learned_network(config, sources.network(), sources.world), sources.world)


PREDICTORS: Mapping[str, PredictorKind] = {
    "none": PredictorKind(_none),
    "ground-truth": PredictorKind(_ground_truth),
    "noisy": PredictorKind(_noisy, sampling=True),
    "constant-velocity": PredictorKind(_constant_velocity),
    "constant-acceleration": PredictorKind(_constant_acceleration),
    "gmm": PredictorKind(_gmm, sampling=True, learned=True),
    "particles": PredictorKind(_particles, sampling=True, learned=True),
    "imm": PredictorKind(_imm, sampling=True),
    "fused": PredictorKind(_fused, sampling=True, learned=True),
    "mdn": PredictorKind(_mdn, sampling=True, network=True),
    "ensemble": PredictorKind(_ensemble, sampling=True, network=True),
}
"""By the name that ``--predictor`` takes, in the order of ``jaxplan.config.PREDICTORS``."""


def _certain(positions: Float[np.ndarray, "s 3"], offsets: Float[np.ndarray, "s"]) -> Prediction:
    """One component of no extent at each position."""
    return Prediction(
        offsets=offsets,
        log_weights=np.zeros(1),
        means=positions[:, :, None],
        factors=np.zeros((len(offsets), 3, 3, 1)),
    )


@in_float64
def _draws(prediction: Prediction, batch: int, rng: np.random.Generator) -> Draws:
    uniform, normal = draw_randoms(len(prediction.offsets), batch, rng)
    goals, densities = _draw_and_score(prediction, density_terms(np.asarray(prediction.factors)), uniform, normal)
    return Draws(np.asarray(goals), np.asarray(densities))


@jax.jit
def _draw_and_score(
    prediction: Prediction,
    terms: tuple[Float[Array, "s 3 3 c"], Float[Array, "s c"]],
    uniform: Float[Array, "s b"],
    normal: Float[Array, "s b 3"],
) -> tuple[Float[Array, "s b 3"], Float[Array, "s b"]]:
    goals = draw(prediction.log_weights, prediction.means, prediction.factors, uniform, normal)
    return goals, log_density(prediction.log_weights, prediction.means, *terms, goals)
