"""Training of the network that foretells flights: its examples, and that it learns, goes on, and repeats itself."""

import dataclasses
import json

import jax
import numpy as np
import pytest

from jaxplan.errors import FileError, InputError
from jaxplan.prediction.mdn.network import NetworkConfig
from jaxplan.prediction.mdn.view import OBSERVATIONS, STEPS
from jaxplan.training.flights import examples
from jaxplan.training.flights.examples import (
    ExamplesConfig,
    examples_digest,
    load_examples,
    make_examples,
    recorded_examples,
)
from jaxplan.training.flights.run import MdnConfig, train_mdn
from tolerances import relative

EVERY_SECOND = 2
"""Of the shards is held out here."""
FEW = ExamplesConfig(windows=12)
QUICK = MdnConfig(
    network=NetworkConfig(width=24, layers=2, components=2, matrices=2),
    steps=60,
    batch=64,
    evaluate_every=30,
)


@pytest.fixture(scope="module", autouse=True)
def small_shards():
    """One to train with and one that is held out, with a room of each kind, are enough."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {"HELD_OUT": EVERY_SECOND, "ROOMS": 3, "STORED": 1, "OPEN": 2}.items():
            patch.setattr(examples, name, value)
        yield


@pytest.fixture(scope="module")
def few(small_shards):
    return dataclasses.replace(FEW, shards=EVERY_SECOND)


@pytest.fixture(scope="module")
def quick(few):
    return dataclasses.replace(QUICK, examples=few)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, few):
    """Examples of few windows, made once."""
    folder = tmp_path_factory.mktemp("run")
    make_examples(folder / "examples", few, 0, print)
    return folder


def linked(folder, tmp_path):
    """A run of one's own with the same examples."""
    (tmp_path / "examples").symlink_to(folder / "examples")
    return tmp_path


def test_examples_are_flights_as_targets_see_them(folder):
    """Ahead of a target lies what follows, in half of the windows without noise to a few centimetres."""
    training, held_out = (load_examples(folder / "examples", held_out=which) for which in (False, True))
    per_shard = 2 * (1 + 2 + 4) * FEW.windows
    assert len(held_out.future) == per_shard
    assert len(training.future) == per_shard
    assert training.future.shape[1:] == (STEPS, 3)
    assert np.median(training.future[:, 3, 0]) > 0.1
    assert set(np.unique(training.view.interval)) == {np.float32(0.1), np.float32(0.2)}
    assert 0.5 < (training.view.seen.sum(axis=1) == OBSERVATIONS - 1).mean() < 0.75
    assert (training.view.room == 2.0).all(axis=1).mean() >= 4 / 7  # open space


def test_examples_that_are_there_are_not_made_again(folder, few):
    path = sorted((folder / "examples").glob("flights-*.npz"))[1]
    kept, others = path.read_bytes(), sorted((folder / "examples").glob("*"))
    whole = examples_digest(folder / "examples")
    path.unlink()
    assert examples_digest(folder / "examples") != whole
    said = []
    make_examples(folder / "examples", few, 0, said.append)
    assert said == [f"shard 2 of 2: {2 * 7 * few.windows} flights"]
    assert path.read_bytes() == kept
    assert examples_digest(folder / "examples") == whole
    assert sorted((folder / "examples").glob("*")) == others
    with pytest.raises(InputError, match="another configuration"):
        make_examples(folder / "examples", dataclasses.replace(few, seed=1), 0, said.append)


def test_missing_examples_are_named(tmp_path):
    with pytest.raises(FileError, match="has no training flights"):
        load_examples(tmp_path, held_out=False)


def test_recorded_flights_are_a_tenth():
    times = 0.1 * np.arange(120)
    flight = np.stack([times, np.sin(times), 0.0 * times], axis=-1)
    found = recorded_examples([flight, flight[:10]], 900, 0)
    assert abs(len(found.future) - round(examples.RECORDED / 0.9 * 900)) <= 1
    assert set(np.unique(found.view.interval)) == {np.float32(0.1), np.float32(0.2)}
    with pytest.raises(InputError, match="none is as long as 2.9 s"):
        recorded_examples([flight[:20]], 900, 0)


def test_a_run_learns_goes_on_and_repeats_itself(folder, quick, tmp_path):
    """What was cut off at half way ends as what was not."""
    (tmp_path / "whole").mkdir()
    whole, score = train_mdn(linked(folder, tmp_path / "whole"), quick, report=lambda line: None)
    lines = [json.loads(line) for line in (tmp_path / "whole" / "metrics.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [30, 60]
    assert lines[1]["train_loss"] < lines[0]["train_loss"] - 0.5
    assert score.nll == pytest.approx(min(line["nll"] for line in lines), **relative("formula", np.float32))

    class CutOff(Exception):
        pass

    def cut(line):
        if line.startswith("step 30"):
            raise CutOff

    (tmp_path / "cut").mkdir()
    part = linked(folder, tmp_path / "cut")
    with pytest.raises(CutOff):
        train_mdn(part, quick, report=cut)
    again, _ = train_mdn(part, quick, report=lambda line: None)
    for ours, theirs in zip(jax.tree.leaves(again.parameters), jax.tree.leaves(whole.parameters), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    with pytest.raises(InputError, match="another configuration"):
        train_mdn(part, dataclasses.replace(quick, batch=32), report=lambda line: None)
    with pytest.raises(InputError, match="another configuration"):  # other examples have other curves
        more = dataclasses.replace(quick.examples, shards=2 * EVERY_SECOND)
        train_mdn(part, dataclasses.replace(quick, examples=more), report=lambda line: None)
