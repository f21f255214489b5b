"""The placing policy: waypoints as well as times, for many courses at once and for any vehicle (docs/decisions/0035).

A course is a way that is free: a few points at even distances from where the vehicle is to where it meets its target,
and one more where it may come to rest. The network of ``network.py`` moves each of them and allots the times between.
Nothing of it vouches for anything: what comes out is the start of a descent (``jaxplan.optimizer``) and is checked.

It sees a course in a frame of its own: the meeting lies ahead, and what lies to the right is mirrored to the left, so
that turned and mirrored courses get turned and mirrored answers by construction. Beside the course it sees the room
around it (distances and their slopes), the state, how near the target must be passed, and the vehicle in numbers.
"""

import dataclasses
import functools
from typing import Any, NamedTuple, Protocol, cast, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.arrays import AnyArray
from jaxplan.numerics import safe_divide, safe_norm
from jaxplan.policy.features import (
    SEGMENT_FEATURES,
    STATE_FEATURES,
    Frame,
    segment_features,
    sequence_frame,
    state_features,
)
from jaxplan.policy.features import turned as turned_by
from jaxplan.policy.network import Memory, NetworkConfig, PolicyNetwork
from jaxplan.spline import FlatStateBatch
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.report import angular_accelerations, thrust_to_weight

SEGMENTS = 6
"""Of a course, the last one from the meeting to the stop: five or six are best, more are badly conditioned."""
SLOPE_STEP = 0.05
"""By which places are moved to see how the room changes [m] (arbitrary)."""
ROOM_FEATURES = 10
VEHICLE_NUMBERS = 6
OUTPUTS = 4
"""Of each segment: the logarithm of its duration, and where its end moves."""
LOG_RANGE = 4.0
"""Largest logarithm of a duration in units of the course's own."""
SHORTEST = 0.085
"""Duration [s] that every segment has at least; the optimiser's bound is just below."""
INNER_SHARE, INNER_LEAST = 0.6, 0.2
"""An inner point moves by so much of the mean segment and so much more [m] at most (arbitrary)."""
STOP_REACH = 3.0
"""m; the stop at most (arbitrary)."""
FARTHEST_SEEN = 3.0
"""m; room beyond is as good (arbitrary)."""
_SIDE_SPEED = 0.3
"""s: what a speed to one side counts beside the points' places there (arbitrary)."""


class Courses(NamedTuple):
    """k courses, batch axis last."""

    points: Float[AnyArray, "7 3 k"]
    """Start, four inner points, the meeting, the stop [m, world]."""
    room: Float[AnyArray, "12 4 k"]
    """At the six points behind the start and the six middles before them: the distance [m] to all that is solid, and
    how it grows along x, y and z (``look_around``)."""
    meet_radius: Float[AnyArray, "k"]
    """How far from its meeting the target may be passed [m]."""
    vehicle: Float[AnyArray, "6 k"]
    """``vehicle_numbers``."""


class Placed(NamedTuple):
    """What the policy makes of k courses."""

    durations: Float[Array, "6 k"]
    """Seconds."""
    points: Float[Array, "7 3 k"]
    """Where the plans go through [m, world]."""


@runtime_checkable
class Place(Protocol):
    """A placing policy."""

    def __call__(self, courses: Courses, initial: FlatStateBatch, /) -> Placed:
        """Durations and places from the states at the courses' first points, of which only yaw is fixed (traced)."""


@runtime_checkable
class PlaceAgain(Protocol):
    """The same courses from other initial states."""

    def __call__(self, initial: FlatStateBatch, /) -> Placed:
        """As ``Place`` (traced)."""


@runtime_checkable
class PlaceOften(Place, Protocol):
    """A placing policy that reads its courses once."""

    def along(self, courses: Courses, initial: FlatStateBatch) -> PlaceAgain:
        """From states like ``initial``, sped up or slowed down (traced)."""


@runtime_checkable
class Distance(Protocol):
    """Distance to all that is solid."""

    def __call__(self, points: Float[AnyArray, "12 4 3 k"], /) -> Float[AnyArray, "12 4 k"]:
        """Metres from places [m, world]."""


