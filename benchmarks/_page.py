"""The page about a run of all benchmarks, from what was kept of it alone."""

from collections.abc import Mapping, Sequence
from typing import Any

from . import _ratios

SHOWN_RUNS = 4
"""Earlier runs in the table of ratios (arbitrary)."""
MINCO = 22.0
NATIVE = 5.6
"""ms; 400 time allocations of 14 waypoints on two threads of another machine: GCOPTER's MINCO with L-BFGS in C++, and a
block-tridiagonal solver with L-BFGS in C++. Weighted time and snap, from rest to rest, no limits, no arrival."""
PAPER = {"search + knots": 9.5, "policy": 71.2, "total": 99.4}
"""ms, Table II, on a Titan Xp."""


def page(run: Mapping[str, Any]) -> str:
    """Markdown."""
    rows = {name: one["rows"] for name, one in run["benchmarks"].items()}
    parts = [_head(run), _table_of_ratios(run, rows), _to_beat(rows), _replan(rows), _start(rows), _how(run)]
    return "\n\n".join(part for part in parts if part) + "\n"


def _head(run: Mapping[str, Any]) -> str:
    machine = run["machine"]
    versions = machine["versions"]
    loads = [one["load_average"] for one in run["benchmarks"].values()]
    return f"""# Performance

`make bench` writes this page: every benchmark with its peers, one after the other.

This run: {machine["cores"]} cores ({machine["processor"]}) at a load of {min(loads):.1f} to {max(loads):.1f}; Python
{machine["python"]}, JAX {versions["jax"]}, commit {str(machine["commit"])[:12]}. With a load above the number of cores
times are longer than those of a quiet machine by about as much; ratios suffer less."""


def _table_of_ratios(run: Mapping[str, Any], rows: Mapping[str, _ratios.Rows]) -> str:
    past: Sequence[Mapping[str, Any]] = run.get("history", [])[-SHOWN_RUNS:]
    heads = ["what", "ours", "beside it", "", "times as fast", *(f"at {str(one['commit'])[:8]}" for one in past)]
    lines = []
    for ratio, value in _ratios.measured(rows):
        before = (one["ratios"].get(_ratios.key(ratio)) for one in past)
        numbers = [f"{value.ours:.3g} {ratio.unit}", ratio.against, f"{value.peer:.3g} {ratio.unit}"]
        lines.append(
            [ratio.name, *numbers, f"**{value.times_as_fast:.3g}**", *("" if b is None else f"{b:.3g}" for b in before)]
        )
    return "## Ratios\n\n" + _table(heads, lines)


def _to_beat(rows: Mapping[str, _ratios.Rows]) -> str:
    of = {ratio.name: value for ratio, value in reversed(_ratios.measured(rows))}
    inside, alone = of.get("policy + arrival in a replan of 400"), of.get("arrival of all 400, 14 waypoints")
    ours = _ratios.Value({"method": "weighted", "waypoints": 14, "batch": 400}, "min_ms").of(
        rows.get("time-allocation", ())
    )
    if inside is None or alone is None or ours is None:
        return ""
    return f"""## The figure to beat

Times for 400 sequences of 14 waypoints by C++, measured elsewhere on two quiet cores: **{MINCO:g} ms** with MINCO and
L-BFGS (GCOPTER's parts), **{NATIVE:g} ms** with a block-tridiagonal solver and L-BFGS. Both weigh time against snap,
from rest to rest; neither knows limits, starts in flight or arrival times. Here, in this run:

- policy and arrival in a replan of 400: {inside.ours:.3g} ms in the median. Not all 400 are matched, but rounds of the
  best until one passes, with arrival times, from flight.
- arrival of all 400 with 14 waypoints each: {alone.ours:.3g} ms, {1.0 / alone.times_as_fast:.1f} passes of the decoder.
- our own batched optimiser, the same problem as that of the C++ solvers: {ours:.3g} ms; for the 400 sequences of a
  replan {inside.peer:.3g} ms.

Ours stand under the load above, theirs do not: only a machine that runs both can say by how much."""


def _replan(rows: Mapping[str, _ratios.Rows]) -> str:
    stages = [row for row in rows.get("planner", ()) if "p50_ms" in row]
    lines = []
    for row in stages:
        paper = f"{PAPER[row['stage']]:g}" if row["stage"] in PAPER and row["candidates"] == 400 else ""
        times = (f"{row['p50_ms']:.3g}", f"{row['p99_ms']:.3g}")
        lines.append([row["world"], str(row["candidates"]), row["stage"], *times, paper])
    heads = ["room", "candidates", "stage", "p50 ms", "p99 ms", "paper (Titan Xp), ms"]
    return "## A replan\n\n" + _table(heads, lines) if lines else ""


def _start(rows: Mapping[str, _ratios.Rows]) -> str:
    lines = [
        [
            row["start"],
            f"{row['cpu_s']:.1f}",
            f"{row['wall_s']:.1f}",
            f"{row['memory_mb']:.0f}",
            f"{row['peak_mb']:.0f}",
        ]
        for row in rows.get("start", ())
    ]
    heads = ["start", "processor s", "wall s", "memory MB", "at most MB"]
    text = """## A start, until it can fly

Until everything that a flight may call is ready; "to a plan", until README's example has its plan, from which nothing
else is compiled.
"""
    return f"{text}\n{_table(heads, lines)}" if lines else ""


def _how(run: Mapping[str, Any]) -> str:
    lines = []
    for name, one in run["benchmarks"].items():
        sizes = f"`{' '.join(one['sizes'])}`" if one["sizes"] else ""
        taken = (f"{one['seconds']:.0f}", f"{one['load_average']:.1f}")
        module = f"bench_{name.replace('-', '_')}"
        lines.append([f"`python -m benchmarks.{module}`", sizes, *taken, one.get("failed", "")])
    table = _table(["benchmark", "sizes", "seconds", "load", "failed"], lines)
    return f"""## How it was measured

{table}

`make bench-check` runs them again and fails where a ratio has fallen to less than half of what it is here. A ratio
compares with a peer, or with a floor that is measured, in the same run; no time is compared with a time of another run.
All rows are in `benchmarks/results/all.json`."""


def _table(heads: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rule = ["---"] * len(heads)
    return "\n".join("| " + " | ".join(line) + " |" for line in (heads, rule, *lines))
