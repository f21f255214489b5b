"""Roadmaps on disk: read back bit for bit, never out of date, never in the way."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxplan.precision import in_float64
from jaxplan.search import roadmap, store
from jaxplan.search.roadmap import Roadmap, build_roadmap
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World
from jaxplan.world.update import update_world, with_spare_boxes

LIMITS = (0.5, 0.21)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("JAXPLAN_CACHE_DIR", str(tmp_path))
    return tmp_path / "roadmaps"


@pytest.fixture(scope="module")
def world() -> World:
    return with_spare_boxes(load_world("env1"))


load = in_float64(store.load_roadmap)


def same(one: Roadmap, other: Roadmap) -> bool:
    """Bit for bit, types and all."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.asarray(a).dtype == np.asarray(b).dtype and np.array_equal(a, b) for a, b in pairs)


def test_what_is_read_is_what_was_built(folder: Path, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    built = load(world, 0.1, LIMITS)
    assert same(built, in_float64(build_roadmap)(world, 0.1, LIMITS))
    monkeypatch.setattr(store, "build_roadmap", None)
    assert same(load(world, 0.1, LIMITS), built)
    assert len(list(folder.iterdir())) == 1


def test_a_map_whose_roads_take_long_is_announced_once(
    folder: Path, world: World, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    load(world, 0.2, LIMITS[:1])
    assert not caplog.messages
    monkeypatch.setattr(roadmap, "MANY", 10)
    load(world, 0.1, LIMITS[:1])
    assert len(caplog.messages) == 1
    assert "places to fly around at cells of 0.1 m: their roads take minutes, once" in caplog.messages[0]
    load(world, 0.1, LIMITS[:1])
    assert len(caplog.messages) == 1


def test_another_world_limit_or_resolution_is_another_file(folder: Path, world: World) -> None:
    changed = update_world(world, add_box=([0.0, 0.0, 0.5], [0.4, 0.4, 1.0])).world
    narrower = dataclasses.replace(world, keep_in=np.asarray(world.keep_in) + 0.1)
    asked = [(world, 0.1, LIMITS), (world, 0.2, LIMITS), (world, 0.1, LIMITS[:1])]
    asked += [(other, 0.1, LIMITS) for other in (changed, narrower)]
    for number, arguments in enumerate(asked):
        load(*arguments)
        assert len(list(folder.iterdir())) == number + 1


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 not a zip", b"half"])
def test_a_damaged_file_is_made_anew(folder: Path, world: World, damage: bytes) -> None:
    built = load(world, 0.1, LIMITS)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2] if damage == b"half" else damage)
    assert same(load(world, 0.1, LIMITS), built)
    assert file.stat().st_size == len(whole)


def test_a_folder_that_cannot_be_written_does_no_harm(
    tmp_path: Path, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("JAXPLAN_CACHE_DIR", str(tmp_path / "file"))
    assert len(load(world, 0.1, LIMITS).levels) == 2


def test_nothing_is_stored_where_that_is_wanted(tmp_path: Path, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JAXPLAN_CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    load(world, 0.1, LIMITS)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.delenv("JAXPLAN_CACHE_DIR")
    assert store.cache_folder() == tmp_path / "jaxplan" / "roadmaps"


def test_the_oldest_files_go(folder: Path, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    load(world, 0.1, LIMITS)
    (first,) = folder.iterdir()
    monkeypatch.setattr(store, "KEPT", int(1.5 * first.stat().st_size))
    load(world, 0.1, (0.5, 0.22))
    assert len(list(folder.iterdir())) == 1
    assert not first.exists()
