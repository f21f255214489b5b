"""What imitation costs: how far a policy's durations are from the optimiser's, and what follows from the difference.

The error is that of the logarithms, so that short and long flights count alike: of every duration, weighted by its
share of the flight, and of their sum, where too short counts more than too long: labels are at the boundary. Durations
that add up well can still be shared out badly, so that a rotor would have to leave its range: the flight that they give
is solved, and its thrust beyond the limits, of which labels have next to none, counts as well. Where a sequence is
labelled from a second initial state, it is imitated as well, and so is what the change of state does to the total time,
in which errors that both share cancel. States beyond the rotors' limits have no label; there the flight time must only
keep growing with alpha, as the arrival iteration needs.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from jaxplan.arrays import AnyArray
from jaxplan.arrival import sped_up
from jaxplan.minsnap.spline_batch import fit_each
from jaxplan.policy.network import Bottleneck, PolicyNetwork
from jaxplan.policy.neural import allocate_times, read_sequences
from jaxplan.spline import FlatStateBatch
from jaxplan.training.examples import Examples
from jaxplan.validation import require_at_least, require_positive
from jaxplan.vehicle.limits import thrust_limit_margin
from jaxplan.vehicle.params import Vehicle

INSTANTS = 32
"""At which a flight's thrusts are looked at."""
RESERVE = 0.02
"""Share of the range of thrust that flights should stay away from the limits, as the labels do."""
MOST_EXCESS = 0.3
"""Excess [s] beyond which a flight costs no more: it is an outlier."""


@dataclasses.dataclass(frozen=True)
class ImitationConfig:
    """What counts how much."""

    divergence: float = 1e-4
    """Weight of the Kullback-Leibler divergence of the bottleneck (as the predecessors')."""
    total: float = 4.0
    """Weight of the error of the total time."""
    haste: float = 1.25
    """What is added to ``total`` where the total time is too short."""
    response: float = 8.0
    """Weight of the error of the change of the total time with the initial state."""
    growth: float = 4.0
    """Weight of how much too little the flight time grows with alpha (``growth_shortfall``)."""
    excess: float = 0.4
    """Weight of thrust beyond the rotors' limits [1/s]. With 0 no flight is solved, and a step takes half the time."""
    max_yaw_rate: float = 1.5
    """Largest yaw rate of the flights that are solved [rad/s]."""

    def __post_init__(self) -> None:
        require_at_least("pretrain", self, 0.0, "divergence", "total", "haste", "response", "growth", "excess")
        require_positive("pretrain", self, "max_yaw_rate")


def imitation_loss(
    network: PolicyNetwork,
    parameters: Any,
    batch: Examples,
    key: PRNGKeyArray,
    config: ImitationConfig,
    vehicle: Vehicle,
) -> Float[Array, ""]:
    """Squared errors of the log-durations, of the log total time and its response, and what else counts.

    Trace it with 64-bit types: flights are solved in float64; the network stays in float32.

    Args:
        network: the policy's.
        parameters: its weights.
        batch: sequences and their labels.
        key: draws which of them are mirrored, and the bottleneck's noise.
        config: what counts how much.
        vehicle: whose limits thrust may not exceed.
    """
    mirror_key, latent_key = jax.random.split(key)
    batch = _mirrored(batch, mirror_key)
    frame, memory, bottleneck = read_sequences(network, parameters, batch.waypoints, batch.count)
    deviation = jnp.exp(0.5 * bottleneck.log_variance)
    noise = jax.random.normal(latent_key, deviation.shape, deviation.dtype)
    memory = memory._replace(latent=bottleneck.mean + deviation * noise)
    known = jnp.sum(batch.sped_up, axis=0) > 0.0
    alpha = jnp.where(known, batch.alpha, batch.alpha**2)
    found = allocate_times(network, parameters, memory, frame, batch.initial)
    later = allocate_times(network, parameters, memory, frame, sped_up(batch.initial, alpha))
    wanted = _log_total(batch.sped_up) - _log_total(batch.durations)
    change = (_log_total(later) - _log_total(found)).astype(wanted.dtype)
    imitated = _error(later, batch.sped_up, config) + config.response * _huber(change - wanted)
    response = jnp.where(known, imitated, config.growth * _huber(growth_shortfall(change, alpha)))
    labels = jnp.sum(1.0 + known.astype(wanted.dtype))
    imitation = jnp.sum(_error(found, batch.durations, config) + response) / labels
    if config.excess > 0.0:
        beyond = thrust_excess(vehicle, batch, found, config.max_yaw_rate)
        imitation += (config.excess * jnp.mean(jnp.minimum(beyond, MOST_EXCESS))).astype(wanted.dtype)
    return imitation + (config.divergence * jnp.mean(_divergence(bottleneck))).astype(wanted.dtype)


