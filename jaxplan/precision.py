"""The borders between float64 and float32, whatever the process's own setting says.

Entry points on the host run with 64-bit types (``in_float64``). The minimum-snap solver computes in float64 even where
it is traced in a process without 64-bit types, and rounds its results to the caller's precision
(``in_float64_inside``): float32 breaks the continuity of jerk and snap silently (docs/decisions/0003-precision.md).
Plant and controller compute in float32 wherever they are called from (``float32_island``).
"""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


def in_float64(function: Callable[P, R]) -> Callable[P, R]:
    """Run a host entry point with 64-bit JAX types, whatever the process's own setting."""

    @functools.wraps(function)
    def scoped(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.enable_x64(True):
            return function(*args, **kwargs)

    return scoped


def is_numpy(arrays: Any) -> bool:
    """Whether every leaf is NumPy or plain Python: a call on the host, outside any transformation."""
    return all(isinstance(a, np.ndarray | np.generic | float | int) for a in jax.tree.leaves(arrays))


def in_float64_inside(function: Callable[..., T]) -> Callable[..., T]:
    """``function`` of arrays, computed in float64; results have the precision of the arguments.

    It is compiled once per shape, also where the caller does not compile. Where the process has no 64-bit types,
    reverse mode works (the gradient is computed in float64 too) and forward mode does not; where it has them, both do.
    """

    compiled = jax.jit(function)

    def computed(*args: Any) -> T:
        if jax.config.jax_enable_x64:  # type: ignore[attr-defined]  # set by name when JAX starts
            return _narrowed(compiled(*_cast(args, jnp.float64)), _precision(args))
        return _bordered(*args)

    @jax.custom_vjp
    def _bordered(*args: Any) -> T:
        with jax.enable_x64(True):
            return _narrowed(compiled(*_cast(args, jnp.float64)), jnp.dtype(jnp.float32))

    def forward(*args: Any) -> tuple[T, tuple]:
        return _bordered(*args), args

    def backward(args: tuple, cotangent: T) -> tuple:
        with jax.enable_x64(True):
            wide = jax.tree.map(lambda c: c.astype(jnp.float64) if c.dtype == jnp.float32 else c, cotangent)
            return _cast(pull_back(_cast(args, jnp.float64), wide), jnp.float32)

    @jax.jit
    def pull_back(args: tuple, cotangent: T) -> tuple:
        return jax.vjp(function, *args)[1](cotangent)

    _bordered.defvjp(forward, backward)
    return computed


def _precision(args: Any) -> Any:
    return jnp.result_type(*jax.tree.leaves(args))


def _cast(tree: Any, dtype: Any) -> Any:
    return jax.tree.map(lambda a: jnp.asarray(a).astype(dtype), tree)


def _narrowed(tree: T, dtype: Any) -> T:
    return jax.tree.map(lambda a: a.astype(dtype) if jnp.issubdtype(a.dtype, jnp.floating) else a, tree)


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
