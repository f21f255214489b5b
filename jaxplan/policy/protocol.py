"""What a planning policy is: a time allocation in two halves.

``encode`` sees only the waypoints and runs once per candidate; ``decode`` adds the initial state and is all that
the alpha iteration repeats. Batch axis last; durations are 0 behind the last real segment.
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

from jaxtyping import Array, Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.spline import FlatStateBatch
from jaxplan.vehicle.identity import VehicleId

Context = Any
"""Whatever a policy's encoder hands to its decoder: any pytree."""


@runtime_checkable
class Encode(Protocol):
    """The half that does not depend on the initial state (traced)."""

    def __call__(self, waypoints: Float[AnyArray, "n 3 k"], count: Int[AnyArray, "k"], /) -> Context:
        """Read k sequences of waypoints [m, world], of which ``count`` are in use; the goal repeats behind them."""


@runtime_checkable
class Decode(Protocol):
    """The half that the alpha iteration repeats (traced)."""

    def __call__(self, context: Context, initial: FlatStateBatch, /) -> Float[Array, "m k"]:
        """Durations [s] of the m = n - 1 segments from k initial states, which lie at the first waypoints."""


class Policy(NamedTuple):
    """A named pair of pure functions, and the vehicle that it was made for."""

    name: str
    encode: Encode
    decode: Decode
    vehicle: VehicleId | None = None
    """The only vehicle that ``build_planner`` takes it for; None: serves any."""
