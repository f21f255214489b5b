"""The offline reference: the optimiser against SciPy, a plan against bounds and dense sampling, its flight."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from experiments import reference_times
from jaxplan.errors import InputError
from jaxplan.optimizer.interior_point import DescentConfig, descend
from jaxplan.optimizer.margins import Linearised
from jaxplan.reference.soonest import ReferenceConfig, soonest
from jaxplan.vehicle.limits import most_thrust
from tolerances import tolerance

CENTRE, RADIUS = np.array([1.0, -0.5, 2.0]), 0.7


def disc(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """A linear objective within a ball, and above a plane that cuts it."""
    inside = RADIUS**2 - jnp.sum((x - jnp.asarray(CENTRE)[None]) ** 2, axis=1)
    return x[:, 0] + 2.0 * x[:, 2], jnp.stack([inside, x[:, 1] + 0.4 * x[:, 0]], axis=1)


def linearised(x: jax.Array) -> Linearised:
    slope, jacobian = jax.vmap(jax.jacfwd(lambda row: tuple(part[0] for part in disc(row[None]))))(x)
    return Linearised(disc(x)[0], slope, jnp.zeros_like(x), disc(x)[1], jacobian)


def test_the_descent_finds_scipys_optimum_from_feasible_and_infeasible_starts(x64: None) -> None:
    starts = CENTRE + 0.5 * np.random.default_rng(0).normal(size=(5, 3))
    config = DescentConfig(iterations=300, barrier=1.0, rate=0.9, last_barrier=1e-7)
    found = np.asarray(descend(disc, linearised, jnp.asarray(starts), config).x)
    assert np.asarray(disc(jnp.asarray(starts))[1]).min() < -0.1
    bounds = [{"type": "ineq", "fun": lambda x, i=i: float(disc(jnp.asarray(x[None]))[1][0, i])} for i in range(2)]
    best = minimize(lambda x: x[0] + 2.0 * x[2], CENTRE, constraints=bounds, method="SLSQP", tol=1e-10)
    np.testing.assert_allclose(found @ [1.0, 0.0, 2.0], best.fun, **tolerance("gradient"))
    assert np.asarray(disc(jnp.asarray(found))[1]).min() > 0.0


@pytest.mark.slow
def test_a_reference_is_flown_and_neither_sooner_than_a_point_mass_nor_later_than_a_rival() -> None:
    """None is sooner than all thrust towards the target at once would be; an earlier reference took 1.10 s."""
    values = {"world": "env1", "target": "env1-01", "speed": 0.5, "departure": 1.6111, "seed": 0}
    case = reference_times._case(values)
    found = soonest(case, dataclasses.replace(ReferenceConfig(), starts=4, rounds=6))
    assert found.feasible
    assert found.verdict.accepted
    meeting = case.position(np.array([case.departure + found.seconds]))[0]
    apart = float(np.linalg.norm(meeting - case.sought.start)) - 0.4
    most = float(most_thrust(case.vehicle)) + float(case.vehicle.gravity)
    assert found.seconds > 0.1 + np.sqrt(2.0 * apart / most)
    assert found.seconds < 1.15
    times = np.linspace(0.0, float(found.spline.duration), 3000)
    assert case.judge.clearance(found.spline.evaluate(times)[:, :3]).min() > float(case.vehicle.radius)
    end = found.spline.state(float(found.spline.duration))
    np.testing.assert_allclose(end.derivatives[1:4], 0.0, atol=1e-3)


@pytest.mark.parametrize("options", [{"segments": 2}, {"starts": 0}, {"rounds": 0}, {"clearance": 0.0}])
def test_wrong_settings_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(options))):
        ReferenceConfig(**options)  # type: ignore[arg-type]
