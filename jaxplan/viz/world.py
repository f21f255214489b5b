"""A picture of a world: from above and from the side, with the padded map and, where given, target trajectories."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxplan.viz.scene import EDGE, FAINT, FILL, draw_world
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import PADDING, RESOLUTIONS, occupancy_lattices

_WIDTH = 9.0
"""Inches."""
_PADDED = "#e9c46a"


def draw_world_picture(
    world: World,
    path: Path,
    curves: dict[str, Float[np.ndarray, "n 3"]] | None = None,
    padding: float = PADDING,
    resolution: float = RESOLUTIONS[0],
) -> None:
    """Write a PNG: the section at the start's height (or half-way up), and the side view half-way through.

    Args:
        world: what is drawn.
        path: where to.
        curves: target trajectories by name [m].
        padding: what the planner keeps from obstacles [m], drawn in yellow.
        resolution: side of a cell of the padded map [m].
    """
    lower, upper = np.asarray(world.bounds, dtype=float)
    width, depth, height = upper - lower
    levels = {2: lower[2] + 0.5 * height, 1: lower[1] + 0.5 * depth}
    if world.start is not None:
        levels[2] = float(np.asarray(world.start)[2])
    figure = Figure(figsize=(_WIDTH, 0.9 * _WIDTH * (depth + height) / width + 1.4), layout="constrained")
    FigureCanvasAgg(figure)
    above, side = figure.subplots(2, 1, height_ratios=[depth, max(height, 0.12 * depth)])
    grid = occupancy_lattices(world, (resolution,), padding)[0]
    for axes, across in ((above, 2), (side, 1)):
        shown = [axis for axis in range(3) if axis != across]
        index = min(int((levels[across] - grid.origin[across]) / grid.resolution), grid.shape[across] - 1)
        _draw_padding(axes, np.take(grid.near_obstacle, index, axis=across), lower[shown], resolution)
        draw_world(axes, world, across, levels[across], None if world.start is None else np.asarray(world.start))
        for number, (name, curve) in enumerate((curves or {}).items()):
            axes.plot(*curve[:, shown].T, color=f"C{number % 10}", linewidth=1.1, label=name, zorder=3)
            axes.plot(*curve[:1, shown].T, "o", color=f"C{number % 10}", markersize=4, zorder=3)
        if world.start is not None:
            axes.plot(*np.asarray(world.start)[shown], "k^", markersize=7, zorder=4)
        axes.set_aspect("equal")
        axes.set_xlim(lower[shown[0]] - 0.3, upper[shown[0]] + 0.3)
        axes.set_ylim(lower[shown[1]] - 0.3, upper[shown[1]] + 0.3)
        axes.set_ylabel(f"{'xyz'[shown[1]]} [m]")
    side.set_xlabel("x [m]")
    title = f"{world.name}: section at z = {levels[2]:.2f} m, and side view at y = {levels[1]:.2f} m"
    above.set_title(title, fontsize=10)
    _draw_legend(figure, above, world, padding)
    figure.savefig(path, dpi=110)


def _draw_legend(figure: Figure, above: Axes, world: World, padding: float) -> None:
    """What is filled, what is padding, where the start is, and the curves by their names."""
    entries: list[tuple[Any, str]] = [
        (Patch(facecolor=FILL, edgecolor=EDGE), "obstacle, cut"),
        (Line2D([], [], color=FAINT), "obstacle above, below or behind"),
        (Patch(facecolor=_PADDED, alpha=0.35), f"padding: closer than {padding:g} m to an obstacle"),
    ]
    if world.start is not None:
        entries.append((Line2D([], [], marker="^", ls="none", color="black", ms=7), "start"))
    entries += list(zip(*above.get_legend_handles_labels(), strict=True))
    figure.legend(*zip(*entries, strict=True), loc="outside lower center", ncols=4, fontsize=8, frameon=False)


def _draw_padding(axes: Axes, padded: Bool[np.ndarray, "a b"], lower: Float[np.ndarray, "2"], side: float) -> None:
    """Colour the padded cells of one section, whose first corner is at ``lower`` [m] and whose cells have that side."""
    image = np.ma.masked_where(~padded.T, np.ones(padded.T.shape))
    ends = lower + np.array(padded.shape) * side
    extent = (lower[0], ends[0], lower[1], ends[1])
    axes.imshow(image, origin="lower", extent=extent, cmap=ListedColormap([_PADDED]), alpha=0.35, zorder=0.5)
