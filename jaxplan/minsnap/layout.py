"""Where the batch is: the solver has it last, many programs have it first."""

from typing import Any, no_type_check

import jax
import jax.numpy as jnp
import numpy as np

from jaxplan.errors import InputError


@no_type_check
def batch_last(name: str, axis: int, *given: tuple[Any, int]) -> tuple[Any, ...]:
    """Arrays with the batch as their last axis, from arrays with the batch at ``axis``; None stays None.

    Args:
        name: of the entry point, for its messages.
        given: each array and how many axes it has with the batch; one of fewer has none, and stays as it is.

    Raises:
        InputError: another axis than the first or the last.
    """
    if axis not in (-1, 0):
        raise InputError(f"{name}: batch_axis is {axis!r}, want -1 (the batch is the last axis) or 0 (the first)")
    return tuple(array if axis == -1 or array is None else _moved(array, axes) for array, axes in given)


@no_type_check
def _moved(array: Any, axes: int) -> Any:
    xp = jnp if isinstance(array, jax.Array) else np
    return xp.moveaxis(xp.asarray(array), 0, -1) if np.ndim(array) == axes else array