class _Own(NamedTuple):
    """The frames of k courses: turned about the vertical, then mirrored where ``side`` is -1."""

    cos: Float[Array, "k"]
    sin: Float[Array, "k"]
    side: Float[Array, "k"]

    def seen(self, vectors: Float[Array, "*a 3 k"]) -> Float[Array, "*a 3 k"]:
        """World vectors in the frames."""
        return self._mirrored(turned_by(vectors, self.cos, self.sin))

    def told(self, vectors: Float[Array, "*a 3 k"]) -> Float[Array, "*a 3 k"]:
        """The inverse."""
        return turned_by(self._mirrored(vectors), self.cos, -self.sin)

    def _mirrored(self, vectors: Float[Array, "*a 3 k"]) -> Float[Array, "*a 3 k"]:
        one = jnp.ones_like(self.side)
        return vectors * jnp.expand_dims(jnp.stack([one, self.side, one]), tuple(range(vectors.ndim - 2)))


class CoursesRead(NamedTuple):
    """k courses as the decoder needs them."""

    start: Float[Array, "1 3 k"]
    """Their first points [m, world]."""
    points: Float[Array, "7 3 k"]
    """All of them, from there."""
    own: _Own
    frame: Frame
    memory: Memory
    radius: Float[Array, "k"]
    numbers: Float[Array, "6 k"]


def vehicle_numbers(vehicle: Vehicle) -> Float[np.ndarray, "6"]:
    """What a vehicle can, as logarithms near 0 for the preset ``mfrl`` (host).

    Thrust to weight; drag at 5 m/s as a share of the weight; angular accelerations about x and z from hover, relative
    to 100 and 10 rad/s^2; the motors' lag relative to 20 ms; the radius relative to 0.2 m.
    """
    weight = float(vehicle.mass) * float(vehicle.gravity)
    pitch, yaw = angular_accelerations(vehicle)[1:]
    ratios = [
        thrust_to_weight(vehicle) / 3.0,
        0.05 + float(vehicle.drag_coefficient) * 25.0 / weight,
        max(pitch, 1.0) / 100.0,
        max(yaw, 0.1) / 10.0,
        float(vehicle.motor_time_constant) / 0.02,
        float(vehicle.radius) / 0.2,
    ]
    return np.log(np.array(ratios))


def look_around(distance: Distance, points: Float[AnyArray, "7 3 k"]) -> Float[AnyArray, "12 4 k"]:
    """The room along k courses, for ``Courses.room``; works on NumPy and JAX arrays as ``distance`` does."""
    middles = 0.5 * (points[1:] + points[:-1])
    moved = np.concatenate([np.zeros((1, 3)), SLOPE_STEP * np.eye(3)])
    xp: Any = np if isinstance(points, np.ndarray) else jnp
    places = xp.concatenate([points[1:], middles])[:, None] + moved[None, :, :, None].astype(points.dtype)
    found = distance(places)
    return xp.concatenate([found[:, :1], (found[:, 1:] - found[:, :1]) / SLOPE_STEP], axis=1)


@dataclasses.dataclass(frozen=True, eq=False)
class PlacingPolicy:
    """A network with its weights; it computes in float32 whatever comes in."""

    network: PolicyNetwork
    parameters: Any

    def __call__(self, courses: Courses, initial: FlatStateBatch) -> Placed:
        """As ``Place``."""
        return place_waypoints(self.network, self.parameters, courses, initial)

    def along(self, courses: Courses, initial: FlatStateBatch) -> PlaceAgain:
        """As ``PlaceOften``."""
        read = read_courses(self.network, self.parameters, courses, initial)
        return functools.partial(place_from, self.network, self.parameters, read)


def placing_policy(config: NetworkConfig, parameters: Any) -> PlacingPolicy:
    """The policy with these weights."""
    return PlacingPolicy(PolicyNetwork(config, OUTPUTS), parameters)


def place_waypoints(network: PolicyNetwork, parameters: Any, courses: Courses, initial: FlatStateBatch) -> Placed:
    """``Place`` with given weights, differentiable in them; the places have the precision of the courses."""
    return place_from(network, parameters, read_courses(network, parameters, courses, initial), initial)


