"""Record with which types a planner's warm-up calls what numba compiles, and in which order that is best compiled.

    python -m tools.record_ahead           # writes jaxplan/ahead.json
    python -m tools.record_ahead --check   # exit code 1 where that has changed

Each entry point is loaded or compiled, nothing kept by others is used but numba's cache.
"""

import argparse
import json
import os
import sys
import tempfile
from typing import Any

from numba import types

from jaxplan import native
from jaxplan.ahead import TABLE, name_of
from jaxplan.config import InterceptConfig

LONGEST = ("optimizer.kernels.descent", "search.kernels.follow", "search.kernels.astar", "tracking.kernels.flight")
"""Parts of names of what takes longest to compile."""


def written(kind: Any) -> Any:
    """How the table says a type; see ``jaxplan.ahead``."""
    if isinstance(kind, types.BaseNamedTuple):
        made = kind.instance_class
        return {"class": f"{made.__module__}:{made.__qualname__}", "parts": [written(part) for part in kind]}
    if isinstance(kind, types.BaseTuple):
        return [written(part) for part in kind]
    if isinstance(kind, types.Array):
        assert kind.mutable, kind
        assert kind.aligned, kind
        return f"{kind.dtype} {kind.ndim} {kind.layout}"
    return "boolean" if kind == types.boolean else str(types.unliteral(kind))


def recorded() -> dict[str, list]:
    """By entry point, the longest first and then in the order of calls from the last one back, its argument types."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["JAXPLAN_CACHE_DIR"] = folder  # no roadmap is ready
        from jaxplan.interception import warm_up
        from jaxplan.scenario import build_scenario

        warm_up(build_scenario(InterceptConfig()))
    found = {name_of(entry.py_func): [list(map(written, s)) for s in entry.signatures] for entry in native.entries()}
    names = [name for name in reversed(found) if found[name]]
    first = [name for part in LONGEST for name in names if part in name]
    return {name: found[name] for name in dict.fromkeys([*first, *names])}


def main() -> int:
    """Write the table, or compare it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    check, now = parser.parse_args().check, recorded()
    if check:
        return int(json.loads(TABLE.read_text()) != now)
    TABLE.write_text(json.dumps(now, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
