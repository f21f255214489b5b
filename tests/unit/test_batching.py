"""A batch in pieces gives what the whole batch gives, for every way to cut it."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.batching import (
    CHUNK_WIDTH,
    CORES,
    THREAD_WIDTH,
    at_fixed_width,
    fill,
    in_chunks,
    in_threads,
    join,
    meanwhile,
    pick,
    side_by_side,
)


def doubled(tree: dict) -> dict:
    """A function of a batch whose members do not see each other."""
    return {"sum": 2.0 * tree["a"].sum(axis=0) + tree["b"], "a": -tree["a"]}


def some_batch(width: int) -> dict:
    rng = np.random.default_rng(0)
    return {"a": rng.normal(size=(3, 2, width)), "b": rng.normal(size=(2, width))}


def assert_same(ours: dict, theirs: dict) -> None:
    assert ours.keys() == theirs.keys()
    for name, leaf in theirs.items():
        np.testing.assert_array_equal(ours[name], leaf)


@pytest.mark.parametrize("width", [0, 1, 2 * CHUNK_WIDTH, 2 * CHUNK_WIDTH + 1, 5 * CHUNK_WIDTH - 3])
def test_in_chunks_it_is_the_whole(width: int, x64: None) -> None:
    widths = []

    def watched(tree: dict) -> dict:
        widths.append(tree["b"].shape[-1])
        return doubled(tree)

    batch = jax.tree.map(jnp.asarray, some_batch(width))
    assert_same(jax.jit(lambda tree: in_chunks(watched, tree, width))(batch), doubled(batch))
    assert max(widths) <= 2 * CHUNK_WIDTH


@pytest.mark.parametrize("width", [1, 2 * THREAD_WIDTH, 2 * THREAD_WIDTH + 1, 4 * THREAD_WIDTH + 7])
def test_in_threads_it_is_the_whole_in_64_bits_and_compiled_once(width: int) -> None:
    shapes = set()

    def watched(tree: dict) -> dict:
        shapes.add(tree["b"].shape)
        return doubled(jax.tree.map(jnp.asarray, tree))

    batch = some_batch(width)
    found = in_threads(watched, batch, width)
    assert_same(found, doubled(batch))
    assert isinstance(found["a"], np.ndarray)
    assert found["a"].dtype == np.float64
    assert len(shapes) == 1


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("count", [1, 5, 8, 23])
def test_at_a_fixed_width_it_is_the_whole(count: int, threads: int) -> None:
    batch, calls, lock = some_batch(40), [], threading.Lock()
    members = np.random.default_rng(1).permutation(40)[:count]

    def watched(some: np.ndarray) -> dict:
        with lock:
            calls.append(len(some))
        return doubled(pick(batch, some))

    assert_same(at_fixed_width(watched, members, 8, threads), doubled(pick(batch, members)))
    assert calls == [8] * -(-count // 8)


def test_what_is_filled_up_is_left_out_again() -> None:
    batch = some_batch(10)
    some = np.array([7, 2, 2])
    np.testing.assert_array_equal(fill(some, 6), [7, 2, 2, 7, 7, 7])
    assert_same(join([(pick(batch, fill(some, 6)), 3)]), pick(batch, some))


def test_side_by_side_keeps_the_order_and_passes_errors_on() -> None:
    assert side_by_side(lambda n: n * n, range(20)) == [n * n for n in range(20)]
    assert side_by_side(len, []) == []
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda n: 1 // n, [1, 0, 2])


def test_meanwhile_a_function_runs_elsewhere_and_on_a_busy_machine_here():
    begun = threading.Event()

    def elsewhere():
        begun.set()
        return threading.get_ident()

    free = meanwhile(elsewhere)
    assert begun.wait(10.0)
    assert free() != threading.get_ident()
    go, busy = threading.Event(), threading.Barrier(CORES + 1)
    held = [meanwhile(lambda: (busy.wait(10.0), go.wait(10.0))) for _ in range(CORES)]
    busy.wait(10.0)
    assert meanwhile(threading.get_ident)() == threading.get_ident()
    go.set()
    for one in held:
        one()


def test_what_goes_wrong_meanwhile_is_raised_where_it_is_asked_for():
    with pytest.raises(ZeroDivisionError):
        meanwhile(lambda: 1 // 0)()
