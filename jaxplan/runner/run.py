"""One run of an experiment, from its configuration to its report."""

import contextlib
import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

from jaxplan.errors import InputError, JaxplanError
from jaxplan.files import write_atomically
from jaxplan.io.output import OutputFolder
from jaxplan.runner import work
from jaxplan.runner.cluster import Finished, run_on_cluster
from jaxplan.runner.configuration import as_plain
from jaxplan.runner.definition import Experiment, Report, Results
from jaxplan.runner.ledger import Ledger
from jaxplan.runner.provenance import origin, sha256
from jaxplan.runner.registry import load_experiment
from jaxplan.runner.shards import Outcome, Shard, Store, cut
from jaxplan.runner.tables import as_csv, duration


@runtime_checkable
class Progress(Protocol):
    """Tells a person how far a run is."""

    def __call__(self, text: str, /) -> None:
        """Show one line, in the place of the one before."""
        ...


class Request(NamedTuple):
    """What is to be run, where and how."""

    name: str
    config: Any
    out: Path
    preset: str = "smoke"
    workers: int | None = None
    """Processes; 0: this one. Default: as many as there are cores, or this one where that gains nothing."""
    scheduler: str | None = None
    resume: bool = False
    command: tuple[str, ...] = ()


class Done(NamedTuple):
    """What a run came to."""

    report: Report
    quarantined: dict[str, str]
    folder: Path


def run(request: Request, progress: Progress = lambda text: None) -> Done:
    """Evaluate what is missing in the folder, then write the report.

    Raises:
        InputError: the configuration or the folder cannot be used.
        ResourceError: the disk, dask or a scheduler refuses; what is finished stays valid.
        IncompleteError: items failed that the report cannot be made without; the others stay valid.
    """
    if request.workers is not None and request.workers < 0:
        raise InputError(f"--workers: have {request.workers}, want 0 or more")
    if request.workers is not None and request.scheduler is not None:
        raise InputError("--workers and --scheduler: have both, want one; a scheduler knows its own workers")
    experiment, config = load_experiment(request.name), as_plain(request.config)
    at_once = experiment.at_once(request.config)
    if at_once > 1 and (request.workers or request.scheduler):
        raise InputError("--workers, --scheduler: have one, and episodes on a device are flown in this process")
    shards = cut(experiment.items(request.config), max(experiment.shard_size, at_once))
    with Store(request.out, request.name, request.preset, config, request.resume) as store:
        missing = store.unfinished(shards)
        if missing:
            store.note_run(origin(list(request.command), experiment.artefacts(request.config)))
            _evaluate(experiment, request, config, store, missing, progress)
        results = _collect(request.config, store, shards)
        with _explained(results):
            report = experiment.report(results)
            _publish(request, report, results, store.runs())
    return Done(report, results.quarantined, request.out)


def _evaluate(
    experiment: Experiment[Any],
    request: Request,
    config: dict[str, Any],
    store: Store,
    missing: list[Shard],
    progress: Progress,
) -> None:
    known = {s.number: {k: o for k, o in (store.read(s) or {}).items() if o.row is not None} for s in missing}
    ledger = Ledger(missing, known)
    clock = _Clock(request.name, ledger.items_left, progress)

    def finished(shard: Shard, outcomes: dict[str, Outcome]) -> None:
        store.write(shard, outcomes)
        clock.tell(ledger.items_left)

    workers = request.workers
    if workers is None and request.scheduler is None:
        alone = not experiment.parallel or experiment.at_once(request.config) > 1
        workers = 0 if alone else os.cpu_count() or 1
    if workers == 0:
        _run_here(request.name, config, ledger, finished)
    else:
        run_on_cluster(request.name, config, ledger, finished, workers or 0, request.scheduler)


