"""Where the time of a replan goes, as stacked bars."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

COLOURS = {
    "predict": "#CC79A7",
    "reject": "#8a8a8a",
    "search + knots": "#E69F00",
    "policy": "#0072B2",
    "minsnap": "#009E73",
    "select": "#56B4E9",
}


def draw_stages(rows: Sequence[Mapping[str, Any]], paper: Mapping[str, float], path: Path) -> None:
    """One bar of medians for each device, world and number of candidates, and the paper's; logarithms would not stack.

    Args:
        rows: device, world, candidates, stage, p50_ms and p99_ms.
        paper: milliseconds by stage.
    """
    bars: dict[str, Mapping[str, float]] = {}
    tails: list[float] = []
    for key in dict.fromkeys((row["device"], row["world"], row["candidates"]) for row in rows):
        mine = [row for row in rows if (row["device"], row["world"], row["candidates"]) == key]
        bars[f"{key[0]}, {key[1]}, {key[2]}"] = {row["stage"]: row["p50_ms"] for row in mine}
        tails.append(next(row["p99_ms"] for row in mine if row["stage"] == "total"))
    bars["paper, Titan Xp, 400"] = paper
    figure = Figure(figsize=(8.0, 0.42 * len(bars) + 1.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    left = np.zeros(len(bars))
    for stage, colour in COLOURS.items():
        times = np.array([bar.get(stage, 0.0) for bar in bars.values()])
        axes.barh(range(len(bars)), times, left=left, color=colour, label=stage)
        left = left + times
    axes.plot(tails, range(len(tails)), "k|", markersize=12, label="total, 99th percentile")
    axes.set_yticks(range(len(bars)), list(bars), fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("median wall time [ms]")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.savefig(path, dpi=130)
