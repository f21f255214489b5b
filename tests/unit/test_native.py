"""How code is compiled for the host, and the key of what numba keeps of it on disk."""

import numba
import numpy as np
import pytest

from jaxplan import load_world
from jaxplan.compilation import compilations
from jaxplan.linking import PART, WHOLE
from jaxplan.native import digest_of, entry_point, inner, specialisations
from jaxplan.optimizer.kernels import compiled as of_optimizer
from jaxplan.search.kernels import compiled as of_search
from jaxplan.search.kernels.sight import clearances
from jaxplan.search.kernels.solids import solids_of
from jaxplan.tracking.kernels import compiled as of_tracking


@pytest.mark.parametrize("compiled", [of_search, of_tracking])
def test_the_cache_key_follows_every_source_file(compiled, tmp_path):
    folder = compiled.Path(compiled.__file__).parent
    for path in sorted(folder.glob("*.py")):
        (tmp_path / path.name).write_bytes(path.read_bytes())
        before = digest_of.__wrapped__(tmp_path)
        (tmp_path / path.name).write_bytes(path.read_bytes() + b"\n")
        assert digest_of.__wrapped__(tmp_path) != before
        (tmp_path / path.name).write_bytes(path.read_bytes())
    assert digest_of.__wrapped__(tmp_path) == compiled.source_digest() == digest_of(folder)


def test_each_has_a_key_of_its_own():
    assert of_search.source_digest() != of_tracking.source_digest()


def test_the_key_of_the_descent_follows_all_that_it_calls():
    own = digest_of(of_optimizer.Path(of_optimizer.__file__).parent)
    assert of_optimizer.source_digest() == own + of_search.source_digest() + of_tracking.source_digest()


def test_every_layout_of_points_is_one_program():
    solids = solids_of(load_world("env1"))
    points = np.random.default_rng(0).uniform(0.5, 1.5, (64, 3))
    expected, known = clearances(solids, points), specialisations()
    for other in (np.asfortranarray(points), points[::-1][::-1], np.repeat(points, 2, axis=1)[:, ::2]):
        np.testing.assert_array_equal(clearances(solids, other), expected)
    assert specialisations() == known


def test_what_numba_makes_ready_counts_as_a_compilation():
    @entry_point
    def double(x):
        return x + x

    known = compilations()
    assert double(1.0) == 2.0
    assert compilations() == known + 1
    assert double(2.0) == 4.0
    assert compilations() == known + 1
    assert double(1) == 2
    assert compilations() == known + 2


def test_parts_are_taken_in_once():
    @inner
    def leaf(x, k):
        return x[k] * x[k]

    @inner
    def middle(x):
        total = 0.0
        for k in range(len(x)):
            total += leaf(x, k)
        return total

    @entry_point
    def whole(x):
        return middle(x) + leaf(x, 0)

    x = np.arange(5.0)
    assert whole(x) == 30.0
    if PART:
        code = whole.inspect_llvm(whole.signatures[0])
        assert code.count("call i32 @_ZN") == 1  # the wrapper's: all else is in it


def test_what_is_looked_up_once_gives_the_code_that_numba_gives():
    def sums(x, y):
        total, count = 0.0, 0
        for k in range(len(x)):
            if x[k] ** 2 > y[k % 2] or count == 3:
                total += x[k] / 2 - y[0]
                count += 1
        return total, count

    options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    compiled, plain = numba.njit(**options, **WHOLE)(sums), numba.njit(**options)(sums)
    x, y = np.arange(5.0), np.ones(2)
    assert compiled(x, y) == plain(x, y) == (0.5 * (2 + 3 + 4) - 3, 3)
    own, theirs = (each.inspect_asm(each.signatures[0]).splitlines() for each in (compiled, plain))
    instructions = [[line.split()[0] for line in lines if line.startswith("\t")] for lines in (own, theirs)]
    assert instructions[0] == instructions[1]
    assert "get_call_type" not in vars(numba.types.Function)
