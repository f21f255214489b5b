"""A dask cluster to work on: one of processes on this machine, or another's scheduler."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from jaxplan.errors import InputError, ResourceError
from jaxplan.runner import work

if TYPE_CHECKING:
    from distributed import Client

LOOPBACK = "127.0.0.1"
"""Where a cluster of this machine listens: nobody else can reach it. It has no dashboard."""
CONNECT_SECONDS = 8.0
"""How long a scheduler may take to answer."""
RESTART_SECONDS = 60.0
"""How long a worker that died may take to start again before its cluster is closed all the same."""


@contextmanager
def connect(workers: int, scheduler: str | None, *, deaths: int = 0) -> "Iterator[Client]":
    """A client of the scheduler at that address, or of a cluster on this machine that ends with it.

    Args:
        deaths: workers of the cluster here that may die over a task before dask gives it up.

    Raises:
        ResourceError: dask is absent, or the scheduler does not answer.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise ResourceError(
            "several processes need dask, which is not installed; pip install 'jaxplan[cluster]', or use "
            "--workers 0 to stay in this process"
        ) from error
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=CONNECT_SECONDS)
        except ValueError as error:
            raise InputError(f"--scheduler: have {scheduler!r}, want an address like tcp://host:8786") from error
        except (OSError, TimeoutError) as error:
            raise ResourceError(
                f"--scheduler {scheduler}: no answer within {CONNECT_SECONDS:.0f} s; start it, or correct the address"
            ) from error
        with client:
            yield client
        return
    settings = {
        "distributed.nanny.pre-spawn-environ": work.ONE_THREAD,
        "distributed.scheduler.allowed-failures": deaths,
        "distributed.deploy.lost-worker-timeout": "1000 days",  # else a nanny is closed while its worker restarts
    }
    with (
        dask.config.set(settings),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=0,
            host=LOOPBACK,
            dashboard_address=None,
            scheduler_kwargs={"dashboard_address": f"{LOOPBACK}:0"},  # of what it serves instead: 8787 may be taken
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        try:
            yield client
        finally:
            with suppress(TimeoutError, OSError):  # a nanny that is starting its worker anew cannot be closed
                client.wait_for_workers(workers, timeout=RESTART_SECONDS)
