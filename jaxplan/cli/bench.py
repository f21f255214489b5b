"""``jaxplan bench``: the benchmarks, from the source tree or from an installed wheel."""

from typing import Literal

from jaxplan.versions import require_supported_jax

Benchmark = Literal[
    "mavlink",
    "minsnap",
    "planner",
    "plant",
    "policy",
    "prediction",
    "runtime",
    "safety",
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
    from jaxplan.runner.registry import bundled

    bundled("benchmarks", f"bench_{name.replace('-', '_')}").main([] if json is None else ["--json", json])
    return 0
