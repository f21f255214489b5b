"""How policies are made: worlds, sequences, labels, shards, and training that goes on where it stopped."""

import dataclasses
import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.errors import FileError, InputError
from jaxplan.policy.network import NetworkConfig, PolicyNetwork
from jaxplan.precision import in_float64
from jaxplan.runner.distribute import map_on_workers
from jaxplan.spline import FlatState
from jaxplan.training.dataset import (
    DatasetConfig,
    Shard,
    build_flights,
    build_labels,
    digest,
    flown_shard,
    in_turn,
    is_held_out,
    make_dataset,
    read_shard,
    shard_path,
    write_shard,
)
from jaxplan.training.examples import load_examples, take_examples
from jaxplan.training.imitation import ImitationConfig, growth_shortfall, imitation_loss, thrust_excess
from jaxplan.training.labels import LabelConfig, Queries, rollout_slowdown
from jaxplan.training.pretrain import PretrainConfig, pretrain, start_training
from jaxplan.training.sequences import SPEED_UP, free_queries, in_flight, join, open_room, rest_queries, take
from jaxplan.training.worlds import SIZES, random_world
from jaxplan.vehicle.limits import least_rotor_margin
from jaxplan.vehicle.load import load_vehicle
from tolerances import tolerance

SMALL = PretrainConfig(
    network=NetworkConfig(hidden=8, attention=4, latent=2),
    imitation=ImitationConfig(excess=0.0),
    steps=40,
    batch=32,
    evaluate_every=20,
)


def test_random_worlds_differ_but_share_their_shapes():
    worlds = [random_world(np.random.default_rng([3, index]), index) for index in range(12)]
    shapes = {tuple(np.shape(leaf) for leaf in jax.tree.leaves(world)) for world in worlds}
    assert len(shapes) == 1
    sizes = np.array([np.diff(world.bounds, axis=0)[0] for world in worlds])
    assert (sizes >= SIZES[0]).all()
    assert (sizes <= SIZES[1]).all()
    assert len({world.provenance for world in worlds}) >= 3
    again = random_world(np.random.default_rng([3, 5]), 5)
    np.testing.assert_array_equal(again.boxes.center, worlds[5].boxes.center)


def test_routed_sequences_start_and_end_free_and_repeat_their_goal():
    room = open_room(random_world(np.random.default_rng([3, 1]), 1))
    found = rest_queries(room, np.random.default_rng(0), 32)
    assert found.waypoints.shape == (14, 3, 32)
    assert ((found.count >= 2) & (found.count <= 14)).all()
    for lane, count in enumerate(found.count):
        steps = np.linalg.norm(np.diff(found.waypoints[..., lane], axis=0), axis=1)
        assert (steps[: count - 1] > 0.0).all()
        np.testing.assert_allclose(steps[count - 1 :], 0.0, **tolerance("formula"))
    lower, upper = room.world.bounds
    assert ((found.waypoints > lower[:, None]) & (found.waypoints < upper[:, None])).all()


def test_free_sequences_have_all_lengths_and_states_in_flight_are_scaled_like_alpha():
    found = free_queries(np.random.default_rng(1), 400)
    assert set(found.count) == set(range(2, 15))
    derivatives = np.arange(15.0).reshape(5, 3) + 1.0
    state = FlatState(derivatives=derivatives, yaw=np.array([0.3, 0.2, 0.1]))
    moving = in_flight(found, state, np.random.default_rng(2))
    alpha = moving.derivatives[0, 0] / derivatives[1, 0]
    assert (alpha >= SPEED_UP[0] - 1e-9).all()
    assert (alpha <= SPEED_UP[1] + 1e-9).all()
    assert 0.3 < np.mean(alpha == 1.0) < 0.5
    for order in range(4):
        np.testing.assert_allclose(moving.derivatives[order, 1], derivatives[order + 1, 1] * alpha ** (order + 1))
    np.testing.assert_allclose(moving.yaw[2], 0.1 * alpha**2)


