"""Multi-resolution search: time and path length against the distance, beside the finest lattice alone.

    jaxplan experiment multi-resolution --preset smoke|small|full

Random pairs of free places in each environment stand for defender and target; the goals of one search lie around the
target. The same goals are searched with the paper's rule (which lattice for which distance) and on the finest lattice
without a budget. Paths are pulled taut in both cases. Times are wall times.
"""

import dataclasses
import itertools
import time

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.tables import as_latex, as_markdown, number
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes, warmup
from jaxplan.world.load import ENVIRONMENTS, load_world
from jaxplan.world.obstacles import World

from . import SUMMARIES
from .closed_loop import check_names
from .figures.multi_resolution import draw_multi_resolution

PAPER = SearchConfig(method="multi-resolution")
FINEST = SearchConfig(
    method="multi-resolution", resolutions=(0.1,), distance_fractions=(), first_budget=10**7, last_budget=10**7
)
"""One lattice, searched to the end."""
SPREAD = 0.6
"""Standard deviation [m] of the goals around the target (about that of a mixture's predictions after 1 s)."""
BINS = (0.0, 0.1, 0.2, 0.4, 1.0)
"""Edges of the table's bins of the distance, as shares of the diagonal: the paper's lattices."""
REPEATS = 3


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """How many searches, for how many goals."""

    worlds: tuple[str, ...] = ENVIRONMENTS
    """Stored worlds."""

    pairs: int = 60
    """Searches in each world."""

    goals: int = 400
    """Goals of a search."""

    seed: int = 0
    """Seed of places and goals."""

    def __post_init__(self) -> None:
        check_names(self.worlds, ("no-policy",), ("none",))
        if self.pairs < 1 or self.goals < 1 or self.seed < 0:
            raise InputError("--pairs and --goals: want at least 1; --seed at least 0")


def items(config: Config) -> list[Item]:
    """One item for each world."""
    return [Item(world, world, {"world": world}) for world in config.worlds]


def evaluate(config: Config, item: Item) -> Row:
    """One row for each pair of places."""
    world, rng = load_world(item.values["world"]), np.random.default_rng(config.seed)
    ways = {"multi": build_lattices(world, PAPER), "finest": build_lattices(world, FINEST)}
    grid = ways["finest"].levels[0].grid
    free = grid.origin + (np.argwhere(~grid.occupied) + 0.5) * grid.resolution
    for lattices in ways.values():
        warmup(lattices, world, 32)
    rows = []
    for _ in range(config.pairs):
        start, target = _pair(free, float(world.diagonal), rng)
        goals = target + rng.normal(scale=[SPREAD, SPREAD, 0.3 * SPREAD], size=(config.goals, 3))
        distance = float(np.linalg.norm(target - start))
        found = {name: _search(lattices, world, start, goals, distance) for name, lattices in ways.items()}
        rows.append({"world": world.name, "distance_share": distance / float(world.diagonal), **_compared(found)})
    return {"rows": rows}


def _pair(
    free: Float[np.ndarray, "n 3"], diagonal: float, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Two free places whose distance is about even over the logarithm of the shares of the diagonal."""
    wanted = diagonal * np.exp(rng.uniform(np.log(0.04), np.log(0.8)))
    start = free[rng.integers(len(free))]
    others = free[rng.integers(len(free), size=400)]
    return start, others[np.argmin(np.abs(np.linalg.norm(others - start, axis=1) - wanted))]


def _search(
    lattices: Lattices,
    world: World,
    start: Float[np.ndarray, "3"],
    goals: Float[np.ndarray, "k 3"],
    distance: float,
) -> tuple[float, Float[np.ndarray, "k"]]:
    """The best of several times [ms], and the lengths of the paths [m]; NaN where there is none."""
    spent = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        paths = find_routes(lattices, world, start, goals, distance)
        spent.append(1e3 * (time.perf_counter() - began))
    return min(spent), np.where(np.asarray(paths.reasons) == 0, np.asarray(paths.length), np.nan)


def _compared(found: dict[str, tuple[float, Float[np.ndarray, "k"]]]) -> Row:
    """The two ways beside each other, for one search."""
    (multi_ms, multi), (finest_ms, finest) = found["multi"], found["finest"]
    both = np.isfinite(multi) & np.isfinite(finest) & (finest > 0.0)
    ratio = multi[both] / finest[both]
    return {
        "multi_ms": multi_ms,
        "finest_ms": finest_ms,
        "multi_found": int(np.isfinite(multi).sum()),
        "finest_found": int(np.isfinite(finest).sum()),
        "median_length_ratio": float(np.median(ratio)) if both.any() else None,
        "most_length_ratio": float(ratio.max()) if both.any() else None,
    }


def report(results: Results[Config]) -> Report:
    """A line for each of the paper's bins of the distance, and the picture."""
    rows = [line for row in results.finished_rows() for line in row["rows"]]
    header = ["distance, share of the diagonal", "searches", "multi-resolution [ms]", "finest [ms]", "length ratio"]
    header += ["found by both / by the finest"]
    lines = []
    for low, high in itertools.pairwise(BINS):
        mine = [row for row in rows if low <= row["distance_share"] < high]
        if not mine:
            continue
        multi, finest = ([row[f"{way}_ms"] for row in mine] for way in ("multi", "finest"))
        ratios = [row["median_length_ratio"] for row in mine if row["median_length_ratio"] is not None]
        found = [sum(row[f"{way}_found"] for row in mine) for way in ("multi", "finest")]
        lines.append(
            [
                f"{low:g} to {high:g}",
                str(len(mine)),
                _median_and_largest(multi),
                _median_and_largest(finest),
                number(float(np.mean(ratios)) if ratios else None),
                f"{found[0]} / {found[1]}",
            ]
        )
    markdown = f"{results.config.goals} goals a search; milliseconds: median / largest.\n\n" + as_markdown(
        header, lines
    )
    return Report(
        markdown=markdown + "\n![time and length against distance](multi_resolution.png)\n",
        table=rows,
        latex=as_latex(header, lines, "Multi-resolution search and the finest lattice"),
        figures={"multi_resolution.png": lambda path: draw_multi_resolution(rows, BINS[1:-1], path)},
        summary=markdown,
    )


def _median_and_largest(values: list[float]) -> str:
    return f"{np.median(values):.1f} / {np.max(values):.1f}"


EXPERIMENT = Experiment(
    summary=SUMMARIES["multi-resolution"],
    presets={"smoke": Config(worlds=("env1",), pairs=6, goals=100), "small": Config(), "full": Config(pairs=1000)},
    items=items,
    evaluate=evaluate,
    report=report,
    parallel=False,
)
