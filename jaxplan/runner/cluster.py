"""Jobs over dask: one thread per worker, each keeping to a group as long as there is work in it.

Every worker has one task at a time, pinned to it, so that what dies with a worker is known: a job, or the preparation
of a group, which never counts against the job. Workers that die are replaced by their nannies.
"""

import time
from concurrent.futures import CancelledError
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

from jaxplan.errors import ResourceError
from jaxplan.runner import work
from jaxplan.runner.connection import connect
from jaxplan.runner.ledger import Job, Ledger
from jaxplan.runner.shards import Outcome, Shard

if TYPE_CHECKING:
    from distributed import Client, Future

WORKER_SECONDS = 60.0
"""How long a run waits without any worker before it gives up."""
PREPARATIONS = 20
"""Workers that may die in a row while they prepare, before the run gives up (arbitrary)."""


@runtime_checkable
class Finished(Protocol):
    """Takes what is complete."""

    def __call__(self, shard: Shard, outcomes: dict[str, Outcome], /) -> None:
        """Keep the outcomes of a shard, by the names of its items."""
        ...


class Running(NamedTuple):
    """A task that a worker has."""

    address: str
    job: Job
    preparing: bool


def run_on_cluster(
    name: str, config: dict[str, Any], ledger: Ledger, finished: Finished, workers: int, scheduler: str | None
) -> None:
    """Evaluate all of the ledger's jobs; ``finished`` is called with each shard that is complete.

    Raises:
        ResourceError: dask is absent, the scheduler does not answer, or workers cannot be kept alive.
    """
    with connect(workers, scheduler) as client:
        _Dispatcher(client, name, config, ledger, finished).run()


class _Dispatcher:
    """Hands jobs to idle workers and takes back what they did."""

    def __init__(self, client: "Client", name: str, config: dict[str, Any], ledger: Ledger, finished: Finished) -> None:
        self._client, self._ledger, self._finished = client, ledger, finished
        self._name, self._config = name, config
        self._running: dict[Future, Running] = {}
        self._prepared: dict[str, set[str]] = {}
        self._failed_preparations = 0
        self._seen = time.monotonic()

    def run(self) -> None:
        from distributed import wait

        while self._ledger.items_left:
            alive = self._alive()
            self._prepared = {address: self._prepared.get(address, set()) for address in alive}
            self._collect(alive)
            self._assign(alive)
            if alive:
                self._seen = time.monotonic()
            elif time.monotonic() - self._seen > WORKER_SECONDS:
                raise ResourceError(f"experiment: no worker for {WORKER_SECONDS:.0f} s; start some and use --resume")
            try:
                wait(list(self._running), timeout=1.0, return_when="FIRST_COMPLETED") if self._running else None
            except (TimeoutError, CancelledError):
                continue
            if not self._running:
                time.sleep(0.2)

    def _alive(self) -> set[str]:
        """Addresses of the workers."""
        try:
            return set(self._client.nthreads())
        except (OSError, TimeoutError) as error:
            raise ResourceError(
                "experiment: the scheduler is gone; what is finished stays valid: start one and go on with --resume"
            ) from error

    def _assign(self, alive: set[str]) -> None:
        """One task for each idle worker: its own group first, then the group that is waited for most."""
        busy = {running.address for running in self._running.values()}
        for address in sorted(alive - busy):
            job = self._ledger.take(self._prepared[address]) or self._take_new_group()
            if job is None:
                return
            group = job.shard.group
            preparing = group not in self._prepared[address]
            arguments: tuple[Any, ...]
            if preparing:
                arguments = (work.prepare, self._name, self._config, group)
            else:
                arguments = (work.evaluate, self._name, self._config, [list(item) for item in job.items])
            future = self._client.submit(*arguments, workers=[address], pure=False, retries=0)
            self._running[future] = Running(address, job, preparing)

    def _take_new_group(self) -> Job | None:
        """A job of the group with most jobs for each worker that is at it."""
        waiting = self._ledger.waiting_groups()
        at_it = [running.job.shard.group for running in self._running.values()]
        if not waiting:
            return None
        return self._ledger.take({max(waiting, key=lambda group: waiting[group] / (1 + at_it.count(group)))})

    def _collect(self, alive: set[str]) -> None:
        for future, running in list(self._running.items()):
            if future.done():
                del self._running[future]
                self._settle(future, running)
            elif running.address not in alive:
                del self._running[future]
                future.cancel(force=True)
                self._lost(running)

    def _settle(self, future: "Future", running: Running) -> None:
        if future.status != "finished":
            if future.status != "error":  # the connection was lost, which says nothing of the job
                return self._ledger.give_back(running.job)
            error = future.exception()
            if type(error).__name__ == "KilledWorker":
                return self._lost(running)
            raise error
        if running.preparing:
            self._prepared[running.address] = {running.job.shard.group}
            self._failed_preparations = 0
            spent = float(future.result())
            self._ledger.give_back(running.job)
            self._ledger.note_preparation(running.job.shard.group, spent)
            return None
        outcomes = [Outcome(*values) for values in future.result()]
        named = {item.name: outcome for item, outcome in zip(running.job.items, outcomes, strict=True)}
        return self._keep(running.job.shard, self._ledger.done(running.job, named))

    def _lost(self, running: Running) -> None:
        """The worker died; the preparation of a group does not count against a job."""
        if not running.preparing:
            self._keep(running.job.shard, self._ledger.died(running.job, "its worker died"))
            return
        self._failed_preparations += 1
        if self._failed_preparations >= PREPARATIONS:
            group = running.job.shard.group
            raise ResourceError(
                f"experiment: {PREPARATIONS} workers in a row died while preparing {group!r}; is there enough memory? "
                "What is finished stays valid: go on with --resume"
            )
        self._ledger.give_back(running.job)

    def _keep(self, shard: Shard, complete: dict[str, Outcome] | None) -> None:
        if complete is not None:
            self._finished(shard, complete)