def made_up_shard(seed, lanes=256):
    """Sequences whose durations are a simple function of lengths and speed: something to learn."""
    rng = np.random.default_rng(seed)
    queries = free_queries(rng, 3 * lanes)
    queries = take(queries, np.flatnonzero(queries.count <= 7)[:lanes])
    derivatives = np.zeros((4, 3, lanes))
    derivatives[0] = rng.normal(size=(3, lanes)) * 2.0
    lengths = np.linalg.norm(np.diff(queries.waypoints, axis=0), axis=1)
    speed, alpha = np.linalg.norm(derivatives[0], axis=0), rng.uniform(0.5, 2.0, lanes)
    durations, sped_up = (lengths / 3.0 * (1.0 + 0.05 * factor * speed) for factor in (1.0, alpha))
    labels = durations, np.ones(lanes, bool), np.full(lanes, np.nan), alpha, sped_up
    return Shard(queries._replace(derivatives=derivatives), *labels)


@pytest.fixture
def data(tmp_path):
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "dataset.json").write_text(json.dumps({"config": dataclasses.asdict(DatasetConfig(shards=8))}))
    for index in range(8):
        write_shard(shard_path(folder, index), made_up_shard(index))
    return folder


def test_shards_come_back_and_damaged_ones_are_refused(tmp_path):
    path, shard = tmp_path / "shard-0000.npz", made_up_shard(0, 16)
    write_shard(path, shard)
    back = read_shard(path)
    np.testing.assert_allclose(back.durations, shard.durations, **tolerance("solve"))
    assert {leaf.dtype for leaf in (back.durations, back.slowdown, back.queries.waypoints)} == {np.dtype(float)}
    np.testing.assert_array_equal(back.queries.count, shard.queries.count)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(FileError, match=r"shard-0000\.npz"):
        read_shard(path)


def test_a_dataset_is_made_in_any_order_and_goes_on_where_it_stopped(tmp_path):
    config, made = DatasetConfig(shards=4), []

    def backwards(make, numbers):
        for number in reversed(numbers):
            made.append(number)
            yield number, made_up_shard(number, lanes=8)
            if len(made) == 2:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_dataset(tmp_path, config, each=backwards)
    assert made == [3, 2]
    make_dataset(tmp_path, config, each=backwards)
    assert made == [3, 2, 1, 0]
    hashes = json.loads((tmp_path / "dataset.json").read_text())["sha256"]
    assert hashes == {f"shard-{k:04d}.npz": digest(shard_path(tmp_path, k)) for k in range(4)}
    np.testing.assert_allclose(
        read_shard(shard_path(tmp_path, 3)).durations, made_up_shard(3, lanes=8).durations, **tolerance("solve")
    )
    with pytest.raises(FileError, match="another configuration"):
        make_dataset(tmp_path, DatasetConfig(shards=4, seed=5), each=backwards)
    make_dataset(tmp_path, DatasetConfig(shards=6), each=backwards)
    assert made == [3, 2, 1, 0, 5, 4]
    assert len(json.loads((tmp_path / "dataset.json").read_text())["sha256"]) == 6
    with pytest.raises(FileError, match="6 shards"):
        make_dataset(tmp_path, DatasetConfig(shards=4), each=backwards)


@pytest.mark.slow
def test_a_shard_is_the_same_from_a_worker(tmp_path):
    config = DatasetConfig(shards=1, seed=4)
    make_dataset(tmp_path / "here", config, each=in_turn)
    make_dataset(tmp_path / "there", config, each=functools.partial(map_on_workers, workers=1))
    here, there = (read_shard(shard_path(tmp_path / name, 0)) for name in ("here", "there"))
    np.testing.assert_array_equal(here.queries.waypoints, there.queries.waypoints)
    np.testing.assert_array_equal(here.feasible, there.feasible)
    np.testing.assert_allclose(here.durations, there.durations, **tolerance("exact", np.float32))
    assert np.mean(here.slowdown == there.slowdown) > 0.99 * np.mean(here.feasible)
    assert 0.5 < np.mean(here.slowdown[here.feasible] == 1.0) < 1.0
    assert flown_shard(config, 0).feasible.tolist() == here.feasible.tolist()


