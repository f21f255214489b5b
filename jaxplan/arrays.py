"""Array types for annotations: on the device, on the host, or on either.

``jaxtyping.Array`` is an array of JAX, ``numpy.ndarray`` one of the host. Records that travel between both hold
``AnyArray``, as do functions of plain arithmetic that serve both. The shapes and dtypes that annotations state are
checked in every test run, by jaxtyping's import hook (``tests/conftest.py``).

A host entry point that takes what a user has, and refuses what it cannot use in a message of its own, says
``Annotated[ArrayLike, "n 3"]`` (``numpy.typing``) instead: the shape is for the reader, the check is the function's.
"""

from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

AnyArray = jax.Array | np.ndarray
"""On the device or on the host."""

Scalar = float | np.floating | Float[AnyArray, ""]
"""A real number, of Python, NumPy or JAX."""


_HOST = (np.ndarray, np.generic, float, int)


def is_numpy(*trees: Any) -> bool:
    """Whether every leaf is NumPy or plain Python: a call on the host, outside any transformation."""
    return all(
        isinstance(tree, _HOST) or all(isinstance(leaf, _HOST) for leaf in jax.tree.leaves(tree)) for tree in trees
    )


def namespace(*trees: Any) -> ModuleType:
    """``numpy`` for what is NumPy, else ``jax.numpy``: functions of plain arithmetic serve both through it."""
    return np if is_numpy(*trees) else jnp
