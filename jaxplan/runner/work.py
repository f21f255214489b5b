"""What a worker does. Names and plain values come in and go out, so that any worker with jaxplan installed will do."""

import time
from typing import Any

from jaxplan.compilation import compilations
from jaxplan.runner.configuration import from_plain
from jaxplan.runner.definition import Item
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

_prepared: list[str] = []
"""The group that this process is prepared for, with its configuration: the newest, since preparing costs memory."""


def prepare(name: str, config: dict[str, Any], group: str) -> float:
    """Load and compile what a group shares, unless this process has; the seconds it took."""
    wanted = f"{name} {group} {config!r}"
    if wanted in _prepared:
        return 0.0
    experiment, began = load_experiment(name), time.perf_counter()
    experiment.prepare(from_plain(experiment.config_type, config), group)
    _prepared[:] = [wanted]
    return time.perf_counter() - began


def evaluate(name: str, config: dict[str, Any], items: list[list[Any]]) -> list[list[Any]]:
    """The outcomes of items of one group, as plain lists; an item that raises has its error instead of a row."""
    experiment = load_experiment(name)
    settings: Any = from_plain(experiment.config_type, config)
    outcomes: list[list[Any]] = []
    for item in (Item(*values) for values in items):
        spent, known, began = prepare(name, config, item.group), compilations(), time.perf_counter()
        try:
            row, error = experiment.evaluate(settings, item), ""
        except Exception as failure:  # whatever an item does must not take the others along
            row, error = None, f"{type(failure).__name__}: {failure}"
        seconds = time.perf_counter() - began
        outcomes.append(list(Outcome(row, error, seconds, compilations() > known, spent)))
    return outcomes
