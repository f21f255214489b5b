"""A start of ``jaxplan intercept`` until it can fly: the first one, a later one, and one that keeps nothing.

    jaxplan bench start [--json FILE]

Each is a process of its own. ``cpu_s`` is processor time, which says more than ``wall_s`` where something else is
running; ``memory_mb`` is what the warm process has in memory, ``peak_mb`` the most that it had.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from . import _harness

CHILD = """
import json, resource, sys
from jaxplan import programs
said = programs.use()
from jaxplan import interception
from jaxplan.config import InterceptConfig
from jaxplan.scenario import build_scenario
scenario = build_scenario(InterceptConfig(world=sys.argv[1]))
interception.warm_up(scenario)
used = resource.getrusage(resource.RUSAGE_SELF)
pages = int(open("/proc/self/statm").read().split()[1])
print(json.dumps({
    "cpu_s": used.ru_utime + used.ru_stime,
    "memory_mb": 1e-6 * pages * resource.getpagesize(),
    "peak_mb": 1e-3 * used.ru_maxrss,
    "said": said,
}))
"""


def measure(world: str) -> list[dict[str, Any]]:
    """One row for each kind of start."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        compiled_for_the_host = {"NUMBA_CACHE_DIR": f"{folder}/numba"}
        for kind, kept in (("first", f"{folder}/kept"), ("later", f"{folder}/kept"), ("nothing kept", "")):
            ours = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "TF_CPP"))}
            environment = {**ours, **compiled_for_the_host, "JAXPLAN_CACHE_DIR": kept}
            began = time.perf_counter()
            child = subprocess.run(
                [sys.executable, "-c", CHILD, world], env=environment, check=True, stdout=subprocess.PIPE, text=True
            )
            taken = time.perf_counter() - began
            rows.append({"start": kind, "world": world, "wall_s": taken, **json.loads(child.stdout.splitlines()[-1])})
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the rows; write them where ``--json`` says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="save the rows, with hardware, versions and commit")
    parser.add_argument("--world", default="env1")
    chosen = parser.parse_args(arguments)
    rows = measure(chosen.world)
    _harness.show(rows)
    if chosen.json:
        _harness.write(chosen.json, rows)


if __name__ == "__main__":
    main()
