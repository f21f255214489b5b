"""An interacting-multiple-model filter: straight on, a fading acceleration, or a turn, whichever explains what is seen.

Blom and Bar-Shalom, The interacting multiple model algorithm for systems with Markovian switching coefficients, IEEE
Transactions on Automatic Control 33(8), 1988; the modes are those of ``jaxplan.prediction.imm_motions``. A state is
position, velocity and acceleration, with one 3 x 3 covariance for all three axes: the spread between modes is shared
out evenly among them, so that the filter has no favourite direction.

The noise of the positions is one of several levels, each with a filter of its own; how likely each makes what was seen
tells which. All functions are pure JAX for one window, in float64 where the caller's JAX has 64-bit types enabled.
Predictors call ``jaxplan.prediction.kernels.beliefs``, the same step by step; tests compare the two.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.numerics import safe_norm
from jaxplan.prediction.imm_motions import MODES, TURN, MotionConfig, liveliness, transition, turn_rate
from jaxplan.records import record, replace

NOISE_LEVELS = (0.003, 0.01, 0.03, 0.08, 0.16, 0.3)
"""Standard deviations [m] of a position: exact, motion capture, ..., a camera from afar (arbitrary)."""
NOISE_SHARES = (0.3, 0.25, 0.2, 0.12, 0.08, 0.05)
"""How likely each is before anything was seen: with two or three positions noise cannot be told from motion."""
_LEAST_WEIGHT = 1e-30
_LOG_TWO_PI = float(np.log(2.0 * np.pi))


@record
class Belief:
    """What the filters know of the target at an instant: l levels of noise, m modes."""

    log_levels: Float[AnyArray, "l"]
    """Logarithms of each level's share times the density of what it was shown [log 1/m^3 for each position]."""
    log_weights: Float[AnyArray, "l m"]
    """Of the modes, normalised for each level."""
    means: Float[AnyArray, "l m 3 3"]
    """Position, velocity and acceleration (rows) [m, m/s, m/s^2, world]."""
    covariances: Float[AnyArray, "l m 3 3"]
    """Of these, the same for each axis."""

    @property
    def shares(self) -> Float[Array, "l m"]:
        """Probability of each level and mode."""
        return jnp.exp(jax.nn.log_softmax(self.log_levels)[:, None] + self.log_weights)


def track(
    config: MotionConfig,
    levels: Float[AnyArray, "l"],
    log_shares: Float[AnyArray, "l"],
    gaps: Float[AnyArray, "n"],
    positions: Float[AnyArray, "n 3"],
    count: Int[AnyArray, ""],
) -> Belief:
    """The beliefs after each position, stacked in the first axis; before the first that counts all are alike.

    Args:
        config: what a plausible target is.
        levels: deviations of the positions' noise [m].
        log_shares: how likely they are.
        gaps: time since the position before [s].
        positions: oldest first [m, world].
        count: how many positions there are, the newest ones; what stands before these may have any finite value.
    """
    place = jnp.arange(len(positions))
    first = len(positions) - count
    later = place > first
    way = safe_norm(positions[-1] - positions[first])
    speed = way / jnp.maximum(jnp.where(later, gaps, 0.0).sum(), 1e-3)
    variances = jnp.stack(
        [
            jnp.asarray(levels) ** 2,
            jnp.full(len(levels), config.speed**2),
            jnp.full(len(levels), liveliness(config, speed).acceleration ** 2),
        ],
        axis=-1,
    )
    start = Belief(
        log_levels=jnp.asarray(log_shares),
        log_weights=jnp.full((len(levels), MODES), -jnp.log(1.0 * MODES)),
        means=jnp.zeros((len(levels), MODES, 3, 3)).at[:, :, 0].set(positions[first]),
        covariances=jnp.repeat((variances[:, :, None] * jnp.eye(3)[None])[:, None], MODES, axis=1),
    )

    def step(belief: Belief, seen: tuple[Array, Array, Array]) -> tuple[Belief, Belief]:
        gap, position, counts = seen
        after = update(levels, predict(config, belief, gap), position)
        kept = jax.tree.map(lambda new, old: jnp.where(counts, new, old), after, belief)
        return kept, kept

    return jax.lax.scan(step, start, (jnp.asarray(gaps), jnp.asarray(positions), later))[1]


