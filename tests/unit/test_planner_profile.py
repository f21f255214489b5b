"""Times by the profile of speeds, compiled: those of its policy and of the arrival matching, in JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.arrival import Arrival, ArrivalConfig, match_arrival
from jaxplan.knots import KnotConfig, select_routes
from jaxplan.planner.kernels.profile import profile_arrival
from jaxplan.policy.speed_profile import speed_profile_policy
from jaxplan.spline import hover
from jaxplan.status import Reason
from tolerances import assert_close


def paths(rng: np.random.Generator, width: int = 60, length: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Of few and of many corners, short and long, straight, and none at all; half go on behind their goals."""
    points = np.cumsum(rng.normal(scale=rng.uniform(0.05, 3.0, (width, 1, 1)), size=(width, length, 3)), axis=1)
    for k in range(width):
        used = 1 + k % length
        points[k, used:] = points[k, used - 1]
    points[5] = points[5, 0] + np.linspace(0.0, 1.0, length)[:, None] * [7.0, 0.0, 0.0]
    stops = np.where(np.arange(width)[:, None] % 2 == 0, points[:, -1], points[:, -1] + rng.normal(size=(width, 3)))
    return points, stops


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("config", [ArrivalConfig(), ArrivalConfig(least_alpha=0.75, tolerance=1e-2, max_calls=9)])
@pytest.mark.parametrize("speed", [0.0, 3.0, 9.0])
def test_times_by_the_profile_are_those_of_the_policy(speed: float, config: ArrivalConfig) -> None:
    rng = np.random.default_rng(2)
    points, stops = paths(rng)
    routes = jax.jit(lambda p, s: select_routes(p, KnotConfig(), stops=s))(points, stops)
    waypoints, count, meet = (
        np.moveaxis(np.asarray(routes.knots.waypoints), 0, -1),
        np.asarray(routes.knots.count),
        np.asarray(routes.meet),
    )
    velocity, state = speed * np.array([0.6, -0.64, 0.48]), hover(np.zeros(3))
    state.derivatives[1] = velocity
    policy, width = speed_profile_policy(7.0), waypoints.shape[-1]
    wanted_times, least = rng.uniform(0.1, 8.0, width), np.full(width, config.least_alpha)
    wanted_times[::7], least[::5] = 0.0, 1.3

    @jax.jit
    def arrive() -> Arrival:
        course = policy.encode(jnp.asarray(waypoints), jnp.asarray(count))
        times, where = jnp.asarray(wanted_times), jnp.asarray(meet)
        return match_arrival(lambda d: policy.decode(course, d), state, times, config, where, jnp.asarray(least))

    found, wanted = profile_arrival(waypoints, count, meet, velocity, wanted_times, least, 7.0, config), arrive()
    for mine, theirs in zip(found, wanted, strict=True):
        assert_close(mine, theirs, "solve")
    assert {0, int(Reason.ALPHA_LT_1)} <= set(np.unique(found.reasons).tolist())
    assert (found.calls.max() == 2) == (speed == 0.0), "from rest one step leads there"
