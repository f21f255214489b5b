"""What an experiment is: a list of items, a function that evaluates one, and a report of all.

An item must depend on nothing but the configuration and itself: not on the items before it, not on the process, not
on the time. Then results do not depend on how many workers there are, nor on which of them died.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

from jaxplan.errors import IncompleteError

C = TypeVar("C")
"""An experiment's configuration: a frozen dataclass."""
C_contra = TypeVar("C_contra", contravariant=True)

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


@dataclasses.dataclass(frozen=True)
class Results(Generic[C]):
    """All that is known when an experiment is reported."""

    config: C
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

    def finished_rows(self, group: str | None = None) -> list[Row]:
        """The rows of the items that were evaluated, of one group or of all.

        Raises:
            IncompleteError: every one of them failed.
        """
        found = [row for item, row in zip(self.items, self.rows, strict=True) if group in (None, item.group)]
        rows = [row for row in found if row is not None]
        if found and not rows:
            raise self.incomplete(group)
        return rows

    def incomplete(self, group: str | None = None) -> IncompleteError:
        """The error that says how many items failed, and why the first of them did."""
        mine = [item.name for item in self.items if group in (None, item.group)]
        failed = [name for name in mine if name in self.quarantined]
        first = failed[0] if failed else "none"
        why = " ".join(self.quarantined.get(first, "not evaluated").split())
        return IncompleteError(
            f"experiment: {len(failed)} of {len(mine)} items failed, and the report needs them; the first, "
            f"{first!r}: {why}; what is finished is kept: mend the cause and go on with --resume"
        )


@runtime_checkable
class Draw(Protocol):
    """Draws one picture."""

    def __call__(self, path: Path, /) -> object:
        """Write the picture into the file ``path``."""
        ...


class Report(NamedTuple):
    """What is written beside the shards."""

    markdown: str
    """The body of ``report.md``; pictures by their file names."""
    table: list[Row]
    """The rows of ``results.csv``."""
    latex: str
    figures: Mapping[str, Draw]
    """File name to the function that draws it."""
    summary: str
    """What the command line prints."""


@runtime_checkable
class ListItems(Protocol[C_contra]):
    """Says what there is to evaluate."""

    def __call__(self, config: C_contra) -> list[Item]:
        """All items of a configuration, items of a group together."""
        ...


@runtime_checkable
class Evaluate(Protocol[C_contra]):
    """Evaluates one item."""

    def __call__(self, config: C_contra, item: Item) -> Row:
        """The item's result; whatever it raises is kept as the reason why it has none."""
        ...


@runtime_checkable
class EvaluateTogether(Protocol[C_contra]):
    """Evaluates many items in one go, as on a GPU."""

    def __call__(self, config: C_contra, items: list[Item], /) -> list[Row]:
        """The results of items of one group, in their order; whatever it raises is the reason why none has any."""
        ...


@runtime_checkable
class CountTogether(Protocol[C_contra]):
    """Says how many items are evaluated in one go."""

    def __call__(self, config: C_contra, /) -> int:
        """At most so many of a group; 1: each on its own."""
        ...


@runtime_checkable
class MakeReport(Protocol[C]):
    """Makes the report of all results."""

    def __call__(self, results: Results[C]) -> Report:
        """The report, of what is there: rows are None where an item failed (``Results.finished_rows``)."""
        ...


@runtime_checkable
class Prepare(Protocol[C_contra]):
    """Loads and compiles what the items of a group share."""

    def __call__(self, config: C_contra, group: str) -> None:
        """Called once per process and group; where it raises, every item of the group fails with that."""
        ...


@runtime_checkable
class ListArtefacts(Protocol[C_contra]):
    """Says which files the results depend on."""

    def __call__(self, config: C_contra) -> list[Path]:
        """Paths of the files, whose hashes are kept with the results."""
        ...


def _nothing(config: object, group: str) -> None:
    """For experiments whose items share nothing."""


def _no_files(config: object) -> list[Path]:
    return []


def _each_on_its_own(config: object, /) -> int:
    return 1


@dataclasses.dataclass(frozen=True)
class Experiment(Generic[C]):
    """An experiment as the command line sees it; every field of its configuration is a flag."""

    summary: str
    """One line for ``--list``."""
    presets: Mapping[str, C]
    """``smoke``, ``small`` and ``full``: instances of one frozen dataclass."""
    items: ListItems[C]
    """All items of a configuration, items of a group together."""
    evaluate: Evaluate[C]
    report: MakeReport[C]
    prepare: Prepare[C] = _nothing
    """Load and compile what the items of a group share, once per process."""
    shard_size: int = 1
    """Items that are lost at most when a worker dies."""
    artefacts: ListArtefacts[C] = _no_files
    """Files that the results depend on, such as weights: their hashes are kept."""
    together: EvaluateTogether[C] | None = None
    """Evaluate many items of a group in one go, in this process, where ``at_once`` says so."""
    at_once: CountTogether[C] = _each_on_its_own
    """How many; they are lost together, too."""
    parallel: bool = True
    """Whether there is anything to gain from workers; False where an item uses all cores itself."""

    @property
    def config_type(self) -> type[C]:
        """The dataclass of the configuration."""
        return type(next(iter(self.presets.values())))
