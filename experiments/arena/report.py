"""The arena's leaderboard: who meets how many, how soon against the reference, what it hits and what it takes."""

from typing import Any, NamedTuple

import numpy as np

from jaxplan.runner.definition import Report, Results, Row
from jaxplan.runner.statistics import wilson
from jaxplan.runner.tables import as_latex, as_markdown, number

from ..figures.arena import Mark, draw_arena

MET, HIT, LOST = "intercepted", "collision", "tracking_lost"
HEADER = ("contestant", "episodes", "met", "95 %", "time / reference", "median s", "hit", "lost")
HEADER += ("closest m", "relative m/s", "energy", "committed", "changed", "outside")
WITHIN = (2.5, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0)
"""s within which those are counted that are met, of targets that can flee for ever."""


class Standing(NamedTuple):
    """Some episodes of one contestant."""

    contestant: str
    rows: list[Row]

    @property
    def met(self) -> list[Row]:
        """Those that ended with an interception."""
        return [row for row in self.rows if row["outcome"] == MET]

    @property
    def share(self) -> float:
        """Of those among all."""
        return len(self.met) / max(len(self.rows), 1)

    def count(self, outcome: str) -> int:
        """Episodes that ended so."""
        return sum(row["outcome"] == outcome for row in self.rows)

    def middle(self, key: str, rows: list[Row] | None = None) -> float | None:
        """The median of what is known."""
        known = [row[key] for row in (self.rows if rows is None else rows) if row.get(key) is not None]
        return float(np.median(known)) if known else None

    def over_reference(self, references: dict[tuple[Any, ...], float]) -> float | None:
        """Geometric mean of the times over the reference's, of the episodes that both met."""
        ratios = [row["time_s"] / references[_key(row)] for row in self.met if _key(row) in references]
        return float(np.exp(np.mean(np.log(ratios)))) if ratios else None

    def ratio(self, part: str, whole: str) -> float | None:
        """Of two counts over all cycles of ours."""
        known = [row for row in self.rows if row.get(whole) and row.get(part) is not None]
        return sum(row[part] for row in known) / sum(row[whole] for row in known) if known else None


def report(results: Results[Any]) -> Report:
    """The leaderboard of all families, one table each, and a picture of the shares."""
    rows = results.finished_rows()
    references = {_key(row): row["time_s"] for row in rows if row["contestant"] == "reference" and row["time_s"]}
    families = list(dict.fromkeys(row["family"] for row in rows))
    sections, marks = [], []
    overall = [[*_line(one, references)] for one in _standings(rows)]
    sections.append("## All families\n\n" + as_markdown(HEADER, overall))
    for family in families:
        for level in dict.fromkeys(row["level"] for row in rows if row["family"] == family):
            some = [row for row in rows if (row["family"], row["level"]) == (family, level)]
            standings = _standings(some)
            sections.append(
                f"## {family}, level {level}\n\n" + as_markdown(HEADER, [_line(one, references) for one in standings])
            )
            marks += [Mark(family, level, one.contestant, one.share, len(one.rows)) for one in standings]
    if "evasive" in families:
        sections.append(_by_time([row for row in rows if row["family"] == "evasive"]))
    hits = sum(row["outcome"] == HIT for row in rows if "/" in row["contestant"])
    ours = sum("/" in row["contestant"] for row in rows)
    explained = (
        "![](arena.png)\n\nMet: within 0.4 m, on the reference and clear of everything. Time over the reference: "
        "geometric mean over the episodes that both met; the reference is an offline optimum that knows the target's "
        "motion, none for targets that react. Closest: median of the least distance. Energy: median, in seconds of "
        "hover. Committed: share of the cycles that committed a new plan; changed: without the first of each "
        "episode. Outside: share of the candidates outside the room."
    )
    return Report(
        markdown=explained + "\n\n" + "\n\n".join(sections),
        table=rows,
        latex=as_latex(HEADER, overall, "The arena."),
        figures={"arena.png": lambda path: draw_arena(marks, path)},
        summary=f"{len(rows)} episodes; our planners hit something in {hits} of {ours}",
    )


def _by_time(rows: list[Row]) -> str:
    """Shares met within a time, by level and contestant."""
    header = ("level", "contestant", *(f"{seconds:g} s" for seconds in WITHIN))
    lines = []
    for level in dict.fromkeys(row["level"] for row in rows):
        for one in _standings([row for row in rows if row["level"] == level]):
            times = np.array([row["time_s"] for row in one.met])
            shares = [number((times <= seconds).sum() / len(one.rows)) for seconds in WITHIN]
            lines.append([str(level), one.contestant, *shares])
    return "## evasive: met within\n\n" + as_markdown(header, lines)


def _standings(rows: list[Row]) -> list[Standing]:
    """One for each contestant, the best share first; the reference before all."""
    names = dict.fromkeys(row["contestant"] for row in rows)
    found = [Standing(name, [row for row in rows if row["contestant"] == name]) for name in names]
    return sorted(found, key=lambda one: (one.contestant != "reference", -one.share))


def _line(one: Standing, references: dict[tuple[Any, ...], float]) -> list[str]:
    low, high = wilson(len(one.met), len(one.rows))
    return [
        one.contestant,
        str(len(one.rows)),
        number(one.share),
        f"{number(low)} to {number(high)}",
        number(one.over_reference(references), ".2f"),
        number(one.middle("time_s", one.met), ".2f"),
        str(one.count(HIT)),
        str(one.count(LOST)),
        number(one.middle("closest_m"), ".2f"),
        number(one.middle("relative_speed_m_s", one.met), ".1f"),
        number(one.middle("energy_hover_s"), ".1f"),
        number(one.ratio("committed", "cycles"), ".2f"),
        number(one.ratio("changes", "cycles"), ".2f"),
        number(one.ratio("outside", "candidates"), ".3f"),
    ]


def _key(row: Row) -> tuple[Any, ...]:
    """Which episode it is, whoever flies."""
    return row["family"], row["level"], row["number"]
