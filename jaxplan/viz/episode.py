"""One episode in one picture: where it happened, which trajectories were considered, and how well it was flown."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxplan.tracking.result import SUCCESS
from jaxplan.viz.candidates import CandidateCurves, candidate_curves, illustrative_cycle
from jaxplan.viz.scene import EDGE, FILL, draw_world
from jaxplan.viz.words import OUTCOMES

if TYPE_CHECKING:
    from jaxplan.interception import Episode

# Okabe and Ito (2008): told apart with every common colour vision; line styles differ too.
DEFENDER, TARGET, USABLE, REJECTED, MARK = "#0072B2", "#D55E00", "#009E73", "#8a8a8a", "#F0E442"

COMMITTED = "#004D38"
QUARRY: dict[str, Any] = {"marker": "s", "ls": "none", "color": TARGET, "markeredgecolor": "white", "ms": 7}
STOP: dict[str, Any] = {"marker": "P", "ls": "none", "color": COMMITTED, "markeredgecolor": "white", "ms": 8}

POSITION_LIMIT, YAW_LIMIT = SUCCESS.position, math.degrees(SUCCESS.yaw)
"""m and degrees; beyond either tracking counts as lost."""

MAP_WIDTH, SIDE_WIDTH, TIME_HEIGHT = 6.8, 3.1, 1.75
LEFT, BOTTOM, TOP, GAP = 0.75, 0.6, 1.05, 0.66
LARGEST_VIEW = np.array([MAP_WIDTH, 8.0, 4.5])
"""Inches; the last one for a room's length, depth and height."""
MARGIN = 0.02
"""Shown around the room, as a share of its size."""


class _Layout(NamedTuple):
    """The picture's size and its axes, as (left, bottom, width, height) in inches."""

    size: tuple[float, float]
    top_view: tuple[float, float, float, float]
    side_view: tuple[float, float, float, float]
    speed: tuple[float, float, float, float]
    error: tuple[float, float, float, float]
    legend: tuple[float, float, float, float]


def draw_episode(episode: "Episode", metrics: dict[str, Any], path: Path) -> None:
    """Draw an episode and save it as a PNG.

    Above: the room from above and from the side, cut where the episode ended, with the target's path, the flown
    path and all candidates of the most telling replan cycle. Below: speeds and tracking errors over time.
    """
    cycle = illustrative_cycle(episode.cycles)
    shown = None if cycle is None else candidate_curves(cycle)
    layout = _layout(np.asarray(episode.scenario.world.bounds, dtype=float))
    figure = Figure(figsize=layout.size, dpi=120, facecolor="white")

    def axes(box: tuple[float, float, float, float]) -> Axes:
        (width, height), (left, bottom, across, up) = layout.size, box
        return figure.add_axes((left / width, bottom / height, across / width, up / height))

    _draw_view(axes(layout.top_view), episode, shown, across=2)
    _draw_view(axes(layout.side_view), episode, shown, across=1)
    _draw_speed(axes(layout.speed), episode)
    _draw_error(axes(layout.error), episode)
    _draw_legend(axes(layout.legend), episode, shown, metrics)
    height = layout.size[1]
    title = OUTCOMES.get(episode.outcome, episode.outcome)
    figure.text(LEFT / layout.size[0], 1.0 - 0.42 / height, title, fontsize=16, fontweight="bold")
    figure.text(LEFT / layout.size[0], 1.0 - 0.68 / height, _subtitle(episode, shown), fontsize=9.5, color=EDGE)
    figure.savefig(path, format="png")


def _layout(bounds: Float[np.ndarray, "2 3"]) -> _Layout:
    """Give both views the same scale, as large as fits a page."""
    room = (1.0 + 2.0 * MARGIN) * (bounds[1] - bounds[0])
    scale = np.min(LARGEST_VIEW / room)
    across, deep, high = (float(side) for side in scale * room)
    whole = max(across, 0.7 * MAP_WIDTH) + 0.2 + SIDE_WIDTH
    plot = (whole - 0.95) / 2.0
    side_at = BOTTOM + TIME_HEIGHT + GAP + 0.1
    top_at = side_at + high + GAP
    beside = whole - SIDE_WIDTH
    return _Layout(
        size=(LEFT + whole + 0.6, top_at + deep + TOP),
        top_view=(LEFT, top_at, across, deep),
        side_view=(LEFT, side_at, across, high),
        speed=(LEFT, BOTTOM, plot, TIME_HEIGHT),
        error=(LEFT + plot + 0.95, BOTTOM, plot, TIME_HEIGHT),
        legend=(LEFT + beside, side_at, SIDE_WIDTH, top_at + deep - side_at),
    )