def test_training_and_held_out_sequences_are_apart(data):
    assert sum(is_held_out(index) for index in range(64)) == 8
    training, held_out = load_examples(data, held_out=False), load_examples(data, held_out=True)
    assert len(training.count) == 7 * 256
    assert len(held_out.count) == 256
    np.testing.assert_allclose(held_out.durations, made_up_shard(7).durations, **tolerance("solve"))


def test_flights_that_were_never_tracked_are_not_imitated(data):
    shard = read_shard(shard_path(data, 7))
    slowdown = np.where(np.arange(256) < 10, np.inf, 1.2)
    write_shard(shard_path(data, 7), shard._replace(slowdown=slowdown))
    held_out = load_examples(data, held_out=True)
    assert len(held_out.count) == 246
    np.testing.assert_allclose(held_out.durations, 1.2 * shard.durations[:, 10:], **tolerance("solve"))


@pytest.mark.slow
def test_training_learns_and_goes_on_where_it_stopped(tmp_path, data):
    """The weights after an interrupted run are those of an uninterrupted one, bit for bit."""
    whole, error = pretrain(tmp_path / "whole", data, SMALL, report=lambda text: None)
    log = (tmp_path / "whole" / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(row)["step"] for row in log] == [20, 40]
    assert error.overall < 0.5 * _error_of(start_training(SMALL), data)

    class Stop(Exception):
        pass

    def stop(text):
        raise Stop

    with pytest.raises(Stop):
        pretrain(tmp_path / "part", data, SMALL, report=stop)
    resumed, _ = pretrain(tmp_path / "part", data, SMALL, report=lambda text: None)
    jax.tree.map(np.testing.assert_array_equal, whole.parameters, resumed.parameters)
    with pytest.raises(InputError, match="another configuration"):
        pretrain(tmp_path / "part", data, dataclasses.replace(SMALL, seed=1))


@pytest.mark.slow
def test_a_run_shorter_than_an_evaluation_is_evaluated_at_its_end(tmp_path, data):
    state, error = pretrain(tmp_path, data, dataclasses.replace(SMALL, evaluate_every=100), report=lambda text: None)
    assert int(state.step) == 40
    assert np.isfinite(error.overall)


@pytest.mark.slow
def test_training_goes_on_from_given_weights(tmp_path, data):
    first, error = pretrain(tmp_path / "first", data, SMALL, report=lambda text: None)
    gentle = dataclasses.replace(SMALL, learning_rate=1e-4)
    second, further = pretrain(tmp_path / "second", data, gentle, report=lambda text: None, start=first.averaged)
    assert further.overall < 1.05 * error.overall
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=0.01), first.averaged, second.averaged)


@functools.partial(jax.jit, static_argnums=2)
def compiled_loss(parameters, examples, config):
    return imitation_loss(PolicyNetwork(SMALL.network), parameters, examples, jax.random.key(0), config, load_vehicle())


@pytest.fixture
def loss(data, x64):
    """(examples, weights): the loss of a policy with random weights; and some examples."""
    examples = jax.tree.map(jnp.asarray, take_examples(load_examples(data, held_out=True), np.arange(64)))
    parameters = jax.jit(lambda: start_training(SMALL).parameters)()

    def value(examples, **weights):
        config = dataclasses.replace(ImitationConfig(excess=0.0), **weights)
        return float(compiled_loss(parameters, examples, config))

    return value, examples


@pytest.mark.slow
def test_the_response_is_learned_from_labels_that_are_known(loss):
    """Second labels bend the weights, and where there are none nothing of them is left."""
    value, examples = loss
    assert value(examples) > value(examples, response=0.0)
    alone = examples._replace(sped_up=jnp.zeros_like(examples.sped_up))
    other = alone._replace(alpha=2.0 * alone.alpha)
    assert value(alone, growth=0.0) == value(other, growth=0.0)
    assert value(alone) == value(alone, response=0.0)


def test_flight_times_that_do_not_grow_enough_with_alpha_cost_something():
    """T constant or shrinking like the square root of alpha: free; T shrinking like alpha: as much as it lacks."""
    alpha = np.array([0.5, 0.5, 2.0, 2.0, 4.0, 1.0])
    power = np.array([0.0, -1.0, -0.5, -1.0, -1.5, 0.0])
    found = growth_shortfall(jnp.asarray(power * np.log(alpha)), jnp.asarray(alpha))
    np.testing.assert_allclose(
        found, [0.0, 0.5 * np.log(2.0), 0.0, 0.5 * np.log(2.0), np.log(4.0), 0.0], **tolerance("solve")
    )


