"""The picture of the multi-resolution search: time and path length against the distance of the drones."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

TICKS = (0.05, 0.1, 0.2, 0.4, 0.8)


def draw_multi_resolution(rows: Sequence[Mapping[str, Any]], edges: Sequence[float], path: Path) -> None:
    """Write a PNG.

    Args:
        rows: one for each search, as ``experiments.multi_resolution`` writes them.
        edges: shares of the diagonal at which the next coarser lattice is taken.
    """
    figure = Figure(figsize=(9.5, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharex=True)
    distance = np.array([row["distance_share"] for row in rows])
    for name, key, colour in (("finest lattice", "finest_ms", "#D55E00"), ("multi-resolution", "multi_ms", "#0072B2")):
        left.scatter(distance, [row[key] for row in rows], s=12, color=colour, alpha=0.75, label=name)
    left.set(yscale="log", ylabel="time of a search [ms]")
    left.legend(frameon=False, fontsize=8)
    known = [row for row in rows if row["median_length_ratio"] is not None]
    shares = [row["distance_share"] for row in known]
    right.scatter(shares, [row["most_length_ratio"] for row in known], s=12, color="0.6", label="worst goal")
    right.scatter(shares, [row["median_length_ratio"] for row in known], s=12, color="#0072B2", label="median goal")
    right.axhline(1.0, color="0.4", linestyle="--", linewidth=1.0)
    right.set_ylabel("length of the path over the finest lattice's")
    right.legend(frameon=False, fontsize=8)
    for axes in (left, right):
        for edge in edges:
            axes.axvline(edge, color="0.8", linewidth=1.0, zorder=0)
        axes.set(xscale="log", xlabel="distance, share of the room's diagonal")
        axes.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