def _draw_view(axes: Axes, episode: "Episode", shown: CandidateCurves | None, across: int) -> None:
    """One orthographic view; ``across`` is the axis that is looked along."""
    first, second = (axis for axis in range(3) if axis != across)
    flown, target = np.asarray(episode.flight.position), np.asarray(episode.flight.target)
    draw_world(axes, episode.scenario.world, across, float(flown[-1, across]), flown[-1])
    if shown is not None:
        _draw_candidates(axes, shown, first, second)
    axes.plot(target[:, first], target[:, second], color=TARGET, linewidth=2.2, linestyle=(0, (5, 1.5)), zorder=5)
    axes.plot(flown[:, first], flown[:, second], color="white", linewidth=4.2, zorder=5.5)
    axes.plot(flown[:, first], flown[:, second], color=DEFENDER, linewidth=2.6, zorder=6)
    for path, colour in ((target, TARGET), (flown, DEFENDER)):
        axes.plot(path[0, first], path[0, second], "o", color="white", markeredgecolor=colour, mew=2, ms=8, zorder=7)
    axes.plot(target[-1, first], target[-1, second], **QUARRY, zorder=7.5)
    axes.plot(flown[-1, first], flown[-1, second], **_end_marker(episode), zorder=8)
    lower, upper = np.asarray(episode.scenario.world.bounds, dtype=float)
    margin = MARGIN * (upper - lower)
    axes.set_xlim(lower[first] - margin[first], upper[first] + margin[first])
    axes.set_ylim(lower[second] - margin[second], upper[second] + margin[second])
    axes.set_aspect("equal", adjustable="box", anchor="W")
    axes.set_xlabel(f"{'xyz'[first]} [m]", labelpad=2)
    axes.set_ylabel(f"{'xyz'[second]} [m]", labelpad=2)
    axes.set_title(("seen from above", "seen from the side")[across == 1], loc="left", fontsize=9.5, color=EDGE)
    axes.tick_params(labelsize=8.5)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _end_marker(episode: "Episode") -> dict[str, Any]:
    if episode.success:
        return {"marker": "*", "color": MARK, "markeredgecolor": "black", "markersize": 19, "linestyle": "none"}
    return {"marker": "X", "color": "black", "markeredgecolor": "white", "markersize": 12, "linestyle": "none"}


def _draw_candidates(axes: Axes, shown: CandidateCurves, first: int, second: int) -> None:
    """Thin lines for trajectories and dots for goals: usable ones green above rejected ones grey."""
    for usable, colour, width, alpha in ((False, REJECTED, 0.6, 0.6), (True, USABLE, 0.8, 0.7)):
        lines = shown.curves[shown.curve_usable == usable][..., [first, second]]
        collection = LineCollection(list(lines), colors=colour, linewidths=width, alpha=alpha, zorder=2.5 + usable)
        axes.add_collection(collection, autolim=False)
        goals = shown.goals[shown.usable == usable]
        marker = "o" if usable else "x"
        axes.scatter(
            goals[:, first], goals[:, second], s=9, marker=marker, color=colour, linewidths=0.8, zorder=3 + usable
        )
    if shown.chosen is not None:
        axes.plot(shown.chosen[:, first], shown.chosen[:, second], color=COMMITTED, lw=1.6, ls=":", zorder=6.5)
        axes.plot(*shown.chosen[-1, [first, second]], **STOP, zorder=6.5)


def _draw_speed(axes: Axes, episode: "Episode") -> None:
    times = np.asarray(episode.flight.times)
    target, flown = (np.linalg.norm(v, axis=1) for v in (episode.flight.target_velocity, episode.flight.velocity))
    axes.plot(times, target, color=TARGET, linestyle=(0, (5, 1.5)), lw=1.6)
    axes.plot(times, flown, color=DEFENDER, lw=1.8)
    axes.set_ylim(bottom=0.0)
    _time_axis(axes, episode, "speed [m/s]")
    axes.annotate(
        "departure", (episode.scenario.departure, 0.97), xycoords=("data", "axes fraction"), xytext=(3, 0),
        textcoords="offset points", va="top", fontsize=8, color=EDGE,
    )  # fmt: skip