@pytest.mark.slow
def test_total_times_that_are_too_short_cost_more_than_those_too_long(loss):
    value, examples = loss
    examples = examples._replace(sped_up=jnp.zeros_like(examples.sped_up), alpha=jnp.ones_like(examples.alpha))

    def extra(factor):
        """What ``haste`` adds when the labels are so much longer."""
        longer = examples._replace(durations=factor * examples.durations)
        return value(longer, haste=2.0) - value(longer, haste=1.0)

    assert extra(1e-2) == 0.0
    assert extra(1e2) > 0.0


@pytest.mark.slow
def test_thrust_beyond_the_limits_costs_something(loss):
    value, examples = loss

    @jax.jit
    def beyond(factor):
        return thrust_excess(load_vehicle(), examples, factor * examples.durations, 1.5)

    slow, fast = (np.asarray(beyond(factor)) for factor in (4.0, 0.5))
    assert np.median(slow) == 0.0
    assert (fast > slow).mean() > 0.9
    extra = [value(examples, excess=weight) - value(examples) for weight in (0.5, 1.0)]
    assert 0.0 < extra[0] == pytest.approx(0.5 * extra[1], rel=1e-3)


def _error_of(state, data):
    from jaxplan.training.pretrain import build_measure

    return build_measure(SMALL)(state.averaged, load_examples(data, held_out=True)).overall


def test_wrong_settings_and_missing_data_are_refused(tmp_path):
    with pytest.raises(InputError, match="batch"):
        PretrainConfig(batch=0)
    for wrong in (-0.1, np.nan):
        with pytest.raises(InputError, match="excess"):
            ImitationConfig(excess=wrong)
    with pytest.raises(FileError, match=r"dataset\.json"):
        load_examples(tmp_path, held_out=False)


@pytest.mark.slow
def test_labels_are_at_the_rotors_limit():
    """Within the limits with the stated reserve, beyond it when flown 4 % faster, and tracked as the slowdown says."""
    config, vehicle = LabelConfig(), load_vehicle()
    label, fly = build_labels(vehicle, config), build_flights(config)
    moving = take(free_queries(np.random.default_rng(1), 8), np.arange(8))
    speed = np.zeros((4, 3, 8))
    speed[0] = 3.0
    queries = join([free_queries(np.random.default_rng(0), 56), moving._replace(derivatives=speed)])
    durations, feasible = label(queries)
    assert feasible.mean() > 0.9

    @in_float64
    def least(factor, instants):
        return np.asarray(least_rotor_margin(vehicle, fly(queries, factor * durations).states(instants)))[:56][
            feasible[:56]
        ]

    assert (least(1.0, config.instants) >= config.reserve - 1e-6).all()
    assert (least(0.96, config.instants) < config.reserve).mean() > 0.9
    assert (least(1.0, 2000) >= -0.1 * vehicle.rotor_speed_max).mean() > 0.9  # what slips between the instants is small
    slowdown = rollout_slowdown(vehicle, queries, durations, feasible, fly)
    assert np.isnan(slowdown[~feasible]).all()
    assert (slowdown[feasible] == 1.0).mean() > 0.5
    assert np.isfinite(slowdown[feasible]).mean() > 0.9
    falling = queries._replace(derivatives=np.where(np.arange(4)[:, None, None] == 1, 60.0, 0.0) + queries.derivatives)
    assert not label(falling)[1].any()  # no rotor reaches 6 g: there is nothing to imitate


@pytest.mark.slow
def test_slower_sequences_need_longer():
    config, vehicle = LabelConfig(), load_vehicle()
    label = build_labels(vehicle, config)
    points = np.zeros((14, 3, 64))
    points[1:, 0] = np.linspace(0.5, 20.0, 64)
    durations, feasible = label(Queries(points, np.full(64, 2), np.zeros((4, 3, 64)), np.zeros((3, 64))))
    assert feasible.all()
    assert (np.diff(durations.sum(axis=0)) > 0.0).all()
