"""Which part of a program computes in float64 and which in float32, whatever the process's own setting says.

``in_float64``: an entry point on the host runs with 64-bit types.
``float64_island``: a traced function computes in float64 also in a process without 64-bit types, and rounds its results
to the caller's precision. The minimum-snap solver is one: float32 breaks the continuity of jerk and snap silently
(docs/decisions/0003-precision.md).
``float32_island``: a traced function computes in float32 also within a program in float64. Plant and controller are.
"""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, TypeVarTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxplan.kept import kept

P = ParamSpec("P")
R = TypeVar("R")
Ts = TypeVarTuple("Ts")


def in_float64(function: Callable[P, R]) -> Callable[P, R]:
    """Run a host entry point with 64-bit JAX types."""

    @functools.wraps(function)
    def scoped(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.enable_x64(True):
            return function(*args, **kwargs)

    return scoped


def float64_island(function: Callable[[*Ts], R]) -> Callable[[*Ts], R]:
    """``function`` of trees of floats, compiled for float64; results have the precision of the arguments.

    It is compiled once per shape, also where the caller does not compile. Where the process has no 64-bit types,
    reverse mode works (the gradient is computed in float64 too) and forward mode does not; where it has them, both do.
    """
    compiled = jax.jit(function)

    def island(*args: *Ts) -> R:
        if jax.config.jax_enable_x64:  # type: ignore[attr-defined]  # jax defines its options at run time
            return _rounded(compiled(*_cast(args, jnp.float64)), _common_precision(args))
        return within_32_bits(*args)

    @jax.custom_vjp
    def within_32_bits(*args: Any) -> R:
        with jax.enable_x64(True):
            return _rounded(compiled(*_cast(args, jnp.float64)), jnp.float32)

    def forward(*args: Any) -> tuple[R, tuple]:
        return within_32_bits(*args), args

    def backward(args: tuple, cotangent: R) -> tuple:
        with jax.enable_x64(True):
            wide = jax.tree.map(lambda leaf: leaf.astype(jnp.float64) if leaf.dtype == jnp.float32 else leaf, cotangent)
            return _cast(pull_back(_cast(args, jnp.float64), wide), jnp.float32)

    @jax.jit
    def pull_back(args: tuple, cotangent: R) -> tuple:
        return jax.vjp(function, *args)[1](cotangent)

    within_32_bits.defvjp(forward, backward)
    return island


def float32_island(function: Callable[..., R]) -> Callable[..., R]:
    """``function`` compiled for float32: floats are rounded on the way in, and 64-bit types do not exist inside.

    It takes the same arguments, of JAX, NumPy or Python and in any precision, with one compilation: all become strong
    types. May be called under ``jit``, ``vmap`` and ``scan`` of a float64 program. Products of matrices keep full
    float32 precision on accelerators. MJX needs JAX's ordinary promotion rules, so these are set as well.
    """
    compiled = kept(function)

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


def _cast(tree: Any, dtype: Any) -> Any:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf).astype(dtype), tree)


def _rounded(tree: R, dtype: Any) -> R:
    """The tree with its floats in another precision."""
    return jax.tree.map(lambda leaf: leaf.astype(dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf, tree)


def _common_precision(tree: Any) -> Any:
    with jax.numpy_dtype_promotion("standard"):
        return jnp.result_type(*jax.tree.leaves(tree))


def _to_32_bits(leaf: Any) -> Any:
    """Floats as strong float32; everything else (keys, counters) as it is."""
    if isinstance(leaf, jax.Array):
        wide = jnp.issubdtype(leaf.dtype, jnp.floating) and (leaf.dtype != jnp.float32 or leaf.weak_type)
        return jax.lax.convert_element_type(leaf, np.dtype(np.float32)) if wide else leaf
    array = np.asarray(leaf)
    return array.astype(np.float32) if array.dtype.kind == "f" else array
