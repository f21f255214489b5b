"""What every replan cycle of an episode came to, as a table (``cycles.csv``)."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from jaxplan.errors import FileError
from jaxplan.files import read_limited
from jaxplan.status import PlanStatus

if TYPE_CHECKING:
    from jaxplan.replanner import Cycle

_COUNTS = ("chosen", "generated", "rejected", "refused")
CYCLES = ("time", "status", *_COUNTS, "deviation", "latency", "sooner", "computed_ms")
"""Columns: s; the name of a ``jaxplan.status.PlanStatus``; an index or -1; counts; m, s, s; ms in all.
A column for each station follows, in ms."""
_LARGEST = 64 * 2**20


def write_cycles(path: Path, cycles: "Sequence[Cycle]") -> None:
    """Write a row for each cycle; ``rejected`` counts reasons, of which a candidate may have several."""
    stations = list(dict.fromkeys(station for cycle in cycles for station in cycle.stage_ms))
    with path.open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow([*CYCLES, *(f"{station}_ms" for station in stations)])
        for cycle in cycles:
            numbers = [cycle.chosen, cycle.generated, sum(cycle.rejected.values()), cycle.refused]
            metres = [cycle.deviation, cycle.latency, cycle.sooner, sum(cycle.stage_ms.values())]
            shares = [cycle.stage_ms.get(station, 0.0) for station in stations]
            row = [*(f"{value:.6f}" for value in (*metres, *shares))]
            table.writerow([f"{cycle.time:.6f}", PlanStatus(cycle.status).name.lower(), *numbers, *row])


def read_cycles(path: Path) -> list[dict[str, float | str]]:
    """The rows of a ``cycles.csv`` by column; NaN where a number is unknown.

    Raises:
        FileError: there is no such file, or it holds something else.
    """
    content = read_limited(path, _LARGEST, "a cycles.csv that jaxplan intercept wrote")
    try:
        rows = list(csv.DictReader(io.StringIO(content.decode()), strict=True))
        return [{name: value if name == "status" else float(value) for name, value in row.items()} for row in rows]
    except (ValueError, TypeError, csv.Error) as error:
        raise FileError(f"{path}: is no cycles.csv of jaxplan intercept ({error}); give another file") from error
