"""Batches of closed loops on one device, and the table that is made of them."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments import on_device, table1
from experiments.closed_loop import Defender, EpisodeConfig
from jaxplan.cli import run
from jaxplan.compilation import compilations
from jaxplan.device import episodes
from jaxplan.device.runner import Flight, Outcome, Runner
from jaxplan.errors import InputError
from jaxplan.io.targets import load_target
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.replanner import ReplannerConfig
from tolerances import assert_close

DEFENDER = Defender("mfrl")
CERTAIN = ("none", "ground-truth", "constant-velocity")


def flights(count: int) -> list[Flight]:
    speeds, departures = np.linspace(0.5, 5.0, count), np.linspace(0.5, 2.0, count)
    names = [f"env1-{1 + number:02d}" for number in range(count)]
    return [
        Flight(load_target(name, world="env1", speed=float(speed)), float(departure), number, 1 + number % 2)
        for number, (name, speed, departure) in enumerate(zip(names, speeds, departures, strict=True))
    ]


@pytest.fixture(scope="module", autouse=True)
def on_the_cpu() -> Iterator[None]:
    """As ``fly_together`` does: a program compiled for one default device is not that for another."""
    with jax.default_device(on_device.device_named("cpu")):
        yield


@pytest.fixture(scope="module")
def runner() -> Runner:
    return on_device.crew(DEFENDER, CERTAIN, 4, "cpu").runner


@pytest.fixture(scope="module")
def outcomes(runner: Runner) -> list[Outcome]:
    return runner.fly(on_device.scene(DEFENDER, "env1"), flights(6))


def test_targets_are_met_by_plans_that_were_committed(outcomes: list[Outcome]) -> None:
    assert [outcome.outcome for outcome in outcomes] == ["intercepted"] * 6
    radius = 0.18
    for flight, outcome in zip(flights(6), outcomes, strict=True):
        assert outcome.plans >= 1
        assert outcome.cycles >= outcome.plans
        assert outcome.end_time > flight.departure
        assert outcome.min_distance < 0.4
        assert outcome.max_position_error < 0.4
        assert outcome.min_clearance > radius


def test_a_plan_takes_over_within_a_period() -> None:
    before, after = (episodes._hold(jnp.full(3, place)) for place in (1.0, 2.0))
    spliced = episodes._spliced(before, after, jnp.int32(10), jnp.arange(20))
    np.testing.assert_array_equal(spliced.pos, np.where(np.arange(20) < 10, 1.0, 2.0)[:, None] * np.ones(3))
    assert not np.asarray(spliced.derivatives[:, 1:]).any()
    config = episodes.LoopConfig(PredictionConfig(), 0.0, ReplannerConfig(period=0.1, latency=0.05))
    assert (config.period, config.latency) == (20, 10)
    with pytest.raises(InputError, match="latency"):
        episodes.LoopConfig(PredictionConfig(), 0.0, ReplannerConfig(period=0.1, latency=0.2))


@pytest.mark.slow
def test_an_episode_depends_on_nothing_but_itself(runner: Runner, outcomes: list[Outcome]) -> None:
    again = runner.fly(on_device.scene(DEFENDER, "env1"), flights(6)[::-1])[::-1]
    for one, other in zip(outcomes, again, strict=True):
        assert (one.outcome, one.cycles, one.plans) == (other.outcome, other.cycles, other.plans)
        assert_close(one[1:6], other[1:6], "exact", np.float32)  # the plant is in float32


def test_one_program_serves_another_room(runner: Runner, outcomes: list[Outcome]) -> None:
    target = load_target(None, world="env2", speed=1.0)
    scene, known = on_device.scene(DEFENDER, "env2"), compilations()
    found = runner.fly(scene, [Flight(target, 0.5, 0, 1)])
    assert found[0].outcome == "intercepted"
    assert compilations() == known


def test_no_flights_and_no_width_are_refused(runner: Runner) -> None:
    with pytest.raises(InputError, match="at least one"):
        runner.fly(on_device.scene(DEFENDER, "env1"), [])
    with pytest.raises(InputError, match="width"):
        Runner(lambda *_: None, lambda *_: None, 0)


@pytest.mark.slow
def test_the_table_is_made_of_them(tmp_path: Path, runner: Runner) -> None:
    words = "experiment table1 --preset small --worlds env1 --planners mfrl --predictors ground-truth constant-velocity"
    words += f" --episodes 4 --device cpu --batch 4 --speeds 0.5 3 --departures 0.5 1 --out {tmp_path}"
    assert run(words.split()) == 0
    rows = list(csv.DictReader((tmp_path / "results.csv").read_text().splitlines()))
    assert len(rows) == 8
    assert sum(row["outcome"] == "intercepted" for row in rows) >= 7
    assert "mfrl, ground-truth" in (tmp_path / "report.md").read_text()
    config = json.loads((tmp_path / "config.json").read_text())["config"]
    assert (config["device"], config["batch"]) == ("cpu", 4)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--device gpu --planners optimiser", "on a device only no-policy, pretrained, mfrl"),
        ("--device cpu --planners mfrl --predictors fused", "on a device only none, ground-truth"),
        ("--device cpu --planners mfrl --predictors gmm --refine", "nothing is refined on a device"),
        ("--device cpu --planners mfrl --predictors gmm --batch 0", "--batch"),
        ("--device cpu --planners mfrl --predictors gmm --workers 2", "in this process"),
    ],
)
def test_what_no_device_flies_is_said_in_one_line(
    words: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = run(f"experiment table1 {words} --out {tmp_path}".split())
    error = capsys.readouterr().err
    assert code == InputError.exit_code
    assert message in error
    assert "Traceback" not in error


def test_a_machine_without_a_gpu_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        on_device.device_named("gpu")
    except InputError:
        code = run(
            f"experiment table1 --device gpu --planners mfrl --predictors gmm --episodes 2 --out {tmp_path}".split()
        )
        error = capsys.readouterr().err
        assert code == InputError.exit_code
        assert "jaxplan[gpu]" in error
        assert "Traceback" not in error
    else:
        pytest.skip("this machine has a GPU")


def test_what_is_flown_together_is_in_one_world_with_as_many_goals() -> None:
    predictors = ("ground-truth", "noisy-0.05", "none", "gmm")
    config = table1.Config(planners=("mfrl",), predictors=predictors, worlds=("env1", "env2"), episodes=2)
    episodes = [EpisodeConfig(**item.values) for item in table1.items(config)]
    together = [[(episodes[i].world, episodes[i].predictor) for i in some] for some in on_device.groups(episodes)]
    assert sorted(together) == [
        [("env1", "ground-truth"), ("env1", "none")],
        [("env1", "noisy-0.05"), ("env1", "gmm")],
        [("env2", "ground-truth"), ("env2", "none")],
        [("env2", "noisy-0.05"), ("env2", "gmm")],
    ]