def predict(config: MotionConfig, belief: Belief, time: Float[AnyArray, ""]) -> Belief:
    """The belief ``time`` [s] later: modes change hands, and each moves on."""
    mixed = interact(config, belief, time)
    velocity = (jnp.exp(mixed.log_weights)[..., None] * mixed.means[:, :, 1]).sum(axis=1)
    rate = turn_rate(config, mixed.means[:, TURN, 1], mixed.means[:, TURN, 2])
    motions, happens = transition(config, time, safe_norm(velocity), rate)
    means = _product(motions, mixed.means)
    moved = _product(_product(motions, mixed.covariances), jnp.swapaxes(motions, -1, -2))
    return replace(mixed, means=means, covariances=moved + happens)


def interact(config: MotionConfig, belief: Belief, time: Float[AnyArray, ""]) -> Belief:
    """Each mode's state as the mixture of those it may have come from within ``time`` [s] (Blom and Bar-Shalom)."""
    left = -jnp.expm1(-time / config.sojourn)
    change = (1.0 - left - left / (MODES - 1)) * jnp.eye(MODES) + left / (MODES - 1)
    joint = jnp.maximum(jnp.exp(belief.log_weights), _LEAST_WEIGHT)[:, :, None] * change[None]
    weights = joint.sum(axis=1)
    share = (joint / weights[:, None])[..., None, None]
    means = (share * belief.means[:, :, None]).sum(axis=1)
    apart = belief.means[:, :, None] - means[:, None]
    spread = _product(apart, jnp.swapaxes(apart, -1, -2)) / 3.0
    covariances = (share * (belief.covariances[:, :, None] + spread)).sum(axis=1)
    return replace(belief, log_weights=jnp.log(weights), means=means, covariances=covariances)


def update(levels: Float[AnyArray, "l"], belief: Belief, position: Float[AnyArray, "3"]) -> Belief:
    """The belief after a position [m, world] was seen (Joseph's form, which keeps covariances definite)."""
    noise = (jnp.asarray(levels) ** 2)[:, None]
    variance = belief.covariances[..., 0, 0] + noise
    gain = belief.covariances[..., :, 0] / variance[..., None]
    off = jnp.asarray(position)[None, None] - belief.means[..., 0, :]
    means = belief.means + gain[..., :, None] * off[..., None, :]
    rest = jnp.eye(3)[None, None] - gain[..., :, None] * jnp.array([1.0, 0.0, 0.0])[None, None, None]
    covariances = _product(_product(rest, belief.covariances), jnp.swapaxes(rest, -1, -2))
    covariances = covariances + noise[..., None, None] * gain[..., :, None] * gain[..., None, :]
    log_weights = belief.log_weights + _log_density(variance, off)
    density = jax.nn.logsumexp(log_weights, axis=1)
    return Belief(
        log_levels=belief.log_levels + density,
        log_weights=log_weights - density[:, None],
        means=means,
        covariances=covariances,
    )


def log_foreseen(
    config: MotionConfig,
    belief: Belief,
    times: Float[AnyArray, "h"],
    positions: Float[AnyArray, "h 3"],
    tolerances: Float[AnyArray, "l"],
) -> Float[Array, "h"]:
    """Logarithm of the density [1/m^3] that a belief gives to each of h later positions by itself.

    Args:
        config: what a plausible target is.
        belief: at some instant.
        times: from then [s].
        positions: that were seen [m, world].
        tolerances: deviation of these [m], for each level of noise.
    """

    def one(time: Float[Array, ""], position: Float[Array, "3"]) -> Float[Array, ""]:
        there = predict(config, belief, time)
        variance = there.covariances[..., 0, 0] + (jnp.asarray(tolerances) ** 2)[:, None]
        density = _log_density(variance, position[None, None] - there.means[..., 0, :])
        return jax.nn.logsumexp(jax.nn.log_softmax(there.log_levels)[:, None] + there.log_weights + density)

    return jax.vmap(one)(jnp.asarray(times), jnp.asarray(positions))


def _log_density(variance: Float[AnyArray, "*n"], off: Float[AnyArray, "*n 3"]) -> Float[Array, "*n"]:
    """Of an isotropic normal distribution in three dimensions."""
    return -1.5 * (_LOG_TWO_PI + jnp.log(variance)) - 0.5 * (off * off).sum(axis=-1) / variance


def _product(a: Float[AnyArray, "*n 3 3"], b: Float[AnyArray, "*n 3 3"]) -> Float[Array, "*n 3 3"]:
    """Of small matrices: faster than ``@``, which calls a routine for each."""
    product: Float[Array, "*n 3 3"] = (jnp.asarray(a)[..., :, :, None] * b[..., None, :, :]).sum(axis=-2)
    return product
