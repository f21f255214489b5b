"""Running a function on a batch in pieces, for four different reasons.

``in_chunks`` (traced): the working set of a chunk stays in the cache of one core.
``in_threads`` (host): the parts of a large batch share the cores.
``side_by_side`` (host): code that holds no lock of Python's does what is independent on all cores.
``at_fixed_width`` (host): a function compiled for one width serves any number of members; a CPU takes as long for a
batch of 400 as for seven of 64, so nothing is lost.

The *width* of a batch is how many problems it holds, *indices* say which; the batch is the last axis of every array.
"""

import functools
import os
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

T = TypeVar("T")
Indices = Int[np.ndarray, "n"]

CHUNK_WIDTH = 224
"""What one core's second-level cache holds, measured on 1 MiB (docs/decisions/0006-minimum-snap.md). Not a multiple of
64, so that rows do not fall into the same cache sets."""

THREAD_WIDTH = 820
"""A whole solve on the host, several of which share the cores: measured for 4096 problems of 14 waypoints, where widths
of 205 to 1400 take 5 to 40 % longer. XLA alone keeps 1.4 of 2 cores busy."""

CORES = min(os.cpu_count() or 1, 4)
"""On which ``side_by_side`` works (at most 4: arbitrary)."""


def in_chunks(function: Callable[[Any], T], tree: Any, width: int) -> T:
    """``function(tree)`` of a batch of ``width``, a wide one in chunks of at most ``CHUNK_WIDTH``, one after the other.

    Not for reverse mode, which would keep every chunk.
    """
    chunks, size = _division(width, CHUNK_WIDTH)
    if chunks == 1:
        return function(tree)

    def chunk(first: Array) -> Any:
        return jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, first, size, axis=-1), tree)

    def step(index: Array, results: T) -> T:
        first = jnp.minimum(index * size, width - size)
        return jax.tree.map(
            lambda whole, part: jax.lax.dynamic_update_slice_in_dim(whole, part, first, axis=-1),
            results,
            function(chunk(first)),
        )

    shapes = jax.eval_shape(lambda: function(chunk(jnp.int32(0))))
    blank = jax.tree.map(lambda shape: jnp.zeros((*shape.shape[:-1], width), shape.dtype), shapes)
    return jax.lax.fori_loop(0, chunks, step, blank)


def in_threads(function: Callable[[Any], T], tree: Any, width: int) -> T:
    """``function(tree)`` as NumPy arrays, a batch of more than twice ``THREAD_WIDTH`` in parts on all cores.

    One shape is compiled. 64-bit JAX types are on for ``function``, whatever the process's setting.
    """
    parts, size = _division(width, THREAD_WIDTH)
    whole: list[T] = []
    allocating = threading.Lock()

    def solve(first: int) -> T:
        with jax.enable_x64(True):
            part = jax.tree.map(lambda leaf: leaf[..., first : first + size], tree)
            return jax.tree.map(np.asarray, function(part))

    def solve_into_whole(first: int) -> None:
        part = solve(first)
        with allocating:
            if not whole:
                whole.append(jax.tree.map(lambda leaf: np.empty((*leaf.shape[:-1], width), leaf.dtype), part))
        jax.tree.map(lambda to, leaf: np.copyto(to[..., first : first + size], leaf), whole[0], part)

    if parts == 1:
        return solve(0)
    with ThreadPoolExecutor(min(parts, os.cpu_count() or 1)) as pool:
        list(pool.map(solve_into_whole, [min(part * size, width - size) for part in range(parts)]))
    return whole[0]


def at_fixed_width(function: Callable[[Indices], Any], indices: Indices, width: int, threads: int = 1) -> Any:
    """What ``function`` gives for at least one of its members, called with ``width`` of them at a time, in NumPy.

    At most ``threads`` calls run at once; JAX's settings that belong to a thread (64-bit types among them) hold in the
    calling one alone.
    """
    cuts = [indices[begin : begin + width] for begin in range(0, len(indices), width)]
    if threads == 1 or len(cuts) == 1:
        return join([(function(fill(some, width)), len(some)) for some in cuts])
    with ThreadPoolExecutor(min(threads, len(cuts))) as pool:
        parts = pool.map(lambda some: function(fill(some, width)), cuts)
        return join([(part, len(some)) for part, some in zip(parts, cuts, strict=True)])


def side_by_side(function: Callable[[Any], T], parts: Iterable[Any]) -> list[T]:
    """``function``, which is compiled for the host, of each of ``parts``, in their order, on several cores."""
    return list(_pool().map(function, parts))


def beside(function: Callable[[], T]) -> Future[T]:
    """``function`` on another core while the caller goes on. It must not call ``side_by_side``."""
    return _pool().submit(function)


def meanwhile(function: Callable[[], T]) -> Callable[[], T]:
    """``function`` on another core while the caller goes on, who asks for the result by calling what is returned.

    On a busy machine, where it has not begun by then, the caller does it.
    """
    future = beside(function)

    def result() -> T:
        return function() if future.cancel() else future.result()

    return result


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(CORES, thread_name_prefix="jaxplan-side")


def fill(indices: Indices, width: int) -> Int[np.ndarray, "{width}"]:
    """The indices with the first one repeated at the end until there are ``width``."""
    return np.concatenate([indices, np.full(width - len(indices), indices[0])])


def pick(tree: Any, indices: Indices) -> Any:
    """Some members of a batch, in NumPy."""
    leaves, structure = jax.tree.flatten(tree)
    return jax.tree.unflatten(structure, [np.take(np.asarray(leaf), indices, axis=-1) for leaf in leaves])


def join(parts: Sequence[tuple[Any, int]]) -> Any:
    """One batch of the first so many members of each part, side by side in NumPy: the inverse of ``fill``."""
    counts = [count for _, count in parts]
    leaves, structures = zip(*(jax.tree.flatten(tree) for tree, _ in parts), strict=True)
    if any(structure != structures[0] for structure in structures):
        raise ValueError(f"join: parts are {structures}, want the same structure of all")

    def joined(pieces: Sequence[Any]) -> np.ndarray:
        cut = [np.asarray(piece)[..., :count] for piece, count in zip(pieces, counts, strict=True)]
        return cut[0] if len(cut) == 1 else np.concatenate(cut, axis=-1)

    return jax.tree.unflatten(structures[0], [joined(pieces) for pieces in zip(*leaves, strict=True)])


def _division(width: int, wanted: int) -> tuple[int, int]:
    """How many pieces of about the ``wanted`` width, and their width: the last overlaps the one before it, unpadded."""
    pieces = -(-width // wanted) if width > 2 * wanted else 1
    return pieces, -(-width // pieces)
