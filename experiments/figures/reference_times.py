"""Reference times beside the closed loop's, and some of the reference trajectories in their rooms."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxplan.io.targets import load_target
from jaxplan.minsnap.single import minimum_snap
from jaxplan.viz.episode import DEFENDER, TARGET
from jaxplan.viz.scene import EDGE, draw_world
from jaxplan.world.load import load_world

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7")
SHOWN = 4
"""Trajectories in a room."""
LATENCY = 0.1
"""s from the departure to the trajectory's start."""


def draw_reference_times(rows: Sequence[Mapping[str, Any]], name: str, path: Path) -> None:
    """Write a PNG file.

    Args:
        rows: those of ``results.csv``.
        name: of the closed loop that is compared.
        path: of the file.
    """
    worlds = list(dict.fromkeys(row["world"] for row in rows))
    figure = Figure(figsize=(4.4 * (len(worlds) + 1), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    scatter, *rooms = figure.subplots(1, len(worlds) + 1)
    _draw_times(scatter, rows, worlds, name)
    for axes, world in zip(rooms, worlds, strict=True):
        _draw_room(axes, world, [row for row in rows if row["world"] == world and row["reference_s"] is not None])
    figure.savefig(path, dpi=120)


def _draw_times(axes: Axes, rows: Sequence[Mapping[str, Any]], worlds: list[str], name: str) -> None:
    for place, world in enumerate(worlds):
        pairs = np.array(
            [
                (row["reference_s"], row["closed_loop_s"])
                for row in rows
                if row["world"] == world and None not in (row["reference_s"], row["closed_loop_s"])
            ]
        ).reshape(-1, 2)
        axes.scatter(*pairs.T, s=9, color=COLOURS[place % len(COLOURS)], label=world, alpha=0.8, linewidths=0.0)
    low, high = axes.get_xlim()
    for ratio in (1.0, 1.5, 2.0):
        axes.plot([low, high], [ratio * low, ratio * high], color="0.6", lw=0.8, ls="--" if ratio > 1.0 else "-")
        axes.annotate(f"{ratio:g} x", (high, ratio * high), fontsize=7.5, color="0.4", ha="right", va="bottom")
    axes.set(xlabel="reference [s]", ylabel=f"{name} [s]", xlim=(low, high))
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    axes.spines[["top", "right"]].set_visible(False)


def _draw_room(axes: Axes, name: str, rows: list[Mapping[str, Any]]) -> None:
    """From above: a few references to rest, and the target until it is met."""
    world = load_world(name)
    lower, upper = np.asarray(world.bounds, dtype=float)
    for row in [rows[place] for place in np.unique(np.linspace(0, len(rows) - 1, min(SHOWN, len(rows))).astype(int))]:
        points, durations = np.array(row["waypoints_m"]), np.array(row["durations_s"])
        spline = minimum_snap(points, durations)
        curve, meeting = spline.sample(300)[1], durations[:-1].sum()
        before = np.asarray(spline.evaluate(np.linspace(0.0, meeting, 200)))
        times = row["departure"] + np.linspace(0.0, LATENCY + meeting, 100)
        target = load_target(row["target"], world=name, speed=row["speed"]).position(times)
        axes.plot(*np.asarray(curve)[:, :2].T, color=DEFENDER, lw=0.9, ls=":", zorder=3)
        axes.plot(*before[:, :2].T, color=DEFENDER, lw=2.0, zorder=4)
        axes.plot(*target[:, :2].T, color=TARGET, lw=2.0, zorder=5)
        axes.plot(*target[-1, :2], "o", color=TARGET, markeredgecolor="white", markersize=7, zorder=6)
        axes.plot(*points[0, :2], "o", color=DEFENDER, markeredgecolor="white", markersize=7, zorder=6)
    draw_world(axes, world, 2, 1.0 if not rows else float(np.mean([row["waypoints_m"][-2][2] for row in rows])))
    axes.set(xlim=(lower[0] - 0.2, upper[0] + 0.2), ylim=(lower[1] - 0.2, upper[1] + 0.2))
    axes.set_aspect("equal")
    axes.set_title(f"{name}: references (dotted: to the stop) and targets", fontsize=9, loc="left", color=EDGE)
    axes.tick_params(labelsize=7.5)
