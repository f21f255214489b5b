"""The picture of vehicles of all sizes: how soon they get there, and what share of their plans they can follow."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

LEADER = {"arrowstyle": "-", "color": "0.6", "linewidth": 0.6}
WANTED = 0.9
"""Share of the usable plans that should be tracked."""


def draw_vehicles(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Two panels over the acceleration that plans ask for, into a PNG file; the larger a vehicle, the larger its point.

    Args:
        rows: as ``experiments.vehicles`` writes them; those without a plan are left out.
        path: of the picture.
    """
    rows = [row for row in rows if row["usable"]]
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2)
    sizes = {True: "presets", False: "files of four lines"}
    for preset, label in sizes.items():
        some = [row for row in rows if row["preset"] == preset]
        x, area = [row["acceleration"] for row in some], [60.0 * row["mass"] ** 0.5 + 10.0 for row in some]
        style: dict[str, Any] = {"s": area, "alpha": 0.8, "label": label, "marker": "D" if preset else "o"}
        axes[0].scatter(x, [row["least_time"] for row in some], **style)
        axes[1].scatter(x, [row["tracked"] / row["usable"] for row in some], **style)
    named = sorted((row for row in rows if row["preset"]), key=lambda row: row["acceleration"])
    for nth, row in enumerate(named):
        place = (row["acceleration"], row["least_time"])
        offset = (4, 12 + 12 * (nth % 2))  # neighbours at two heights
        axes[0].annotate(row["name"], place, xytext=offset, textcoords="offset points", fontsize=8, arrowprops=LEADER)
    axes[0].set_title("the larger a point, the heavier the vehicle", fontsize=9)
    axes[1].axhline(WANTED, color="0.6", linewidth=1.0, linestyle="--")
    lowest = min([row["tracked"] / row["usable"] for row in rows], default=0.0)
    axes[1].set_ylim(min(0.85, lowest - 0.05), 1.005)
    axes[0].set_ylabel("median least time to the same goals [s]")
    axes[1].set_ylabel("share of usable plans that is tracked")
    axes[0].set_ylim(bottom=0.0)
    for axis in axes:
        axis.set_xlabel("acceleration that plans ask for [m/s²]")
        axis.spines[["top", "right"]].set_visible(False)
    axes[1].legend(frameon=False, fontsize=8, loc="lower right")
    figure.savefig(path, dpi=130)
