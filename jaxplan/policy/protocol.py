"""What a planning policy is: a time allocation in two halves.

``encode`` sees only the waypoints and runs once per candidate; ``decode`` adds the initial state and is all that
the alpha iteration repeats. Batch axis last; durations are 0 behind the last real segment.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxtyping import Array, Float, Int

from jaxplan.spline import FlatStateBatch

Context = Any
"""Whatever a policy's encoder hands to its decoder: any pytree."""


class Policy(NamedTuple):
    """A named pair of pure functions."""

    name: str
    encode: Callable[[Float[Array, "n 3 k"], Int[Array, "k"]], Context]
    decode: Callable[[Context, FlatStateBatch], Float[Array, "m k"]]
    """The states' positions are those of the first waypoints."""
