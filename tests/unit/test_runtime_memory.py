"""What is set aside before a flight is not looked through again."""

import gc

from jaxplan.runtime import settle


def test_what_was_there_is_set_aside_and_what_comes_later_is_still_collected():
    kept = [[number] for number in range(1000)]
    before = len(gc.get_objects())
    settle()
    try:
        assert gc.get_freeze_count() >= 1000
        assert len(gc.get_objects()) < before / 10
        later: list[object] = []
        later.append(later)
        del later
        assert gc.collect() >= 1
    finally:
        gc.unfreeze()
    assert kept[999] == [999]
