"""A gradient through the solve.

`minimum_snap_batch` may stand inside `jax.grad`. Here three gates may be passed anywhere within half a metre of their
middle, and the segments may take any times that add up to the same total: waypoints and times are improved together,
by Adam, on the snap of the trajectory that is optimal for them.
"""

import jax
import jax.numpy as jnp
import numpy as np
import optax

import jaxplan

MIDDLES = np.array([[0.0, 0.0, 1.0], [2.0, 2.0, 1.5], [5.0, -1.0, 2.0], [7.0, 1.5, 1.0], [9.0, 0.0, 1.0]])  # m
TOTAL, RADIUS = 6.0, 0.5  # s, m
STEPS = 200


def problem(free: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array]:
    """Waypoints inside their gates, and times with the same sum, for any numbers whatever."""
    moved = RADIUS * free["aside"] / jnp.sqrt(1.0 + jnp.sum(free["aside"] ** 2, axis=1, keepdims=True))
    waypoints = jnp.asarray(MIDDLES).at[1:-1].add(moved)
    return waypoints, TOTAL * jax.nn.softmax(free["shares"])


def snap(free: dict[str, jax.Array]) -> jax.Array:
    """The logarithm of the integral of the squared snap."""
    waypoints, durations = problem(free)
    return jnp.log(jaxplan.minimum_snap_batch(waypoints[..., None], durations[:, None]).cost[0])


def main() -> None:
    """Check the gradient against a difference, then descend."""
    with jax.enable_x64(True):
        free = {"aside": jnp.full((3, 3), 1e-3), "shares": jnp.log(jnp.full(4, 0.25))}
        slope = jax.grad(snap)(free)["shares"][1]
        ahead, behind = (snap({**free, "shares": free["shares"].at[1].add(step)}) for step in (1e-4, -1e-4))
        print(f"gradient {slope:.4f}, difference {(ahead - behind) / 2e-4:.4f}")

        optimiser = optax.adam(0.05)
        state, descend = optimiser.init(free), jax.jit(jax.value_and_grad(snap))
        first = snap(free)
        for _ in range(STEPS):
            _, slopes = descend(free)
            updates, state = optimiser.update(slopes, state)
            free = optax.apply_updates(free, updates)
        waypoints, durations = problem(free)
        print(f"snap falls to {float(jnp.exp(snap(free) - first)):.3f} of what it was")
        print("times [s]:", np.array2string(np.asarray(durations), precision=2))
        aside = np.linalg.norm(np.asarray(waypoints) - MIDDLES, axis=1)[1:-1]
        print("gates passed off their middle by [m]:", np.array2string(aside, precision=2))


if __name__ == "__main__":
    main()
