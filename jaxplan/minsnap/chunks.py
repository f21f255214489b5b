"""A large batch solved a part at a time, so that the working set of each part stays in the cache."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array

T = TypeVar("T")

CHUNK = 224
"""Lanes that one core's second-level cache holds, measured on 1 MiB (docs/decisions/0006-minimum-snap.md). Not a
multiple of 64, so that rows do not fall into the same cache sets."""


def in_chunks(function: Callable[[Any], T], arrays: Any, lanes: int) -> T:
    """``function(arrays)``, where the last axis of every array, in and out, is the batch of ``lanes``.

    The last part overlaps the one before it instead of being padded. Not for reverse mode: it would keep every part.
    """
    if lanes <= 2 * CHUNK:
        return function(arrays)
    chunks = -(-lanes // CHUNK)
    size = -(-lanes // chunks)

    def cut(first: Array) -> Any:
        return jax.tree.map(lambda a: jax.lax.dynamic_slice_in_dim(a, first, size, axis=-1), arrays)

    def step(index: Array, results: T) -> T:
        first = jnp.minimum(index * size, lanes - size)
        return jax.tree.map(
            lambda whole, part: jax.lax.dynamic_update_slice_in_dim(whole, part, first, axis=-1),
            results,
            function(cut(first)),
        )

    shapes = jax.eval_shape(lambda: function(cut(jnp.int32(0))))
    return jax.lax.fori_loop(
        0, chunks, step, jax.tree.map(lambda s: jnp.zeros((*s.shape[:-1], lanes), s.dtype), shapes)
    )
