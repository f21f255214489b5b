"""Flights of the filter and of the learned mixture, as many of each as they have deserved.

Both are asked what they would have said some half a second ago, without the newest positions, and how likely that makes
these: a mixture of models weighted by predictive density (Raftery and others, Technometrics 52(1), 2010), kept to the
window at hand, so that nothing is remembered from one call to the next. The densities are tempered, since errors at
successive steps are one error, and blurred, since what is missed by centimetres is met. A flight unlike those of the
training set, a noisy or an evasive one, so goes over to the filter step by step.

The mixture is conditioned with the noise that the filter found in the positions.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.special import ndtr

from jaxplan.kept import kept
from jaxplan.precision import in_float64
from jaxplan.prediction.imm import log_foreseen, track
from jaxplan.prediction.imm_flights import RANDOMS, Filters, believed_position, filter_flights, outside_of_things
from jaxplan.prediction.imm_motions import USUAL_MOTION, MotionConfig
from jaxplan.prediction.mixture import MODES, ConditionalMixture, condition
from jaxplan.prediction.mixture_predictor import LEAST_SEEN, WindowMixture
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.particles import even_randoms, fastest_seen, flights_proposal, mixture_flights
from jaxplan.prediction.protocol import PredictionConfig, Proposal, Proposer
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
    mixture = WindowMixture(config, model, world)
    uniform, numbers = even_randoms(RANDOMS)
    normal, choice = numbers[:, :MODES], ndtr(numbers[:, MODES])
    room = surroundings_of(world)
    most = min(max(1, round(HINDSIGHT / config.dt)), config.steps, max(1, config.observations - LEAST_SEEN))

    @in_float64
    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        recent = filters.newest(observations)
        held = max(0, min(most, len(recent.times) - LEAST_SEEN))
        believed, flights, levels, foreseen = _filtered(
            motion, most, filters.noise, filters.window(recent), np.array(held), offsets, (uniform, normal)
        )
        start, fastest = outside_of_things(room, np.asarray(believed)), fastest_seen(observations, config)
        noise = noises[int(np.asarray(levels).argmax())]
        given = mixture.given(recent, noise)
        if given is None:
            return flights_proposal(config, room, start, flights, Note.PREDICTOR_FALLBACK, fastest)
        learned, distance = mixture_flights(*given, uniform, normal)
        hindsight = _foreseen(mixture, recent, held, noise, most)
        log_odds = _log_odds(mixture, recent, float(distance), hindsight, np.asarray(foreseen)[:held])
        chosen = np.where((choice < 1.0 / (1.0 + np.exp(-log_odds)))[:, None, None], learned, flights)
        unusual = mixture.is_unusual(recent, float(distance))
        note = Note.PREDICTOR_FALLBACK if unusual else Note(0)
        return flights_proposal(config, room, start, chosen, note, fastest)

    return propose


def _foreseen(
    mixture: WindowMixture, recent: Observations, held: int, noise: float, most: int
) -> Float[Array, "h"] | None:
    """Log-densities [log 1/m^3] that the learned mixture gave to the newest positions without having seen them.

    None where too few are left to ask it.

    Args:
        mixture: as of all flights.
        recent: the window.
        held: how many of its newest positions it is asked for, of ``most`` at most.
        noise: of the positions [m], beyond what the mixture learned with.
        most: how many densities the compiled program computes, whatever ``held``.
    """
    first = len(recent.times) - held
    before = mixture.given(Observations(times=recent.times[:first], positions=recent.positions[:first]), noise)
    if not held or before is None:
        return None
    later = np.resize(recent.positions[first:], (most, 3))
    return _mixture_foresees(*before, later, np.hypot(BLUR, noise))


def _log_odds(
    mixture: WindowMixture,
    recent: Observations,
    distance: float,
    learned: Float[Array, "h"] | None,
    filtered: Float[np.ndarray, "k"],
) -> float:
    """Logarithm of the learned mixture's odds against the filter, between -30 and 30 (host).

    Args:
        mixture: as of all flights.
        recent: the window.
        distance: its squared Mahalanobis distance from the mixture's nearest component.
        learned: as ``_foreseen``.
        filtered: the filter's log-densities of the k newest positions.
    """
    log_odds = PRIOR - 0.5 * TEMPER * max(distance - _UNUSUAL * mixture.coordinates(recent), 0.0)
    if learned is not None:
        log_odds += TEMPER * float((np.asarray(learned)[: len(filtered)] - filtered).sum())
    return float(np.clip(log_odds, -30.0, 30.0))


@functools.partial(kept, static=2)
def _filtered(
    motion: MotionConfig,
    most: int,
    noise: tuple[Float[Array, "l"], Float[Array, "l"]],
    window: tuple[Float[Array, "n"], Float[Array, "n 3"], Int[Array, ""]],
    held: Int[Array, ""],
    offsets: Float[Array, "s"],
    randoms: tuple[Float[Array, "p"], Float[Array, "p r"]],
) -> tuple[Float[Array, "3"], Float[Array, "p s 3"], Float[Array, "l"], Float[Array, "h"]]:
    """Where the target is believed to be, its flights, the levels' log-likelihoods, and what was foreseen.

    The latter are log-densities [log 1/m^3] of ``most`` positions, of which the first ``held`` mean something.
    """
    gaps, positions, _ = window
    beliefs = track(motion, *noise, *window)
    now, then = (jax.tree.map(lambda leaf, at=at: leaf[at], beliefs) for at in (-1, len(gaps) - 1 - held))
    times = jnp.cumsum(gaps)
    later = jnp.minimum(len(gaps) - held + jnp.arange(most), len(gaps) - 1)
    since = times[later] - times[len(gaps) - 1 - held]
    foreseen = log_foreseen(motion, then, since, jnp.asarray(positions)[later], jnp.hypot(BLUR, noise[0]))
    return believed_position(now), filter_flights(motion, now, offsets, *randoms), now.log_levels, foreseen


@jax.jit
def _mixture_foresees(
    model: ConditionalMixture, seen: Float[Array, "p"], positions: Float[Array, "h 3"], tolerance: Float[Array, ""]
) -> Float[Array, "h"]:
    """Log-density [log 1/m^3] that the mixture gives to each of the next positions [m, world], to ``tolerance`` [m].

    ``seen`` is the newest position [m, world] of an older window, and behind it what is observed of that.
    """
    log_weights, means, _ = condition(model, seen[3:])
    factors = jnp.moveaxis(jnp.asarray(model.factors)[: len(positions)], -1, 1)
    spread = factors @ jnp.swapaxes(factors, -1, -2) + tolerance**2 * jnp.eye(3)[None, None]
    lower = jnp.linalg.cholesky(spread)
    off = (positions - seen[None, :3])[:, None] - jnp.swapaxes(means[: len(positions)], 1, 2)
    white = jax.scipy.linalg.solve_triangular(lower, off[..., None], lower=True)[..., 0]
    volumes = jnp.log(jnp.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=-1)
    exponents = log_weights[None] - volumes - 0.5 * (white * white).sum(axis=-1)
    return jax.nn.logsumexp(exponents, axis=-1) - 1.5 * jnp.log(2.0 * jnp.pi)
