"""One function of many numbers over dask, for work that has no groups, no report and files of its own."""

from collections.abc import Callable, Iterator
from typing import TypeVar

from jaxplan.errors import ResourceError
from jaxplan.runner.connection import connect

T = TypeVar("T")
DEATHS = 3
"""Workers that may die over one task."""


def map_on_workers(
    make: Callable[[int], T], numbers: list[int], *, workers: int, scheduler: str | None = None
) -> Iterator[tuple[int, T]]:
    """Call a function with each number, on workers; gives number and result, as they are done.

    Args:
        make: something that dask can send: a function of a module, or a partial of one.
        workers: processes on this machine, unless there is a ``scheduler``.

    Raises:
        ResourceError: dask is absent, the scheduler does not answer, or workers die over a task.
    """
    with connect(workers, scheduler, deaths=DEATHS) as client:
        from distributed import KilledWorker, as_completed

        tasks = dict(zip(client.map(make, numbers, pure=False), numbers, strict=True))
        for future in as_completed(list(tasks)):
            number = tasks.pop(future)
            try:
                yield number, future.result()
            except KilledWorker as error:
                died = f"{DEATHS + 1} workers died over number {number}"
                raise ResourceError(f"{died}; is there enough memory? What is finished stays valid") from error
