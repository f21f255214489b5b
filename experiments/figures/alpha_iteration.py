"""The picture of the alpha iteration: convergence, growth of the flight time, and tracking error."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def draw_alpha_iteration(
    errors: dict[str, Float[np.ndarray, "passes k"]],
    alphas: Float[np.ndarray, "a"],
    times: Float[np.ndarray, "a k"],
    tracking: Float[np.ndarray, "a k"],
    path: Path,
    *,
    tolerance: float,
    limit: float,
) -> None:
    """Write a PNG file.

    Args:
        errors: relative error of the arrival time after each pass, by method.
        times: flight time at each alpha over that at alpha = 1.
        tracking: largest position error of each flight [m].
        tolerance: error at which a candidate has converged.
        limit: position error of a feasible flight [m].
    """
    figure = Figure(figsize=(11.0, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3)
    for name, values in errors.items():
        passes = np.arange(1, len(values) + 1)
        _band(left, passes, np.maximum(values, 1e-8), name, (50.0, 95.0))
    left.axhline(tolerance, color="0.4", linestyle="--", linewidth=1.0)
    left.set(yscale="log", xlabel="passes of the policy", ylabel="arrival error, median and 95 %")
    left.legend(frameon=False, fontsize=8)
    _band(middle, alphas, times, "policy", (50.0, 95.0))
    middle.plot(alphas, alphas, color="0.6", linewidth=1.0, label="state ignored")
    middle.set(xlabel="scale factor alpha", ylabel="T(alpha) / T(1), median and 5 to 95 %")
    middle.fill_between(alphas, *np.nanpercentile(times, [5.0, 95.0], axis=1), alpha=0.2, linewidth=0)
    middle.legend(frameon=False, fontsize=8)
    mean, deviation = np.nanmean(tracking, axis=1), np.nanstd(tracking, axis=1)
    right.fill_between(alphas, np.maximum(mean - deviation, 0.0), mean + deviation, alpha=0.25, linewidth=0)
    right.plot(alphas, mean, marker="o", markersize=3)
    right.axhline(limit, color="0.4", linestyle="--", linewidth=1.0)
    right.set(xlabel="scale factor alpha", ylabel="largest position error [m], mean and std", ylim=(0.0, None))
    for axis in (left, middle, right):
        axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)


def _band(
    axis: Axes,
    x: Float[np.ndarray, "n"],
    values: Float[np.ndarray, "n k"],
    name: str,
    percentiles: tuple[float, float],
) -> None:
    """A line at the first percentile over the lanes, and a thin one at the second."""
    middle, high = np.nanpercentile(values, percentiles, axis=1)
    (line,) = axis.plot(x, middle, marker="o", markersize=3, label=name)
    axis.plot(x, high, color=line.get_color(), linewidth=0.8, linestyle=":")
