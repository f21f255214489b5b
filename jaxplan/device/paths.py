"""Shortest ways in a room to many goals at once, read off the distances between all places of its roadmap.

The way to a goal is straight where the start sees it. Else it goes over the place i that sees the goal and makes

    min_j (|s - p_j| + lengths[j, i]) + |p_i - g|        j: a place that the start sees

least: a product of the row of distances from the start with the matrix of all pairs, in the semiring of minimum and
sum, then a minimum over i. Places are tried in the order of that sum, for all goals at a time, until each goal is seen;
where that takes too long, in the order of their distances from the goal. The goal is then joined to the first corner
of its way that it sees.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplan.device.room import Room
from jaxplan.numerics import safe_norm
from jaxplan.world.clearance import clearance_at_once, wall_clearance

LOOKS = 24
"""Points of a line of sight that are looked at (arbitrary: what flies there is checked without gaps)."""
SLACK = 0.02
"""m; by how much such a point may be nearer to obstacles than the padding: lines run along the padding (arbitrary)."""
TRIES = 24
"""Places that are tried for each goal at most, in either order (arbitrary)."""
HOPS = 12
"""Places on the longest way (arbitrary)."""


class Ways(NamedTuple):
    """From one start to k goals."""

    points: Float[Array, "k l 3"]
    """Corners [m, world]: the start, places, the goal, which is repeated."""
    length: Float[Array, "k"]
    """[m]; infinite where none was found."""
    found: Bool[Array, "k"]


class _Try(NamedTuple):
    """Carry of the search for places that see the goals."""

    place: Int[Array, "k"]
    """The one that was found."""
    key: Float[Array, "k"]
    """The largest that was tried."""
    found: Bool[Array, "k"]
    tries: Int[Array, ""]


def shortest_ways(room: Room, start: Float[Array, "3"], goals: Float[Array, "k 3"], at_once: int = 1) -> Ways:
    """Ways from a start to goals [m, world] that keep the padding, or what start and goal keep where that is less.

    ``at_once`` places are tried for each goal at a time: one is soonest on a CPU, several where work is free.
    """
    begin, goals = start.astype(jnp.float32), goals.astype(jnp.float32)
    places = jnp.asarray(room.places)
    straight = sees(room, jnp.broadcast_to(begin, goals.shape), goals)
    seen = sees(room, jnp.broadcast_to(begin, places.shape), places)
    first = jnp.where(seen, safe_norm(places - begin[None]), jnp.inf)
    over = first[:, None] + room.lengths
    entered = jnp.argmin(over, axis=0).astype(jnp.int32)  # one reduction: two would keep all sums of a batch
    to_place = first[entered] + jnp.asarray(room.lengths)[entered, jnp.arange(places.shape[0])]
    apart = safe_norm(places[None] - goals[:, None])
    reached = jnp.where(jnp.isfinite(to_place)[None], apart, jnp.inf)
    seen_from = _places_that_see(room, (to_place[None] + apart, reached), goals, straight, at_once)
    place = seen_from.place
    points, whole = _corners(room, begin, goals, straight, entered[place], place)
    points = _joined_early(room, points)
    found = straight | (seen_from.found & whole)
    length = jnp.sum(safe_norm(jnp.diff(points, axis=1)), axis=1)
    return Ways(points, jnp.where(found, length, jnp.inf), found)


def sees(room: Room, a: Float[Array, "n 3"], b: Float[Array, "n 3"], strictly: bool = False) -> Bool[Array, "n"]:
    """Whether the segments from a to b [m, world] each keep their distances, as far as the points tell.

    Where an end is nearer to an obstacle or to a face than paths are, the segment keeps what that end keeps; where
    ``strictly`` is true only a may be nearer.
    """
    shares = jnp.linspace(0.0, 1.0, LOOKS, dtype=a.dtype)
    points = a[:, None] + shares[None, :, None] * (b - a)[:, None]
    free, inside = clearance_at_once(room.world, points), wall_clearance(room.world, points)
    end = 0 if strictly else -1
    from_obstacles = jnp.minimum(room.padding, jnp.minimum(free[:, 0], free[:, end])) - SLACK
    from_faces = jnp.minimum(room.from_faces, jnp.minimum(inside[:, 0], inside[:, end])) - 1e-4
    return jnp.all((free >= jnp.maximum(from_obstacles, 0.0)[:, None]) & (inside >= from_faces[:, None]), axis=1)


def _places_that_see(
    room: Room,
    orders: tuple[Float[Array, "k n"], Float[Array, "k n"]],
    goals: Float[Array, "k 3"],
    done: Bool[Array, "k"],
    at_once: int,
) -> _Try:
    """For each goal that is not ``done`` the place with the least key that sees it; infinite keys are not tried.

    Keys are those of the first of the ``orders``, and after so many tries of the second.
    """
    places, at_once = jnp.asarray(room.places), min(at_once, room.places.shape[0])
    none = jnp.zeros(goals.shape[0], jnp.int32)
    first = -(-TRIES // at_once) * at_once

    def unfinished(search: _Try) -> Bool[Array, ""]:
        return (search.tries < 2 * first) & jnp.any(~search.found)

    def step(search: _Try) -> _Try:
        keys = jnp.where(search.tries < first, *orders)
        tried_before = jnp.where(search.tries == first, -1.0, search.key)
        least, tried = _least(jnp.where(keys > tried_before[:, None], keys, jnp.inf), at_once)
        ends = jnp.repeat(goals[:, None], at_once, axis=1)
        seeing = sees(room, places[tried].reshape(-1, 3), ends.reshape(-1, 3)).reshape(tried.shape)
        seeing &= least < jnp.inf
        chosen = jnp.argmax(seeing, axis=1)
        place = jnp.take_along_axis(tried, chosen[:, None], axis=1)[:, 0].astype(jnp.int32)
        return _Try(
            place=jnp.where(search.found, search.place, place),
            key=least[:, -1],
            found=search.found | jnp.any(seeing, axis=1),
            tries=search.tries + at_once,
        )

    start = _Try(none, jnp.full(goals.shape[0], -1.0, goals.dtype), done, jnp.int32(0))
    return jax.lax.while_loop(unfinished, step, start)


def _least(keys: Float[Array, "k n"], count: int) -> tuple[Float[Array, "k c"], Int[Array, "k c"]]:
    """The least keys of each row in order, and where they are: a few passes cost less than sorting whole rows."""
    least, places = [], []
    for _ in range(count):
        least.append(jnp.min(keys, axis=1))
        places.append(jnp.argmin(keys, axis=1).astype(jnp.int32))
        keys = jnp.where(keys > least[-1][:, None], keys, jnp.inf)
    return jnp.stack(least, axis=1), jnp.stack(places, axis=1)


def _joined_early(room: Room, points: Float[Array, "k l 3"]) -> Float[Array, "k l 3"]:
    """The same ways without the corners behind the first one that sees the goal."""
    count, corners, _ = points.shape
    goals = points[:, -1]
    from_corners = jnp.repeat(goals[:, None], corners, axis=1)
    visible = sees(room, points.reshape(-1, 3), from_corners.reshape(-1, 3)).reshape(count, corners)
    behind = jnp.arange(corners)[None] > jnp.argmax(visible, axis=1)[:, None]
    return jnp.where(behind[..., None], from_corners, points)


def _corners(
    room: Room,
    begin: Float[Array, "3"],
    goals: Float[Array, "k 3"],
    straight: Bool[Array, "k"],
    entered: Int[Array, "k"],
    left: Int[Array, "k"],
) -> tuple[Float[Array, "k l 3"], Bool[Array, "k"]]:
    """The ways' corners, and whether all of them fit: from the places where they are ``entered`` to those ``left``."""
    onward, places = jnp.asarray(room.onward), jnp.asarray(room.places)

    def hop(place: Int[Array, "k"], _: None) -> tuple[Int[Array, "k"], Int[Array, "k"]]:
        return jnp.where(place == left, place, onward[place, left]), place

    end, hops = jax.lax.scan(hop, entered, None, length=HOPS)
    passed = jnp.concatenate([jnp.zeros_like(hops[:1], bool), hops[:-1] == left[None]])  # the last one is behind it
    between = jnp.where((passed | straight[None])[..., None], goals[None], places[hops])
    first = jnp.broadcast_to(begin, goals.shape)
    return jnp.moveaxis(jnp.concatenate([first[None], between, goals[None]]), 0, 1), end == left
