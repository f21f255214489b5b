"""Every benchmark with its peers in one go, each in a process of its own, and one page about it.

    jaxplan bench all [--json FILE] [--page FILE] [--against FILE]

Sizes are small: all of it takes minutes on two cores. ``--json`` keeps the rows, and the ratios of the runs that the
file held before; the page, beside it unless ``--page`` says where, is written from that file alone. ``--against``
compares the ratios with those of an earlier run and fails where one fell below its share: times differ from machine to
machine and from hour to hour, ratios to a peer of the same run much less.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxplan.errors import FileError, InputError
from jaxplan.files import write_atomically

from . import _harness, _page, _ratios

SIZES: dict[str, tuple[str, ...]] = {
    "minsnap": ("--waypoints", "14", "--batches", "400", "--repeats", "10"),
    "time-allocation": ("--waypoints", "14", "--batches", "400", "--repeats", "3"),
    "policy": ("--candidates", "400", "--waypoints", "14", "--repeats", "10"),
    "search": ("--worlds", "env3", "--cycles", "50", "--peers", "5", "--pairs", "100"),
    "prediction": ("--repeats", "100"),
    "plant": ("--batches", "256", "--seconds", "1", "--peers", "1"),
    "planner": ("--worlds", "env1", "--counts", "400", "--cycles", "40"),
    "cycle": ("--worlds", "env1", "--targets", "1"),
    "safety": ("--worlds", "env1", "--departures", "0.5", "--targets", "1"),
    "runtime": ("--seconds", "10", "--kills", "1"),
    "device": ("--parts", "host", "replan", "--counts", "20", "400"),
    "mavlink": ("--seconds", "5"),
    "start": (),
}
"""The benchmarks in their order, and how large."""
KEPT_RUNS = 12
"""Earlier runs whose ratios a file remembers."""
LEAST_SHARE = 0.5
"""Of what a ratio was, below which it counts as a regression (arbitrary: twice as slow)."""
EXIT_REGRESSION = 14
_CALL = "import sys; from jaxplan.runner.registry import bundled; bundled('benchmarks', sys.argv[1]).main(sys.argv[2:])"


def run_one(name: str, sizes: Sequence[str]) -> dict[str, Any]:
    """Rows of one benchmark, how long it took and what the load was; what was wrong, where it failed."""
    with tempfile.TemporaryDirectory() as folder:
        path, began = Path(folder) / "rows.json", time.perf_counter()
        command = [sys.executable, "-c", _CALL, f"bench_{name.replace('-', '_')}", *sizes, "--json", str(path)]
        child = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        taken = {"seconds": time.perf_counter() - began, "load_average": os.getloadavg()[0], "sizes": list(sizes)}
        if child.returncode != 0 or not path.is_file():
            last = child.stderr.strip().splitlines()[-1:] or [f"exit code {child.returncode}"]
            return {"rows": [], "failed": last[0], **taken}
        return {"rows": json.loads(path.read_text(encoding="utf-8"))["rows"], **taken}


def read(path: Path) -> dict[str, Any]:
    """An earlier run. Raises ``FileError``."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be read as a run of all benchmarks ({error})") from error
    if not isinstance(found, dict) or not isinstance(found.get("benchmarks"), dict):
        raise FileError(f"{path}: is no run of all benchmarks; want what jaxplan bench all --json wrote")
    return found


def ratios_of(run: Mapping[str, Any]) -> dict[str, float]:
    """Times as fast, by ``_ratios.key``."""
    rows = {name: one["rows"] for name, one in run["benchmarks"].items()}
    return {_ratios.key(ratio): value.times_as_fast for ratio, value in _ratios.measured(rows)}


def remembered(run: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The history of the next run: that of this one, and this one's ratios."""
    last = {"commit": run["machine"]["commit"], "load_average": run["machine"]["load_average"]}
    return [*run.get("history", []), {**last, "ratios": ratios_of(run)}][-KEPT_RUNS:]


def regressions(now: Mapping[str, float], then: Mapping[str, float], least: float = LEAST_SHARE) -> list[str]:
    """What fell below its share or is missing, in words."""
    fallen = []
    for name, before in then.items():
        if name not in now:
            fallen.append(f"{name}: was {before:.3g} times as fast, now missing")
        elif not now[name] >= least * before:
            fallen.append(f"{name}: was {before:.3g} times as fast, now {now[name]:.3g}")
    return fallen


def main(arguments: Sequence[str] | None = None) -> int:
    """Run them; 14 where a ratio has fallen or a benchmark has failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="where the run is kept")
    parser.add_argument("--page", type=Path, help="where the page is written (default: beside --json, as .md)")
    parser.add_argument("--against", type=Path, help="an earlier run; its ratios are compared, its benchmarks are run")
    parser.add_argument("--only", nargs="+", choices=tuple(SIZES), help="some of them (default: all)")
    chosen = parser.parse_args(arguments)
    if chosen.page and not chosen.json:
        raise InputError("bench all: a page is written from what is kept; give --json as well")
    earlier = read(chosen.against) if chosen.against else None
    before = read(chosen.json) if chosen.json and chosen.json.is_file() else None
    run: dict[str, Any] = {
        "machine": _harness.machine(),
        "benchmarks": {},
        "history": [] if before is None else remembered(before),
    }
    for name in chosen.only or (earlier["benchmarks"] if earlier else SIZES):
        print(f"== {name}", flush=True)
        run["benchmarks"][name] = run_one(name, SIZES[name])
        _harness.show(run["benchmarks"][name]["rows"])
        if chosen.json:
            _keep(run, chosen.json, chosen.page or chosen.json.with_suffix(".md"))
    return _judge(run, earlier, chosen.only)


def _keep(run: Mapping[str, Any], path: Path, page: Path) -> None:
    """Write what there is so far: whoever stops it keeps that."""
    for place, content in ((path, json.dumps(run, indent=1) + "\n"), (page, _page.page(run))):
        place.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(place, content)


def _judge(run: Mapping[str, Any], earlier: Mapping[str, Any] | None, only: Sequence[str] | None) -> int:
    """Print what is wrong; the exit code."""
    wrong = [f"{name}: failed: {one['failed']}" for name, one in run["benchmarks"].items() if "failed" in one]
    if earlier is not None:
        of = {name: one for name, one in earlier["benchmarks"].items() if only is None or name in only}
        wrong += regressions(ratios_of(run), ratios_of({"benchmarks": of}))
    for line in wrong:
        print(f"bench all: {line}", file=sys.stderr)
    return EXIT_REGRESSION if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
