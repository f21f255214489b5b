"""The picture of what predictors propose for one moment of a target's flight."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure

from jaxplan.viz.scene import draw_world
from jaxplan.world.obstacles import World

_SEEN, _REAL, _REJECTED = "#1f3b73", "#c8102e", "#9aa0a8"


@dataclass(frozen=True)
class PredictionPanel:
    """The candidates of one predictor; world frame, metres and seconds."""

    title: str
    goals: Float[np.ndarray, "k 3"]
    times: Float[np.ndarray, "k"]
    """From the newest observation."""
    usable: Bool[np.ndarray, "k"]
    """Not outside the room, in a padded obstacle or out of reach."""
    observed: Float[np.ndarray, "o 3"]
    future: Float[np.ndarray, "f 3"]
    """What really happens next."""


def draw_predictions(rows: Sequence[tuple[World, Sequence[PredictionPanel]]], path: Path) -> None:
    """One row of panels for each world, seen from above, into a PNG file."""
    widths = max(len(panels) for _, panels in rows)
    heights = [_height(world) for world, _ in rows]
    figure = Figure(figsize=(3.4 * widths, 0.5 + 3.2 * sum(heights)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(rows), widths, squeeze=False, height_ratios=heights)
    for line, (world, panels) in zip(grid, rows, strict=True):
        for axes, panel in zip(line, panels, strict=True):
            dots = _draw_panel(axes, world, panel)
        figure.colorbar(dots, ax=line[-1], label="seconds ahead", shrink=0.8)
    grid[0, 0].legend(loc="lower right", fontsize=7, framealpha=0.9)
    figure.savefig(path, dpi=150)


def _height(world: World) -> float:
    width, depth = (np.asarray(world.bounds)[1] - np.asarray(world.bounds)[0])[:2]
    return float(depth / width)


def _draw_panel(axes: Axes, world: World, panel: PredictionPanel) -> PathCollection:
    draw_world(axes, world, across=2, level=float(panel.observed[-1, 2]))
    wrong, good = panel.goals[~panel.usable], panel.goals[panel.usable]
    axes.scatter(wrong[:, 0], wrong[:, 1], s=7, marker="x", color=_REJECTED, linewidths=0.6, label="rejected", zorder=3)
    dots = axes.scatter(
        good[:, 0],
        good[:, 1],
        c=panel.times[panel.usable],
        s=7,
        cmap="viridis",
        vmin=0.0,
        vmax=panel.times.max(),
        zorder=4,
    )
    axes.plot(*panel.future[:, :2].T, color=_REAL, linewidth=1.4, label="real future", zorder=5)
    axes.plot(*panel.observed[:, :2].T, color=_SEEN, marker=".", markersize=4, linewidth=1.0, label="seen", zorder=6)
    lower, upper = np.asarray(world.bounds)
    axes.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), aspect="equal", title=panel.title)
    axes.title.set_fontsize(9)
    axes.tick_params(labelsize=7)
    return dots
