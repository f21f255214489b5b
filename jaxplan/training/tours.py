"""Random tours of a world along searched routes: waypoints for the flights from which predictors learn."""

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.prediction.waypoints import FLIGHTS, WaypointSource
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.obstacles import World

_PLACES = 48
"""Places that the tours of one batch visit."""
_LEGS = 3
_LEG = (0.3, 0.6)
"""Least and largest distance between two places, as shares of the room's diagonal."""
_ROOM_FOR_CURVES = 0.3
"""What routes keep from obstacles beyond the windows' margin [m]: a curve through waypoints swings out."""


def tours(world: World, margin: float, waypoints: int = 12) -> WaypointSource:
    """Flights over far places of a world, with waypoints at even distances along the taut routes between them."""
    lattices = build_lattices(world, SearchConfig(method="multi-resolution", padding=margin + _ROOM_FOR_CURVES))

    def source(rng: np.random.Generator) -> Float[np.ndarray, "n 3 b"]:
        places = _places(world, margin + _ROOM_FOR_CURVES, rng)
        legs = _legs(lattices, world, places)
        starts = [place for place in range(len(places)) if legs[place]]
        if not starts:
            raise InputError(f"world {world.name!r}: no routes between far places were found; want a roomier world")
        flights = [_tour(legs, starts[rng.integers(len(starts))], rng, waypoints) for _ in range(FLIGHTS)]
        return np.stack(flights, axis=-1)

    return source


def _places(world: World, padding: float, rng: np.random.Generator) -> Float[np.ndarray, "p 3"]:
    lower, upper = np.asarray(world.bounds, dtype=float)
    pool = rng.uniform(lower, upper, (64 * _PLACES, 3))
    free = pool[host_free_distance(world, pool) > padding]
    if len(free) < 2:
        raise InputError(
            f"world {world.name!r}: {len(free)} of {len(pool)} random places are clear; want a roomier one"
        )
    return free[:_PLACES]


def _legs(lattices: Lattices, world: World, places: Float[np.ndarray, "p 3"]) -> list[dict[int, np.ndarray]]:
    """For each place the routes to others at a moderate distance, by the other's index."""
    shares = np.linalg.norm(places[:, None] - places, axis=-1) / world.diagonal
    legs: list[dict[int, np.ndarray]] = []
    for place, share in zip(places, shares, strict=True):
        far = np.flatnonzero((share > _LEG[0]) & (share < _LEG[1]))
        legs.append({})
        if len(far):
            routes = find_routes(lattices, world, place, places[far], target_distance=0.5 * world.diagonal)
            reached = zip(far, routes.points, routes.count, routes.reasons, strict=True)
            legs[-1] = {int(to): points[: int(count)] for to, points, count, reason in reached if not reason}
    return legs


def _tour(
    legs: list[dict[int, np.ndarray]], place: int, rng: np.random.Generator, waypoints: int
) -> Float[np.ndarray, "n 3"]:
    """Points at even distances along a few legs in a row."""
    corners: list[np.ndarray] = []
    for _ in range(_LEGS):
        if not legs[place]:
            break
        onward = list(legs[place])[rng.integers(len(legs[place]))]
        corners.append(legs[place][onward][1 if corners else 0 :])
        place = onward
    path = np.concatenate(corners)
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    even = np.linspace(0.0, travelled[-1], waypoints)
    return np.stack([np.interp(even, travelled, path[:, axis]) for axis in range(3)], axis=1)
