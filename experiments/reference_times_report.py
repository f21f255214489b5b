"""The report of the reference times: how soon targets could be met, beside how soon the closed loop met them."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError
from jaxplan.runner.definition import Report, Results, Row
from jaxplan.runner.tables import as_latex, as_markdown, number

from .figures.reference_times import draw_reference_times

_STORED = Path(__file__).parent.parent / "docs" / "results"
DEFAULT = _STORED / "table1-mfrl" / "results.csv"
"""Table I's episodes as they were flown last, where there is a checkout."""
REFERENCES = _STORED / "reference-times" / "results.csv"
"""Their reference times, likewise."""
_KEY = ("world", "target", "speed", "departure")


def compared_file(named: str | None) -> Path | None:
    """Which results of Table I the references are compared with; None where there are none."""
    path = DEFAULT if named is None else Path(named)
    return path if path.is_file() else None


def report(results: Results[Any]) -> Report:
    """References by room, beside the closed loop's times where these are known."""
    config = results.config
    path = compared_file(config.compare)
    closed = {} if path is None else closed_loop_times(path, config.planner, config.predictor)
    rows = [{**row, "closed_loop_s": closed.get(episode_key(row))} for row in results.finished_rows()]
    worlds = list(dict.fromkeys(row["world"] for row in rows))
    parts = {world: [row for row in rows if row["world"] == world] for world in worlds} | {"all": rows}
    name = f"{config.planner}, {config.predictor}"
    header = ["", "episodes", "flown", "reference [s]", "closed loop [s]", "mean ratio", "median", "90 %", "top speed"]
    lines = [_line(world, some) for world, some in parts.items()]
    spent = [s for s, compiled in zip(results.seconds, results.compiled, strict=True) if not compiled]
    text = [
        f"{len(rows)} episodes of Table I. Reference: seconds from departure to within 0.4 m of the target, whose",
        "motion is known, by the soonest trajectory found that the simulated vehicle flies in control and clear of",
        f"everything; closed loop: the same by {name}, over the episodes in which both meet it. Ratios: closed loop",
        "over reference.",
        "",
        as_markdown(header, lines),
        _extremes(rows),
        f"An episode took {number(float(np.mean(spent)) if spent else None, '.1f')} s of one core.",
        "",
        "![reference times](reference_times.png)",
    ]
    return Report(
        markdown="\n".join(text) + "\n",
        table=rows,
        latex=as_latex(header, lines, "Reference times to intercept and those of the closed loop"),
        figures={"reference_times.png": lambda path: draw_reference_times(rows, name, path)},
        summary=as_markdown(header, lines),
    )


def closed_loop_times(path: Path, planner: str, predictor: str) -> dict[tuple[str, ...], float]:
    """Times to intercept [s] of one cell of Table I's ``results.csv``, by episode; those that meet the target only."""
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            cell = [row for row in csv.DictReader(stream) if (row["planner"], row["predictor"]) == (planner, predictor)]
        return {episode_key(row): float(row["time_to_intercept_s"]) for row in cell if row["time_to_intercept_s"]}
    except (OSError, KeyError, ValueError) as error:
        raise FileError(f"{path}: is not a results.csv of table1 ({type(error).__name__}: {error})") from error


def stored_references(path: Path = REFERENCES) -> dict[tuple[str, ...], float]:
    """Reference times [s] by episode, as ``reference-times`` has written them; none where there is no such file."""
    if not path.is_file():
        return {}
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream))
        return {episode_key(row): float(row["reference_s"]) for row in rows if row["reference_s"]}
    except (OSError, KeyError, ValueError) as error:
        raise FileError(f"{path}: is not a results.csv of reference-times ({type(error).__name__}: {error})") from error


def ratios(rows: list[Row]) -> Float[np.ndarray, "n"]:
    """Closed loop over reference, of the episodes that have both."""
    return np.array([row["closed_loop_s"] / row["reference_s"] for row in _both(rows)])


def _both(rows: list[Row]) -> list[Row]:
    return [row for row in rows if row["reference_s"] is not None and row["closed_loop_s"] is not None]


def episode_key(row: Row) -> tuple[str, ...]:
    """World, target, speed and departure, as text."""
    return tuple(f"{float(row[name]):g}" if name in ("speed", "departure") else row[name] for name in _KEY)


def _line(name: str, rows: list[Row]) -> list[str]:
    flown = [row["reference_s"] for row in rows if row["reference_s"] is not None]
    closed, ratio = [row["closed_loop_s"] for row in _both(rows)], ratios(rows)

    def of(values: Any, statistic: Any) -> str:
        return number(float(statistic(values)) if len(values) else None, ".2f")

    fastest = max((row["top_speed_m_s"] for row in rows), default=np.nan)
    return [
        name,
        str(len(rows)),
        str(len(flown)),
        of(flown, np.mean),
        of(closed, np.mean),
        of(ratio, np.mean),
        of(ratio, np.median),
        of(ratio, lambda values: np.percentile(values, 90)),
        f"{fastest:.1f} m/s",
    ]


def _extremes(rows: list[Row]) -> str:
    """Episodes without a reference, and those where the closed loop was sooner than it."""
    lost = [f"{row['target']} at {row['speed']:.2g} m/s" for row in rows if row["reference_s"] is None]
    sooner = sum(ratio < 1.0 for ratio in ratios(rows))
    text = (
        f"Without a reference: {', '.join(lost) or 'none'}. The closed loop was sooner than the reference in {sooner}."
    )
    return text + "\n"
