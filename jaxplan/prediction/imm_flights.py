"""Whole flights of the target from an interacting-multiple-model filter, and the predictor that proposes them.

A particle has a mode, a state drawn from what that mode believes, and goes on as the mode does, with noise: straight,
with an acceleration that fades, or in a turn. The noise of a whole flight has three numbers for each axis, the weights
of the slowest three cosines in white noise; what is faster hardly moves a position. As in
``jaxplan.prediction.particles``, random numbers are the same in every cycle and nobody flies through walls.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.numerics import safe_norm
from jaxplan.prediction.imm import NOISE_LEVELS, NOISE_SHARES, Belief
from jaxplan.prediction.imm_motions import (
    FADING,
    MODES,
    STRAIGHT,
    TURN,
    USUAL_MOTION,
    MotionConfig,
    liveliness,
    turn_motion,
    turn_rate,
)
from jaxplan.prediction.kernels.flights import COSINES, GRID, LARGEST, LARGEST_EXPONENT, filtered
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.particles import even_randoms, fastest_seen, flights_proposal
from jaxplan.prediction.protocol import PredictionConfig, Proposal, Proposer, window_of
from jaxplan.prediction.survival import Surroundings, surroundings_of
from jaxplan.status import Note
from jaxplan.world.obstacles import World

RANDOMS = 19
"""Normal numbers of a particle: nine for its state, nine for its noise, and one that ``fused`` chooses by."""
_START_CLEARANCE = 0.05
"""m: a target that was seen inside something is put so far in front of it."""
_PUSHES, _SLOPE = 8, 1e-6
"""How often at most it is pushed, and over how many metres to either side the slope of the distance is taken."""


class Filters:
    """The filters of a configuration: the levels of noise, and which positions count."""

    def __init__(self, config: PredictionConfig) -> None:
        self._config = config
        self.noise = (
            (np.array(NOISE_LEVELS), np.log(NOISE_SHARES))
            if config.noise is None
            else (np.array([config.noise]), np.zeros(1))
        )
        """Levels [m], and the logarithms of their shares."""

    def newest(self, observations: Observations) -> Observations:
        """What is looked at of the observations: all of the span that a mixture knows, too."""
        return observations.within(self._config.dt * (self._config.observations - 1))


def as_shown(recent: Observations) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 3"], int]:
    """What the filters are shown (host): gaps [s], positions [m, world], and how many there are."""
    return np.diff(recent.times, prepend=recent.times[0]), recent.positions, len(recent.times)


def imm_proposer(config: PredictionConfig, world: World | None, motion: MotionConfig = USUAL_MOTION) -> Proposer:
    """Flights of the filter that hit nothing, for any number of positions at whatever times."""
    filters, offsets = Filters(config), config.offsets
    randoms = even_randoms(RANDOMS)
    room = surroundings_of(world)

    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        shown = as_shown(filters.newest(observations))
        found = filtered(motion, filters.noise, shown, 0, 0.0, offsets, randoms)
        start = outside_of_things(room, found.believed)
        fastest = fastest_seen(window_of(observations, config), config)
        return flights_proposal(config, room, start, found.flights, Note(0), fastest)

    return propose


def filter_flights(
    config: MotionConfig,
    belief: Belief,
    offsets: Float[AnyArray, "s"],
    uniform: Float[AnyArray, "n"],
    normal: Float[AnyArray, "n r"],
) -> Float[Array, "n s 3"]:
    """Particles [m, world] from a belief, pure JAX: what tests compare ``kernels.flights`` with, which is called.

    Args:
        config: what a plausible target is.
        belief: of the filters, at the newest position.
        offsets: times from then [s], even.
        uniform, normal: numbers in [0, 1) that choose level and mode, and at least 18 standard normal ones each.
    """
    shares = jnp.cumsum(belief.shares.reshape(-1))
    chosen = (jnp.asarray(uniform)[:, None] * shares[-1] >= shares[None, :-1]).sum(axis=1)
    mode: Int[Array, "n"] = chosen % MODES
    factors = _factors(jnp.asarray(belief.covariances).reshape(-1, 3, 3))[chosen]
    normals = jnp.asarray(normal)[:, :18].reshape(-1, 2, 3, 3)
    state = jnp.asarray(belief.means).reshape(-1, 3, 3)[chosen]
    state = state + (factors[:, :, :, None] * normals[:, 0, None]).sum(axis=2)
    position, velocity, acceleration = state[:, 0], state[:, 1], state[:, 2]
    size = safe_norm(acceleration, keepdims=True)
    acceleration = acceleration * jnp.minimum(1.0, LARGEST * config.max_acceleration / jnp.maximum(size, 1e-9))
    speed = safe_norm(velocity)
    fading, times = liveliness(config, speed).fading[:, None], jnp.asarray(offsets)[None]
    turned = turn_motion(times, turn_rate(config, velocity, acceleration)[:, None])
    bent = jnp.where((mode == FADING)[:, None], fading * (times + fading * jnp.expm1(-times / fading)), 0.0)
    bent = jnp.where((mode == TURN)[:, None], turned[:, :, 0, 2], bent)
    onwards = jnp.where((mode == TURN)[:, None], turned[:, :, 0, 1], times)
    mean = position[:, None] + onwards[..., None] * velocity[:, None] + bent[..., None] * acceleration[:, None]
    moved = _noise_response(config, jnp.asarray(offsets), mode, speed)
    flights: Float[Array, "n s 3"] = mean + (moved[..., None] * normals[:, 1, None]).sum(axis=2)
    return flights


def outside_of_things(room: Surroundings, place: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The place itself, or where something is in the way or the room ends, one close by where it is not (host)."""
    around = place + _SLOPE * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    for _ in range(_PUSHES):
        free = room.free_distances(around)
        if not free[0] < 0.5 * _START_CLEARANCE:
            break
        away = (free[1:4] - free[4:]) / (2.0 * _SLOPE)
        around = around + (_START_CLEARANCE - free[0]) * away / max(float(away @ away), 0.1)
    return around[0]


