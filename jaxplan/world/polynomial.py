"""A lower bound of the clearance anywhere on a polynomial, not only at samples (pure JAX).

A polynomial on [0, 1] lies in the convex hull of its control points (Bernstein basis). Cut into pieces, the control
points b_i of each lie in a ball around the piece's middle p(1/2) of radius r = max_i |b_i - p(1/2)|, hence so does the
piece; distance to obstacles is 1-Lipschitz, so on the whole piece ``clearance >= clearance(p(1/2)) - r``. The radius of
n pieces shrinks like 1/n. A needle between two samples is met by the ball that contains it.

``jaxplan.selection`` bounds planned splines by speed and acceleration instead: it has both at its samples already, and
so needs no control points of pieces. This one takes coefficients alone.
"""

from math import comb

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.numerics import safe_norm
from jaxplan.world.clearance import clearance, wall_clearance
from jaxplan.world.obstacles import World


def clearance_lower_bound(
    world: World, coefficients: Float[Array, "*batch n 3"], pieces: int = 16, walls: bool = True
) -> Float[Array, "*batch"]:
    """Lower bound [m] of the distance from polynomials to obstacles, and to the room's faces where ``walls``.

    ``coefficients`` are ascending on [0, 1] [m, world]. NaN where a coefficient is not finite.
    """
    control = jnp.einsum("pcn,...nd->...pcd", jnp.asarray(_pieces(coefficients.shape[-2], pieces)), coefficients)
    powers = jnp.asarray(((np.arange(pieces) + 0.5) / pieces)[:, None] ** np.arange(coefficients.shape[-2]))
    middles = jnp.einsum("pn,...nd->...pd", powers, coefficients)
    radius = safe_norm(control - middles[..., None, :]).max(axis=-1)
    free = clearance(world, middles)
    if walls:
        free = jnp.minimum(free, wall_clearance(world, middles))
    return jnp.min(free - radius, axis=-1)


def _pieces(count: int, pieces: int) -> Float[np.ndarray, "p c n"]:
    """Maps from ``count`` ascending coefficients on [0, 1] to the control points of each of the pieces.

    With t = (p + s) / P, t^k = sum_j C(k, j) p^(k-j) s^j / P^k; and s^j = sum_i C(i, j) / C(n - 1, j) B_i(s).
    """
    degree = count - 1
    to_control = np.array(
        [[comb(i, j) / comb(degree, j) if j <= i else 0.0 for j in range(count)] for i in range(count)]
    )
    maps = np.zeros((pieces, count, count))
    for p in range(pieces):
        for k in range(count):
            for j in range(k + 1):
                maps[p, j, k] = comb(k, j) * float(p) ** (k - j) / float(pieces) ** k
    return np.asarray(np.einsum("cj,pjn->pcn", to_control, maps))
