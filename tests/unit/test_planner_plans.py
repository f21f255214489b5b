"""What became of every candidate, as a caller asks for it."""

import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner.records import Plans
from jaxplan.selection import Margins


def three_candidates() -> Plans:
    """The second and the third have trajectories that rest at z = 10 and z = 20 m; the first one has none."""
    position = np.zeros((1, 10, 3, 2))
    position[0, 0, 2] = [10.0, 20.0]
    margin = np.zeros(2)
    return Plans(
        goals=np.zeros((3, 3)),
        arrival_times=np.ones(3),
        reasons=np.array([1, 0, 0], dtype=np.uint32),
        score=np.array([-np.inf, 1.0, 2.0]),
        alpha=np.ones(3),
        trajectory=np.array([-1, 0, 1]),
        splines=SplineBatch(durations=np.ones((1, 2)), position=position, yaw=np.zeros((1, 6, 1, 2))),
        margins=Margins(
            deviation=margin,
            clearance=margin,
            rotor_speed=margin,
            probability=np.array([0.8, 0.9]),
            reasons=np.zeros(2, dtype=np.uint32),
        ),
    )


@pytest.mark.parametrize("index", [1, np.int64(2)])
def test_a_candidate_has_its_own_trajectory(index: int) -> None:
    plans = three_candidates()
    assert plans.spline(index).evaluate(0.5)[2] == pytest.approx(10.0 * index)
    assert plans.probability(index) == pytest.approx(0.7 + 0.1 * index)


@pytest.mark.parametrize(("index", "said"), [(-1, "nothing is usable"), (3, "want 0 to 2"), (0, "has no trajectory")])
def test_what_there_is_not_is_never_the_last_one(index: int, said: str) -> None:
    """``select`` says -1 where nothing is usable."""
    plans = three_candidates()
    for ask in (plans.spline, plans.probability):
        with pytest.raises(InputError, match=said):
            ask(index)
