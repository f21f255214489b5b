"""The picture of flights by a firmware: errors along references, errors of interceptions, and what the rotors did."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

LIMIT = 400.0
"""mm, from which an interception counts as lost."""
CORNERS = ("front left", "front right", "rear right", "rear left")
"""Rotors of the vehicle, in its order."""


def draw_firmware(
    references: Sequence[Mapping[str, Any]], flights: Sequence[Mapping[str, Any]], rate: float, path: Path
) -> None:
    """Three panels: position error over time along each reference and in each interception; rotors of the fastest one.

    Args:
        references: as ``experiments.firmware`` keeps them.
        flights: interceptions, likewise.
        rate: rows a second of their traces.
        path: of the picture.
    """
    figure = Figure(figsize=(12.5, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    along, intercepting, turning = figure.subplots(1, 3)
    for place, row in enumerate(references):
        label = f"{row['speed']:g} m/s" if row["speed"] else "hover"
        shade = f"C{place}"
        error = 1e3 * np.asarray(row["trace"]["error"])
        along.plot(np.arange(1, len(error) + 1) / rate, error, color=shade, linewidth=1.1, label=label)
    along.set(title="eights from rest to rest, by top speed", xlabel="time [s]", ylabel="position error [mm]")
    along.set(yscale="log", ylim=(0.5, 1000.0))
    for row in flights:
        error = 1e3 * np.asarray(row["trace"]["error"])
        shade = "C0" if row["outcome"] == "intercepted" else "C3"
        intercepting.plot(np.arange(1, len(error) + 1) / rate, error, color=shade, linewidth=0.9, alpha=0.8)
    met = sum(row["outcome"] == "intercepted" for row in flights)
    intercepting.axhline(LIMIT, color="0.5", linewidth=0.8, linestyle="--", label="lost beyond")
    intercepting.set(yscale="log", ylim=(0.5, 1000.0), xlabel="time [s]")
    intercepting.set(title=f"interceptions, replanned: {met} of {len(flights)} met", ylabel="position error [mm]")
    if flights:
        fastest = max(flights, key=lambda row: row["speed"])
        rotors = np.asarray(fastest["trace"]["rotors"])
        for rotor, name in zip(rotors.T, CORNERS, strict=True):
            turning.plot(np.arange(1, len(rotor) + 1) / rate, rotor, linewidth=1.0, label=name)
        turning.set_title(f"rotors of the fastest, {fastest['speed']:.1f} m/s")
    turning.set(xlabel="time [s]", ylabel="share of the largest speed", ylim=(0.0, 1.02))
    for axis in figure.axes:
        axis.spines[["top", "right"]].set_visible(False)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(frameon=False, fontsize=7, loc="upper left")
    figure.savefig(path, dpi=130)
