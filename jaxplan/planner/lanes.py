"""Arrays of changing length in programs of fixed shape (host)."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from jaxplan.errors import InputError


def bucket_for(count: int, buckets: tuple[int, ...]) -> int:
    """The smallest compiled size that holds ``count`` candidates."""
    for bucket in buckets:
        if count <= bucket:
            return bucket
    raise InputError(f"planner: {count} candidates, want at most {buckets[-1]}; raise PlannerConfig.buckets")


def round_sizes(buckets: tuple[int, ...]) -> tuple[int, int]:
    """Candidates of the first round of an ordered evaluation, and of the others."""
    return buckets[0], buckets[min(1, len(buckets) - 1)]


def pad(values: np.ndarray, length: int, fill: Any) -> np.ndarray:
    """``values`` followed by rows of ``fill`` up to ``length``."""
    padding = np.broadcast_to(np.asarray(fill, dtype=values.dtype), (length - len(values), *values.shape[1:]))
    return np.concatenate([values, padding])


def scatter(values: np.ndarray, places: Int[np.ndarray, "n"], length: int, fill: float) -> np.ndarray:
    """The first values put at the ``places`` of an array of ``fill``."""
    full = np.full(length, fill, dtype=np.result_type(values, type(fill)))
    full[places] = values[: len(places)]
    return full


def join_lanes(parts: Sequence[tuple[Any, int]]) -> Any:
    """Trees of arrays, of each the first lanes along the last axis, side by side in NumPy."""
    trees = [jax.tree.map(lambda leaf, count=count: np.asarray(leaf)[..., :count], tree) for tree, count in parts]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1), *trees)
