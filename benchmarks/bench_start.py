"""A start until ``jaxplan intercept`` can fly, and until a first plan: the first one, a later one, one keeping nothing.

    jaxplan bench start [--json FILE]

The first plan is that of README's example: what it does not call is not compiled. To fly takes all that a flight may
call. Each is a process of its own. ``cpu_s`` is processor time, which says more than ``wall_s`` where something else is
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

BEGIN = """
import json, resource, sys
from jaxplan import programs
said = programs.use()
"""
FLY = """
from jaxplan import interception
from jaxplan.config import InterceptConfig
from jaxplan.scenario import build_scenario
interception.warm_up(build_scenario(InterceptConfig(world=sys.argv[1])))
"""
PLAN = """
import numpy as np
import jaxplan
world, vehicle = jaxplan.load_world(sys.argv[1]), jaxplan.load_vehicle()
policy, classifier = jaxplan.load_policy("mfrl"), jaxplan.load_classifier("mfrl")
planner = jaxplan.build_planner(world=world, vehicle=vehicle, policy=policy, classifier=classifier)
times = 0.1 * np.arange(11, 31)
goals = np.array([-4.0, -1.0, 1.0]) + times[:, None] * [0.3, 0.0, 0.0]
candidates = jaxplan.candidates_from(goals[0], goals, times, log_likelihood=np.zeros(20))
plans = planner.plan_batch(jaxplan.hover(world.start), candidates)
assert jaxplan.select(plans) >= 0
"""
END = """
used = resource.getrusage(resource.RUSAGE_SELF)
pages = int(open("/proc/self/statm").read().split()[1])
print(json.dumps({
    "cpu_s": used.ru_utime + used.ru_stime,
    "memory_mb": 1e-6 * pages * resource.getpagesize(),
    "peak_mb": 1e-3 * used.ru_maxrss,
    "said": said,
}))
"""
UNTIL = {"": FLY, ", to a plan": PLAN}
"""What is started, by what is said of it beside the kind of start."""


def measure(world: str) -> list[dict[str, Any]]:
    """One row for each kind of start."""
    return [row for name, body in UNTIL.items() for row in _started(name, BEGIN + body + END, world)]


def _started(name: str, script: str, world: str) -> list[dict[str, Any]]:
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        compiled_for_the_host = {"NUMBA_CACHE_DIR": f"{folder}/numba"}
        for kind, kept in (("first", f"{folder}/kept"), ("later", f"{folder}/kept"), ("nothing kept", "")):
            ours = {key: value for key, value in os.environ.items() if not key.startswith(("JAX_", "TF_CPP"))}
            environment = {**ours, **compiled_for_the_host, "JAXPLAN_CACHE_DIR": kept}
            began = time.perf_counter()
            command = [sys.executable, "-c", script, world]
            child = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True)
            taken = {"wall_s": time.perf_counter() - began, **json.loads(child.stdout.splitlines()[-1])}
            rows.append({"start": kind + name, "world": world, **taken})
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
