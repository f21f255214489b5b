"""BLAS on one thread while small matrices are worked on."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from jaxplan.blas import on_one_thread
from jaxplan.prediction.target_model import shipped_model


def blas_threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_one_thread_while_it_runs_and_as_many_as_before_afterwards() -> None:
    with threadpool_limits(2, user_api="blas"):
        assert blas_threads() == {2}
        assert on_one_thread(blas_threads)() == {1}
        assert blas_threads() == {2}
        with pytest.raises(ZeroDivisionError):
            on_one_thread(lambda: 1 // 0)()
        assert blas_threads() == {2}


def test_a_conditional_mixture_does_not_depend_on_the_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    model = shipped_model("env1", 0.1)
    seen: list[set[int]] = []
    factor = np.linalg.cholesky
    monkeypatch.setattr(np.linalg, "cholesky", lambda matrices: (seen.append(blas_threads()), factor(matrices))[1])
    with threadpool_limits(2, user_api="blas"):
        ready = model.conditional(5, 0.1)
    assert seen
    assert set().union(*seen) == {1}
    with threadpool_limits(1, user_api="blas"):
        again = model.conditional(5, 0.1)
    assert np.array_equal(np.asarray(ready.rows), np.asarray(again.rows))
    assert np.array_equal(np.asarray(ready.modes), np.asarray(again.modes))
