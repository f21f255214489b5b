"""Programs whose traces are kept: the same results, found by the next process, and never those of something else."""

import dataclasses
import functools
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan import kept as module
from jaxplan import programs
from jaxplan.closure import Undecided, closure_digest
from jaxplan.kept import kept
from jaxplan.spline import FlatState, hover
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.reach import reach

CHILD = """
import json, sys
from jaxplan import programs
said = programs.use()
import jax, numpy as np
from jaxplan import kept
traced = []
trace = kept._trace
kept._trace = lambda *args: (traced.append(1), trace(*args))[1]
from jaxplan.spline import hover
from jaxplan.tracking.rollout import build_plant
from jaxplan.vehicle.load import load_vehicle
plant = build_plant(load_vehicle(sys.argv[1]), noise=False)
place = hover((0.0, 0.0, 1.0))
rows = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf, float)[None], 9, axis=0), place)
state, log = plant.fly(plant.reset(place, jax.random.key(0)), rows)
many = jax.vmap(lambda key: plant.reset(place, key).pos)(jax.random.split(jax.random.key(1), 3))
print(json.dumps([said, len(traced), np.asarray(log.pos).tobytes().hex(), type(log).__name__, many.shape]))
"""


def started(root: Path, vehicle: str = "mfrl") -> tuple[str | None, int, str, str, list[int]]:
    """What a new process was told, how much it traced to keep it, and what it computed."""
    ours = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "TF_CPP"))}
    ours["JAXPLAN_CACHE_DIR"] = str(root)
    command = [sys.executable, "-c", CHILD, vehicle]
    return tuple(json.loads(subprocess.run(command, env=ours, capture_output=True, text=True, check=True).stdout))


def test_the_next_process_traces_nothing_and_computes_the_same(tmp_path: Path) -> None:
    said, traced, found, kind, shape = started(tmp_path)
    assert (said, traced, kind, shape) == (None, 2, "FlightLog", [3, 3])
    assert started(tmp_path) == (None, 0, found, kind, shape)
    assert started(tmp_path, "cf21")[1:3] != (0, found)  # another vehicle is another program
    traces = sorted(tmp_path.rglob("*-traced"))
    assert len(traces) == 4
    for path in traces:
        path.write_bytes(path.read_bytes()[:-1])
    said, traced, again, *_ = started(tmp_path)
    assert said is not None
    assert said.startswith("cache: 4 damaged")
    assert (traced, again) == (2, found)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(programs, "folder_in_use", lambda: tmp_path)
    return tmp_path


def bound(scale: float) -> Callable[[FlatState, jax.Array], tuple[FlatState, dict[str, jax.Array | None]]]:
    def function(state: FlatState, x: jax.Array) -> tuple[FlatState, dict[str, jax.Array | None]]:
        return state, {"far": reach(load_vehicle(), jnp.float64(scale), x), "none": None}

    function.__module__ = "jaxplan.made_up"  # as if it were ours
    return function


def test_results_are_those_of_jit_whatever_their_tree(folder: Path) -> None:
    with jax.enable_x64(True):
        state, x = hover((1.0, 2.0, 3.0)), np.linspace(0.0, 2.0, 5)
        expected = jax.jit(bound(3.0))(state, x)
        for _ in range(2):
            found = kept(bound(3.0))(state, x)
            assert jax.tree.structure(found) == jax.tree.structure(expected)
            assert all(np.array_equal(*pair) for pair in zip(*map(jax.tree.leaves, (found, expected)), strict=True))
            assert not any(leaf.committed for leaf in jax.tree.leaves(found))
        assert len(list(folder.iterdir())) == 1
        kept(bound(4.0))(state, x)
        kept(bound(3.0))(state, x[:3])
        assert len(list(folder.iterdir())) == 3


def test_what_another_version_wrote_is_traced_anew(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with jax.enable_x64(True):
        state, x = hover((1.0, 2.0, 3.0)), np.linspace(0.0, 2.0, 5)
        expected = kept(bound(3.0))(state, x)[1]["far"]
        (path,) = folder.iterdir()
        key = path.name.removesuffix("-traced")
        for content in (b"", b"{}\n", b'["os:system", [], []]\nx', b'["builtins:tuple", null, [0]]\nnothing of JAX'):
            programs.write_traced(folder, key, content)
            assert np.array_equal(kept(bound(3.0))(state, x)[1]["far"], expected)
        monkeypatch.setattr(module, "_versions", lambda: "others")
        kept(bound(3.0))(state, x)
        assert len(list(folder.iterdir())) == 2


def test_it_composes(folder: Path) -> None:
    double = kept(_doubled)
    values = jnp.arange(3.0)
    assert np.array_equal(jax.vmap(double)(values), 2.0 * values)
    assert np.array_equal(jax.jit(double)(values), 2.0 * values)
    assert float(jax.grad(double)(1.0)) == 2.0
    assert list(folder.iterdir()) == []


def _doubled(x: jax.Array) -> jax.Array:
    return 2.0 * x


def test_what_cannot_be_judged_is_not_kept(folder: Path) -> None:
    assert float(kept(_doubled)(1.0)) == 2.0  # a test's function is none of ours
    assert list(folder.iterdir()) == []
    with pytest.raises(ZeroDivisionError):
        kept(lambda x: x * (1 // 0))(1.0)


def test_static_arguments_are_part_of_the_key(folder: Path) -> None:
    def power(by: int, x: jax.Array) -> jax.Array:
        return x**by

    power.__module__ = "jaxplan.made_up"
    function = kept(power, static=1)
    assert [float(function(by, 3.0)) for by in (2, 3, 2)] == [9.0, 27.0, 9.0]
    assert len(list(folder.iterdir())) == 2


def test_digests_tell_what_differs() -> None:
    def adding(amount: object) -> Callable:
        return functools.partial(np.add, amount)

    base = closure_digest(adding(np.arange(3.0)))
    assert closure_digest(adding(np.arange(3.0))) == base
    others = [
        np.arange(3.0) + 1e-15,
        np.arange(3),
        np.arange(3.0)[None],
        [0.0, 1.0, 2.0],
        (0.0, 1.0, 2.0),
        "0",
        0,
        True,
    ]
    digests = {closure_digest(adding(other)) for other in others}
    assert len(digests | {base}) == len(others) + 1
    assert closure_digest(load_vehicle("mfrl")) != closure_digest(load_vehicle("cf21"))
    assert closure_digest(bound(1.0)) != closure_digest(bound(2.0))


@dataclasses.dataclass
class Unknown:
    what: object


@pytest.mark.parametrize("value", [object(), Unknown(1), _doubled, np.array([object()]), lambda: None, iter(())])
def test_the_unknown_has_no_digest(value: object) -> None:
    with pytest.raises(Undecided):
        closure_digest(value)
