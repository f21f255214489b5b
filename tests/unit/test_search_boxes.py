"""Segments that touch a box, and where they must lead."""

import numpy as np
import pytest

from jaxplan.search.kernels.boxes import between, sides, touches


@pytest.mark.parametrize("seed", range(3))
def test_a_segment_that_touches_leads_between_the_sides(seed: int) -> None:
    """From outside, from within, from its edges and corners; also where it comes but close to the box."""
    rng, found = np.random.default_rng(seed), 0
    for _ in range(2000):
        a, b = rng.integers(-4, 5, (2, 3)) * 0.5 if rng.random() < 0.5 else rng.uniform(-2.0, 2.0, (2, 3))
        lower, upper = np.sort(rng.integers(-2, 3, (2, 3)) * 0.5, axis=0)
        around = float(rng.choice([0.0, 0.3]))
        if touches.py_func(a, b, lower, upper, around):
            found += 1
            seen = sides.py_func(a, lower - around, upper + around)
            assert between.py_func(seen, a, b, 0.0)
    assert found > 300


def test_what_is_beside_the_sides_is_left_out() -> None:
    """A box 2 m ahead from -1 m to 1 m: its sides are seen at 27 degrees."""
    seen = sides.py_func((0.0, 0.0, 0.0), (2.0, -1.0, 0.0), (3.0, 1.0, 1.0))
    np.testing.assert_allclose(seen, np.array([2.0, -1.0, 2.0, 1.0]) / np.sqrt(5.0))
    for y, inside in ((1.9, True), (-1.9, True), (2.1, False), (-2.1, False)):
        assert between.py_func(seen, (0.0, 0.0, 0.0), (4.0, y, 0.0), 0.0) == inside
    assert between.py_func(seen, (0.0, 0.0, 0.0), (4.0, 2.1, 0.0), 0.1)
    assert not between.py_func(seen, (0.0, 0.0, 0.0), (-4.0, 0.0, 0.0), 0.1)
