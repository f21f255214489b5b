"""How many times as fast as a peer of the same run: numbers that another machine, or a busy one, changes least."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

Rows = Sequence[Mapping[str, Any]]


class Value(NamedTuple):
    """A number of a benchmark: the field of the first row that has all of these values."""

    row: Mapping[str, Any]
    field: str

    def of(self, rows: Rows) -> float | None:
        """None where no row has it."""
        for row in rows:
            if self.field in row and all(str(row.get(key, "")).startswith(str(is_)) for key, is_ in self.row.items()):
                return None if row[self.field] is None else float(row[self.field])
        return None


class Ratio(NamedTuple):
    """Ours against a peer."""

    name: str
    benchmark: str
    ours: Value
    peer: Value
    against: str
    unit: str = "ms"
    faster_is_more: bool = False
    """Whether the numbers are rates."""

    def of(self, rows: Rows) -> "Measured | None":
        """None where ours or the peer's is missing."""
        ours, peer = self.ours.of(rows), self.peer.of(rows)
        if not ours or not peer:
            return None
        return Measured(ours, peer, ours / peer if self.faster_is_more else peer / ours)


class Measured(NamedTuple):
    """A ratio in one run."""

    ours: float
    peer: float
    times_as_fast: float


_FIRST_PASS = {"candidates": 400, "waypoints": 14}
RATIOS = (
    Ratio(
        "minimum snap, 400 of 14 waypoints, each",
        "minsnap",
        Value({"method": "solve", "waypoints": 14, "batch": 400, "dtype": "float64"}, "ms_per_problem"),
        Value({"method": "scipy banded", "waypoints": 14}, "ms_per_problem"),
        "SciPy's banded Cholesky",
    ),
    Ratio(
        "time allocation, 400 of 14 waypoints, each",
        "time-allocation",
        Value({"method": "weighted", "waypoints": 14, "batch": 400}, "ms_per_problem"),
        Value({"method": "scipy L-BFGS-B", "waypoints": 14}, "ms_per_problem"),
        "SciPy's L-BFGS-B, our gradient",
    ),
    Ratio(
        "policy + arrival in a replan of 400",
        "planner",
        Value({"stage": "policy", "candidates": 400}, "p50_ms"),
        Value({"policy": "optimiser (a)"}, "min_ms"),
        "our optimiser for the same 400",
    ),
    Ratio(
        "the same",
        "planner",
        Value({"stage": "policy", "candidates": 400}, "p50_ms"),
        Value({"stage": "floor"}, "floor_ms"),
        "floor: the operations of one evaluation",
    ),
    Ratio(
        "a whole replan of 400",
        "planner",
        Value({"stage": "total", "candidates": 400}, "p50_ms"),
        Value({"stage": "floor"}, "floor_ms"),
        "the same floor",
    ),
    Ratio(
        "arrival of all 400, 14 waypoints",
        "policy",
        Value({"part": "match arrival", **_FIRST_PASS}, "min_ms"),
        Value({"part": "decode", **_FIRST_PASS}, "min_ms"),
        "floor: one pass of the decoder",
    ),
    Ratio(
        "routes + knots for 400 goals",
        "search",
        Value({"search": "roadmap", "method": "routes + knots"}, "p50_ms"),
        Value({"method": "scipy"}, "p50_ms"),
        "SciPy's Dijkstra on a lattice",
    ),
    Ratio(
        "400 candidates conditioned, drawn, scored",
        "prediction",
        Value({"way": "compiled"}, "median_ms"),
        Value({"way": "scipy"}, "median_ms"),
        "NumPy and SciPy",
    ),
    Ratio(
        "flights under control, 256 at once",
        "plant",
        Value({"method": "track, indi", "batch": 256}, "flights_per_s"),
        Value({"method": "C MuJoCo", "batch": 256}, "flights_per_s"),
        "C MuJoCo, the body alone",
        unit="flights/s",
        faster_is_more=True,
    ),
    Ratio(
        "a later start, processor time",
        "start",
        Value({"start": "later"}, "cpu_s"),
        Value({"start": "first"}, "cpu_s"),
        "the first start",
        unit="s",
    ),
)


def measured(benchmarks: Mapping[str, Rows]) -> list[tuple[Ratio, Measured]]:
    """Those that a run has."""
    found = ((ratio, ratio.of(benchmarks.get(ratio.benchmark, ()))) for ratio in RATIOS)
    return [(ratio, value) for ratio, value in found if value is not None]


def key(ratio: Ratio) -> str:
    """By what a ratio is known from run to run."""
    return f"{ratio.name} | {ratio.against}"
