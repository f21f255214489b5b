"""What the experiment ``placing`` comes to: by start, by vehicle, by room."""

from typing import Any, NamedTuple

import numpy as np

from jaxplan.runner.definition import Report, Results, Row
from jaxplan.runner.tables import as_latex, as_markdown, number

from .figures.placing import draw_placing

OWN = "mfrl"
"""The vehicle that policies are trained for above all; the others are random."""
STARTS = ("from hover", "from flight")
OPTIMUM = "optimiser"
WHO = ("profile", OWN, "placed", "profile, refined", "placed, refined", OPTIMUM)
"""In the tables' order."""
SOLID = ((0.0, 0.05), (0.05, 0.12), (0.12, 1.0))
"""Shares of a room that are solid, by which rooms are told apart."""


class _Share(NamedTuple):
    """What someone's plans come to, over some courses."""

    count: int
    kept: int
    tracked: int
    """Of those that are kept."""
    ratio: float | None
    """Mean of the times over the optimum's, where both are kept."""


def _share(courses: list[Row], name: str) -> _Share | None:
    """None where nobody of that name planned."""
    mine = [row["plans"][name] for row in courses if name in row["plans"]]
    if not mine:
        return None
    kept = [plan for plan in mine if plan["time"] is not None]
    pairs = [(row["plans"].get(name, {}).get("time"), row["plans"][OPTIMUM]["time"]) for row in courses]
    ratios = [time / least for time, least in pairs if time is not None and least is not None]
    tracked = sum(bool(plan["tracked"]) for plan in kept)
    return _Share(len(mine), len(kept), tracked, float(np.mean(ratios)) if ratios else None)


def report(results: Results[Any]) -> Report:
    """Own vehicle and others, by who planned; then vehicle by vehicle and room by room for refined plans."""
    rows = results.finished_rows()
    groups = {OWN: [row for row in rows if row["name"] == OWN], "others": [row for row in rows if row["name"] != OWN]}
    table = [
        {"vehicles": title, "start": start, "plans": who, **share._asdict()}
        for title, some in groups.items()
        for start in STARTS
        for who in WHO
        if (share := _share(_courses(some, start), who)) is not None
    ]
    header = ["vehicles", "start", "plans", "courses", "kept", "tracked of these", "time / optimiser"]
    lines = [
        [row["vehicles"], row["start"], row["plans"], str(row["count"]), *_numbers(_Share(*list(row.values())[3:]))]
        for row in table
    ]
    markdown = as_markdown(header, lines)
    return Report(
        markdown=f"{markdown}\n![placing](placing.png)\n\n{_by_vehicle(rows)}\n{_by_room(rows)}",
        table=table,
        latex=as_latex(header, lines, "Times alone, times and places, and the optimiser"),
        figures={"placing.png": lambda path: draw_placing(_points(rows), path)},
        summary=markdown,
    )


def _courses(rows: list[Row], start: str) -> list[Row]:
    return [course for row in rows for course in row["courses"] if course["start"] == start]


def _numbers(share: _Share) -> list[str]:
    """Shares and the ratio, as they stand in tables."""
    tracked = share.tracked / share.kept if share.kept else None
    return [number(share.kept / share.count), number(tracked), number(share.ratio)]


def _by_vehicle(rows: list[Row]) -> str:
    header = ["vehicle", "mass [kg]", "thrust to weight", "lag [ms]"]
    header += [f"{what}, {start}" for start in STARTS for what in ("kept", "tracked", "time / optimiser")]
    lines = []
    for row in rows:
        shares = [_share(_courses([row], start), "placed, refined") for start in STARTS]
        numbers = [cell for share in shares for cell in (["-"] * 3 if share is None else _numbers(share))]
        lag = 1e3 * row["motor_time_constant"]
        lines.append([row["name"], f"{row['mass']:.2f}", f"{row['thrust_to_weight']:.1f}", f"{lag:.0f}", *numbers])
    return f"Placed and refined, by vehicle:\n\n{as_markdown(header, lines)}"


def _by_room(rows: list[Row]) -> str:
    lines = []
    for low, high in SOLID:
        for start in STARTS:
            some = [course for course in _courses(rows, start) if low <= course["filled"] < high]
            share = _share(some, "placed, refined")
            if share is not None:
                lines.append([f"{low:.0%} to {high:.0%}", start, str(share.count), *_numbers(share)])
    header = ["solid", "start", "courses", "kept", "tracked of these", "time / optimiser"]
    return f"Placed and refined, by how much of the room is solid, all vehicles:\n\n{as_markdown(header, lines)}"


def _points(rows: list[Row]) -> dict[str, list[tuple[float, float]]]:
    """Time over the optimum, and the share kept and tracked, of each vehicle from flight, by who planned."""
    found: dict[str, list[tuple[float, float]]] = {}
    for who in WHO[:-1]:
        for row in rows:
            share = _share(_courses([row], STARTS[1]), who)
            if share is not None and share.ratio is not None:
                found.setdefault(who, []).append((share.ratio, share.tracked / share.count))
    return found
