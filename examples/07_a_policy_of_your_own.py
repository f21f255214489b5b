"""A time allocation of your own, in thirty lines.

A policy allots the times between waypoints, in two halves: `encode` reads the waypoints once, `decode` adds the initial
state and is called again and again while arrival times are matched. Both are traced by JAX, with the batch as last
axis; times behind the last waypoint are 0. This one accelerates and brakes evenly on every segment.

The planner scales what a policy says until each goal is reached together with the target, solves the minimum-snap
trajectories and checks them against the rotors' limits, whoever allotted the times. It flies at most a third faster
than a policy says (alpha from 0.75), so one that is too cautious meets its target later.
"""

import jax
import jax.numpy as jnp
import numpy as np

import jaxplan
from jaxplan.policy.protocol import Policy

ACCELERATION, SPEED = 5.0, 4.0  # m/s^2, m/s: at most, on each segment


def encode(waypoints: jax.Array, count: jax.Array) -> jax.Array:
    """Lengths of the segments, (m, k) m; 0 behind the last waypoint of each of the k sequences."""
    lengths = jnp.sqrt(jnp.sum(jnp.diff(jnp.asarray(waypoints), axis=0) ** 2, axis=1))
    real = jnp.arange(len(lengths))[:, None] < jnp.asarray(count)[None] - 1
    return jnp.where(real, jnp.maximum(lengths, 1e-3), 0.0)


def decode(lengths: jax.Array, initial: object) -> jax.Array:
    """Times, (m, k) s: up to speed and down again, or as fast as the way allows."""
    ramp = SPEED**2 / ACCELERATION  # m for both together
    short = 2.0 * jnp.sqrt(lengths / ACCELERATION)
    long = 2.0 * SPEED / ACCELERATION + (lengths - ramp) / SPEED
    return jnp.where(lengths < ramp, short, long)


def main() -> None:
    """Plan to the same goals with this policy and with a constant speed."""
    world, vehicle = jaxplan.load_world("env1"), jaxplan.load_vehicle("mfrl")
    start = jaxplan.hover(world.start)
    times = np.linspace(0.5, 4.0, 36)  # s: a target that flies by
    goals = np.array([-4.0, -3.0, 1.0]) + times[:, None] * np.array([0.0, 0.8, 0.0])  # m
    candidates = jaxplan.candidates_from(goals[0], goals, times, np.zeros(len(times)))
    config = jaxplan.PlannerConfig(allocate="policy")  # no other allocation beside it
    for policy in (Policy("ramps", encode, decode), jaxplan.constant_speed_policy(2.5)):
        planner = jaxplan.build_planner(config, world=world, vehicle=vehicle, policy=policy)
        plans = planner.plan_batch(start, candidates)
        best = jaxplan.select(plans)
        if best < 0:
            print(f"{policy.name}: none of {len(times)} candidates can be used")
            continue
        print(f"{policy.name}: meets the target after {times[best]:.1f} s, alpha {plans.alpha[best]:.2f}")
        spline = plans.spline(best)
        speed = np.linalg.norm(spline.evaluate(np.linspace(0.0, times[best], 50), derivative=1)[:, :3], axis=1)
        print(f"  fastest {speed.max():.1f} m/s on the way, at rest behind the target after {spline.duration:.1f} s")


if __name__ == "__main__":
    main()
