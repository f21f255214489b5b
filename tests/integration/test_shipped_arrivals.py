"""The arrival matching of the shipped policies over 100,000 random candidates."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.arrival import ArrivalConfig, match_arrival, sped_up
from jaxplan.knots import MAX_WAYPOINTS
from jaxplan.policy.checkpoint import load_policy
from jaxplan.spline import FlatState
from jaxplan.status import Reason

LANES = 1000
ARRIVAL = ArrivalConfig()


def random_sequences(rng):
    """Waypoints of 2 to 14, metres apart, padded by the last one."""
    waypoints = np.cumsum(rng.normal(size=(MAX_WAYPOINTS, 3, LANES)) * np.array([1.5, 1.5, 0.4])[:, None], axis=0)
    count = rng.integers(2, MAX_WAYPOINTS + 1, LANES)
    last = np.minimum(np.arange(MAX_WAYPOINTS)[:, None], count - 1)
    return np.take_along_axis(waypoints, last[:, None], axis=0), count


def random_state(rng):
    """A state in flight, up to 6 m/s."""
    derivatives = rng.normal(size=(5, 3)) * np.array([0.0, 2.0, 3.0, 10.0, 60.0])[:, None]
    return FlatState(derivatives=derivatives, yaw=rng.normal(size=3) * np.array([2.0, 0.5, 0.5]))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pretrained", "mfrl"])
def test_arrivals_are_met_or_flagged(name):
    """Every accepted lane arrives within the tolerance, by a decoder call of its own; few calls; alpha < 1 is exact."""
    policy, rng = load_policy(name), np.random.default_rng(0)

    @jax.jit
    def match(waypoints, count, state, share):
        context = policy.encode(waypoints, count)
        least = jnp.sum(policy.decode(context, sped_up(state, jnp.ones(LANES))), axis=0)
        goals = share * least
        found = match_arrival(lambda d: policy.decode(context, d), state, goals, ARRIVAL)
        # float32: of what comes out beyond its range nothing is accepted
        again = found.alpha * jnp.sum(policy.decode(context, sped_up(state, found.alpha)), axis=0)
        return goals, found, again

    flagged, calls = 0, []
    with jax.enable_x64(True):
        for _ in range(100):
            share = np.exp(rng.uniform(np.log(0.5), np.log(4.0), LANES))
            goals, found, again = jax.tree.map(np.asarray, match(*random_sequences(rng), random_state(rng), share))
            unreachable = (found.reasons & int(Reason.ALPHA_LT_1)) > 0
            np.testing.assert_array_equal(unreachable, share < np.exp(-ARRIVAL.tolerance))
            met = found.reasons == 0
            assert (np.abs(found.durations.sum(axis=0)[met] / goals[met] - 1.0) <= ARRIVAL.tolerance).all()
            assert (np.abs(again[met] / goals[met] - 1.0) <= 2.0 * ARRIVAL.tolerance).all()
            assert (found.alpha[met] >= np.exp(-ARRIVAL.tolerance)).all()
            assert found.calls.max() <= ARRIVAL.max_calls
            flagged += int(((found.reasons & int(Reason.ALPHA_NOT_CONVERGED)) > 0).sum())
            calls.append(found.calls[~unreachable])
    assert np.median(np.concatenate(calls)) <= 5
    assert flagged <= 100
