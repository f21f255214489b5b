"""No garbage collection while things are compiled, and none that looks through all of it afterwards."""

import gc

import pytest

from jaxplan.compilation import uncollected


@pytest.fixture
def nothing_set_aside():
    """The collector as a process has it that set nothing aside."""
    assert gc.isenabled()
    gc.unfreeze()
    yield
    gc.unfreeze()


def test_nothing_is_collected_within(nothing_set_aside):
    with uncollected():
        assert not gc.isenabled()
        with uncollected():
            assert not gc.isenabled()
        assert not gc.isenabled()
    assert gc.isenabled()


def test_what_was_made_is_old_behind_it(nothing_set_aside):
    with uncollected():
        made = [[number] for number in range(10_000)]
    young = {id(one) for generation in (0, 1) for one in gc.get_objects(generation)}
    assert not any(id(one) in young for one in made)
    assert gc.get_freeze_count() == 0


def test_what_was_set_aside_stays_there(nothing_set_aside):
    made = [[number] for number in range(10_000)]
    gc.freeze()
    with uncollected():
        made.append([])
    assert gc.get_freeze_count() >= len(made) - 1
