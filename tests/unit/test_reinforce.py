"""Reinforcement: the reward as written in the paper, steps that climb it, and runs that go on where they stopped."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError

from jaxplan import cli
from jaxplan.errors import InputError
from jaxplan.feasibility.classifier import make_classifier, new_model
from jaxplan.feasibility.features import LOW_FIDELITIES, motion_features
from jaxplan.feasibility.gaussian_process import Related, rbf
from jaxplan.minsnap.spline_batch import fit_each
from jaxplan.policy.checkpoint import TrainedPolicy
from jaxplan.policy.network import NetworkConfig
from jaxplan.spline import FlatStateBatch
from jaxplan.training.active import least_certain, perturbed
from jaxplan.training.classifier import ClassifierConfig
from jaxplan.training.examples import Examples
from jaxplan.training.labels import LabelConfig
from jaxplan.training.mfrl import MfrlConfig, reinforce
from jaxplan.training.pretrain import PretrainConfig, start_training
from jaxplan.training.reinforce import ReinforceConfig, build_climb, rewards, start_learning
from jaxplan.vehicle.identity import identify
from jaxplan.vehicle.load import load_vehicle
from tolerances import tolerance

NETWORK = NetworkConfig(hidden=8, attention=4, latent=2)


@pytest.fixture(scope="module")
def examples():
    """Straight and crooked flights from hover with durations of a sensible size."""
    rng = np.random.default_rng(0)
    points = np.cumsum(rng.normal(size=(7, 3, 64)), axis=0)
    points -= points[:1]
    count = rng.integers(2, 8, 64)
    for lane, last in enumerate(count - 1):
        points[last:, :, lane] = points[last, :, lane]
    real = np.arange(6)[:, None] < count - 1
    durations = np.where(real, 0.3 + np.linalg.norm(np.diff(points, axis=0), axis=1) / 3.0, 0.0)
    derivatives = np.zeros((5, 3, 64))
    state = FlatStateBatch(derivatives=derivatives, yaw=np.zeros((3, 64)))
    return Examples(points, count, state, durations, np.ones(64), np.zeros_like(durations))


@pytest.fixture(scope="module")
def parameters():
    return jax.jit(lambda: start_training(PretrainConfig(network=NETWORK)).parameters)()


@jax.jit
def splines_of(examples, factor):
    """The flights with all durations changed by a factor."""
    return fit_each(examples.initial, examples.waypoints, factor * examples.durations, 1.5)


@pytest.fixture(scope="module")
def classifier(examples):
    """Random opinions on such flights, which depend on the summary as much as on the margin."""
    with jax.enable_x64(True):
        motion = np.asarray(jax.jit(motion_features)(splines_of(examples, 1.0), load_vehicle()))
    model = jax.jit(new_model, static_argnums=(0, 1))(8, 0, motion)
    dimensions = len(model.scales.centre) - LOW_FIDELITIES
    length = float(np.sqrt(dimensions))
    kernel = Related(rbf(dimensions, length), rbf(dimensions, 2.0 * length), rbf(LOW_FIDELITIES))
    weights = jnp.asarray(2.0 * np.random.default_rng(0).normal(size=8), jnp.float32)
    return make_classifier(model._replace(process=model.process._replace(kernel=kernel, mean=weights)))


@pytest.mark.slow
def test_the_reward_is_probability_times_saved_time(examples, classifier):
    logs = np.log(np.maximum(examples.durations, 1e-3)) - 0.1
    with jax.enable_x64(True):
        probability = jax.jit(lambda splines: classifier.predict(splines, load_vehicle()).probability)
        chance = np.asarray(probability(splines_of(examples, 0.9048374180359595)))
        configs = ReinforceConfig(bonus=0.0), ReinforceConfig(bonus=0.2), ReinforceConfig(bonus=0.1, ceiling=0.05)
        earned = jax.jit(lambda logs: [rewards(probability, examples, logs, config) for config in configs])(logs)
        gains = 1.0 - np.exp(-0.1), 1.2 - np.exp(-0.1), 0.15
        for (found, feasible, relative), gain in zip(earned, gains, strict=True):
            np.testing.assert_allclose(feasible, chance, **tolerance("exact", np.float32))
            np.testing.assert_allclose(relative, np.exp(-0.1), **tolerance("solve"))
            np.testing.assert_allclose(found, gain * chance, **tolerance("exact", np.float32))


@pytest.mark.slow
@pytest.mark.parametrize("method", ["gradient", "ppo"])
def test_steps_climb_the_reward(examples, parameters, classifier, method):
    """On one batch, seen again and again, the reward grows far beyond its noise."""
    config = ReinforceConfig(method=method, learning_rate=3e-3, anchor=1e-4, deviation=0.05)
    with jax.enable_x64(True):
        climb = build_climb(NETWORK, parameters, load_vehicle(), config)
        learner, earned = start_learning(parameters, config), []
        batch = jax.tree.map(jnp.asarray, examples)
        for step in range(40):
            learner, found = climb(learner, classifier, batch, jax.random.key(step))
            earned.append(float(found.reward))
    assert np.isfinite(earned).all()
    assert np.mean(earned[-5:]) > 1.05 * np.mean(earned[:5])


@pytest.mark.slow
def test_steps_become_smaller(examples, parameters, classifier):
    """Along a gradient that hardly changes, Adam's steps are the learning rate."""
    config = ReinforceConfig(learning_rate=1e-6, halved=1)
    with jax.enable_x64(True):
        climb = build_climb(NETWORK, parameters, load_vehicle(), config)
        learner, batch, moved = start_learning(parameters, config), jax.tree.map(jnp.asarray, examples), []
        for step in range(3):
            after, _ = climb(learner, classifier, batch, jax.random.key(step))
            change = jax.tree.map(lambda a, b: float(jnp.max(jnp.abs(a - b))), after.parameters, learner.parameters)
            moved.append(max(jax.tree.leaves(change)))
            learner = after
    np.testing.assert_allclose(moved, 1e-6 / np.arange(1, 4), rtol=0.2)


