"""What a worker does. Names and plain values come in and go out, so that any worker with jaxplan installed will do."""

import time
from typing import Any, NamedTuple

from jaxplan.compilation import compilations
from jaxplan.errors import JaxplanError
from jaxplan.runner.configuration import from_plain
from jaxplan.runner.definition import EvaluateTogether, Experiment, Item, Row
from jaxplan.runner.registry import load_experiment
from jaxplan.runner.shards import Outcome

ONE_THREAD = {
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
    "NPROC": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
}
"""Environment of a worker: one thread each, so that as many fit as there are cores, and sums keep their order."""


class _Prepared(NamedTuple):
    """The group that this process is prepared for, with its configuration."""

    wanted: str
    failure: str
    """Why the group could not be prepared; empty where it was."""


_prepared: list[_Prepared] = []
"""One at most: the newest, since preparing costs memory."""


def prepare(name: str, config: dict[str, Any], group: str) -> float:
    """Load and compile what a group shares, unless this process has; the seconds it took.

    What is raised meanwhile is not tried again here: it becomes the error of every item of the group.
    """
    wanted = f"{name} {group} {config!r}"
    if any(known.wanted == wanted for known in _prepared):
        return 0.0
    experiment, began = load_experiment(name), time.perf_counter()
    settings, failure = from_plain(experiment.config_type, config), ""
    try:
        experiment.prepare(settings, group)
    except Exception as error:  # one group that cannot be prepared must not take the others along
        failure = f"{type(error).__name__}: {error} (while preparing {group!r})"
    _prepared[:] = [_Prepared(wanted, failure)]
    return time.perf_counter() - began


def evaluate(name: str, config: dict[str, Any], items: list[list[Any]]) -> list[list[Any]]:
    """The outcomes of items of one group, as plain lists; an item that raises has its error instead of a row."""
    experiment = load_experiment(name)
    settings = from_plain(experiment.config_type, config)
    some = [Item(*values) for values in items]
    if experiment.together is not None and experiment.at_once(settings) > 1:
        return [list(outcome) for outcome in _all_at_once(experiment.together, settings, some)]
    outcomes: list[list[Any]] = []
    for item in some:
        spent, known, began = prepare(name, config, item.group), compilations(), time.perf_counter()
        row, error = _attempt(experiment, settings, item)
        seconds = time.perf_counter() - began
        outcomes.append(list(Outcome(row, error, seconds, compilations() > known, spent)))
    return outcomes


def _all_at_once(together: EvaluateTogether[Any], settings: object, items: list[Item]) -> list[Outcome]:
    """Each item has its share of the time that all took, in which all were compiled for."""
    known, began, error = compilations(), time.perf_counter(), ""
    rows: list[Row | None] = [None] * len(items)
    try:
        rows = [*together(settings, items)]
    except JaxplanError:  # it holds for all of them, whoever tries again
        raise
    except Exception as failure:
        error = f"{type(failure).__name__}: {failure}"
    seconds = (time.perf_counter() - began) / len(items)
    return [Outcome(row, error, seconds, compilations() > known, 0.0) for row in rows]


def _attempt(experiment: Experiment[Any], settings: object, item: Item) -> tuple[Row | None, str]:
    """An item's row, or None and why there is none."""
    if _prepared[0].failure:
        return None, _prepared[0].failure
    try:
        return experiment.evaluate(settings, item), ""
    except Exception as failure:  # whatever an item does must not take the others along
        return None, f"{type(failure).__name__}: {failure}"
