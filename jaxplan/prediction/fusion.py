"""Flights of the filter and of learned ones, as many of each as they have deserved.

Learned are those of a mixture of windows, or those of a network (``jaxplan.prediction.mdn``). Both sides are asked what
they would have said some half a second ago, without the newest positions, and how likely that makes these: a mixture of
models weighted by predictive density (Raftery and others, Technometrics 52(1), 2010), kept to the window at hand, so
that nothing is remembered from one call to the next. The densities are tempered, since errors at successive steps are
one error, and blurred, since what is missed by centimetres is met. A flight unlike those of the training set, a noisy
or an evasive one, so goes over to the filter step by step.

A mixture is conditioned with the noise that the filter found in the positions.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from jaxplan.prediction.imm_flights import RANDOMS, Filters, as_shown, outside_of_things
from jaxplan.prediction.imm_motions import USUAL_MOTION, MotionConfig
from jaxplan.prediction.kernels.flights import filtered
from jaxplan.prediction.kernels.mixture import conditioned, log_densities
from jaxplan.prediction.mixture import MODES
from jaxplan.prediction.mixture_predictor import LEAST_SEEN, WindowMixture
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.particles import even_randoms, fastest_seen, flights_proposal, mixture_flights
from jaxplan.prediction.protocol import PredictionConfig, Proposal, Proposer, window_of
from jaxplan.prediction.survival import surroundings_of
from jaxplan.prediction.target_model import TargetModel
from jaxplan.status import Note
from jaxplan.world.obstacles import World

HINDSIGHT = 0.5
"""Seconds before the newest position from which both are asked for it."""
TEMPER = 0.2
"""Power of the densities. With 0.1 to 0.3 the mixture of both is better than either nearly everywhere."""
BLUR = 0.05
"""m that a prediction may be off without being worse for it."""
PRIOR = 0.5
"""Logarithm of the odds of the learned flights before anything is seen."""
LEARNED_NOISE = 0.01
"""m: up to this the noise is what the mixture learned with."""
_UNUSUAL = 3.0
"""Squared Mahalanobis distance per observed coordinate from which on a window counts as unusual."""


class Foretold(NamedTuple):
    """What somebody who learned says of a window."""

    flights: Float[np.ndarray, "n s 3"]
    """Particles [m, world]."""
    surprise: float
    """How much more unlike all that was learned the window is than a usual one, in squared Mahalanobis distance."""
    note: Note
    foreseen: Float[np.ndarray, "h"] | None
    """Log-densities [log 1/m^3] given to the newest positions without having seen them; None where too few are left."""


@runtime_checkable
class Learned(Protocol):
    """Foretells flights as it learned them."""

    def __call__(self, window: Observations, held: int, noise: float) -> Foretold | None:
        """None where too little was seen.

        Args:
            window: the newest positions, as ``window_of`` cuts them.
            held: for how many of the newest it says what it would have said without them.
            noise: standard deviation of the positions [m], beyond what it learned with.
        """


def fused_proposer(
    config: PredictionConfig, learned: Learned, world: World | None, motion: MotionConfig = USUAL_MOTION
) -> Proposer:
    """Flights of the filter and of somebody who learned that hit nothing."""
    filters, offsets = Filters(config), config.offsets
    noises = [0.0 if level <= LEARNED_NOISE else float(level) for level in filters.noise[0]]
    uniform, numbers = even_randoms(RANDOMS)
    choice, room = ndtr(numbers[:, MODES]), surroundings_of(world)
    most = min(max(1, round(HINDSIGHT / config.dt)), config.steps, max(1, config.observations - LEAST_SEEN))

    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        recent, window = filters.newest(observations), window_of(observations, config)
        held = max(0, min(most, len(window.times) - LEAST_SEEN))
        places = np.searchsorted(recent.times, window.times[-1 - held :])
        shown, held_back = as_shown(recent), int(places[-1] - places[0])
        found = filtered(motion, filters.noise, shown, held_back, BLUR, offsets, (uniform, numbers))
        start, fastest = outside_of_things(room, found.believed), fastest_seen(window, config)
        told = learned(window, held, noises[int(found.log_levels.argmax())])
        if told is None:
            return flights_proposal(config, room, start, found.flights, Note.PREDICTOR_FALLBACK, fastest)
        log_odds = _log_odds(told, found.foreseen[places[1:] - places[0] - 1])
        chosen = np.where((choice < 1.0 / (1.0 + np.exp(-log_odds)))[:, None, None], told.flights, found.flights)
        return flights_proposal(config, room, start, chosen, told.note, fastest)

    return propose


def learned_mixture(config: PredictionConfig, model: TargetModel, world: World | None) -> Learned:
    """A mixture of windows.

    Raises InputError where the model is for other windows than those of ``config``, or for another room.
    """
    mixture = WindowMixture(config, model, world, on_device=False)
    uniform, numbers = even_randoms(RANDOMS)
    normal = np.ascontiguousarray(numbers[:, :MODES])

    def learned(window: Observations, held: int, noise: float) -> Foretold | None:
        given = mixture.given(window, noise)
        if given is None:
            return None
        flights, distance = mixture_flights(*given, uniform, normal)
        surprise = max(distance - _UNUSUAL * mixture.coordinates(window), 0.0)
        note = Note.PREDICTOR_FALLBACK if mixture.is_unusual(window, distance) else Note(0)
        return Foretold(flights, surprise, note, _foreseen(mixture, window, held, noise))

    return learned


def before_the_newest(window: Observations, held: int) -> Observations:
    """The window without its newest ``held`` positions."""
    first = len(window.times) - held
    return Observations(times=window.times[:first], positions=window.positions[:first])


def _foreseen(mixture: WindowMixture, window: Observations, held: int, noise: float) -> Float[np.ndarray, "h"] | None:
    """As of ``Foretold``; arguments as of ``Learned``."""
    before = mixture.given(before_the_newest(window, held), noise)
    if not held or before is None:
        return None
    model, seen = before
    given = conditioned(model, seen[3:])
    return log_densities(model, given, seen[:3], window.positions[-held:], float(np.hypot(BLUR, noise)))


def _log_odds(told: Foretold, foreseen: Float[np.ndarray, "h"]) -> float:
    """Logarithm of the odds of learned flights, between -30 and 30 (host); ``foreseen`` is what the filter foresaw."""
    log_odds = PRIOR - 0.5 * TEMPER * told.surprise
    if told.foreseen is not None:
        log_odds += TEMPER * float((told.foreseen - foreseen).sum())
    return float(np.clip(log_odds, -30.0, 30.0))
