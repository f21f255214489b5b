"""Products of 3-vectors, entry by entry: anything that can be indexed by 0, 1, 2.

Over a batch XLA fuses plain arithmetic on entries into one loop. A contraction of three entries would be a small matrix
product for every lane, and stacking entries costs a copy of all lanes.
"""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplan.arrays import AnyArray

Entry = Float[AnyArray, "..."]
"""One number, or one for each state of a batch."""
Vector = Sequence[Entry] | Float[AnyArray, "3 ..."]


def dot(u: Vector, v: Vector) -> Entry:
    """u . v; its unit is the product of theirs."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def cross(u: Vector, v: Vector) -> tuple[Entry, Entry, Entry]:
    """u x v, right-handed."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


def length(v: Vector) -> Float[Array, "..."]:
    """Euclidean norm with gradient 0 at 0; unlike ``numerics.safe_norm``, NaN stays NaN."""
    squared = dot(v, v)
    zero = squared == 0.0
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, squared)))


def direction(v: Vector, otherwise: Vector) -> tuple[Float[Array, "..."], Float[Array, "..."], Float[Array, "..."]]:
    """v / |v|, and ``otherwise`` where v is 0."""
    size = length(v)
    zero = size == 0.0
    safe = jnp.where(zero, 1.0, size)
    x, y, z = (jnp.where(zero, otherwise[axis], v[axis] / safe) for axis in range(3))
    return x, y, z
