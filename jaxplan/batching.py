"""Batches of any length in programs of one fixed width, and large ones a part at a time.

A CPU takes as long for 400 lanes at once as for seven times 64, and one width is compiled once. Parts are small enough
that the working set of each stays in the cache.
"""

import functools
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

P = ParamSpec("P")
T = TypeVar("T")

CHUNK = 224
"""Lanes that one core's second-level cache holds, measured on 1 MiB (docs/decisions/0006-minimum-snap.md). Not a
multiple of 64, so that rows do not fall into the same cache sets."""

PART = 820
"""Lanes of a whole solve on the host, several of which share the cores: measured for 4096 problems of 14 waypoints,
where 205 to 1400 lanes take 5 to 40 % longer. XLA alone keeps 1.4 of 2 cores busy."""


def batch_last(function: Callable[P, T]) -> Callable[P, T]:
    """Mark a kernel whose arrays all have the batch as their last axis.

    There a vector over the batch meets arrays of any rank, from the right, as JAX broadcasts by default. A process may
    forbid that everywhere else (``jax_numpy_rank_promotion``), to find mistakes, as our tests do.
    """

    @functools.wraps(function)
    def marked(*args: P.args, **kwargs: P.kwargs) -> T:
        with jax.numpy_rank_promotion("allow"):
            return function(*args, **kwargs)

    return marked


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


def in_parts(function: Callable[[Any], T], arrays: Any, lanes: int) -> T:
    """``function(arrays)`` as NumPy arrays; a large batch is the last axis of every array, solved on all cores (host).

    All parts have one size, so that one shape is compiled; the last one overlaps the one before it. 64-bit JAX types
    are on for ``function``, whatever the process's setting.
    """
    parts = -(-lanes // PART) if lanes > 2 * PART else 1
    size = -(-lanes // parts)
    whole: list[T] = []
    allocating = threading.Lock()

    def solve(first: int) -> T:
        with jax.enable_x64(True):
            return jax.tree.map(np.asarray, function(jax.tree.map(lambda a: a[..., first : first + size], arrays)))

    def solve_into_whole(first: int) -> None:
        part = solve(first)
        with allocating:
            if not whole:
                whole.append(jax.tree.map(lambda a: np.empty((*a.shape[:-1], lanes), a.dtype), part))
        jax.tree.map(lambda to, a: np.copyto(to[..., first : first + size], a), whole[0], part)

    if parts == 1:
        return solve(0)
    with ThreadPoolExecutor(min(parts, os.cpu_count() or 1)) as pool:
        list(pool.map(solve_into_whole, [min(part * size, lanes - size) for part in range(parts)]))
    return whole[0]


Lanes = Int[np.ndarray, "n"]


def in_portions(program: Callable[[Lanes], Any], lanes: Lanes, width: int, threads: int = 1) -> Any:
    """What ``program`` gives for at least one lane, called with ``width`` of them at a time, as NumPy arrays.

    The last call is filled up by repeating a lane; leaves have the batch last. At most ``threads`` calls run at once;
    JAX's settings that belong to a thread (64-bit types among them) hold in the calling one alone.
    """
    cuts = [lanes[begin : begin + width] for begin in range(0, len(lanes), width)]
    if threads == 1 or len(cuts) == 1:
        return join([(program(fill(some, width)), len(some)) for some in cuts])
    with ThreadPoolExecutor(min(threads, len(cuts))) as pool:
        parts = pool.map(lambda some: program(fill(some, width)), cuts)
        return join([(part, len(some)) for part, some in zip(parts, cuts, strict=True)])


def fill(lanes: Lanes, width: int) -> Lanes:
    """Lanes repeated at the end until there are ``width``."""
    return np.concatenate([lanes, np.full(width - len(lanes), lanes[0])])


def pick(tree: Any, lanes: Lanes) -> Any:
    """Some lanes of a tree of arrays whose last axis is the batch."""
    return jax.tree.map(lambda leaf: np.take(np.asarray(leaf), lanes, axis=-1), tree)


def join(parts: Sequence[tuple[Any, int]]) -> Any:
    """Trees of arrays, of each the first lanes along the last axis, side by side in NumPy."""
    trees = [jax.tree.map(lambda leaf, count=count: np.asarray(leaf)[..., :count], tree) for tree, count in parts]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1), *trees)
