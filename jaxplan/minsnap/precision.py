"""float64 inside, whatever the process's JAX flags: the border of the batched solver.

float32 breaks the continuity of jerk and snap silently (docs/decisions/0003-precision.md), so the solver computes in
float64 even where it is traced in a process without 64-bit types, and rounds its results to the caller's precision.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

T = TypeVar("T")


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
        if jax.config.jax_enable_x64:
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
