"""Records: frozen keyword-only pytrees whose checks run for people and not for tracers."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.records import record, replace, static


@record
class Ball:
    center: jax.Array
    radius: jax.Array
    name: str = static(default="ball")

    def __post_init__(self) -> None:
        if not float(self.radius) > 0.0:
            raise ValueError("radius")


def ball(**changes: object) -> Ball:
    return Ball(**{"center": jnp.zeros(3), "radius": jnp.float32(2.0), **changes})


def test_a_record_is_frozen_and_keyword_only() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        ball().radius = 3.0  # type: ignore[misc]
    with pytest.raises(TypeError):
        Ball(jnp.zeros(3), jnp.float32(1.0))  # type: ignore[misc]


def test_checks_run_for_people() -> None:
    with pytest.raises(ValueError, match="radius"):
        ball(radius=jnp.float32(-1.0))
    with pytest.raises(ValueError, match="radius"):
        replace(ball(), radius=jnp.float32(float("nan")))


def test_checks_do_not_run_under_jit_vmap_or_grad() -> None:
    scaled = jax.jit(lambda b: jax.tree.map(lambda leaf: -leaf, b))(ball())
    assert float(scaled.radius) == -2.0
    batch = jax.vmap(lambda r: ball().__class__.__name__ and r)(jnp.arange(3.0))
    assert batch.shape == (3,)
    gradient = jax.grad(lambda b: b.radius**2 + b.center.sum())(ball())
    assert float(gradient.radius) == 4.0
    np.testing.assert_array_equal(gradient.center, np.ones(3))


def test_static_fields_are_structure() -> None:
    leaves, tree = jax.tree.flatten(ball(name="a"))
    assert len(leaves) == 2
    assert tree != jax.tree.structure(ball(name="b"))
    assert jax.tree.unflatten(tree, leaves).name == "a"
    traces = []
    traced = jax.jit(lambda b: traces.append(b.name) or b.radius)
    for name in ("a", "b", "a"):
        traced(ball(name=name))
    assert traces == ["a", "b"]


def test_paths_are_named() -> None:
    paths = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_flatten_with_path(ball())[0]]
    assert paths == [".center", ".radius"]
