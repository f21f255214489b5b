"""Tune the knots: how far minimum snap strays from its path, against how many segments it costs.

    jaxplan experiment tune-knots --preset smoke|small|full

Random pairs of free points in the three environments are joined by taut routes. For each pair of k_d,min and k_c,min
every route gets its knots and a minimum-snap trajectory from rest to rest at a constant mean speed, and the deviation
test of the planner is made on it. The choice is the fewest segments whose share of rejected trajectories is within two
percentage points of the least one.
"""

import dataclasses
import itertools
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.knots import KnotConfig, select_routes
from jaxplan.minsnap.single import minimum_snap
from jaxplan.precision import in_float64
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.tables import as_latex, as_markdown, number
from jaxplan.search.lattice import SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.world.load import ENVIRONMENTS, load_world

from . import SUMMARIES
from .figures.knots import draw_knot_tuning

DISTANCES = (1.0, 1.5, 2.0, 3.0, 4.0)
"""Values of k_d,min [m] that are tried."""
TURNINGS = (0.12, 0.25, 0.5, 1.0)
"""Values of k_c,min [rad] that are tried."""
ALLOWED = 0.5
"""Deviation [m] that the paper allows."""


class Outcome(NamedTuple):
    """One setting over all routes."""

    distance: float
    turning: float
    segments: float
    """Mean number."""
    median: float
    """Deviation [m]."""
    rejected: float
    """Share of trajectories that stray by more than ``ALLOWED``."""


def random_routes(pairs: int, seed: int) -> list[Float[np.ndarray, "p 3"]]:
    """Taut routes [m] between random free points, about as many from each environment; straight ones are left out."""
    routes: list[tuple[str, Float[np.ndarray, "p 3"]]] = []
    for name in ENVIRONMENTS:
        world = load_world(name)
        lattices, rng = build_lattices(world, SearchConfig(method="multi-resolution")), np.random.default_rng(seed)
        grid = lattices.levels[0].grid
        free = grid.origin + (np.argwhere(~grid.occupied) + 0.5) * grid.resolution
        while sum(owner == name for owner, _ in routes) < pairs // len(ENVIRONMENTS):
            start, goal = free[rng.integers(len(free), size=2)]
            found = find_routes(lattices, world, start, goal[None], float(np.linalg.norm(goal - start)))
            if found.reasons[0] == 0 and found.count[0] > 2:
                routes.append((name, found.points[0]))
    return [route for _, route in routes]


@in_float64
def outcome(routes: list[Float[np.ndarray, "p 3"]], distance: float, turning: float) -> Outcome:
    """Segments and deviations of all routes for one setting."""
    config = KnotConfig(distance_per_knot=distance, turning_per_knot=turning)
    select = jax.jit(lambda path: select_routes(path[None], config))
    deviations, segments = [], []
    for path in routes:
        route = jax.tree.map(lambda leaf: np.asarray(leaf)[0], select(path))
        waypoints = route.knots.waypoints[: int(route.knots.count)]
        durations = np.maximum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1), 1e-3)
        curve = minimum_snap(waypoints, durations)
        points = np.asarray(curve.evaluate(np.linspace(0.0, float(curve.duration), 400)))[:, :3]
        deviations.append(distance_to_path(points, route.samples).max())
        segments.append(len(durations))
    found = np.array(deviations)
    rejected = float(np.mean(found > ALLOWED))
    return Outcome(distance, turning, float(np.mean(segments)), float(np.median(found)), rejected)


def distance_to_path(points: Float[np.ndarray, "n 3"], path: Float[np.ndarray, "s 3"]) -> Float[np.ndarray, "n"]:
    """From each point to the nearest point of a polyline [m]."""
    edges = np.diff(path, axis=0)
    squares = np.maximum((edges**2).sum(axis=1), 1e-12)
    offset = points[:, None] - path[:-1]
    share = np.clip((offset * edges).sum(axis=2) / squares, 0.0, 1.0)
    return np.linalg.norm(offset - share[..., None] * edges, axis=2).min(axis=1)


def choose(outcomes: list[Outcome]) -> Outcome:
    """The fewest segments among the settings that reject hardly more than the best one."""
    least = min(item.rejected for item in outcomes)
    return min((item for item in outcomes if item.rejected <= least + 0.02), key=lambda item: item.segments)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Over how many routes the knots are tuned."""

    pairs: int = 120
    """Routes, a third in each environment."""

    seed: int = 0
    """Seed of their ends."""

    def __post_init__(self) -> None:
        if self.pairs < len(ENVIRONMENTS) or self.seed < 0:
            raise InputError(f"--pairs {self.pairs} --seed {self.seed}: want at least {len(ENVIRONMENTS)} and 0")


def items(config: Config) -> list[Item]:
    """One item: all settings see the same routes."""
    return [Item("settings", "routes", {})]


def evaluate(config: Config, item: Item) -> Row:
    """Every setting on the same routes."""
    routes = random_routes(config.pairs, config.seed)
    settings = itertools.product(DISTANCES, TURNINGS)
    return {"rows": [outcome(routes, *setting)._asdict() for setting in settings]}


def report(results: Results[Config]) -> Report:
    """A line for each setting, the one chosen, and the picture."""
    (found,) = results.finished_rows()
    rows = found["rows"]
    outcomes = [Outcome(**row) for row in rows]
    chosen = choose(outcomes)
    header = ["k_d,min [m]", "k_c,min [rad]", "segments", "median deviation [m]", f"above {ALLOWED:g} m"]
    lines = [
        [f"{o.distance:g}", f"{o.turning:g}", f"{o.segments:.2f}", number(o.median), f"{o.rejected:.1%}"]
        for o in outcomes
    ]
    choice = f"Chosen: k_d,min = {chosen.distance:g} m, k_c,min = {chosen.turning:g} rad.\n"
    curves = {f"k_c,min = {turning:g} rad": [o for o in outcomes if o.turning == turning] for turning in TURNINGS}
    markdown = as_markdown(header, lines) + "\n" + choice
    return Report(
        markdown=markdown + "\n![deviation against segments](knots.png)\n",
        table=rows,
        latex=as_latex(header, lines, "Settings of the knots"),
        figures={"knots.png": lambda path: draw_knot_tuning(curves, chosen, path)},
        summary=markdown,
    )


EXPERIMENT = Experiment(
    summary=SUMMARIES["tune-knots"],
    presets={"smoke": Config(pairs=9), "small": Config(), "full": Config(pairs=1200)},
    items=items,
    evaluate=evaluate,
    report=report,
    parallel=False,
)