@pytest.mark.slow
def test_an_anchor_holds_the_policy(examples, parameters, classifier):
    """With the divergence alone to minimise, the weights stay where they are."""
    config = ReinforceConfig(anchor=1e6)
    with jax.enable_x64(True):
        climb = build_climb(NETWORK, parameters, load_vehicle(), config)
        learner, batch = start_learning(parameters, config), jax.tree.map(jnp.asarray, examples)
        first = None
        for step in range(5):
            learner, found = climb(learner, classifier, batch, jax.random.key(step))
            first = found if first is None else first
    assert float(found.relative_time) == pytest.approx(float(first.relative_time), rel=2e-3)


def test_labels_go_where_the_classifier_is_least_sure():
    assert least_certain(np.array([0.9, 0.45, 0.1, 0.52]), 2).tolist() == [3, 1]
    rng = np.random.default_rng(0)
    tried = np.log(perturbed(np.ones((13, 5000)), (0.8, 1.25), 0.05, rng))
    assert np.sqrt(tried.var(axis=0, ddof=1).mean()) == pytest.approx(0.05, rel=0.02)
    factors = tried.mean(axis=0)
    assert factors.std() == pytest.approx(np.log(1.25 / 0.8) / np.sqrt(12.0), rel=0.05)


def test_wrong_settings_are_refused():
    with pytest.raises((InputError, TypeCheckError), match="method"):  # where annotations are checked, they come first
        ReinforceConfig(method="sarsa")
    for wrong in ({"learning_rate": 0.0}, {"tries": 0}, {"halved": 0}, {"anchor": np.nan}):
        with pytest.raises(InputError, match="reinforce"):
            ReinforceConfig(**wrong)
    with pytest.raises(InputError, match="pool"):
        MfrlConfig(pool=10, chosen=10, random=1)


def test_the_command_refuses_what_is_not_there(tmp_path, capsys):
    arguments = ["--data", str(tmp_path), "--run", str(tmp_path / "run"), "--classifier", str(tmp_path / "c.npz")]
    assert cli.run(["train", "mfrl", *arguments, "--out", str(tmp_path / "p.txt")]) == 10
    assert cli.run(["train", "mfrl", *arguments, "--out", str(tmp_path / "p.npz")]) == 11
    assert "dataset.json" in capsys.readouterr().err


@pytest.mark.slow
def test_a_run_that_was_cut_off_ends_as_one_that_was_not(tmp_path, examples, parameters):
    """Two rounds with rollouts, in one go and with a stop after the first."""
    small = ClassifierConfig(inducing=8, steps=10, batch=32)
    config = MfrlConfig(
        classifier=small,
        first_steps=20,
        first_labels=64,
        rounds=2,
        pool=64,
        chosen=16,
        random=16,
        steps=3,
        batch=16,
        calibration=64,
    )
    vehicle = load_vehicle()
    start = TrainedPolicy(NETWORK, parameters, identify(vehicle))

    def run(folder, report=lambda text: None, config=config):
        return reinforce(folder, examples, vehicle, start, config, LabelConfig(), report)

    def stop(text):
        raise KeyboardInterrupt

    whole = run(tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "cut", stop)
    assert run(tmp_path / "cut", config=dataclasses.replace(config, rounds=1)).done == 1
    cut = run(tmp_path / "cut")
    assert whole.done == cut.done == 2
    for left, right in zip(jax.tree.leaves(whole), jax.tree.leaves(cut), strict=True):
        np.testing.assert_array_equal(left, right)
    rows = [json.loads(line) for line in (tmp_path / "cut" / "metrics.jsonl").read_text().splitlines()]
    assert [row["round"] for row in rows] == [1, 2]
    assert {"auc", "brier", "relative_time", "probability", "rollouts"} <= set(rows[0])
    with pytest.raises(InputError, match="another configuration"):
        reinforce(tmp_path / "cut", examples, vehicle, start, MfrlConfig(), LabelConfig())
