"""The picture of tracking error against scale factor."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def draw_scale_factor(rows: Sequence[Mapping[str, float]], path: Path, *, position: float, yaw: float) -> None:
    """Mean and standard deviation of both errors, and the share of feasible flights, into a PNG file.

    Args:
        rows: one for each alpha, as ``experiments.scale_factor`` writes them.
        position: threshold of the labels [m].
        yaw: threshold of the labels [deg].
    """
    table = {key: np.array([row[key] for row in rows], dtype=float) for key in rows[0]}
    figure = Figure(figsize=(10.0, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 3)
    panels = ((axes[0], "position", "m", position, np.inf), (axes[1], "yaw", "deg", yaw, 180.0))
    for axis, name, unit, limit, most in panels:
        mean, deviation = table[f"{name}_mean_{unit}"], table[f"{name}_std_{unit}"]
        band = np.clip([mean - deviation, mean + deviation], 0.0, most)
        axis.fill_between(table["alpha"], *band, alpha=0.25, linewidth=0)
        axis.plot(table["alpha"], mean, marker="o", markersize=3)
        axis.axhline(limit, color="0.4", linestyle="--", linewidth=1.0)
        axis.annotate("infeasible above", (table["alpha"][-1], limit), ha="right", va="bottom", color="0.4", fontsize=8)
        axis.set_ylabel(f"largest {name} error [{unit}], mean and std")
        axis.set_ylim(bottom=0.0)
    axes[2].plot(table["alpha"], table["feasible_share"], marker="o", markersize=3, label="feasible")
    axes[2].plot(table["alpha"], table["lost_share"], marker="s", markersize=3, label="lost (left out of the means)")
    axes[2].set_ylabel("share of flights")
    axes[2].set_ylim(-0.03, 1.03)
    axes[2].legend(frameon=False, fontsize=8)
    for axis in axes:
        axis.axvline(1.0, color="0.7", linewidth=1.0)
        axis.set_xlabel("scale factor alpha (1: rotor limits)")
        axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
