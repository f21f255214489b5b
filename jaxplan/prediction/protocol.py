"""What a predictor is: observations in, a distribution over future positions and goal candidates out.

Every predictor looks ``steps`` intervals of ``dt`` ahead (paper, Sec. III-C). Those that are certain propose their
position at each step, the others ``batch`` draws for each, so the number of candidates is fixed when it is built.
``seed`` makes draws repeatable, cycle by cycle. A target that has been silent is predicted from when it was last seen:
what lies in the past by now is rejected, what remains is as uncertain as its age makes it, and after
``PredictionConfig.lost_after`` nothing remains.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.prediction.candidates import Candidates, candidates_from
from jaxplan.prediction.futures import Futures
from jaxplan.prediction.mixture import Prediction
from jaxplan.prediction.observations import Observations, usual_observations
from jaxplan.records import replace
from jaxplan.status import Note, Reason
from jaxplan.validation import require_at_least, require_positive
from jaxplan.world.obstacles import World

LARGE_ROOM = 20.0
"""Room diagonal [m] from which predictions are farther apart (paper, Sec. IV)."""
SPACING = 0.1
SPACING_IN_LARGE_ROOMS = 0.2
"""Seconds between predictions (paper, Sec. IV)."""


@dataclasses.dataclass(frozen=True)
class PredictionConfig:
    """How far and how densely the target's future is sampled (paper, Sec. IV)."""

    steps: int = 20
    """N_pred, intervals ahead."""
    dt: float = SPACING
    """Length of an interval [s]; ``for_world`` knows a room's."""
    batch: int = 20
    """N_batch, samples for each interval, for predictors that sample."""
    observations: int = 10
    """N_obs, positions ``dt`` apart of which a mixture knows the future; filters take all that lie between."""
    sigma: float = 0.05
    """sigma_pred [m]: step i of the noisy prediction has the variance i * sigma^2."""
    lost_after: float = 1.0
    """Seconds of silence after which a target counts as lost (arbitrary)."""
    noise: float | None = None
    """Standard deviation [m] of an observed position, for ``imm`` and ``fused``; None: they find it themselves."""

    def __post_init__(self) -> None:
        require_at_least("prediction", self, 1, "steps", "batch", "observations")
        if self.noise is not None:
            require_positive("prediction", self, "noise")
        require_positive("prediction", self, "dt", "sigma", "lost_after")

    @classmethod
    def for_world(cls, world: World) -> "PredictionConfig":
        """How far and how densely targets are predicted in a room of this size (paper, Sec. IV)."""
        return cls(dt=SPACING if world.diagonal < LARGE_ROOM else SPACING_IN_LARGE_ROOMS)

    @property
    def offsets(self) -> Float[np.ndarray, "steps"]:
        """Times of the predicted positions [s] from the newest observation."""
        return self.dt * np.arange(1, self.steps + 1)


def window_of(observations: Observations, config: PredictionConfig) -> Observations:
    """The newest positions ``dt`` apart, N_obs at most: what mixtures learned to look at."""
    return observations.newest(config.observations, config.dt)


@runtime_checkable
class Predictor(Protocol):
    """Proposes goal candidates for the target seen so far."""

    def __call__(self, observations: Observations, cycle: int) -> Candidates:
        """The candidates of replan cycle number ``cycle``; their arrival times count from now."""


@runtime_checkable
class Searcher(Protocol):
    """A predictor that says where to look for a target that was never seen (``jaxplan.prediction.lookout``)."""

    def look_from(self, now: float, position: Float[np.ndarray, "3"]) -> None:
        """The vehicle is there [m, world] at ``now`` [s]."""

    def __call__(self, observations: Observations | None, cycle: int) -> Candidates:
        """As a ``Predictor``; None: the target was never seen."""


class Draws(NamedTuple):
    """b random positions for each of s steps."""

    positions: Float[np.ndarray, "s b 3"]
    """Metres, world."""
    log_densities: Float[np.ndarray, "s b"]
    """Of these positions [log 1/m^3]."""


class Flights(NamedTuple):
    """Motions of the target that are possible as a whole."""

    start: Float[np.ndarray, "3"]
    """Where it was at the newest observation [m, world]."""
    positions: Float[np.ndarray, "n s 3"]
    """Where each is at the steps [m, world]."""
    weights: Float[np.ndarray, "n"]
    """Their probabilities, to within a factor."""

    def futures(self, offsets: Float[np.ndarray, "s"], age: float) -> Futures:
        """The same, their start included, in times from now; the newest observation is ``age`` [s] old."""
        first = np.broadcast_to(self.start, (len(self.positions), 1, 3))
        return Futures(
            times=np.concatenate([[0.0], offsets]) - age,
            positions=np.concatenate([first, self.positions], axis=1),
            weights=self.weights / self.weights.sum(),
        )


class Proposal(NamedTuple):
    """What a predictor makes of its observations."""

    distribution: Callable[[], Prediction]
    """Where the target may be: made for those who look at it, which a cycle does not."""
    draws: Draws | None
    """The goals that are proposed; None where these are the means of the distribution."""
    note: Note = Note(0)
    flights: Flights | None = None
    """Whole motions, where it knows them."""


@runtime_checkable
class Proposer(Protocol):
    """The part in which predictors differ."""

    def __call__(self, observations: Observations, rng: np.random.Generator) -> Proposal:
        """The distribution after the newest observation, and draws from it where it is not certain."""


@dataclasses.dataclass(frozen=True)
class StepPredictor:
    """A predictor over even steps: ``predict`` gives the distribution, a call the candidates of one cycle."""

    config: PredictionConfig
    seed: int
    propose: Proposer

    def predict(self, observations: Observations) -> Prediction:
        """Where the target may be ``config.offsets`` after the newest observation."""
        return self.propose(observations, np.random.default_rng(self.seed)).distribution()

    def proposal(self, observations: Observations, cycle: int) -> Proposal:
        """What cycle number ``cycle`` makes of these observations; the same whenever it is asked."""
        return self.propose(usual_observations(observations), np.random.default_rng((self.seed, cycle)))

    def __call__(self, observations: Observations, cycle: int) -> Candidates:
        """Goals for the coming steps; with the bit TARGET_LOST, and no place, once the target is silent too long."""
        observations = usual_observations(observations)
        distribution, draws, note, flights = self.proposal(observations, cycle)
        offsets = self.config.offsets
        if draws is None:
            draws = Draws(np.asarray(distribution().means).swapaxes(1, 2), np.zeros((len(offsets), 1)))
        candidates = candidates_from(
            observations.positions[-1],
            draws.positions.reshape(-1, 3),
            np.repeat(offsets - observations.age, draws.positions.shape[1]),
            draws.log_densities.reshape(-1),
        )
        if not observations.age <= self.config.lost_after:
            lost = np.full(len(candidates.reasons), np.uint32(Reason.TARGET_LOST))
            candidates = replace(candidates, goals=np.full_like(candidates.goals, np.nan), reasons=lost)
        elif flights is not None:
            candidates = replace(candidates, futures=flights.futures(offsets, observations.age))
        return replace(candidates, note=int(note))