def read_courses(network: PolicyNetwork, parameters: Any, courses: Courses, initial: FlatStateBatch) -> CoursesRead:
    """What the network needs to know of courses, from the frames that they have with these initial states."""
    start = jnp.asarray(courses.points)[:1]
    points = (jnp.asarray(courses.points) - start).astype(jnp.float32)
    room, radius, numbers, velocity = (
        jnp.asarray(leaf, jnp.float32)
        for leaf in (courses.room, courses.meet_radius, courses.vehicle, initial.derivatives[1])
    )
    own = _own_frame(points, velocity)
    seen = own.seen(points)
    count = jnp.full(radius.shape, float(SEGMENTS + 1), jnp.float32)
    frame = sequence_frame(seen, count)
    features, real = segment_features(seen, count, frame)
    features = jnp.concatenate([features, _room_features(own, room)], axis=1)
    memory, _ = network.apply(parameters, features, real, method="encode")
    return CoursesRead(start, points, own, frame, memory, radius, numbers)


def place_from(network: PolicyNetwork, parameters: Any, read: CoursesRead, initial: FlatStateBatch) -> Placed:
    """Durations and places along courses that were read, from any initial states at their first points."""
    own, points, radius = read.own, read.points, read.radius
    derivatives, yaw = (jnp.asarray(leaf, jnp.float32) for leaf in (initial.derivatives, initial.yaw))
    heading = jnp.arctan2(own.sin, own.cos)
    turns = own.side[None] * jnp.stack([yaw[0] - heading, yaw[1], yaw[2]])
    state = FlatStateBatch(derivatives=own.seen(derivatives), yaw=turns)
    whole = jnp.concatenate([state_features(state, read.frame), jnp.log(radius)[None], read.numbers])
    found = cast(Array, network.apply(parameters, read.memory, whole, method="decode"))
    unit = read.frame.length / SEGMENTS
    durations = SHORTEST + read.frame.nominal[None] * jnp.exp(jnp.clip(found[:, 0], -LOG_RANGE, LOG_RANGE))
    moved = own.told(_in_ball(found[:, 1:]))
    inner = points[1:-2] + (INNER_SHARE * unit + INNER_LEAST)[None, None] * moved[:-2]
    meet = points[-2] + radius[None] * moved[-2]
    stop = points[-1] + radius[None] * moved[-2] + STOP_REACH * moved[-1]
    placed = jnp.concatenate([points[:1], inner, meet[None], stop[None]])
    return Placed(durations, read.start + placed.astype(read.start.dtype))


def start_placing(config: NetworkConfig, key: Array) -> Any:
    """Random weights, a tree as Flax has it."""
    features = jnp.ones((SEGMENTS, SEGMENT_FEATURES + ROOM_FEATURES, 2), jnp.float32)
    state = jnp.ones((STATE_FEATURES + 1 + VEHICLE_NUMBERS, 2), jnp.float32)
    return PolicyNetwork(config, OUTPUTS).init(key, features, features[:, 0] > 0.0, state)


def _own_frame(points: Float[Array, "7 3 k"], velocity: Float[Array, "3 k"]) -> _Own:
    """x to the meeting; the points, and a little the velocity, on the left."""
    ahead = points[-2] - points[0]
    span = safe_norm(ahead[:2], axis=0)
    cos, sin = jnp.where(span > 0.0, safe_divide(ahead[0], span), 1.0), safe_divide(ahead[1], span)
    across = turned_by(jnp.concatenate([points, _SIDE_SPEED * velocity[None]]), cos, sin)[:, 1]
    return _Own(cos, sin, jnp.where(jnp.sum(across, axis=0) < 0.0, -1.0, 1.0).astype(cos.dtype))


def _room_features(own: _Own, room: Float[Array, "12 4 k"]) -> Float[Array, "6 10 k"]:
    """Of each segment: the room at its end, then at its middle."""
    free = jnp.clip(room[:, :1], -0.2, FARTHEST_SEEN)
    found = jnp.concatenate([jnp.log(free + 0.3), 1.0 / (free + 0.5), own.seen(room[:, 1:])], axis=1)
    return jnp.concatenate([found[:SEGMENTS], found[SEGMENTS:]], axis=1)


def _in_ball(vectors: Float[Array, "m 3 k"]) -> Float[Array, "m 3 k"]:
    """Vectors of any length, inside the unit ball."""
    return vectors / jnp.sqrt(1.0 + jnp.sum(vectors * vectors, axis=1, keepdims=True))
