"""NumPy's linear algebra of many small matrices, on one thread.

OpenBLAS splits a product or a decomposition over all cores from some tens of rows on, and its threads wait for each
other by spinning. For a batch of small matrices that is waste at best; where the cores have something else to do, such
as a planner that flies or a compiler, it takes a hundred times as long (docs/decisions/0039-start.md).
"""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, ParamSpec, TypeVar

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
R = TypeVar("R")


def on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """``function`` (host) with one thread of each BLAS library while it runs, and as many as before after it."""

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with _libraries().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


@functools.cache
def _libraries() -> "ThreadpoolController":
    """The BLAS libraries of this process: looking for them takes longer than most calls."""
    import scipy.linalg  # noqa: F401  # SciPy brings a BLAS of its own, which must be there to be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
