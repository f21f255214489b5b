"""``free_distance`` for code on the host: any number of points, one compiled program."""

import jax
import numpy as np
from jaxtyping import Float

from jaxplan.precision import in_float64
from jaxplan.world.clearance import free_distance
from jaxplan.world.obstacles import World


@in_float64
def host_free_distance(
    world: World, points: Float[np.ndarray, "*batch 3"], width: int = 16384
) -> Float[np.ndarray, "*batch"]:
    """Distance [m] from each point [m, world] to the nearest obstacle or face of the room; NaN for NaN (host).

    Args:
        world: the room; on the device, if it is asked for often.
        points: any number of them.
        width: points in one call of the compiled program, so that nothing compiles twice.
    """
    flat, world = points.reshape(-1, 3), world.nameless()
    calls = max(1, -(-len(flat) // width))
    padded = np.zeros((calls * width, 3))
    padded[: len(flat)] = flat
    parts = [np.asarray(_compiled(world, part)) for part in padded.reshape(calls, width, 3)]
    return np.concatenate(parts)[: len(flat)].reshape(points.shape[:-1])


_compiled = jax.jit(free_distance)