def _run_here(name: str, config: dict[str, Any], ledger: Ledger, finished: Finished) -> None:
    """All jobs in this process, one after the other."""
    while job := ledger.take():
        found = work.evaluate(name, config, [list(item) for item in job.items])
        outcomes = {item.name: Outcome(*values) for item, values in zip(job.items, found, strict=True)}
        complete = ledger.done(job, outcomes)
        if complete is not None:
            finished(job.shard, complete)


class _Clock:
    """Says how far a run is and how long it still takes."""

    def __init__(self, name: str, count: int, progress: Progress) -> None:
        self._name, self._count, self._progress = name, count, progress
        self._began = time.monotonic()
        progress(f"{name}: {count} items to evaluate")

    def tell(self, left: int) -> None:
        done, spent = self._count - left, time.monotonic() - self._began
        rate = done / max(spent, 1e-9)
        remaining = duration(left / rate) if done else "-"
        self._progress(f"{self._name}: {done} of {self._count}, {60 * rate:.1f} a minute, {remaining} left")


def _collect(config: Any, store: Store, shards: list[Shard]) -> Results[Any]:
    items, rows, seconds, compiled = [], [], [], []
    quarantined: dict[str, str] = {}
    preparing: dict[str, float] = {}
    for shard in shards:
        outcomes = store.read(shard)
        assert outcomes is not None, "every shard was evaluated"
        for item in shard.items:
            outcome = outcomes[item.name]
            items.append(item)
            rows.append(outcome.row)
            seconds.append(outcome.seconds)
            compiled.append(outcome.compiled)
            preparing[item.group] = max(preparing.get(item.group, 0.0), outcome.prepare_seconds)
            if outcome.row is None:
                quarantined[item.name] = outcome.error
    return Results(config, items, rows, seconds, compiled, quarantined, preparing)


@contextlib.contextmanager
def _explained(results: Results[Any]) -> Iterator[None]:
    """Where items failed, they are why their report cannot be made, whatever making it raises."""
    try:
        if all(row is None for row in results.rows) and results.quarantined:
            raise results.incomplete()
        yield
    except JaxplanError:
        raise
    except Exception as error:
        if results.quarantined:
            raise results.incomplete() from error
        raise


def _publish(request: Request, report: Report, results: Results[Any], found: list[dict[str, Any]]) -> None:
    """Write report, table and pictures; ``provenance.json`` is the last and has the hashes of the others."""
    folder = request.out
    with OutputFolder(folder) as output:
        output.write("results.csv", as_csv(report.table))
        output.write("table.tex", report.latex)
        for name, draw in report.figures.items():
            output.write(name, draw)
        output.write("report.md", _page(request, report, results, found))
        output.publish()
    names = ["results.csv", "table.tex", "report.md", *report.figures]
    hashes = {name: sha256(folder / name) for name in names}
    page = {"seed": getattr(request.config, "seed", None), "runs": found, "results": hashes}
    write_atomically(folder / "provenance.json", json.dumps(page, indent=1) + "\n")


def _page(request: Request, report: Report, results: Results[Any], found: list[dict[str, Any]]) -> str:
    """``report.md``: the body, what was left out, and where it comes from."""
    lines = [f"# {request.name}, preset {request.preset}", "", report.markdown.rstrip(), ""]
    if results.quarantined:
        lines += ["## Left out", "", f"{len(results.quarantined)} items could not be evaluated:", ""]
        lines += [f"- `{name}`: {why}" for name, why in results.quarantined.items()] + [""]
    lines += [
        "## Origin",
        "",
        "```",
        *(run["command"] or f"jaxplan experiment {request.name}" for run in found),
        "```",
        "",
    ]
    for commit in dict.fromkeys(run["commit"] for run in found):
        machine = next(run["machine"] for run in found if run["commit"] == commit)
        lines += [f"Commit {commit}; {machine['processor']}, {machine['cores']} cores.", ""]
    lines += ["The configuration is in `config.json`, versions and hashes are in `provenance.json`.", ""]
    return "\n".join(lines)
