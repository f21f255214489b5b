"""Predictors behind one protocol: observations in, a distribution over future positions and goal candidates out.

Every predictor looks ``steps`` intervals of ``dt`` ahead (paper, Sec. III-C). Those that are certain propose their
position at each step, the others ``batch`` draws for each, so the number of candidates is fixed when it is built.
``seed`` makes draws repeatable, cycle by cycle. A target that has been silent is predicted from when it was last seen:
what lies in the past by now is rejected, what remains is as uncertain as its age makes it, and after
``PredictionConfig.lost_after`` nothing remains.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.config import PREDICTORS
from jaxplan.errors import InputError
from jaxplan.precision import in_float64
from jaxplan.prediction.candidates import Candidates, candidates_from
from jaxplan.prediction.kinematic import constant_acceleration, constant_velocity
from jaxplan.prediction.mixture import ConditionalMixture, Prediction, choose, condition, log_density, scales
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.target_model import TargetModel, check_model, window_coordinates
from jaxplan.records import replace
from jaxplan.status import Note, Reason
from jaxplan.world.obstacles import World

Trajectory = Callable[[Float[np.ndarray, "n"]], Float[np.ndarray, "n 3"]]
"""Target positions [m, world] at given times [s]."""

SAMPLING = ("noisy", "gmm")
"""Predictors that propose a batch of goals for every step; the others propose one."""

LARGE_ROOM = 20.0
"""Room diagonal [m] from which predictions are farther apart (paper, Sec. IV)."""
SPACING = 0.1
SPACING_IN_LARGE_ROOMS = 0.2
"""Seconds between predictions (paper, Sec. IV)."""

_UNUSUAL = 10.0
"""Squared Mahalanobis distance per observed coordinate above which a window is unlike all that a mixture knows."""
_EVEN = 1e-6
"""Seconds by which the spacing of observations may differ from ``dt``."""


@dataclasses.dataclass(frozen=True)
class PredictionConfig:
    """How far and how densely the target's future is sampled (paper, Sec. IV)."""

    steps: int = 20
    """N_pred, intervals ahead."""
    dt: float = SPACING
    """Length of an interval [s]; ``default_spacing`` for a room's."""
    batch: int = 20
    """N_batch, samples for each interval, for predictors that sample."""
    observations: int = 10
    """N_obs, positions that are remembered, ``dt`` apart."""
    sigma: float = 0.05
    """sigma_pred [m]: step i of the noisy prediction has the variance i * sigma^2."""
    lost_after: float = 1.0
    """Seconds of silence after which a target counts as lost (arbitrary)."""

    def __post_init__(self) -> None:
        for name in ("steps", "batch", "observations"):
            if getattr(self, name) < 1:
                raise InputError(f"prediction: {name} is {getattr(self, name)}, want at least 1")
        for name in ("dt", "sigma", "lost_after"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError(f"prediction: {name} is {getattr(self, name)}, want a positive number")

    @property
    def offsets(self) -> Float[np.ndarray, "steps"]:
        """Times of the predicted positions [s] from the newest observation."""
        return self.dt * np.arange(1, self.steps + 1)


def default_spacing(world: World) -> float:
    """Seconds between predictions in a room of this size."""
    return SPACING if world.diagonal < LARGE_ROOM else SPACING_IN_LARGE_ROOMS


class Predictor(Protocol):
    """Proposes goal candidates for the target seen so far."""

    def __call__(self, observations: Observations, cycle: int) -> Candidates: ...


class Guess(NamedTuple):
    """What a predictor makes of its observations."""

    prediction: Prediction
    draws: tuple[Float[np.ndarray, "s b 3"], Float[np.ndarray, "s b"]] | None
    """Positions [m] and the logarithms of their densities; None where only the means are proposed."""
    note: Note = Note(0)


Guesser = Callable[[Observations, np.random.Generator], Guess]


@dataclasses.dataclass(frozen=True)
class StepPredictor:
    """A predictor of this module: ``predict`` gives the distribution, a call the candidates of one cycle."""

    config: PredictionConfig
    seed: int
    guess: Guesser

    def predict(self, observations: Observations) -> Prediction:
        """Where the target may be ``config.offsets`` after the newest observation."""
        return self.guess(observations, np.random.default_rng(self.seed)).prediction

    def __call__(self, observations: Observations, cycle: int) -> Candidates:
        """Goals for the coming steps; with the bit TARGET_LOST, and no place, once the target is silent too long."""
        guess = self.guess(observations, np.random.default_rng((self.seed, cycle)))
        offsets = np.asarray(guess.prediction.offsets)
        goals, densities = guess.draws or (
            np.asarray(guess.prediction.means).swapaxes(1, 2),
            np.zeros((len(offsets), 1)),
        )
        candidates = candidates_from(
            observations.positions[-1],
            goals.reshape(-1, 3),
            np.repeat(offsets - observations.age, goals.shape[1]),
            densities.reshape(-1),
        )
        if not observations.age <= self.config.lost_after:
            lost = np.full(len(candidates.reasons), np.uint32(Reason.TARGET_LOST))
            candidates = replace(candidates, goals=np.full_like(candidates.goals, np.nan), reasons=lost)
        return replace(candidates, note=int(guess.note))


def build_predictor(
    name: str,
    config: PredictionConfig,
    truth: Trajectory,
    seed: int = 0,
    model: TargetModel | None = None,
    world: World | None = None,
) -> StepPredictor:
    """The predictor called ``name``; ``truth`` is the target's real motion, which only some may look at.

    Args:
        model: the mixture for ``gmm``; its windows must be those of ``config``, its room that of ``world`` if given.

    Raises:
        InputError: ``name`` is not one of ``PREDICTORS``, or the model does not fit.
    """
    offsets = config.offsets

    def none(observations: Observations, rng: np.random.Generator) -> Guess:
        return Guess(_certain(np.repeat(observations.positions[-1:], config.steps, axis=0), offsets), None)

    def ground_truth(observations: Observations, rng: np.random.Generator) -> Guess:
        return Guess(_certain(truth(observations.times[-1] + offsets), offsets), None)

    def noisy(observations: Observations, rng: np.random.Generator) -> Guess:
        deviations = config.sigma * np.sqrt(np.arange(1, config.steps + 1))
        means = truth(observations.times[-1] + offsets)
        prediction = replace(_certain(means, offsets), factors=deviations[:, None, None, None] * np.eye(3)[:, :, None])
        return Guess(prediction, _draw(prediction, config.batch, rng))

    def straight(observations: Observations, rng: np.random.Generator) -> Guess:
        return Guess(constant_velocity(observations, offsets), None)

    def curved(observations: Observations, rng: np.random.Generator) -> Guess:
        return Guess(constant_acceleration(observations, offsets), None)

    if name not in PREDICTORS:
        raise InputError(f"predictor: unknown name {name!r}, want one of {', '.join(PREDICTORS)}")
    if name == "gmm":
        return StepPredictor(config, seed, _mixture_guesser(config, model, world))
    guessers: dict[str, Guesser] = {
        "none": none,
        "ground-truth": ground_truth,
        "noisy": noisy,
        "constant-velocity": straight,
        "constant-acceleration": curved,
    }
    return StepPredictor(config, seed, guessers[name])


def _mixture_guesser(config: PredictionConfig, model: TargetModel | None, world: World | None) -> Guesser:
    """The conditional mixture; constant velocity where too little was seen, or nothing like it in training."""
    if model is None:
        raise InputError("predictor: gmm needs a target model; give one, see jaxplan train gmm --help")
    check_model(model, observations=config.observations, steps=config.steps, dt=config.dt, world=world)
    prepared = model.prepare()
    on_device = in_float64(jax.device_put)(prepared)
    anchored, offsets, unusual = model.bounds is not None, config.offsets, model.observed * _UNUSUAL

    @in_float64
    def guess(observations: Observations, rng: np.random.Generator) -> Guess:
        if not _complete(observations, config):
            return Guess(constant_velocity(observations, offsets), None, Note.PREDICTOR_FALLBACK)
        newest = observations.positions[-1]
        observed = window_coordinates(observations.positions, config.observations, anchored)
        uniform, normal = _randoms(config.steps, config.batch, rng)
        randoms = np.concatenate([uniform[..., None], normal], axis=-1)
        log_weights, means, scored, distance = conditional_draw(on_device, np.append(newest, observed), randoms)
        if not float(distance) <= unusual:
            return Guess(constant_velocity(observations, offsets), None, Note.PREDICTOR_FALLBACK)
        prediction = Prediction(offsets=offsets, log_weights=log_weights, means=means, factors=prepared.factors)
        drawn = np.asarray(scored)
        return Guess(prediction, (drawn[..., :3], drawn[..., 3]))

    return guess


@jax.jit
def conditional_draw(
    model: ConditionalMixture, seen: Float[Array, "3+q"], randoms: Float[Array, "s b 4"]
) -> tuple[Float[Array, "k"], Float[Array, "s 3 k"], Float[Array, "s b 4"], Float[Array, ""]]:
    """Condition, draw and score in one program: log-weights, means, positions with log-densities, unlikeness.

    Few arguments and results, since each costs some 15 us to hand over: ``seen`` is the newest position and what is
    observed, ``randoms`` a uniform and three normal numbers for each draw.
    """
    log_weights, means, distance = condition(model, seen[3:])
    means = means + seen[:3, None]
    goals = choose(log_weights, means, model.factors, randoms[..., 0], randoms[..., 1:])
    densities = log_density(log_weights, means, model.inverses, model.log_volumes, goals)
    return log_weights, means, jnp.concatenate([goals, densities[..., None]], axis=-1), distance


def _complete(observations: Observations, config: PredictionConfig) -> bool:
    """Whether these are N_obs positions at the intervals that a model was trained on."""
    if len(observations.times) != config.observations:
        return False
    return bool(np.abs(np.diff(observations.times) - config.dt).max(initial=0.0) < _EVEN)


def _certain(positions: Float[np.ndarray, "s 3"], offsets: Float[np.ndarray, "s"]) -> Prediction:
    return Prediction(
        offsets=offsets,
        log_weights=np.zeros(1),
        means=positions[:, :, None],
        factors=np.zeros((len(offsets), 3, 3, 1)),
    )


def _randoms(steps: int, batch: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    normal = rng.standard_normal((steps, batch, 3))
    return rng.random((steps, batch)), normal


@in_float64
def _draw(prediction: Prediction, batch: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    uniform, normal = _randoms(len(prediction.offsets), batch, rng)
    goals, densities = _plain_draw(prediction, scales(np.asarray(prediction.factors)), uniform, normal)
    return np.asarray(goals), np.asarray(densities)


@jax.jit
def _plain_draw(
    prediction: Prediction,
    scale: tuple[Float[Array, "s 3 3 c"], Float[Array, "s c"]],
    uniform: Float[Array, "s b"],
    normal: Float[Array, "s b 3"],
) -> tuple[Array, Array]:
    goals = choose(prediction.log_weights, prediction.means, prediction.factors, uniform, normal)
    return goals, log_density(prediction.log_weights, prediction.means, *scale, goals)
