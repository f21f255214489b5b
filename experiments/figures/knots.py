"""The picture of the knot tuning: deviation from the path against the number of segments."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


class Setting(Protocol):
    """What one setting of the knots comes to over many routes."""

    @property
    def segments(self) -> float:
        """Mean number."""

    @property
    def median(self) -> float:
        """Deviation [m]."""

    @property
    def rejected(self) -> float:
        """Share of trajectories beyond the allowed deviation."""


def draw_knot_tuning(lines: Mapping[str, Sequence[Setting]], chosen: Setting, path: Path) -> None:
    """Write a PNG with one line per label, and the chosen setting in a red square."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    for axes, value, label in ((left, "median", "median deviation [m]"), (right, "rejected", "share above 0.5 m")):
        for number, (name, line) in enumerate(lines.items()):
            color = matplotlib.colormaps["viridis"](number / len(lines))
            values = [getattr(item, value) for item in line]
            axes.plot([item.segments for item in line], values, "o-", color=color, label=name)
        axes.plot(chosen.segments, getattr(chosen, value), "rs", markersize=11, fillstyle="none")
        axes.set_xlabel("mean number of segments")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    right.legend(fontsize=8)
    figure.savefig(path, dpi=110)
