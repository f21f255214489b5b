"""The picture of flights in other people's simulators: what share keeps within what error."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

LIMIT = 0.4
"""m, from which a flight fails."""
STYLES = {"own gains": ":", "our gains": "--", "feed-forward": "-"}
COLOURS = ("C0", "C1", "C2")
TITLES = {"interception": "whole interceptions", "plan": "the last plan alone", "policy": "policy flights"}


def draw_foreign_plants(
    flights: Sequence[Mapping[str, Any]], ways: Sequence[tuple[str, str]], kinds: Sequence[str], path: Path
) -> None:
    """A panel for each kind of flight: the share of flights whose largest position error is at most so much.

    Args:
        flights: as ``experiments.foreign_plants`` keeps them.
        ways: plant and controller of each line; a colour for each plant, a style for each controller.
        kinds: of flights, a panel each; some flights are of each.
        path: of the picture.
    """
    figure = Figure(figsize=(3.6 * max(len(kinds), 2), 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    plants = list(dict.fromkeys(plant for plant, _ in ways))
    for axis, kind in zip(figure.subplots(1, len(kinds), squeeze=False)[0], kinds, strict=True):
        some = [flight for flight in flights if flight["kind"] == kind]
        for plant, control in ways:
            errors = np.sort([flight[f"{plant}, {control}"]["error"] for flight in some])
            x, y = np.append(errors, 100.0), np.append(np.arange(1, len(errors) + 1) / len(errors), 1.0)
            colour = COLOURS[plants.index(plant)]
            axis.step(x, y, STYLES[control], where="post", color=colour, label=f"{plant}, {control}", linewidth=1.3)
        axis.axvline(LIMIT, color="0.6", linewidth=0.8)
        axis.set(xscale="log", xlim=(0.01, 10.0), ylim=(0.0, 1.02), title=f"{TITLES[kind]} ({len(some)})")
        axis.set_xlabel("largest position error [m]")
        axis.spines[["top", "right"]].set_visible(False)
    figure.axes[0].set_ylabel("share of flights")
    figure.axes[-1].legend(frameon=False, fontsize=7, loc="lower right")
    figure.savefig(path, dpi=130)
