"""The one table of tolerances, by precision and by kind of quantity. A local override carries its reason.

exact:    the same arithmetic in another order (jit against eager, vmap against a loop)
formula:  a closed form or an independent implementation of it
solve:    behind a linear solve or an optimiser; condition numbers up to 1e6
gradient: automatic against finite differences
"""

import numpy as np

_TABLE = {
    "float64": {"exact": 1e-12, "formula": 1e-10, "solve": 1e-7, "gradient": 1e-5},
    "float32": {"exact": 1e-5, "formula": 1e-5, "solve": 1e-3, "gradient": 1e-2},
}


def tolerance(kind: str, dtype: object = np.float64) -> dict[str, float]:
    """``rtol`` and ``atol`` for ``numpy.testing.assert_allclose`` on quantities of order one in SI units."""
    value = _TABLE[np.dtype(dtype).name][kind]  # type: ignore[call-overload]
    return {"rtol": value, "atol": value}


def relative(kind: str, dtype: object = np.float64) -> dict[str, float]:
    """``rel`` and ``abs`` for ``pytest.approx``, likewise."""
    value = tolerance(kind, dtype)["rtol"]
    return {"rel": value, "abs": value}


def assert_close(actual: object, desired: object, kind: str, dtype: object = np.float64) -> None:
    """Assert equality within the table's tolerance."""
    np.testing.assert_allclose(np.asarray(actual), np.asarray(desired), **tolerance(kind, dtype))  # type: ignore[arg-type]
