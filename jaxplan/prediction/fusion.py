"""Flights of the filter and of the learned mixture, as many of each as they have deserved.

Both are asked what they would have said some half a second ago, without the newest positions, and how likely that makes
these: a mixture of models weighted by predictive density (Raftery and others, Technometrics 52(1), 2010), kept to the
window at hand, so that nothing is remembered from one call to the next. The densities are tempered, since errors at
successive steps are one error, and blurred, since what is missed by centimetres is met. A flight unlike those of the
training set, a noisy or an evasive one, so goes over to the filter step by step.

The mixture is conditioned with the noise that the filter found in the positions.
"""

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
"""Logarithm of the learned mixture's odds before anything is seen."""
LEARNED_NOISE = 0.01
"""m: up to this the noise is what the mixture learned with."""
_UNUSUAL = 3.0
"""Squared Mahalanobis distance per observed coordinate from which on a window counts as unusual."""


def fused_proposer(
    config: PredictionConfig, model: TargetModel, world: World | None, motion: MotionConfig = USUAL_MOTION
) -> Proposer:
    """Flights of both that hit nothing.

    Raises InputError where the model is for other windows than those of ``config``, or for another room.
    """
    filters, offsets = Filters(config), config.offsets
    noises = [0.0 if level <= LEARNED_NOISE else float(level) for level in filters.noise[0]]
    mixture = WindowMixture(config, model, world, on_device=False)
    uniform, numbers = even_randoms(RANDOMS)
    normal, choice = np.ascontiguousarray(numbers[:, :MODES]), ndtr(numbers[:, MODES])
    room = surroundings_of(world)
    most = min(max(1, round(HINDSIGHT / config.dt)), config.steps, max(1, config.observations - LEAST_SEEN))

    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        recent, window = filters.newest(observations), window_of(observations, config)
        held = max(0, min(most, len(window.times) - LEAST_SEEN))
        places = np.searchsorted(recent.times, window.times[-1 - held :])
        shown, held_back = as_shown(recent), int(places[-1] - places[0])
        found = filtered(motion, filters.noise, shown, held_back, BLUR, offsets, (uniform, numbers))
        start, fastest = outside_of_things(room, found.believed), fastest_seen(window, config)
        noise = noises[int(found.log_levels.argmax())]
        given = mixture.given(window, noise)
        if given is None:
            return flights_proposal(config, room, start, found.flights, Note.PREDICTOR_FALLBACK, fastest)
        learned, distance = mixture_flights(*given, uniform, normal)
        foreseen = found.foreseen[places[1:] - places[0] - 1]
        log_odds = _log_odds(mixture, window, distance, _foreseen(mixture, window, held, noise), foreseen)
        chosen = np.where((choice < 1.0 / (1.0 + np.exp(-log_odds)))[:, None, None], learned, found.flights)
        note = Note.PREDICTOR_FALLBACK if mixture.is_unusual(window, distance) else Note(0)
        return flights_proposal(config, room, start, chosen, note, fastest)

    return propose


def _foreseen(mixture: WindowMixture, window: Observations, held: int, noise: float) -> Float[np.ndarray, "h"] | None:
    """Log-densities [log 1/m^3] that the learned mixture gave to the newest positions without having seen them.

    None where too few are left to ask it.

    Args:
        mixture: as of all flights.
        window: the positions that it is conditioned on.
        held: how many of its newest positions it is asked for.
        noise: of the positions [m], beyond what the mixture learned with.
    """
    first = len(window.times) - held
    before = mixture.given(Observations(times=window.times[:first], positions=window.positions[:first]), noise)
    if not held or before is None:
        return None
    model, seen = before
    given = conditioned(model, seen[3:])
    return log_densities(model, given, seen[:3], window.positions[first:], float(np.hypot(BLUR, noise)))


def _log_odds(
    mixture: WindowMixture,
    window: Observations,
    distance: float,
    learned: Float[np.ndarray, "h"] | None,
    foreseen: Float[np.ndarray, "h"],
) -> float:
    """Logarithm of the learned mixture's odds against the filter, between -30 and 30 (host).

    Args:
        mixture: as of all flights.
        window: the positions that it is conditioned on.
        distance: its squared Mahalanobis distance from the mixture's nearest component.
        learned: as ``_foreseen``.
        foreseen: the filter's log-densities of the newest positions.
    """
    log_odds = PRIOR - 0.5 * TEMPER * max(distance - _UNUSUAL * mixture.coordinates(window), 0.0)
    if learned is not None:
        log_odds += TEMPER * float((learned - foreseen).sum())
    return float(np.clip(log_odds, -30.0, 30.0))
