"""Pictures of success in closed loop: beside the paper's, over the target's speed, and what the rest failed by."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito (2008)."""
KINDS = {"collision": "#D55E00", "tracking_lost": "#E69F00", "target_ended": "#56B4E9", "no_plan": "#8a8a8a"}


class Bar(NamedTuple):
    """One cell of a table."""

    planner: str
    predictor: str
    share: float
    interval: tuple[float, float]
    paper: float | None


class Line(NamedTuple):
    """One cell over the target's maximum speed [m/s]."""

    planner: str
    predictor: str
    speeds: Float[np.ndarray, "n"]
    shares: Float[np.ndarray, "n"]
    intervals: Float[np.ndarray, "n 2"]
    """Of the shares, 95 %."""


def draw_success(bars: Sequence[Bar], path: Path) -> None:
    """A group of bars for each planner, one bar for each predictor, the paper's shares as black marks."""
    planners = list(dict.fromkeys(bar.planner for bar in bars))
    predictors = list(dict.fromkeys(bar.predictor for bar in bars))
    figure = Figure(figsize=(max(7.0, 0.36 * len(bars) + 3.5), 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    place, ticks = 0.0, []
    labelled: set[str] = set()
    for planner in planners:
        mine = [bar for bar in bars if bar.planner == planner]
        ticks.append(place + 0.5 * (len(mine) - 1))
        for bar in mine:
            colour = COLOURS[predictors.index(bar.predictor) % len(COLOURS)]
            label = None if bar.predictor in labelled else bar.predictor
            labelled.add(bar.predictor)
            axes.bar(place, bar.share, width=0.85, color=colour, label=label)
            error = np.clip([[bar.share - bar.interval[0]], [bar.interval[1] - bar.share]], 0.0, None)
            axes.errorbar(place, bar.share, yerr=error, fmt="none", color="0.25", capsize=2.5, linewidth=1.0)
            if bar.paper is not None:
                known = None if "paper" in labelled else "paper"
                labelled.add("paper")
                axes.plot([place - 0.42, place + 0.42], [bar.paper] * 2, color="black", linewidth=2.2, label=known)
            place += 1.0
        place += 1.3
    axes.set_xticks(ticks, planners)
    axes.set_ylabel("share of interceptions, 95 % interval")
    axes.set_ylim(0.0, 1.02)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.savefig(path, dpi=130)


def draw_success_by_speed(lines: Sequence[Line], path: Path) -> None:
    """A panel for each planner, a line with intervals for each predictor; side by side, so that none hides another."""
    planners = list(dict.fromkeys(line.planner for line in lines))
    predictors = list(dict.fromkeys(line.predictor for line in lines))
    columns = min(3, len(planners))
    rows = -(-len(planners) // columns)
    figure = Figure(figsize=(4.6 * columns + 0.6, 3.0 * rows + 0.7), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, planner in zip(panels.flat, planners, strict=False):
        for line in (line for line in lines if line.planner == planner):
            colour = COLOURS[predictors.index(line.predictor) % len(COLOURS)]
            place = predictors.index(line.predictor) - 0.5 * (len(predictors) - 1)
            beside = place * _spread(line.speeds, len(predictors))
            error = np.abs(line.intervals.T - line.shares)
            style = {"marker": "o", "markersize": 3, "linewidth": 1.2, "elinewidth": 0.8, "capsize": 1.5}
            axes.errorbar(line.speeds + beside, line.shares, error, color=colour, label=line.predictor, **style)
        axes.set_title(planner, fontsize=10)
        axes.set(ylim=(-0.03, 1.03), xlabel="target's maximum speed [m/s]", ylabel="share, 95 % interval")
        axes.spines[["top", "right"]].set_visible(False)
    for axes in list(panels.flat)[len(planners) :]:
        axes.set_visible(False)
    shown: dict[str, Any] = {}
    for axes in panels.flat:
        handles, labels = axes.get_legend_handles_labels()
        shown |= dict(zip(labels, handles, strict=True))
    figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.savefig(path, dpi=130)


def _spread(speeds: Float[np.ndarray, "n"], lines: int) -> float:
    """How far apart lines are drawn [m/s], so that all of them take up 0.6 of the way between two speeds."""
    return 0.6 * float(np.diff(speeds).min(initial=1.0)) / max(lines, 1)


def draw_failures(cells: Mapping[str, Mapping[str, float]], path: Path) -> None:
    """A bar for each cell: the share of its episodes that failed, by kind."""
    figure = Figure(figsize=(7.5, 0.26 * len(cells) + 1.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    names, left = list(cells), np.zeros(len(cells))
    for kind, colour in KINDS.items():
        shares = np.array([cells[name].get(kind, 0.0) for name in names])
        axes.barh(range(len(names)), shares, left=left, color=colour, label=kind.replace("_", " "))
        left = left + shares
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("share of episodes that failed")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.savefig(path, dpi=130)
