"""The report of Table I: success beside the paper's, what fails and where, and how long more would take."""

from collections import Counter
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.runner.definition import Report, Results, Row
from jaxplan.runner.statistics import wilson
from jaxplan.runner.tables import as_latex, as_markdown, duration

from .closed_loop import PADDING, VEHICLE
from .figures.success import Bar, Line, draw_failures, draw_success, draw_success_by_speed
from .reference_times_report import episode_key, stored_references

PAPER = {
    "no-policy": {"none": 0.14, "ground-truth": 0.40, "noisy-0.01": 0.40, "noisy-0.05": 0.30, "gmm": 0.36},
    "pretrained": {"none": 0.38, "ground-truth": 0.78, "noisy-0.01": 0.76, "noisy-0.05": 0.66, "gmm": 0.68},
    "mfrl": {"none": 0.57, "ground-truth": 0.90, "noisy-0.01": 0.85, "noisy-0.05": 0.76, "gmm": 0.82},
}
"""Shares of interceptions (paper, Table I)."""
FULL = 3000
"""Episodes of a cell in the paper."""
MANY = 64
"""Cores of the larger machine for which times are extrapolated."""
SUCCESS = "intercepted"
FAILURES = ("collision", "tracking_lost", "target_ended", "no_plan")


class Cell(NamedTuple):
    """All episodes of one planner with one predictor."""

    planner: str
    predictor: str
    rows: list[Row]

    @property
    def good(self) -> int:
        """Episodes that ended with an interception."""
        return sum(row["outcome"] == SUCCESS for row in self.rows)

    @property
    def share(self) -> float:
        """Their share of all."""
        return self.good / max(len(self.rows), 1)

    @property
    def interval(self) -> tuple[float, float]:
        """The share's 95 % interval."""
        return wilson(self.good, len(self.rows))

    @property
    def paper(self) -> float | None:
        """The paper's share; None where it has no such cell."""
        return PAPER.get(self.planner, {}).get(self.predictor)

    def over_reference(self, references: dict[tuple[str, ...], float]) -> Float[np.ndarray, "n"]:
        """Time to intercept over the reference, of the episodes that have both."""
        met = [row for row in self.rows if row["time_to_intercept_s"] is not None and episode_key(row) in references]
        return np.array([row["time_to_intercept_s"] / references[episode_key(row)] for row in met])

    def failures(self) -> Counter[str]:
        """How the other episodes ended, and how often."""
        return Counter(row["outcome"] for row in self.rows if row["outcome"] != SUCCESS)


def report(results: Results[Any]) -> Report:
    """Tables, pictures and times."""
    rows = results.finished_rows()
    cells = by_cell(rows)
    usual = (results.config.vehicle, results.config.padding) == (VEHICLE, PADDING)
    header, lines = _main_table(cells, stored_references() if usual else {})
    times = _times(results)
    count = max(len(cell.rows) for cell in cells)
    text = [
        f"{count} episodes a cell; {len(rows)} in all. Shares of interceptions with Wilson's 95 % intervals, and the",
        "paper's; failures by kind. `pursuit` and `navigation` plan nothing and see no obstacles; what the `optimiser`",
        "takes to compute is not counted against it. Over reference: how many times as long as the soonest trajectory",
        "known for the same episode (`reference-times`), in the mean and for one in ten.",
        "",
        as_markdown(header, lines),
        "![success](success.png)",
        "",
        "## Below the paper",
        "",
        _below(cells),
        "## By environment",
        "",
        _split(cells, "world"),
        "## By the target's maximum speed [m/s]",
        "",
        _split(cells, "speed"),
        "## Plans",
        "",
        "Every committed plan, sampled every 5 ms over its whole length: the least distance to anything beyond the",
        "vehicle's radius, and how fast the fastest still is at its end. Hesitated: episodes slower than 1 m/s again",
        "after more than 3 m/s. Without a plan: cycles after the departure in which nothing can even be approached.",
        "",
        _plans(cells),
        "![success by speed](speeds.png)",
        "",
        "![failures](failures.png)",
        "",
        "## Time",
        "",
        times,
    ]
    bars = [Bar(c.planner, c.predictor, c.share, c.interval, c.paper) for c in cells]
    kinds = {f"{c.planner}, {c.predictor}": {k: c.failures()[k] / len(c.rows) for k in FAILURES} for c in cells}
    return Report(
        markdown="\n".join(text),
        table=rows,
        latex=as_latex(header, lines, f"Success in closed loop, {count} episodes a cell, with 95 % intervals"),
        figures={
            "success.png": lambda path: draw_success(bars, path),
            "speeds.png": lambda path: draw_success_by_speed(_lines(cells), path),
            "failures.png": lambda path: draw_failures(kinds, path),
        },
        summary=as_markdown(header, lines) + times,
    )


def by_cell(rows: Iterable[Row]) -> list[Cell]:
    """The rows sorted into cells, in the order of their first rows."""
    found: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        found.setdefault((row["planner"], row["predictor"]), []).append(row)
    return [Cell(planner, predictor, mine) for (planner, predictor), mine in found.items()]


