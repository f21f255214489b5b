"""Labels at two fidelities behind one signature: what they share, where they differ, how often they agree."""

import jax
import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.minsnap.single import minimum_snap
from jaxplan.records import replace
from jaxplan.spline import PiecewisePolynomial
from jaxplan.tracking.fidelity import build_labeller
from jaxplan.tracking.result import Flaw
from jaxplan.tracking.track import track
from jaxplan.vehicle.limits import rotor_limit_margin
from jaxplan.vehicle.load import load_vehicle


def random_splines(count: int, seed: int = 0) -> list[PiecewisePolynomial]:
    rng = np.random.default_rng(seed)
    chains = np.cumsum(rng.uniform(-2.0, 2.0, (count, 4, 3)), axis=1)
    speeds = rng.uniform(1.0, 7.0, count)
    steps = np.linalg.norm(np.diff(chains, axis=1), axis=2)
    return [minimum_snap(chain, step / v + 0.1) for chain, step, v in zip(chains, steps, speeds, strict=True)]


def test_low_fidelity_is_the_worst_rotor_along_the_way() -> None:
    vehicle, splines = load_vehicle(), random_splines(12)
    bad = replace(splines[0], position=splines[0].position * np.nan)
    margins = jax.jit(jax.vmap(lambda state: rotor_limit_margin(vehicle, state)))
    labels = build_labeller("rotor-limits")([*splines, bad, splines[0].dilate(0.0)])
    for index, spline in enumerate(splines):
        times = np.linspace(0.0, float(spline.duration), 256)
        worst = float(margins(spline.state(times[::5])).min())
        assert labels.margin[index] * vehicle.rotor_speed_max <= worst + 0.1  # a fifth of the samples, in float32
        assert labels.feasible[index] == (labels.margin[index] >= 0.0)
    assert 0 < np.count_nonzero(labels.feasible[:12]) < 12
    assert [int(bits) for bits in labels.reasons[12:]] == [Flaw.NONFINITE, Flaw.DURATION]
    assert np.all(labels.margin[12:] == -np.inf)


@pytest.mark.slow
def test_both_fidelities_take_the_same_input_and_mostly_agree() -> None:
    splines = random_splines(100, seed=3)
    low, high = (build_labeller(fidelity)(splines) for fidelity in ("rotor-limits", "rollout"))
    flown = track(splines)
    np.testing.assert_array_equal(high.feasible, flown.feasible)
    np.testing.assert_array_equal(high.feasible, high.margin > 0.0)
    assert np.mean(low.feasible == high.feasible) > 0.6
    slow = [spline.dilate(4.0) for spline in splines[:20]]
    slowed = build_labeller("rotor-limits")(slow)
    assert np.all(slowed.feasible)
    assert np.any(slowed.decided)
    assert np.all(low.decided[~low.feasible])
    assert np.all(high.decided)


def test_an_unknown_fidelity_is_refused() -> None:
    with pytest.raises(InputError, match="rotor-limits, rollout"):
        build_labeller("exact")  # type: ignore[arg-type]
