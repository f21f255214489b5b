"""An experiment whose results are known, and whose items can be told to fail in every way there is."""

import dataclasses
import math
import os
import signal
import time
from pathlib import Path

from jaxplan.errors import InputError
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """How many items, and which of them fail."""

    count: int = 12
    """Items."""

    sleep: float = 0.0
    """Seconds an item takes."""

    raising: tuple[int, ...] = ()
    """Items that raise."""

    dying: tuple[int, ...] = ()
    """Items that kill their process."""

    dying_once: tuple[int, ...] = ()
    """Items that kill their process the first time."""

    unprepared: tuple[int, ...] = ()
    """Numbers of the groups that cannot be prepared."""

    marks: str | None = None
    """Folder where those leave a mark, and the others a line for each time they are evaluated."""

    needs: int | None = None
    """An item that the report takes for granted."""

    padding: int = 0
    """Bytes that the items from the eighth on add to their results."""

    seed: int = 0
    """Added to every item's number."""

    def __post_init__(self) -> None:
        if self.count < 1:
            raise InputError(f"--count: have {self.count}, want at least 1")


def items(config: Config) -> list[Item]:
    return [Item(f"number {n}", f"group {n // 6}", {"number": n}) for n in range(config.count)]


def evaluate(config: Config, item: Item) -> Row:
    number = item.values["number"]
    if config.marks is not None:
        with (Path(config.marks) / f"{number}.txt").open("a") as file:
            file.write("evaluated\n")
    if number in config.raising:
        raise ValueError(f"no root of {number}")
    first = config.marks is not None and len((Path(config.marks) / f"{number}.txt").read_text().splitlines()) == 1
    if number in config.dying or (number in config.dying_once and first):
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(config.sleep)
    return {**item.values, "root": math.sqrt(number + config.seed), "padding": "x" * (config.padding * (number >= 8))}


def prepare(config: Config, group: str) -> None:
    if int(group.split()[1]) in config.unprepared:
        if config.marks is not None:
            with (Path(config.marks) / "preparations.log").open("a") as file:
                file.write(f"{group}\n")
        raise NotImplementedError(f"{group} is not for this machine")


def report(results: Results[Config]) -> Report:
    if results.config.needs is not None and results.rows[results.config.needs] is None:
        raise KeyError("rows")  # as the report of one's own that takes every row for granted
    rows = [row for row in results.rows if row is not None]
    total = sum(row["root"] for row in rows)
    return Report(f"Sum {total:.3f}\n", rows, "", {}, f"sum {total:.3f}")


EXPERIMENT = Experiment(
    summary="Roots of numbers",
    presets={"smoke": Config(count=4), "small": Config(), "full": Config(count=48)},
    items=items,
    evaluate=evaluate,
    report=report,
    prepare=prepare,
    shard_size=3,
)
