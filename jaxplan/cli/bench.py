"""``jaxplan bench``: the benchmarks, from the source tree or from an installed wheel."""

import importlib
import sys
from pathlib import Path
from typing import Any, Literal

from jaxplan.errors import ResourceError
from jaxplan.versions import require_supported_jax

Benchmark = Literal[
    "minsnap",
    "planner",
    "plant",
    "policy",
    "prediction",
    "search",
    "time-allocation",
]
"""Each is a file benchmarks/bench_<name>.py."""


def bench(name: Benchmark, *, json: str | None = None, debug: bool = False) -> int:
    """Measure a station against its peers, in one run on this machine.

    Parameters
    ----------
    name
        What to measure.
    json
        Where the rows are saved, with hardware, versions and commit.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    _benchmark(name).main([] if json is None else ["--json", json])
    return 0


def _benchmark(name: str) -> Any:
    """The benchmark's module: inside an installed package, or beside the package in the source tree."""
    module = f"bench_{name.replace('-', '_')}"
    if (Path(__file__).parent.parent / "_benchmarks").is_dir():
        return importlib.import_module(f"jaxplan._benchmarks.{module}")
    source = Path(__file__).parent.parent.parent
    if not (source / "benchmarks" / f"{module}.py").is_file():
        raise ResourceError("bench: this installation has no benchmarks; install a wheel or use the source tree")
    if str(source) not in sys.path:
        sys.path.insert(0, str(source))
    return importlib.import_module(f"benchmarks.{module}")
