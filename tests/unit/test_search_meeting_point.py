"""Paths that end within a radius of their goals."""

import numpy as np
import pytest

from jaxplan.search.lattice import Paths
from jaxplan.search.meeting_point import LEFT, ending_before
from jaxplan.status import Reason
from tolerances import tolerance


def paths() -> Paths:
    """One around a corner with a last leg of 2 m, one with a last leg of 0.1 m, one of no length, one without end."""
    points = np.array(
        [
            [[0, 0, 0], [3, 0, 0], [3, 2, 0], [3, 2, 0]],
            [[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 0.1]],
            [[1, 1, 1], [1, 1, 1], [1, 1, 1], [1, 1, 1]],
            [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]],
        ],
        float,
    )
    return Paths(
        points=points,
        count=np.array([3, 4, 2, 4]),
        reasons=np.array([0, 0, 0, Reason.PREFIX_ONLY], np.uint32),
        notes=np.zeros(4, np.uint32),
        resolution=np.full(4, 0.1),
        length=np.array([5.0, 2.1, 0.0, 9.0]),
        expanded=0,
    )


def test_the_last_leg_is_shorter_by_the_radius_or_half() -> None:
    found = ending_before(paths(), 0.25)
    np.testing.assert_allclose(found.points[0, 2:], [[3, 1.75, 0]] * 2, **tolerance("exact"))
    np.testing.assert_allclose(found.points[1, 3], [1, 1, 0.1 * LEFT], **tolerance("exact"))
    np.testing.assert_allclose(found.length, [4.75, 2.05, 0.0, 9.0], **tolerance("exact"))
    np.testing.assert_array_equal(found.points[2:], paths().points[2:])
    np.testing.assert_array_equal(found.points[:2, :2], paths().points[:2, :2])


@pytest.mark.parametrize("radius", [0.0, 0.25])
def test_nothing_to_end(radius: float) -> None:
    none = paths()
    none = Paths(**{name: getattr(none, name)[:0] if name != "expanded" else 0 for name in none.__dataclass_fields__})
    assert len(ending_before(none, radius).points) == 0
    assert ending_before(paths(), 0.0).points[0, 2, 1] == 2.0
