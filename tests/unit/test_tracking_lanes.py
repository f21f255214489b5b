"""Evaluation entry by entry over lanes, against ``vmap``."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.precision import float32_island
from jaxplan.tracking.lanes import joined, over_lanes, split
from jaxplan.tracking.model import Motion, step_body, vehicle_body
from jaxplan.vehicle.params import load_vehicle

LANES = 16


def compared(function: Callable[..., Any], *args: np.ndarray, rtol: float = 1e-5) -> None:
    """``over_lanes`` and ``vmap`` agree, the lanes being the last axis, bad lanes included."""
    found = jax.jit(lambda *a: joined(over_lanes(function)(*split(a))))(*args)
    expected = jax.vmap(function, in_axes=-1, out_axes=-1)(*args)
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert ours.dtype == theirs.dtype
        np.testing.assert_allclose(ours, theirs, rtol=rtol, atol=rtol)


def some(*shape: int) -> np.ndarray:
    return np.random.default_rng(len(shape)).normal(size=(*shape, LANES)).astype(np.float32)


TABLE = np.arange(12, dtype=np.float32).reshape(4, 3)

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "products": lambda x, m: (m @ x, TABLE @ x, m @ m.T, jnp.einsum("ij,ik,j->k", m, m, x), jnp.cross(x, m[0])),
    "moves": lambda x, m: (m.T[::-1], jnp.concatenate([m, x[None]]), m[np.array([2, 0, 2])], jnp.pad(x, 1), m[1:, ::2]),
    "windows": lambda x, m: (m[np.array([1, 2]), np.array([0, 1])], jnp.tile(x, 2), jax.lax.slice_in_dim(m, 1, 3)),
    "writes": lambda x, m: (
        m.at[1].set(x),
        m.at[np.array([0, 0, 2])].add(m),
        jnp.cumsum(x),
        jnp.zeros(3).at[2].set(x[0]),
    ),
    "sums": lambda x, m: (m.sum(0), m.max(), jnp.all(m > 0, axis=1), jnp.any(x > 0), jnp.prod(x), m.mean()),
    "elements": lambda x, m: (
        jnp.arctan2(x, x[0]),
        jnp.where(x > 0, x, 0.0),
        jnp.clip(x, -1, 1),
        x**3,
        jnp.sqrt(x * x),
    ),
    "constants": lambda x, m: (jnp.arange(3) // 2 + x, jnp.sort(TABLE[0]) * x, jnp.eye(3) @ x, jnp.ones(3)),
    "loops": lambda x, m: jax.lax.fori_loop(0, 3, lambda i, c: c * 0.5 + jnp.sin(x), x),
    "rows": lambda x, m: jax.lax.scan(lambda c, row: (c + row, c @ row), x, m, reverse=True),
    "nested": lambda x, m: {"a": jnp.linalg.norm(x), "b": jax.jit(jnp.outer)(x, x)},
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_equals_vmap(name: str) -> None:
    compared(FUNCTIONS[name], some(3), some(3, 3))


def test_a_bad_lane_leaves_its_neighbours_alone() -> None:
    x = some(3)
    x[1, 5] = np.nan
    compared(FUNCTIONS["products"], x, some(3, 3))


def test_what_depends_on_data_is_refused() -> None:
    with pytest.raises(NotImplementedError, match="constant"):
        compared(lambda x: x[jnp.argmax(x)], some(3))
    with pytest.raises(NotImplementedError, match="while"):
        compared(lambda x: jax.lax.while_loop(lambda c: c[0] < 1.0, lambda c: c + 1.0, x), some(3))


def test_mjx_steps_the_same_over_lanes() -> None:
    body = vehicle_body(load_vehicle())
    quat = some(4)
    motion = Motion(pos=some(3), quat_wxyz=quat / np.linalg.norm(quat, axis=0), vel=some(3), body_rates=some(3))
    step = float32_island(lambda *a: joined(over_lanes(lambda *b: step_body(body, *b))(*split(a))))
    found = step(motion, some(4), some(3), some(3))
    plain = float32_island(jax.vmap(lambda *a: step_body(body, *a), -1, -1))(motion, some(4), some(3), some(3))
    for name, ours, theirs in zip(Motion._fields, found, plain, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-5, err_msg=name)
