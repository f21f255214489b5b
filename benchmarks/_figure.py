"""The picture of a benchmark: time per problem against size and against batch."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure


def draw_costs(ours: list[dict[str, Any]], baselines: list[dict[str, Any]], path: Path) -> None:
    """Write a picture of rows with ``waypoints``, ``batch`` and ``ms_per_problem``; baselines have no batch."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    by_size, by_batch = figure.subplots(1, 2, sharey=True)
    for batch in sorted({row["batch"] for row in ours}):
        rows = sorted((row for row in ours if row["batch"] == batch), key=lambda row: row["waypoints"])
        by_size.plot(*_columns(rows, "waypoints"), "o-", label=f"batch of {batch}")
    for name in sorted({row["method"] for row in baselines}):
        rows = sorted((row for row in baselines if row["method"] == name), key=lambda row: row["waypoints"])
        by_size.plot(*_columns(rows, "waypoints"), "s--", label=name)
    for size in sorted({row["waypoints"] for row in ours}):
        rows = sorted((row for row in ours if row["waypoints"] == size), key=lambda row: row["batch"])
        by_batch.plot(*_columns(rows, "batch"), "o-", label=f"{size} waypoints")
    by_size.set(xlabel="waypoints", ylabel="time per problem [ms]", yscale="log")
    by_batch.set(xlabel="problems in the batch", xscale="log")
    for axes in (by_size, by_batch):
        axes.legend(fontsize="small")
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=150)


def _columns(rows: list[dict[str, Any]], key: str) -> tuple[list[float], list[float]]:
    return [row[key] for row in rows], [row["ms_per_problem"] for row in rows]
