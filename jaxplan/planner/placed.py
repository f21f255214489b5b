"""Waypoints and times of many candidates at once by the placing policy, each slowed down until it meets its target.

The policy moves the points of a course of six segments along the searched path, and allots their times. As with times
alone (``jaxplan.arrival``), what it gives for initial derivatives that are alpha times as slow takes alpha times as
long: alpha is matched to the target's arrival, and the points are those of that alpha.
"""

import functools
from typing import Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.arrays import AnyArray
from jaxplan.arrival import Arrival, ArrivalConfig, match_arrival, sped_up
from jaxplan.kept import kept
from jaxplan.planner.refined import RefinementConfig
from jaxplan.planner.stations import Routes
from jaxplan.planner.validator import Room
from jaxplan.policy.placing import SEGMENTS, Courses, Place, PlaceAgain, PlaceOften, look_around
from jaxplan.prediction.candidates import Candidates, mean_motion
from jaxplan.spline import FlatState, FlatStateBatch


@runtime_checkable
class MatchPlaced(Protocol):
    """Durations that arrive at given times, and the points that they belong to."""

    def __call__(
        self, state: FlatState, courses: Courses, arrival_times: Float[AnyArray, "k"]
    ) -> tuple[Arrival, Float[Array, "7 3 k"]]:
        """Times in s, points in m (world)."""


def build_match_placed(place: Place, config: ArrivalConfig) -> MatchPlaced:
    """Compiled for as many courses as it is first asked; no plan is faster than the policy has it."""

    @kept
    def matched(
        state: FlatState, courses: Courses, arrival_times: Float[Array, "k"]
    ) -> tuple[Arrival, Float[Array, "7 3 k"]]:
        ones = jnp.ones_like(arrival_times)
        again = _along(place, courses, sped_up(state, ones))

        def decode(initial: FlatStateBatch) -> Float[Array, "6 k"]:
            return again(initial).durations.astype(arrival_times.dtype)

        meet = jnp.full(arrival_times.shape, SEGMENTS - 1, jnp.int32)
        arrival = match_arrival(decode, state, arrival_times, config, meet, ones)
        return arrival, again(sped_up(state, jnp.maximum(arrival.alpha, 1.0))).points

    return matched  # type: ignore[no-any-return]


def _along(place: Place, courses: Courses, initial: FlatStateBatch) -> PlaceAgain:
    """The policy for these courses: read once where it can."""
    return place.along(courses, initial) if isinstance(place, PlaceOften) else functools.partial(place, courses)


def courses_along(
    routes: Routes, room: Room, meet_radius: Float[np.ndarray, "k"], numbers: Float[np.ndarray, "6"]
) -> tuple[Courses, Routes]:
    """Courses along k routes, cut evenly up to their goals, and the routes with the courses' points (host).

    Args:
        routes: with a stop point behind each goal, or none.
        room: for what is around the courses.
        meet_radius: how far from their goals the targets may be passed [m].
        numbers: of the vehicle that flies (``vehicle_numbers``).
    """
    samples, waypoints, count, meet = (
        np.asarray(leaf) for leaf in (routes.samples, routes.waypoints, routes.count, routes.meet)
    )
    goal, last = (np.take_along_axis(waypoints, at[None, None], axis=0) for at in (meet, count - 1))
    points, width = np.concatenate([_even(samples, goal[0], last[0]), goal, last]), len(count)

    def distance(places: Float[AnyArray, "12 4 3 k"]) -> Float[AnyArray, "12 4 k"]:
        return room.free_distance(np.moveaxis(np.asarray(places), 2, -1).reshape(-1, 3)).reshape(12, 4, -1)

    courses = Courses(
        points=points,
        room=look_around(distance, points),
        meet_radius=meet_radius,
        vehicle=np.repeat(numbers[:, None], width, axis=1),
    )
    number = np.asarray(routes.count).dtype
    placed = routes._replace(
        waypoints=points, count=np.full(width, SEGMENTS + 1, number), meet=np.full(width, SEGMENTS - 1, number)
    )
    return courses, placed


def _even(
    samples: Float[np.ndarray, "s 3 k"], goal: Float[np.ndarray, "3 k"], stop: Float[np.ndarray, "3 k"]
) -> Float[np.ndarray, "5 3 k"]:
    """Points at even steps from the start until before the goal, of samples that go on to a stop."""
    whole = np.linalg.norm(np.diff(samples, axis=0), axis=1).sum(axis=0)
    beyond = np.linalg.norm(stop - goal, axis=0) / np.maximum(whole, 1e-9)
    shares = np.linspace(0.0, 1.0, SEGMENTS)[:-1, None] * np.clip(1.0 - beyond, 0.0, 1.0)[None]
    at = shares * (len(samples) - 1.0)
    low = np.clip(at.astype(int), 0, len(samples) - 2)[:, None]
    share = at[:, None] - low
    return (1.0 - share) * np.take_along_axis(samples, low, axis=0) + share * np.take_along_axis(
        samples, low + 1, axis=0
    )


def meet_radii(
    candidates: Candidates, times: Float[np.ndarray, "k"], config: RefinementConfig | None
) -> Float[np.ndarray, "k"]:
    """How far from their goals targets may be passed at these times [m]: as by refined plans."""
    limits = config or RefinementConfig()
    instants, _, spread = mean_motion(candidates)
    return np.maximum(limits.meet_radius - limits.caution * np.interp(times, instants, spread), limits.least_radius)
