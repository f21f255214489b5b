"""Boxes of the arena that move: where they may be, how they turn, what is told of them."""

import itertools

import numpy as np
import pytest

from experiments.arena.families import LEVELS, TRAFFIC, case
from experiments.arena.movers import STRAY, TURNING, Mover, Traffic
from jaxplan.replanner.foresight import REACTION
from jaxplan.world.host_distance import host_free_distance
from tolerances import tolerance


@pytest.mark.parametrize("family", ["moving", "moving-seen", "moving-abrupt"])
def test_what_moves_keeps_clear_of_walls_and_of_the_target(family: str) -> None:
    for number, (level, (count, speed)) in itertools.product(range(3), zip(LEVELS, TRAFFIC, strict=True)):
        one = case(family, level, number, seed=0)
        assert one.traffic is not None
        assert len(one.traffic.movers) == count
        times = np.arange(0.0, one.target.duration, 0.02)
        assert one.traffic.distances(times, one.target.position(times)).min() > 0.75
        early = times[times < one.departure]
        assert one.traffic.distances(early, np.broadcast_to(one.start, (len(early), 3))).min() > 1.0
        for mover in one.traffic.movers:
            way = mover.positions(times)
            assert np.linalg.norm(np.diff(way, axis=0), axis=1).max() / 0.02 < speed + 1e-9
            corners = way[:, None] + mover.half * np.array([[-1.0] * 3, [1.0] * 3])
            assert host_free_distance(one.world, corners).min() > 0.0
    known, seen = (case(name, 2, 1, 0).traffic for name in ("moving", "moving-seen"))
    assert known is not None
    assert seen is not None
    np.testing.assert_array_equal([one.middle for one in known.movers], [one.middle for one in seen.movers])
    abrupt = case("moving-abrupt", 2, 1, 0).traffic
    assert abrupt is not None
    assert abrupt.straying == TURNING > seen.straying


def test_ways_are_those_that_are_flown() -> None:
    """A known one always; a seen one that swings for a third of a second, once it has been seen as long."""
    half = np.array([0.2, 0.3, 0.4])
    for abrupt, known, seconds in ((False, True, 1.8), (True, True, 1.8), (False, False, 0.3)):
        mover = Mover(half, np.zeros(3), np.array([1.5, 0.5, 0.1]), 1.3, 0.4, abrupt)
        for now in np.arange(0.6, 5.0, 0.3):
            ways = Traffic((mover,), known).ways(now, 0.3)
            soon = ways.times <= now + seconds
            way = mover.positions(ways.times[soon])
            assert (way - half >= ways.lower[0, soon] - 5e-3).all()
            assert (way + half <= ways.upper[0, soon] + 5e-3).all()


@pytest.mark.parametrize(("straying", "enough"), [(TURNING, True), (0.8 * TURNING, False)])
def test_within_a_reaction_a_box_that_turns_around_comes_no_nearer_than_plans_keep(
    straying: float, enough: bool
) -> None:
    """If what it can do is told; that it turns is seen one sighting late."""
    beyond = []
    for phase, now in itertools.product(np.arange(0.0, 6.0, 1.0), np.arange(0.6, 5.0, 0.05)):
        mover = Mover(np.array([0.2, 0.3, 0.4]), np.zeros(3), np.array([1.5, 0.5, 0.1]), 1.9, phase, True)
        ways = Traffic((mover,), False, straying=straying).ways(now, 0.3)
        soon = ways.times <= now + REACTION
        way = mover.positions(ways.times[soon])
        beyond += [ways.lower[0, soon] - (way - mover.half), way + mover.half - ways.upper[0, soon]]
    assert (max(part.max() for part in beyond) < STRAY) == enough


def test_a_box_that_turns_around_at_once_has_one_speed_and_one_acceleration() -> None:
    mover = Mover(np.ones(3), np.zeros(3), np.array([0.9, 1.2, 0.0]), 2.0, 0.7, True)
    times = np.arange(0.0, 8.0, 1e-3)
    share = mover.positions(times) @ mover.swing / float(mover.swing @ mover.swing)
    speed = np.gradient(share, times) * 1.5
    np.testing.assert_allclose([share.min(), share.max()], [-1.0, 1.0], atol=1e-5)  # of a place between two samples
    np.testing.assert_allclose(np.abs(speed).max(), 3.0, **tolerance("solve"))
    np.testing.assert_allclose(np.abs(np.gradient(speed, times)).max(), TURNING, **tolerance("solve"))


def test_noise_of_boxes_is_the_same_again() -> None:
    mover = Mover(np.ones(3), np.zeros(3), np.array([0.9, 1.2, 0.0]), 2.0, 0.7)
    traffic = Traffic((mover,), False, noise=0.02, seed=3)
    first, again = traffic.ways(1.0, 0.3), traffic.ways(1.0, 0.3)
    np.testing.assert_array_equal(first.lower, again.lower)
    assert np.abs(first.lower - traffic._replace(seed=4).ways(1.0, 0.3).lower).max() > 1e-3


def test_the_distance_to_a_box_that_moves_is_that_to_it_then() -> None:
    mover = Mover(np.array([0.5, 0.5, 0.5]), np.zeros(3), np.array([2.0, 0.0, 0.0]), np.pi, 0.0)
    points = np.array([[2.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 3.0, 4.0]])
    found = Traffic((mover,), True).distances(np.array([0.0, 0.5, 1.0]), points)
    np.testing.assert_allclose(found, [1.5, 0.0, np.hypot(2.5, 3.5)], **tolerance("formula"))