def _main_table(cells: list[Cell], references: dict[tuple[str, ...], float]) -> tuple[list[str], list[list[str]]]:
    header = ["planner, predictor", "success", "95 %", "paper", "difference", *(k.replace("_", " ") for k in FAILURES)]
    header += ["mean time [s]", "over reference", "90 %"]
    lines = []
    for cell in cells:
        low, high = cell.interval
        times = [row["time_to_intercept_s"] for row in cell.rows if row["time_to_intercept_s"] is not None]
        paper = ["-", "-"] if cell.paper is None else [f"{cell.paper:.2f}", f"{cell.share - cell.paper:+.2f}"]
        failures = [str(cell.failures()[kind]) for kind in FAILURES]
        name = f"{cell.planner}, {cell.predictor}"
        mean, over = f"{np.mean(times):.2f}" if times else "-", cell.over_reference(references)
        ratio = [f"{np.mean(over):.2f}", f"{np.percentile(over, 90):.2f}"] if len(over) else ["-", "-"]
        lines.append([name, f"{cell.share:.3f}", f"{low:.2f} to {high:.2f}", *paper, *failures, mean, *ratio])
    return header, lines


def _below(cells: list[Cell]) -> str:
    """By how much cells are below the paper's, and what fails there: kinds, environments, speeds."""
    lines = []
    for cell in cells:
        if cell.paper is None or cell.share >= cell.paper:
            continue
        lost = [row for row in cell.rows if row["outcome"] != SUCCESS]
        parts = [_most(lost, key) for key in ("outcome", "world", "speed")]
        lines.append(
            f"- {cell.planner}, {cell.predictor}: {cell.paper - cell.share:.2f} below {cell.paper:.2f}"
            f"{' (within the interval)' if cell.interval[1] >= cell.paper else ''}; {len(lost)} failures: "
            + "; ".join(parts)
        )
    return "\n".join(lines or ["No cell that the paper has."]) + "\n"


def _most(rows: list[Row], key: str) -> str:
    return ", ".join(f"{count} {value}" for value, count in Counter(row[key] for row in rows).most_common())


def _split(cells: list[Cell], key: str) -> str:
    """Success of every cell for each value of a column."""
    values = sorted({row[key] for cell in cells for row in cell.rows})
    lines = []
    for cell in cells:
        shares = []
        for value in values:
            mine = [row["outcome"] == SUCCESS for row in cell.rows if row[key] == value]
            shares.append(f"{np.mean(mine):.2f}" if mine else "-")
        lines.append([f"{cell.planner}, {cell.predictor}", *shares])
    return as_markdown(["", *(f"{value:.3g}" if isinstance(value, float) else value for value in values)], lines)


def _plans(cells: list[Cell]) -> str:
    """How many there were, whether they keep clear and end at rest, and how often there was none."""
    header = ["", "plans", "least clearance [m]", "end speed [m/s]", "end [m/s^2]", "hesitated", "without a plan"]
    lines = []
    for cell in cells:
        rows = [row for row in cell.rows if row.get("plan_clearance_m") is not None]
        if not rows:
            continue
        columns = ("plan_clearance_m", "plan_end_speed_m_s", "plan_end_acceleration_m_s2")
        clearance, speed, acceleration = (np.array([row[name] for row in rows]) for name in columns)
        without, cycles = (sum(row[name] for row in cell.rows) for name in ("cycles_without_plan", "replans"))
        hesitated = np.mean([row["hesitated"] for row in cell.rows])
        worst = [f"{clearance.min():.3f}", f"{speed.max():.1e}", f"{acceleration.max():.1e}"]
        count = sum(row["plans"] for row in rows)
        shares = [f"{100 * hesitated:.1f} %", f"{100 * without / max(cycles, 1):.2f} %"]
        lines.append([f"{cell.planner}, {cell.predictor}", str(count), *worst, *shares])
    return as_markdown(header, lines)


def _lines(cells: list[Cell]) -> list[Line]:
    """Success over speed, for the picture."""
    lines = []
    for cell in cells:
        speeds = sorted({row["speed"] for row in cell.rows})
        parts = [Cell(*cell[:2], [row for row in cell.rows if row["speed"] == speed]) for speed in speeds]
        shares, intervals = [part.share for part in parts], [part.interval for part in parts]
        lines.append(Line(*cell[:2], *(np.array(values, dtype=float) for values in (speeds, shares, intervals))))
    return lines


def _times(results: Results[Any]) -> str:
    """What was spent, and what the paper's number of episodes would take here and on a larger machine.

    Episodes that compiled something say nothing of the next ones; their time counts as preparation.
    """
    warm: dict[tuple[str, str], list[float]] = {}
    cold: dict[tuple[str, str], list[float]] = {}
    for item, spent, compiled in zip(results.items, results.seconds, results.compiled, strict=True):
        place = cold if compiled else warm
        place.setdefault((item.values["planner"], item.values["predictor"]), []).append(spent)
    every = [spent for some in warm.values() for spent in some]
    preparing = sum(results.prepare_seconds.values()) + sum(map(sum, cold.values()))
    if not every:
        return f"Every episode compiled something ({duration(preparing)} in all): nothing can be extrapolated.\n"
    usual = float(np.mean(every))
    each = [np.mean(warm.get(cell, usual)) for cell in {**warm, **cold}]
    full, longest = FULL * float(np.sum(each)), max(results.prepare_seconds.values(), default=0.0)
    return (
        f"{len(every)} warm episodes took {duration(sum(every))} of a worker, {60.0 / usual:.0f} a minute; "
        f"compiling for {len(results.prepare_seconds)} planners took {duration(preparing)}.\n"
        f"Extrapolated to {FULL} episodes a cell: {duration(full + preparing)} with one worker, "
        f"{duration((full + preparing) / 2)} with 2, {duration(full / MANY + longest)} with {MANY} on as many cores.\n"
    )
