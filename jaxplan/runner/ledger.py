"""What is still to be done and what is to be tried again, whoever does it.

A shard goes to a worker as a whole. If the worker dies, the shard is tried again; after ``ATTEMPTS`` deaths its items
are tried one by one, and an item that fails ``ATTEMPTS`` times on its own is quarantined. An item that raises is known
at once and tried again alone.
"""

from collections import deque
from collections.abc import Container
from typing import NamedTuple

from jaxplan.runner.definition import Item
from jaxplan.runner.shards import Outcome, Shard

ATTEMPTS = 3
"""Failures of a shard before it is split, and of an item before it is given up."""


class Job(NamedTuple):
    """Items of one shard that a worker evaluates together."""

    shard: Shard
    items: tuple[Item, ...]
    failures: int = 0


class Ledger:
    """Jobs that wait, and the outcomes of shards that are not complete yet."""

    def __init__(self, shards: list[Shard], known: dict[int, dict[str, Outcome]] | None = None) -> None:
        self._outcomes = {shard.number: dict((known or {}).get(shard.number, {})) for shard in shards}
        self._waiting = deque(
            Job(s, tuple(item for item in s.items if item.name not in self._outcomes[s.number])) for s in shards
        )
        self.items_left = sum(len(job.items) for job in self._waiting)
        self._preparation: dict[str, float] = {}

    def waiting_groups(self) -> dict[str, int]:
        """Jobs that wait, by group."""
        counts: dict[str, int] = {}
        for job in self._waiting:
            counts[job.shard.group] = counts.get(job.shard.group, 0) + 1
        return counts

    def take(self, groups: Container[str] | None = None) -> Job | None:
        """The next job, of one of the ``groups`` if given; None where there is none."""
        for place, job in enumerate(self._waiting):
            if groups is None or job.shard.group in groups:
                del self._waiting[place]
                return job
        return None

    def give_back(self, job: Job) -> None:
        """The job was not begun: it waits again, in front."""
        self._waiting.appendleft(job)

    def note_preparation(self, group: str, seconds: float) -> None:
        """What preparing a group took; it is kept with the next outcome of the group."""
        self._preparation[group] = seconds

    def done(self, job: Job, outcomes: dict[str, Outcome]) -> dict[str, Outcome] | None:
        """Take the outcomes of a job; those of its whole shard if that is complete now."""
        for item in job.items:
            outcome = outcomes[item.name]
            failures = job.failures + 1 if len(job.items) == 1 else 1
            if outcome.row is None and failures < ATTEMPTS:
                self._waiting.appendleft(Job(job.shard, (item,), failures))
            else:
                self._settle(job.shard, item, outcome)
        return self._complete(job.shard)

    def died(self, job: Job, why: str) -> dict[str, Outcome] | None:
        """The worker of a job died; the outcomes of its shard if that is complete now."""
        failures = job.failures + 1
        if failures < ATTEMPTS:
            self._waiting.appendleft(job._replace(failures=failures))
        elif len(job.items) > 1:
            self._waiting.extendleft(Job(job.shard, (item,)) for item in reversed(job.items))
        else:
            self._settle(job.shard, job.items[0], Outcome(None, why, 0.0))
        return self._complete(job.shard)

    def _settle(self, shard: Shard, item: Item, outcome: Outcome) -> None:
        prepared = self._preparation.pop(shard.group, 0.0) + outcome.prepare_seconds
        outcome = outcome._replace(prepare_seconds=prepared)
        self._outcomes[shard.number][item.name] = outcome
        self.items_left -= 1

    def _complete(self, shard: Shard) -> dict[str, Outcome] | None:
        outcomes = self._outcomes[shard.number]
        return outcomes if len(outcomes) == len(shard.items) else None
