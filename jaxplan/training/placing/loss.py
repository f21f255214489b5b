"""What a placed plan costs: the time to its meeting, and what it exceeds on the way.

The margins are the optimiser's (``jaxplan.optimizer.margins``), at fewer instants: rotors without and against drag,
tilt, heading, turning, distance to all that is solid. What is exceeded costs seconds: by how much at worst, as the
optimiser has it, and in the mean, which has a slope everywhere.
"""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.numerics import safe_norm
from jaxplan.optimizer.margins import PER_METRE, body_demand, body_margins
from jaxplan.planner import RefinementConfig
from jaxplan.planner.descent import MAX_TILT
from jaxplan.policy.network import PolicyNetwork
from jaxplan.policy.placing import Distance, place_waypoints
from jaxplan.selection import CheckConfig
from jaxplan.spline import FlatStateBatch
from jaxplan.training.placing.problems import Problems, mean_of, solved
from jaxplan.training.placing.vehicles import Fleet
from jaxplan.validation import require_at_least
from jaxplan.vehicle.params import Vehicle

BODY_SAMPLES, PLACE_SAMPLES = 8, 12
"""Instants of a segment at which the body and the distance are looked at."""
CHECKS, REFINED = CheckConfig(), RefinementConfig(dilation=1.06)
"""What the planner keeps to, and its refinements beyond that; placed plans can be flown so much faster."""
RESERVE = 0.02
"""By which margins should be above 0."""
LARGE = 3.0
"""Seconds beyond which what is exceeded counts less: it cannot be helped."""


@dataclasses.dataclass(frozen=True)
class PlacingLoss:
    """What counts how much, in seconds."""

    worst: float = 5.0
    """For a unit by which the worst margin is exceeded."""
    mean: float = 20.0
    """For a unit by which all are in the mean."""
    stopping: float = 0.03
    """For a second until the vehicle rests."""

    def __post_init__(self) -> None:
        require_at_least("placing", self, 0.0, "worst", "mean", "stopping")


class Judged(NamedTuple):
    """Of k plans."""

    loss: Float[Array, "k"]
    meeting: Float[Array, "k"]
    """When they meet [s]."""
    least: Float[Array, "k"]
    """Their worst margin."""
    splines: SplineBatch


def keep_of(vehicles: Vehicle) -> Float[Array, "k"]:
    """Distance [m] that each of k vehicles keeps at rest."""
    return jnp.asarray(vehicles.radius) + (CHECKS.tracking_margin + REFINED.spare)


def judge(
    network: PolicyNetwork, parameters: Any, problems: Problems, fleet: Fleet, distance: Distance, config: PlacingLoss
) -> Judged:
    """Plans by the policy with these weights, and what they cost."""
    placed = place_waypoints(network, parameters, problems.courses, problems.initial)
    splines = solved(problems.initial, placed)
    bodies = _bodies(fleet.vehicles, problems.initial, splines)
    spare = _spare(fleet.vehicles, splines, distance)
    exceeded = jax.nn.relu(RESERVE - bodies), jax.nn.relu(RESERVE - spare)
    worst = jnp.maximum(*(jnp.max(part, axis=0) for part in exceeded))
    mean = jnp.sum(exceeded[0], axis=0) / (len(bodies) / 21) + jnp.mean(exceeded[1], axis=0)
    cost = LARGE * jnp.log1p((config.worst * worst + config.mean * mean) / LARGE)
    meeting = jnp.sum(splines.durations[:-1], axis=0)
    loss = meeting + config.stopping * jnp.sum(splines.durations, axis=0) + cost
    return Judged(loss, meeting, jnp.minimum(jnp.min(bodies, axis=0), jnp.min(spare, axis=0)), splines)


def placing_loss(
    network: PolicyNetwork, parameters: Any, problems: Problems, fleet: Fleet, distance: Distance, config: PlacingLoss
) -> Float[Array, ""]:
    """The mean cost [s] of problems that count."""
    judged = judge(network, parameters, problems, fleet, distance, config)
    return mean_of(judged.loss, problems.good)


def _bodies(vehicles: Vehicle, initial: FlatStateBatch, splines: SplineBatch) -> Float[Array, "n k"]:
    """Margins of the body at all instants."""
    faster = (REFINED.dilation ** np.arange(1.0, 5.0)).astype(splines.durations.dtype)
    states = splines.derivatives(_middles(BODY_SAMPLES))[:, :, 1:] * faster[None, None, :, None, None]
    width = states.shape[-1]
    tilt, pitch = (jnp.float32(np.radians(angle)) for angle in (MAX_TILT, REFINED.max_pitch))

    def margins(vehicle: Vehicle, yaw: Float[Array, ""], rows: Float[Array, "i 4 3"]) -> Float[Array, "i 21"]:
        rate = jnp.minimum(REFINED.max_body_rate, REFINED.max_lag / vehicle.motor_time_constant)
        demands = jax.vmap(functools.partial(body_demand, vehicle, yaw, rate))(rows)
        return body_margins(vehicle, tilt, pitch, demands)

    rows = states.reshape(-1, 4, 3, width)
    found = jax.vmap(margins, in_axes=(0, 0, -1), out_axes=-1)(vehicles, jnp.asarray(initial.yaw)[0], rows)
    return found.reshape(-1, width)


def _spare(vehicles: Vehicle, splines: SplineBatch, distance: Distance) -> Float[Array, "n k"]:
    """Distances beyond what is kept, weighted as the optimiser's."""
    found = splines.derivatives(_middles(PLACE_SAMPLES))[:, :, :2].reshape(-1, 2, 3, splines.durations.shape[1])
    speed = safe_norm(found[:, 1], axis=1)
    kept = (jnp.asarray(vehicles.radius) + REFINED.spare)[None] + CHECKS.margin_at(speed)
    return PER_METRE * (jnp.asarray(distance(found[:, 0])) - kept)


def _middles(count: int) -> Float[np.ndarray, "{count}"]:
    return (np.arange(count) + 0.5) / count
