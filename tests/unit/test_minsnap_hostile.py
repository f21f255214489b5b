"""Hostile numbers in every argument: one declared error, a status, or a finite solution."""

import warnings

import numpy as np
import pytest

import jaxplan
from jaxplan.errors import InputError

CALLS = 150


def spoilt(rng: np.random.Generator, values: np.ndarray) -> object:
    """The same numbers, one of them wild, or all of another size, shape or type; or left alone."""
    array = np.array(values, float)
    place = int(rng.integers(array.size))
    match int(rng.integers(0, 12)):
        case 0:
            array.flat[place] = np.nan
        case 1:
            array.flat[place] = -np.inf
        case 2:
            array.flat[place] = 10.0 ** rng.uniform(-300, 300) * rng.choice([-1, 1])
        case 3:
            array *= 10.0 ** rng.uniform(-12, 12)
        case 4:
            return array[..., : int(rng.integers(0, array.shape[-1] + 1))]
        case 5:
            return array[None]
        case 6:
            return array.astype(rng.choice(["f2", "f4", "i4", "O", "S8", "U4", "c16", "?", "M8[s]"]))
        case 7:
            return array.tolist()
    return array


@pytest.mark.parametrize("seed", range(2))
def test_one_problem(seed: int) -> None:
    rng, solved = np.random.default_rng(seed), 0
    for _ in range(CALLS):
        count = int(rng.integers(1, 4))
        numbers = rng.normal(size=(count + 1, 3)), rng.uniform(0.3, 2.0, count), rng.normal(size=(4, 3))
        waypoints, durations, initial = (spoilt(rng, part) for part in numbers)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = jaxplan.minimum_snap(waypoints, durations, initial=initial)
        except InputError:
            continue
        solved += 1
        assert np.isfinite(found.position).all()
        assert np.isfinite(found.durations).all()
    assert CALLS // 10 < solved < CALLS


@pytest.mark.parametrize("seed", range(2))
def test_a_batch(seed: int) -> None:
    rng, solved = np.random.default_rng(seed), 0
    for _ in range(CALLS):
        waypoints, durations = (spoilt(rng, part) for part in (rng.normal(size=(4, 3, 4)), rng.uniform(0.3, 2, (3, 4))))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = jaxplan.minimum_snap_batch(waypoints, durations)
        except InputError:
            continue
        solved += 1
        finite = np.isfinite(found.splines.position).all(axis=(0, 1, 2))
        assert (finite | (np.asarray(found.status) != 0)).all()
    assert CALLS // 10 < solved < CALLS