def growth_shortfall(change: Float[Array, "b"], alpha: Float[Array, "b"]) -> Float[Array, "b"]:
    """How far the flight time alpha T(alpha D) is from growing like the square root of alpha, at least.

    Args:
        change: log T(alpha D) - log T(D).
    """
    growth = jnp.log(alpha)
    return jax.nn.relu(0.5 * jnp.abs(growth) - (change + growth) * jnp.sign(growth))


def thrust_excess(
    vehicle: Vehicle, batch: Examples, durations: Float[Array, "m b"], max_yaw_rate: float
) -> Float[Array, "b"]:
    """How far, as a share of its range, and how long [s] each flight's worst rotor would be beyond its limits.

    Less ``RESERVE``: what comes closer to them counts already.
    """
    exact = (batch.initial, batch.waypoints, durations)
    initial, waypoints, times = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), exact)
    splines = fit_each(initial, waypoints, times, max_yaw_rate)
    states = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), splines).states(INSTANTS)
    beyond = jax.nn.relu(RESERVE - thrust_limit_margin(vehicle, states))
    return jnp.mean(beyond, axis=0).astype(durations.dtype) * jnp.sum(durations, axis=0)


def _error(
    durations: Float[Array, "m b"], wanted: Float[AnyArray, "m b"], config: ImitationConfig
) -> Float[Array, "b"]:
    """Loss of each sequence."""
    real = durations > 0.0
    even = real.astype(wanted.dtype)
    share = 0.5 * wanted / (jnp.sum(wanted, axis=0) + 1e-9)[None] + 0.5 * even / jnp.sum(even, axis=0)[None]
    error = jnp.where(real, _log(durations).astype(wanted.dtype) - _log(wanted), 0.0)
    total = _log_total(durations).astype(wanted.dtype) - _log_total(wanted)
    weight = config.total * jnp.where(total < 0.0, config.haste, 1.0)
    return jnp.sum(share * _huber(error), axis=0) + weight * _huber(total)


def _mirrored(batch: Examples, key: PRNGKeyArray) -> Examples:
    """Half of the batch reflected in a vertical plane: a quadrotor flies left as it flies right."""
    side = jnp.where(jax.random.bernoulli(key, 0.5, batch.count.shape), 1.0, -1.0).astype(batch.waypoints.dtype)
    flip = jnp.stack([jnp.ones_like(side), side, jnp.ones_like(side)])[None]
    state = FlatStateBatch(derivatives=batch.initial.derivatives * flip, yaw=batch.initial.yaw * side[None])
    return batch._replace(waypoints=batch.waypoints * flip, initial=state)


def _divergence(bottleneck: Bottleneck) -> Float[Array, "k"]:
    """Kullback-Leibler divergence from the standard normal distribution."""
    mean, log_variance = bottleneck
    return 0.5 * jnp.sum(mean**2 + jnp.exp(log_variance) - 1.0 - log_variance, axis=0)


def _huber(error: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Squared where small, linear where a label is an outlier."""
    return optax.losses.huber_loss(error, delta=0.2)


def _log(x: Float[AnyArray, "*b"]) -> Float[Array, "*b"]:
    return jnp.log(jnp.maximum(x, 1e-3))


def _log_total(durations: Float[AnyArray, "m b"]) -> Float[Array, "b"]:
    return _log(jnp.sum(durations, axis=0))
