"""The report of flights by a firmware: what was followed, what was met, and whether it was the same twice."""

from collections.abc import Sequence
from typing import Any

from jaxplan.runner.definition import Report, Results, Row
from jaxplan.runner.statistics import wilson
from jaxplan.runner.tables import as_latex, as_markdown, number

from .figures.firmware import draw_firmware

GENTLE = 5.0
"""m/s, up to which a reference counts as gentle."""
KEPT_RATE = 50
"""Rows a second that are kept for the picture."""
REFERENCE_HEADER = (
    "reference m/s",
    "m/s^2",
    "rms mm",
    "worst mm",
    "twist deg",
    "saturated",
    "identical",
    "ours rms mm",
)
MET_HEADER = ("interception", "outcome", "after s", "m/s", "weights", "replans", "plans", "rms mm", "worst mm")
MET_HEADER += ("twist deg", "clearance m", "saturated", "identical", "ours", "ours worst mm")


def report(results: Results[Any]) -> Report:
    """A line for each reference and each interception; what share was met; the picture."""
    results.finished_rows()  # raises where nothing is left
    known = [(item.name, row) for item, row in zip(results.items, results.rows, strict=True) if row is not None]
    references = [row for _, row in known if row["kind"] == "reference"]
    flights = [(name, row) for name, row in known if row["kind"] == "interception"]
    met = sum(row["outcome"] == "intercepted" for _, row in flights)
    collided = sum(row["outcome"] == "collision" for _, row in flights)
    alike = sum(row["identical"] for _, row in known)
    low, high = wilson(met, len(flights))
    gentle = [row["rms"] for row in references if row["speed"] <= GENTLE]
    closest = f"largest rms of the references up to {GENTLE:g} m/s: {1e3 * max(gentle):.1f} mm. " if gentle else ""
    alone = all(row["own_network"] for _, row in known)
    network = "a network of its own" if alone else "the fixed ports of 127.0.0.1, with no network of its own here"
    text = (
        f"{as_markdown(REFERENCE_HEADER, [_reference_cells(row) for row in references])}\n"
        f"{as_markdown(MET_HEADER, [_met_cells(name, row) for name, row in flights])}\n"
        f"Interceptions by the firmware: {met} of {len(flights)} met (95 %: {number(low)} to {number(high)}), "
        f"{collided} collisions; {closest}Flown twice with every bit the same: {alike} of {len(known)}. "
        f"The firmware had {network}.\n"
    )
    return Report(
        markdown=f"{text}\n![firmware](firmware.png)\n",
        table=[{"name": name, **{key: value for key, value in row.items() if key != "trace"}} for name, row in known],
        latex=as_latex(MET_HEADER, [_met_cells(name, row) for name, row in flights], "Interceptions by the firmware"),
        figures={"firmware.png": lambda path: draw_firmware(references, [row for _, row in flights], KEPT_RATE, path)},
        summary=f"{met} of {len(flights)} met, {collided} collisions, {alike} of {len(known)} flown twice alike",
    )


def _reference_cells(row: Row) -> Sequence[str]:
    return [
        f"{row['speed']:g}",
        number(row["acceleration"], ".1f"),
        number(1e3 * row["rms"], ".1f"),
        number(1e3 * row["worst"], ".0f"),
        number(row["twist_deg"], ".1f"),
        number(row["saturated"]),
        "yes" if row["identical"] else "no",
        number(1e3 * row["own_rms"], ".1f"),
    ]


def _met_cells(name: str, row: Row) -> Sequence[str]:
    return [
        name,
        row["outcome"],
        number(row["time_to_intercept_s"]),
        number(row["speed"], ".1f"),
        number(row["thrust_g"], ".1f"),
        str(row["replans"]),
        str(row["plans"]),
        number(1e3 * row["rms"], ".1f"),
        number(1e3 * row["worst"], ".0f"),
        number(row["twist_deg"], ".1f"),
        number(row["min_clearance_m"]),
        number(row["saturated"]),
        "yes" if row["identical"] else "no",
        row["own_outcome"],
        number(1e3 * row["own_worst"], ".0f"),
    ]
