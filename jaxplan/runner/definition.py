"""What an experiment is: a list of items, a function that evaluates one, and a report of all.

An item must depend on nothing but the configuration and itself: not on the items before it, not on the process, not
on the time. Then results do not depend on how many workers there are, nor on which of them died.
"""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

Row = dict[str, Any]
"""The result of an item: plain JSON values."""


class Item(NamedTuple):
    """The smallest piece of an experiment."""

    name: str
    """Unique in its experiment; what a person reads when the item fails."""
    group: str
    """Items of one group share what ``Experiment.prepare`` builds."""
    values: dict[str, Any]
    """What the item stands for: plain JSON values."""


class Results(NamedTuple):
    """All that is known when an experiment is reported."""

    config: Any
    items: list[Item]
    rows: list[Row | None]
    """One for each item, in the items' order; None where it was quarantined."""
    seconds: list[float]
    """Wall time of each item in its worker."""
    compiled: list[bool]
    """Whether that includes compilation."""
    quarantined: dict[str, str]
    """Items that could not be evaluated, and why."""
    prepare_seconds: dict[str, float]
    """Wall time of preparing each group, where it was prepared."""


class Report(NamedTuple):
    """What is written beside the shards."""

    markdown: str
    """The body of ``report.md``; pictures by their file names."""
    table: list[Row]
    """The rows of ``results.csv``."""
    latex: str
    figures: dict[str, Callable[[Path], object]]
    """File name to the function that draws it."""
    summary: str
    """What the command line prints."""


def _nothing(config: Any, group: str) -> None:
    """For experiments whose items share nothing."""


def _no_files(config: Any) -> list[Path]:
    return []


@dataclasses.dataclass(frozen=True)
class Experiment:
    """An experiment as the command line sees it; every field of its configuration is a flag."""

    summary: str
    """One line for ``--list``."""
    presets: Mapping[str, Any]
    """``smoke``, ``small`` and ``full``: instances of one frozen dataclass."""
    items: Callable[[Any], list[Item]]
    """All items of a configuration, items of a group together."""
    evaluate: Callable[[Any, Item], Row]
    report: Callable[[Results], Report]
    prepare: Callable[[Any, str], None] = _nothing
    """Load and compile what the items of a group share, once per process."""
    shard_size: int = 1
    """Items that are lost at most when a worker dies."""
    artefacts: Callable[[Any], list[Path]] = _no_files
    """Files that the results depend on, such as weights: their hashes are kept."""
    parallel: bool = True
    """Whether there is anything to gain from workers; False where an item uses all cores itself."""

    @property
    def config_type(self) -> type:
        return type(next(iter(self.presets.values())))
