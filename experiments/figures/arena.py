"""The arena in one picture: for each family and level a row of dots, one for each contestant."""

from pathlib import Path
from typing import NamedTuple

import matplotlib.figure
import numpy as np


class Mark(NamedTuple):
    """What one contestant came to on one level of one family."""

    family: str
    level: int
    contestant: str
    share: float
    episodes: int


def draw_arena(marks: list[Mark], path: Path) -> None:
    """Shares met as a table of colours: contestants down, families and levels across."""
    columns = list(dict.fromkeys((mark.family, mark.level) for mark in marks))
    overall: dict[str, list[float]] = {}
    for mark in marks:
        overall.setdefault(mark.contestant, []).append(mark.share)
    names = sorted(overall, key=lambda name: (name != "reference", -float(np.mean(overall[name]))))
    shares = np.full((len(names), len(columns)), np.nan)
    for mark in marks:
        shares[names.index(mark.contestant), columns.index((mark.family, mark.level))] = mark.share
    figure = matplotlib.figure.Figure(
        figsize=(2.6 + 0.62 * len(columns), 1.2 + 0.36 * len(names)), layout="constrained"
    )
    axes = figure.add_subplot()
    axes.imshow(np.ma.masked_invalid(shares), cmap="YlGn", vmin=0.0, vmax=1.0, aspect="auto")
    for row, column in np.ndindex(*shares.shape):
        value = shares[row, column]
        text = "" if np.isnan(value) else f"{100.0 * value:.0f}"
        axes.text(column, row, text, ha="center", va="center", fontsize=8, color="white" if value > 0.7 else "black")
    axes.set_yticks(range(len(names)), names)
    axes.set_xticks(range(len(columns)), [f"{level}" for _, level in columns])
    for family in dict.fromkeys(family for family, _ in columns):
        places = [place for place, (other, _) in enumerate(columns) if other == family]
        place = float(np.mean(places)), -0.5
        axes.annotate(family, place, (0, 4), textcoords="offset points", ha="center", va="bottom", fontsize=9)
        axes.axvline(places[-1] + 0.5, color="white", linewidth=3)
    axes.set_xlabel("level")
    axes.set_title("share of targets met [%]", pad=22, fontsize=10)
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    figure.savefig(path, dpi=140)
