"""Batches of any length in programs of one fixed width (host).

A CPU takes as long for 400 lanes at once as for seven times 64, and one width is compiled once.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

Lanes = Int[np.ndarray, "n"]


def in_portions(program: Callable[[Lanes], Any], lanes: Lanes, width: int) -> Any:
    """What ``program`` gives for at least one lane, called with ``width`` of them at a time, as NumPy arrays.

    The last call is filled up by repeating a lane; leaves have the batch last.
    """
    cuts = [lanes[begin : begin + width] for begin in range(0, len(lanes), width)]
    return join([(program(fill(some, width)), len(some)) for some in cuts])


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
