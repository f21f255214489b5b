"""Records: frozen keyword-only pytrees whose checks run for people and not for tracers."""

import dataclasses
import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

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


TRACK = """
from jaxtyping import Array, Float

from jaxplan.records import record, static


@record
class Track:
    times: Float[Array, "n"]
    positions: Float[Array, "n 3"]
    name: str = static(default="track")
"""

CHECKED = """
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import TypeCheckError, install_import_hook

with install_import_hook("track", "beartype.beartype"):
    from track import Track
from jaxplan.records import replace

good = Track(times=jnp.zeros(4), positions=jnp.zeros((4, 3)))
moved = replace(good, positions=jnp.ones((4, 3)), name="moved")
assert moved.name == "moved" and float(moved.positions.sum()) == 12.0


def refused(build):
    try:
        build()
    except TypeCheckError:
        return True
    return False


assert refused(lambda: Track(times=jnp.zeros(4), positions=jnp.zeros((4, 2))))
assert refused(lambda: Track(times=jnp.zeros(4), positions=jnp.zeros((5, 3)))), "one n for all fields"
assert refused(lambda: Track(times=jnp.zeros(4, int), positions=jnp.zeros((4, 3))))
assert refused(lambda: Track(times=np.zeros(4), positions=jnp.zeros((4, 3))))
assert refused(lambda: Track(times=jnp.zeros(4), positions=jnp.zeros((4, 3)), name=3))
assert refused(lambda: replace(good, times=jnp.zeros(5)))
assert refused(lambda: jax.jit(lambda t: Track(times=t, positions=t))(jnp.zeros(4))), "a person's, under jit too"

# JAX rebuilds records with more axes, of other types, of anything at all.
batched = jax.vmap(lambda shift: replace(good, positions=good.positions + shift))(jnp.arange(5.0))
assert batched.positions.shape == (5, 4, 3)
assert jax.tree.map(np.asarray, good).times.dtype == np.float32
assert jax.tree.map(lambda leaf: "anything", good).times == "anything"
assert jax.eval_shape(lambda t: t, batched).times.shape == (5, 4)
stacked = jax.lax.scan(lambda carry, _: (carry, carry), good, length=2)[1]
assert stacked.times.shape == (2, 4)
"""


def test_fields_are_checked_where_a_person_builds_a_record_and_not_where_jax_does(
    tmp_path: Path, repository: Path
) -> None:
    """In a process of its own: the import hook checks what is imported after it."""
    (tmp_path / "track.py").write_text(TRACK)
    (tmp_path / "checked.py").write_text(CHECKED)
    search = {"PYTHONPATH": f"{repository}:{tmp_path}", "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, "checked.py"], cwd=tmp_path, env=search, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


MYPY = """
[mypy]
ignore_missing_imports = True
disable_error_code = name-defined, valid-type, syntax

[mypy-jax.*]
follow_imports = skip
"""

MISUSED = """
import jax.numpy as jnp

from track import Track

good = Track(times=jnp.zeros(4), positions=jnp.zeros((4, 3)))
Track(jnp.zeros(4), jnp.zeros((4, 3)))
Track(times=jnp.zeros(4))
Track(times=jnp.zeros(4), positions=jnp.zeros((4, 3)), name=3)
good.times = jnp.ones(4)
"""


@pytest.mark.skipif(importlib.util.find_spec("mypy") is None, reason="mypy is not installed")
def test_type_checkers_see_frozen_keyword_only_fields(tmp_path: Path, repository: Path) -> None:
    """On records.py alone: the whole package takes mypy half a minute."""
    (tmp_path / "jaxplan").mkdir()
    (tmp_path / "jaxplan" / "__init__.py").touch()
    shutil.copy(repository / "jaxplan" / "records.py", tmp_path / "jaxplan" / "records.py")
    (tmp_path / "track.py").write_text(TRACK)
    (tmp_path / "misused.py").write_text(MISUSED)
    (tmp_path / "mypy.ini").write_text(MYPY)
    command = [sys.executable, "-m", "mypy", "--config-file", "mypy.ini", "misused.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    complaints = [line for line in done.stdout.splitlines() if "error:" in line]
    assert [int(line.split(":")[1]) for line in complaints] == [7, 8, 9, 10], done.stdout + done.stderr
    for line, said in zip(complaints, ("positional", '"positions"', '"name"', "read-only"), strict=True):
        assert said in line
