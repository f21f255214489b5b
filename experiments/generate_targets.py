"""Make the target trajectories that are stored with a world: minimum snap through free waypoints.

    python -m experiments.generate_targets --world env1 --count 10 --seed 1

Waypoints are drawn uniformly where the clearance is large enough; a trajectory is kept when its whole curve is at least
``MARGIN`` from every obstacle and face. Durations are
proportional to distance: only the shape matters, since a target is time-scaled to the wanted speed.
"""

import json
from pathlib import Path

import cyclopts
import jax
import numpy as np

import jaxplan
from jaxplan.io.targets import target_spline
from jaxplan.numerics import in_float64
from jaxplan.world.clearance import clearance, wall_clearance
from jaxplan.world.scene import load_world

MARGIN = 0.5
"""Least distance [m] from obstacles and faces (so that goals on the trajectory are free in the padded map)."""
REACH = (2.0, 6.0)
"""Shortest and longest step [m] between waypoints."""


def distance_function(world):
    """Distance [m] to the nearest obstacle or face, compiled once for each number of points."""
    compiled = jax.jit(lambda points: jax.numpy.minimum(clearance(world, points), wall_clearance(world, points)))
    return in_float64(lambda points: np.asarray(compiled(points)))


def draw_waypoints(pool, rng, count):
    """A random chain of points of the ``pool`` with steps of moderate length."""
    chain = [rng.integers(len(pool))]
    while len(chain) < count:
        step = np.linalg.norm(pool - pool[chain[-1]], axis=1)
        chain.append(rng.choice(np.flatnonzero((step > REACH[0]) & (step < REACH[1]))))
    return pool[chain]


def trajectory(world, rng, waypoints=7):
    """Waypoints and durations of the first random trajectory that stays free."""
    free_distance = distance_function(world)
    lower, upper = np.asarray(world.bounds)
    pool = rng.uniform(lower + MARGIN, upper - MARGIN, (4096, 3))
    pool = pool[free_distance(pool) > MARGIN + 0.1]
    while True:
        chain = draw_waypoints(pool, rng, waypoints)
        durations = np.linalg.norm(np.diff(chain, axis=0), axis=1)
        spline = target_spline(chain, durations)
        curve = spline.evaluate(np.linspace(0.0, float(spline.duration), 1000))[:, :3]
        if free_distance(curve).min() >= MARGIN:
            return chain, durations


app = cyclopts.App(name="generate_targets", help=__doc__)


@app.default
def main(world: str = "env1", count: int = 10, seed: int = 1, out: Path | None = None) -> None:
    """Write ``<world>_targets.json`` beside the world."""
    room = load_world(world)
    rng = np.random.default_rng(seed)
    trajectories = {}
    for index in range(count):
        waypoints, durations = trajectory(room, rng)
        trajectories[f"{world}-{index + 1:02d}"] = {
            "waypoints": np.round(waypoints, 4).tolist(),
            "durations": np.round(durations, 4).tolist(),
        }
    path = out or Path(jaxplan.__file__).parent / "world" / "environments" / f"{world}_targets.json"
    command = f"python -m experiments.generate_targets --world {world} --count {count} --seed {seed}"
    path.write_text(json.dumps({"command": command, "units": "m, s", "trajectories": trajectories}, indent=1) + "\n")
    print(f"{count} trajectories in {path}")


if __name__ == "__main__":
    app()
