"""Moments of one episode side by side: every candidate's trajectory, what was committed and what was flown."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxplan.viz.episode import DEFENDER, REJECTED, TARGET, USABLE
from jaxplan.viz.scene import EDGE, draw_world
from jaxplan.world.obstacles import World

COMMITTED = "#CC79A7"


def draw_moments(world: World, episode: Mapping[str, Any], path: Path) -> None:
    """One panel from above for each of ``episode["moments"]``, as ``experiments.trajectories`` keeps them."""
    lower, upper = np.asarray(world.bounds, dtype=float)
    shape = (upper - lower)[1] / (upper - lower)[0]
    moments = episode["moments"]
    columns = min(3, len(moments)) or 1
    rows = -(-len(moments) // columns) or 1
    figure = Figure(figsize=(4.0 * columns, (4.0 * shape + 0.5) * rows + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for axes, moment in zip(panels, moments, strict=False):
        draw_world(axes, world, 2, float(np.asarray(episode["flown"])[0, 2]))
        _draw_moment(axes, episode, moment)
        axes.set_xlim(lower[0] - 0.2, upper[0] + 0.2)
        axes.set_ylim(lower[1] - 0.2, upper[1] + 0.2)
        axes.set_aspect("equal")
    for axes in list(figure.axes)[len(moments) :]:
        axes.set_visible(False)
    entries = [
        (Line2D([], [], color=DEFENDER, lw=2.4), "defender, flown"),
        (Line2D([], [], color=TARGET, lw=2.0, ls=(0, (5, 1.5))), "target, until then and after"),
        (Line2D([], [], color=USABLE, lw=1.0), "usable trajectory"),
        (Line2D([], [], color=REJECTED, lw=1.0), "rejected trajectory"),
        (Line2D([], [], color=COMMITTED, lw=2.0), "committed in this cycle"),
    ]
    figure.legend(*zip(*entries, strict=True), loc="outside lower center", ncols=5, frameon=False, fontsize=8)
    figure.savefig(path, dpi=120)


def _draw_moment(axes: Axes, episode: Mapping[str, Any], moment: Mapping[str, Any]) -> None:
    times = np.asarray(episode["times"])
    flown, target = np.asarray(episode["flown"]), np.asarray(episode["target"])
    past = times <= moment["time"]
    usable = np.asarray(moment["curve_usable"], dtype=bool)
    curves = np.asarray(moment["curves"], dtype=float).reshape(len(usable), -1, 3)
    for kind, colour in ((False, REJECTED), (True, USABLE)):
        lines = curves[usable == kind][..., :2]
        axes.add_collection(LineCollection(list(lines), colors=colour, linewidths=0.7, alpha=0.7, zorder=2.5 + kind))
    if moment["chosen"] is not None:
        axes.plot(*np.asarray(moment["chosen"])[:, :2].T, color=COMMITTED, lw=2.0, zorder=4)
    axes.plot(*target[:, :2].T, color=TARGET, lw=0.8, ls=":", zorder=3)
    axes.plot(*target[past, :2].T, color=TARGET, lw=2.0, ls=(0, (5, 1.5)), zorder=4)
    axes.plot(*flown[past, :2].T, color=DEFENDER, lw=2.4, zorder=5)
    for place, colour in ((target, TARGET), (flown, DEFENDER)):
        now = place[int(past.sum()) - 1] if past.any() else place[0]
        axes.plot(*now[:2], "o", color=colour, markeredgecolor="white", markersize=8, zorder=6)
    title = f"{moment['time']:.1f} s: {moment['usable']} of {moment['generated']} usable"
    axes.set_title(title, fontsize=9.5, loc="left", color=EDGE)
    axes.tick_params(labelsize=7.5)