def believed_position(belief: Belief) -> Float[Array, "3"]:
    """Mean position [m, world]."""
    return (belief.shares[..., None] * belief.means[..., 0, :]).sum(axis=(0, 1))


def _noise_response(
    config: MotionConfig, offsets: Float[Array, "s"], mode: Int[Array, "n"], speed: Float[Array, "n"]
) -> Float[Array, "n s c"]:
    """Metres that a unit of each cosine in a mode's white noise has moved each particle."""
    horizon, expected = offsets[-1], liveliness(config, speed)
    grid = (np.arange(GRID) + 0.5) / GRID
    waves = np.cos(np.pi * grid[:, None] * np.arange(COSINES)) * np.where(np.arange(COSINES) == 0, 1.0, np.sqrt(2.0))
    weights = waves * jnp.sqrt(horizon) / GRID
    lag = offsets[:, None] - horizon * grid[None]
    begun = jnp.where((lag > 0.0)[..., None], weights[None], 0.0)
    straight, whole = (lag[..., None] * begun).sum(axis=1), begun.sum(axis=1)
    fading = expected.fading[:, None, None]
    grown = jnp.exp(jnp.minimum(horizon * grid[None] / fading[:, :, 0], LARGEST_EXPONENT))
    left = jnp.tensordot(grown, begun, ((1,), (1,)))
    left = jnp.exp(-offsets[None, :, None] / fading) * left
    turning = 0.5 * (lag[..., None] ** 2 * begun).sum(axis=1)
    responses = (straight[None], fading * (straight[None] - fading * (whole[None] - left)), turning[None])
    sizes = expected.noises(config)
    moved = jnp.zeros((len(speed), len(offsets), COSINES))
    for which in (STRAIGHT, FADING, TURN):
        one = sizes[which][:, None, None] * responses[which]
        moved = jnp.where((mode == which)[:, None, None], one, moved)
    return moved


def _factors(covariances: Float[Array, "k 3 3"]) -> Float[Array, "k 3 3"]:
    """Lower triangular factors; what rounding has made negative on the diagonal counts as 0."""
    a, tiny = covariances, 1e-12
    first = jnp.sqrt(jnp.maximum(a[:, 0, 0], tiny))
    second, third = a[:, 1, 0] / first, a[:, 2, 0] / first
    middle = jnp.sqrt(jnp.maximum(a[:, 1, 1] - second**2, tiny))
    low = (a[:, 2, 1] - second * third) / middle
    last = jnp.sqrt(jnp.maximum(a[:, 2, 2] - third**2 - low**2, tiny))
    zero = jnp.zeros_like(first)
    rows = (first, zero, zero), (second, middle, zero), (third, low, last)
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)
