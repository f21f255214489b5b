"""The picture of learned policies beside minimum snap: times, tracking errors, failures, and what labels buy."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

TITLES = ("Total time of a flight", "Tracking error, cumulative", "Flights that are not tracked", "What labels buy")
"""Of the panels, from left to right."""


def draw_policy_comparison(
    times: dict[str, Float[np.ndarray, "n"]],
    errors: dict[str, Float[np.ndarray, "n"]],
    failures: dict[str, dict[int, float]],
    curve: dict[str, dict[int, float]],
    path: Path,
    *,
    limit: float,
) -> None:
    """Write a PNG file.

    Args:
        times: total time of each flight over the minimum-snap label's, by policy.
        errors: largest position error of each flight [m], by who allotted its times.
        failures: share of flights that are not tracked, by number of waypoints.
        curve: area under the ROC curve by number of rollout labels, with and without the low fidelity.
        limit: position error of a feasible flight [m].
    """
    figure = Figure(figsize=(13.0, 3.7), layout="constrained")
    FigureCanvasAgg(figure)
    first, second, third, fourth = figure.subplots(1, 4)
    for name, values in times.items():
        first.hist(np.clip(values, 0.6, 1.4), np.linspace(0.6, 1.4, 41), alpha=0.5, density=True, label=name)
    first.axvline(1.0, color="0.4", linestyle="--", linewidth=1.0)
    first.set(xlabel="T / T of minimum snap", ylabel="density")
    for name, values in errors.items():
        second.plot(np.sort(np.clip(values, 0.0, 1.0)), np.linspace(0.0, 1.0, len(values)), label=name)
    second.axvline(limit, color="0.4", linestyle="--", linewidth=1.0)
    second.set(xlabel="largest position error [m]", ylabel="share of flights", xlim=(0.0, 0.5))
    for name, rates in failures.items():
        third.plot(list(rates), list(rates.values()), marker="o", markersize=3, label=name)
    third.xaxis.set_major_locator(MaxNLocator(integer=True))
    third.set(xlabel="waypoints", ylabel="share not tracked", ylim=(0.0, None))
    for name, scores in curve.items():
        fourth.plot(list(scores), list(scores.values()), marker="o", markersize=3, label=name)
    fourth.set(xlabel="rollout labels", ylabel="area under the ROC curve", xscale="log")
    counts = sorted({count for found in curve.values() for count in found})
    fourth.set_xticks(counts, [str(count) for count in counts])
    fourth.minorticks_off()
    for axis, title in zip((first, second, third, fourth), TITLES, strict=True):
        axis.set_title(title, fontsize=10, loc="left")
        axis.legend(frameon=False, fontsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
