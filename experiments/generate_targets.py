"""Make the target trajectories that are stored with a world: minimum snap through free waypoints.

    python -m experiments.generate_targets --world env1 --count 10 --seed 1
    python -m experiments.generate_targets --world env2 --count 10 --seed 1 --routed

Waypoints are drawn uniformly where the clearance is large enough or, with ``--routed``, set along searched routes
between far places, so that a target passes doors that chance would rarely find. A trajectory is kept when its whole
curve is at least ``MARGIN`` from every obstacle and face. Durations are
proportional to distance: only the shape matters, since a target is time-scaled to the wanted speed.
"""

import itertools
import json
from collections.abc import Callable
from pathlib import Path

import cyclopts
import jax
import numpy as np
from jaxtyping import Float

import jaxplan
from jaxplan.io.targets import target_spline
from jaxplan.precision import in_float64
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.world.clearance import free_distance
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World

MARGIN = 0.5
"""Least distance [m] from obstacles and faces (so that goals on the trajectory are free in the padded map)."""
REACH = (2.0, 6.0)
"""Shortest and longest step [m] between waypoints that are drawn."""
LEG = (0.3, 0.6)
"""Least and largest distance between the places that a route joins, as shares of the room's diagonal."""
ROUTED_WAYPOINTS = 12
"""Points along the three routes, about 3 m apart in the larger rooms; one number, so that the solver compiles once."""


def distance_function(world: World) -> Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n"]]:
    """Distance [m] to the nearest obstacle or face, compiled once for each number of points."""
    compiled = jax.jit(lambda points: free_distance(world, points))
    return in_float64(lambda points: np.asarray(compiled(points)))


def draw_waypoints(
    pool: Float[np.ndarray, "p 3"], rng: np.random.Generator, count: int
) -> Float[np.ndarray, "count 3"]:
    """A random chain of points of the ``pool`` with steps of moderate length."""
    chain = [rng.integers(len(pool))]
    while len(chain) < count:
        step = np.linalg.norm(pool - pool[chain[-1]], axis=1)
        chain.append(rng.choice(np.flatnonzero((step > REACH[0]) & (step < REACH[1]))))
    return pool[chain]


def routed_waypoints(
    world: World, lattices: Lattices, pool: Float[np.ndarray, "p 3"], rng: np.random.Generator
) -> Float[np.ndarray, "n 3"] | None:
    """Points along the way over three far places; None where no way leads to one of them."""
    places = pool[rng.integers(len(pool), size=1)]
    while len(places) < 4:
        step = np.linalg.norm(pool - places[-1], axis=1) / world.diagonal
        place = pool[rng.choice(np.flatnonzero((step > LEG[0]) & (step < LEG[1])))]
        places = np.concatenate([places, place[None]])
    corners = [places[:1]]
    for start, goal in itertools.pairwise(places):
        route = find_routes(lattices, world, start, goal[None], target_distance=float(np.linalg.norm(goal - start)))
        if route.reasons[0]:
            return None
        corners.append(route.points[0, 1 : int(route.count[0])])
    path = np.concatenate(corners)
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    even = np.linspace(0.0, travelled[-1], ROUTED_WAYPOINTS)
    return np.stack([np.interp(even, travelled, path[:, axis]) for axis in range(3)], axis=1)


def trajectory(
    world: World, rng: np.random.Generator, routed: bool, waypoints: int = 7
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "m"]]:
    """Waypoints and durations of the first random trajectory that stays free."""
    distance = distance_function(world)
    lower, upper = np.asarray(world.bounds)
    pool = rng.uniform(lower + MARGIN, upper - MARGIN, (4096, 3))
    pool = pool[distance(pool) > MARGIN + 0.1]
    lattices = build_lattices(world, SearchConfig(method="multi-resolution", padding=MARGIN + 0.3)) if routed else None
    while True:
        if lattices is None:
            chain: Float[np.ndarray, "n 3"] | None = draw_waypoints(pool, rng, waypoints)
        else:
            chain = routed_waypoints(world, lattices, pool, rng)
        if chain is None:
            continue
        durations = np.linalg.norm(np.diff(chain, axis=0), axis=1)
        spline = target_spline(chain, durations)
        curve = np.asarray(spline.evaluate(np.linspace(0.0, float(spline.duration), 1000)))[:, :3]
        if distance(curve).min() >= MARGIN:
            return chain, durations


app = cyclopts.App(name="generate_targets", help=__doc__)


@app.default
def main(world: str = "env1", count: int = 10, seed: int = 1, routed: bool = False, out: Path | None = None) -> None:
    """Write ``<world>_targets.json`` beside the world."""
    room = load_world(world)
    rng = np.random.default_rng(seed)
    trajectories = {}
    for index in range(count):
        waypoints, durations = trajectory(room, rng, routed)
        trajectories[f"{world}-{index + 1:02d}"] = {
            "waypoints": np.round(waypoints, 4).tolist(),
            "durations": np.round(durations, 4).tolist(),
        }
    path = out or Path(jaxplan.__file__).parent / "world" / "environments" / f"{world}_targets.json"
    command = f"python -m experiments.generate_targets --world {world} --count {count} --seed {seed}"
    command += " --routed" if routed else ""
    path.write_text(json.dumps({"command": command, "units": "m, s", "trajectories": trajectories}, indent=1) + "\n")
    print(f"{count} trajectories in {path}")


if __name__ == "__main__":
    app()