def _draw_error(axes: Axes, episode: "Episode") -> None:
    """Position and yaw error, scaled so that both limits are the same line."""
    times = np.asarray(episode.flight.times)
    position, yaw = np.asarray(episode.flight.position_error), np.degrees(np.abs(np.asarray(episode.flight.yaw_error)))
    highest = 1.15 * max(1.0, np.max(position) / POSITION_LIMIT, np.max(yaw) / YAW_LIMIT)
    axes.plot(times, position, color=DEFENDER, lw=1.8, label="position [m]")
    _time_axis(axes, episode, "position error [m]")
    axes.yaxis.label.set_color(DEFENDER)
    axes.set_ylim(0.0, highest * POSITION_LIMIT)
    right = axes.twinx()
    right.plot(times, yaw, color="#CC79A7", lw=1.2, ls="-.")
    right.set_ylim(0.0, highest * YAW_LIMIT)
    right.set_ylabel("yaw error [deg]", color="#a8537f", fontsize=9)
    right.tick_params(labelsize=8.5, colors="#a8537f")
    right.spines[["top", "left"]].set_visible(False)
    axes.axhline(POSITION_LIMIT, color="black", lw=1.0, ls="--")
    axes.annotate(
        f"limit {POSITION_LIMIT:g} m, {YAW_LIMIT:g} deg", (0.99, POSITION_LIMIT), ha="right", va="top", fontsize=8,
        xycoords=("axes fraction", "data"), xytext=(0, -2), textcoords="offset points",
    )  # fmt: skip


def _time_axis(axes: Axes, episode: "Episode", label: str) -> None:
    axes.set_xlim(0.0, float(episode.flight.times[-1]) or 1.0)
    axes.set_xlabel("time [s]", fontsize=9, labelpad=2)
    axes.set_ylabel(label, fontsize=9)
    axes.tick_params(labelsize=8.5)
    axes.grid(color="#e6e8ec", linewidth=0.7)
    axes.spines[["top", "right"]].set_visible(False)
    axes.axvline(episode.scenario.departure, color=EDGE, lw=0.9, ls=":")


def _draw_legend(axes: Axes, episode: "Episode", shown: CandidateCurves | None, metrics: dict[str, Any]) -> None:
    """What the lines mean, and the numbers that matter."""
    axes.set_axis_off()
    end = {key: value for key, value in _end_marker(episode).items() if key != "markersize"}
    entries: list[tuple[Any, str]] = [
        (Line2D([], [], color=DEFENDER, lw=2.6), "defender, flown"),
        (Line2D([], [], color=TARGET, lw=2.2, ls=(0, (5, 1.5))), "target"),
        (Line2D([], [], marker="o", ls="none", color="white", markeredgecolor=EDGE, mew=2, ms=8), "start"),
        (Line2D([], [], markersize=13, **end), "interception" if episode.success else "end"),
        (Line2D([], [], **QUARRY), "target then"),
        (Patch(facecolor=FILL, edgecolor=EDGE), "obstacle, cut at the end's level"),
    ]
    if shown is not None:
        counts = int(shown.usable.sum()), int((~shown.usable).sum())
        entries += [
            (Line2D([], [], color=USABLE, lw=1.2, marker="o", ms=3.5), f"usable candidate ({counts[0]})"),
            (Line2D([], [], color=REJECTED, lw=1.2, marker="x", ms=4.5), f"rejected or outranked ({counts[1]})"),
        ]
        if shown.chosen is not None:
            entries.append((Line2D([], [], color=COMMITTED, lw=1.6, ls=":"), "committed then"))
            entries.append((Line2D([], [], **STOP), "its stop point"))
    entries += [(Line2D([], [], ls="none"), line) for line in ("", *_numbers(metrics))]
    style = {"loc": "upper left", "frameon": False, "fontsize": 9.5, "labelspacing": 0.75, "borderaxespad": 0.0}
    axes.legend(*zip(*entries, strict=True), **style)


def _numbers(metrics: dict[str, Any]) -> list[str]:
    rows = [
        ("time to intercept", metrics.get("time_to_intercept_s"), "s"),
        ("smallest distance", metrics.get("min_distance_m"), "m"),
        ("smallest clearance", metrics.get("min_clearance_m"), "m"),
        ("largest position error", metrics.get("max_position_error_m"), "m"),
        ("largest yaw error", metrics.get("max_yaw_error_deg"), "deg"),
    ]
    known = [(name, value, unit) for name, value, unit in rows if value is not None and np.isfinite(value)]
    return [f"{name}: {value:.2f} {unit}" for name, value, unit in known]


def _subtitle(episode: "Episode", shown: CandidateCurves | None) -> str:
    parts = [f"world {episode.scenario.world.name}", f"departure at {episode.scenario.departure:g} s"]
    if shown is not None:
        parts.append(f"candidates of the cycle at {shown.time:.1f} s")
    return ", ".join(parts)
