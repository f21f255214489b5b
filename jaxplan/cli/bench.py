"""``jaxplan bench``: the benchmarks, from the source tree or from an installed wheel."""

from typing import Literal

from jaxplan.errors import InputError
from jaxplan.versions import require_supported_jax

Benchmark = Literal[
    "all",
    "cycle",
    "device",
    "mavlink",
    "minsnap",
    "planner",
    "plant",
    "policy",
    "prediction",
    "runtime",
    "safety",
    "search",
    "start",
    "time-allocation",
]
"""Each is a file benchmarks/bench_<name>.py."""


def bench(
    name: Benchmark,
    *,
    json: str | None = None,
    page: str | None = None,
    against: str | None = None,
    debug: bool = False,
) -> int:
    """Measure a station against its peers, in one run on this machine.

    Parameters
    ----------
    name
        What to measure; all: each of the others, at small sizes.
    json
        Where the rows are saved, with hardware, versions and commit.
    page
        Where the page about all of them is written. Default: beside --json.
    against
        An earlier run of all of them: exit code 14 where a ratio to a peer has fallen to less than half.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    from jaxplan.runner.registry import bundled

    given = {"--json": json, "--page": page, "--against": against}
    if name != "all" and (page or against):
        raise InputError("--page, --against: only of jaxplan bench all; leave them out")
    arguments = [word for option, value in given.items() if value is not None for word in (option, value)]
    code = bundled("benchmarks", f"bench_{name.replace('-', '_')}").main(arguments)
    return code if isinstance(code, int) else 0
