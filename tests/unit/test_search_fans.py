"""What stands in which direction: no primitive that a segment can come too close to is missing from its sector."""

import numpy as np
import pytest

from jaxplan.native import entry_point
from jaxplan.search.kernels.fans import SECTORS, look_round, sector_of

LIMIT = 0.4


@entry_point
def fan(boxes: np.ndarray, limit: float, a: tuple, members: np.ndarray, counts: np.ndarray) -> None:
    look_round(boxes, limit, a, members, counts)


@entry_point
def sector(a: tuple, b: tuple) -> int:
    return sector_of(a, b)


def enters(low: np.ndarray, high: np.ndarray, a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the segment a-b touches a box seen from above, by looking at many points of it."""
    points = a + np.linspace(0.0, 1.0, 20_000)[:, None] * (b - a)
    return bool(((points >= low) & (points <= high)).all(axis=1).any())


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_whatever_a_segment_enters_is_in_its_sector(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = rng.uniform(-5.0, 5.0, (30, 3))
    boxes = np.concatenate([low, low + rng.uniform(0.05, 2.0, (30, 3))], axis=1)
    boxes[0], boxes[1] = [-1e9] * 3 + [1e9] * 3, [-1e6 - 1.0] * 3 + [-1e6] * 3  # a plane, and a box that is not there
    found = 0
    for _ in range(6):
        a = rng.uniform(-6.0, 6.0, 3)
        members, counts = np.empty((SECTORS, len(boxes)), np.int32), np.empty(SECTORS, np.int32)
        fan(boxes, LIMIT, tuple(a.tolist()), members, counts)
        for _ in range(60):
            b = rng.uniform(-6.0, 6.0, 3)
            place = sector(tuple(a.tolist()), tuple(b.tolist()))
            among = set(members[place, : counts[place]].tolist())
            met = {n for n, box in enumerate(boxes) if enters(box[:2] - LIMIT, box[3:5] + LIMIT, a[:2], b[:2])}
            assert met <= among
            found += len(met) > 1
    assert found > 30
    assert counts.mean() < 0.6 * len(boxes)


def test_directions_along_the_axes_and_straight_up() -> None:
    """Where a place touches a grown box, and where the direction is on the border of two sectors or none at all."""
    boxes = np.array([[1.0, -0.5, 0.0, 2.0, 0.5, 1.0], [-0.5, 1.0, 0.0, 0.5, 2.0, 1.0]])
    members, counts = np.empty((SECTORS, 2), np.int32), np.empty(SECTORS, np.int32)
    a = (0.0, 0.0, 0.5)
    fan(boxes, 0.2, a, members, counts)
    for b, wanted in (((3.0, 0.0, 0.5), 0), ((3.0, -1e-9, 0.5), 0), ((0.0, 3.0, 0.5), 1), ((1e-9, 3.0, 0.5), 1)):
        place = sector(a, b)
        assert wanted in members[place, : counts[place]]
    fan(boxes, 1.0, a, members, counts)  # it stands in both
    assert sector(a, (0.0, 0.0, 2.0)) == 0
    assert (counts == 2).all()
