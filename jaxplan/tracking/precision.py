"""The float32 island: plant and controller compute in float32, whatever the process or the caller's scope says."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

R = TypeVar("R")


def float32_island(function: Callable[..., R]) -> Callable[..., R]:
    """``function`` compiled for float32: floats are cast on the way in, and 64-bit types do not exist inside.

    Strong types only, so one compilation serves float64, NumPy and Python arguments. May be called under ``jit``,
    ``vmap`` and ``scan`` of a float64 program. Products of matrices keep full float32 precision on accelerators. MJX
    needs JAX's ordinary promotion rules, so these are set as well.
    """
    compiled = jax.jit(function)

    @functools.wraps(function)
    def island(*args: Any) -> R:
        args = jax.tree.map(_to_32_bits, args)
        with (
            jax.enable_x64(False),
            jax.numpy_dtype_promotion("standard"),
            jax.numpy_rank_promotion("allow"),
            jax.default_matmul_precision("highest"),
        ):
            return compiled(*args)

    return island


def _to_32_bits(leaf: Any) -> Any:
    """Floats as strong float32; everything else (keys, counters) as it is."""
    if isinstance(leaf, jax.Array):
        wide = jnp.issubdtype(leaf.dtype, jnp.floating) and (leaf.dtype != jnp.float32 or leaf.weak_type)
        return jax.lax.convert_element_type(leaf, np.dtype(np.float32)) if wide else leaf
    array = np.asarray(leaf)
    return array.astype(np.float32) if array.dtype.kind == "f" else array
