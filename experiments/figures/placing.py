"""The picture of placed plans: how soon they meet, and how many can be flown."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def draw_placing(points: Mapping[str, Sequence[tuple[float, float]]], path: Path) -> None:
    """One point a vehicle, by who planned, into a PNG file.

    Args:
        points: time over the optimiser's, and the share of all plans that is kept and tracked.
        path: of the picture.
    """
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    for who, some in points.items():
        axis.scatter(*zip(*some, strict=True), s=22, alpha=0.8, label=who)
    axis.axvline(1.0, color="0.4", linestyle="--", linewidth=1.0)
    axis.set(xlabel="time to the meeting, over the optimiser's", ylabel="share kept and tracked", ylim=(-0.03, 1.03))
    axis.set_title("one point a vehicle, from flight", fontsize=9)
    axis.legend(frameon=False, fontsize=8)
    axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
