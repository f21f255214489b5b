"""The picture of the network's size: error against time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter


def draw_network_size(rows: Sequence[Mapping[str, Any]], path: Path, *, shipped: int) -> None:
    """One point a size, for a whole evaluation and for one decoder pass, into a PNG file.

    Args:
        rows: as ``experiments.network_size`` writes them; those without an error, which came to nothing, are left out.
        shipped: the width that the shipped policies have, which is marked.
    """
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    rows = [row for row in rows if row["error"] is not None]
    error = [100.0 * row["error"] for row in rows]
    kinds = (("evaluation_ms", "encoder and one pass", (4, 4), "left"), ("pass_ms", "one pass", (-4, -12), "right"))
    for name, label, offset, side in kinds:
        times = [row[name] for row in rows]
        (line,) = axis.plot(times, error, marker="o", label=label)
        for row, time, value in zip(rows, times, error, strict=True):
            weight = "bold" if row["hidden"] == shipped else "normal"
            axis.annotate(
                str(row["hidden"]),
                (time, value),
                xytext=offset,
                ha=side,
                textcoords="offset points",
                color=line.get_color(),
                fontweight=weight,
            )
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_ylim(0.0, 1.15 * max(error, default=1.0))
    axis.set_xlabel("400 sequences of 14 waypoints [ms]")
    axis.set_ylabel("held-out error of the total time [%]")
    axis.set_title("width of the decoder's GRU; bold: shipped", fontsize=9)
    axis.legend(frameon=False)
    axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
