"""What was learned for one vehicle is refused for another, wherever both meet; files say whom they serve."""

import dataclasses
import functools
import io
import json
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.errors import FileError, InputError
from jaxplan.feasibility.checkpoint import load_classifier, save_classifier
from jaxplan.feasibility.classifier import make_classifier, new_model
from jaxplan.feasibility.features import INSTANTS, MOTION_FEATURES
from jaxplan.planner import PlannerConfig, build_planner
from jaxplan.policy.checkpoint import TrainedPolicy, load_parameters, load_policy, policy_card, save_policy
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.policy.features import SEGMENT_FEATURES, STATE_FEATURES
from jaxplan.policy.network import NetworkConfig, PolicyNetwork
from jaxplan.policy.neural import neural_policy
from jaxplan.records import replace
from jaxplan.training.dataset import DatasetConfig, dataset_vehicle, in_turn, make_dataset
from jaxplan.training.evaluate import compare
from jaxplan.training.examples import Examples
from jaxplan.training.labels import LabelConfig, initial_states
from jaxplan.training.mfrl import MfrlConfig, reinforce
from jaxplan.training.sequences import free_queries
from jaxplan.vehicle import identity
from jaxplan.vehicle.fingerprint import fingerprint
from jaxplan.vehicle.identity import UNSTATED, VehicleId, from_header, identify, require_same_vehicle, to_header
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle
from jaxplan.weights import signed
from jaxplan.world.obstacles import World, make_obstacles

SMALL = NetworkConfig(hidden=4, attention=2, latent=2)


@pytest.fixture(scope="module")
def small_vehicle(tmp_path_factory: pytest.TempPathFactory) -> Vehicle:
    """The preset with other mass and arm, as a user's file has it."""
    path = tmp_path_factory.mktemp("vehicles") / "small.toml"
    text = (preset_file()).read_text(encoding="utf-8")
    text = re.sub(r"^mass = 0\.771 ", "mass = 0.5 ", text, flags=re.MULTILINE).replace("0.08", "0.06")
    path.write_text(text, encoding="utf-8")
    vehicle = load_vehicle(path)
    assert (vehicle.mass, abs(vehicle.rotor_positions[0, 0])) == (0.5, 0.06)
    return vehicle


def preset_file() -> Path:
    return Path(identity.__file__).parent / "presets" / "mfrl.toml"


@pytest.fixture(scope="module")
def world() -> World:
    bounds = np.array([[0.0, 0.0, 0.0], [2.0, 2.0, 2.0]])
    return World(name="empty", bounds=bounds, obstacles=make_obstacles(), keep_in=np.array(0.2), provenance="test")


@functools.cache
def parameters(config: NetworkConfig = SMALL):
    shapes = (13, SEGMENT_FEATURES, 2), (13, 2), (STATE_FEATURES, 2)
    features, real, state = (jnp.ones(shape, jnp.float32) for shape in shapes)
    return jax.jit(PolicyNetwork(config).init)(jax.random.key(0), features, real > 0.0, state)


@functools.cache
def model():
    motion = np.random.default_rng(0).normal(size=(MOTION_FEATURES, INSTANTS, 12)).astype(np.float32)
    return jax.jit(new_model, static_argnums=(0, 1))(4, 0, motion)


def planner_for(vehicle: Vehicle, world: World, **parts):
    return build_planner(PlannerConfig(width=4), world=world, vehicle=vehicle, **parts)


def test_a_planner_refuses_a_policy_made_for_another_vehicle(small_vehicle: Vehicle, world: World) -> None:
    for name in ("mfrl", "pretrained"):
        with pytest.raises(InputError) as caught:
            planner_for(small_vehicle, world, policy=load_policy(name))
        said = str(caught.value)
        assert "\n" not in said
        assert f"policy '{name}'" in said
        assert f"'mfrl' ({fingerprint(load_vehicle())})" in said
        assert f"'small' ({fingerprint(small_vehicle)})" in said
        assert "train" in said
        assert "no-policy" in said


def test_a_planner_refuses_a_classifier_made_for_another_vehicle(small_vehicle: Vehicle, world: World) -> None:
    with pytest.raises(InputError, match=r"^classifier: was made for vehicle 'mfrl'.*have vehicle 'small'"):
        planner_for(small_vehicle, world, policy=constant_speed_policy(), classifier=load_classifier("mfrl"))


def test_a_planner_takes_what_serves_the_vehicle(small_vehicle: Vehicle, world: World) -> None:
    """Any policy that is for no vehicle in particular; the same numbers by another name; what was made for it."""
    planner_for(small_vehicle, world, policy=constant_speed_policy())
    renamed = replace(load_vehicle(), name="renamed")
    planner_for(renamed, world, policy=load_policy("mfrl"), classifier=load_classifier("mfrl"))
    own = neural_policy("own", SMALL, parameters(), identify(small_vehicle))
    planner_for(small_vehicle, world, policy=own, classifier=make_classifier(model(), identify(small_vehicle)))
    with pytest.raises(InputError, match="made for vehicle 'small'"):
        planner_for(renamed, world, policy=own)


def test_files_say_for_which_vehicle_they_were_made(tmp_path, small_vehicle: Vehicle) -> None:
    policy, classifier = tmp_path / "policy.npz", tmp_path / "classifier.npz"
    save_policy(policy, SMALL, parameters(), {}, vehicle=small_vehicle)
    save_classifier(classifier, model(), {}, vehicle=small_vehicle)
    wanted = VehicleId("small", fingerprint(small_vehicle))
    assert (
        load_policy(policy).vehicle == load_parameters(policy).vehicle == load_classifier(classifier).vehicle == wanted
    )


@pytest.mark.parametrize("name", ["pretrained", "mfrl"])
def test_the_shipped_weights_are_for_the_default_vehicle_and_say_so(name: str) -> None:
    """Fails when a number of the preset changes, or what counts as one: then the weights are no longer for it."""
    assert load_policy(name).vehicle == identify(load_vehicle()) == UNSTATED
    assert len(policy_card(name)["header_added"]["sha256_before"]) == 64
    if name == "mfrl":
        assert load_classifier(name).vehicle == UNSTATED


def rewritten(path, change, sign=signed) -> None:
    """Change the header of a file of weights and, with ``sign``, renew its hash."""
    with np.load(path) as data:
        arrays = dict(data)
    header = json.loads(arrays.pop("header").tobytes())
    change(header)
    packed = io.BytesIO()
    np.savez(packed, header=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)
    path.write_bytes(sign(packed.getvalue()))


def test_files_from_before_are_for_the_preset(tmp_path, small_vehicle: Vehicle) -> None:
    policy, classifier = tmp_path / "policy.npz", tmp_path / "classifier.npz"
    save_policy(policy, SMALL, parameters(), {}, vehicle=small_vehicle)
    save_classifier(classifier, model(), {}, vehicle=small_vehicle)
    for path in (policy, classifier):
        rewritten(path, lambda header: header.pop("vehicle"))
    assert load_policy(policy).vehicle == load_classifier(classifier).vehicle == UNSTATED


def test_a_vehicle_that_was_changed_in_a_file_is_refused_by_the_hash(tmp_path, small_vehicle: Vehicle) -> None:
    policy, classifier = tmp_path / "policy.npz", tmp_path / "classifier.npz"
    save_policy(policy, SMALL, parameters(), {}, vehicle=load_vehicle())
    save_classifier(classifier, model(), {}, vehicle=load_vehicle())
    for path, load in ((policy, load_policy), (classifier, load_classifier)):
        stated = path.read_bytes()[-32:]
        rewritten(path, lambda header: None, sign=lambda content, stated=stated: content + stated)
        load(path)  # the same content has the same hash
        change = lambda header: header.update(vehicle=to_header(small_vehicle))  # noqa: E731
        rewritten(path, change, sign=lambda content, stated=stated: content + stated)
        with pytest.raises(FileError, match=rf"{path.name}.*hash"):
            load(path)


@pytest.mark.parametrize("stated", ["mfrl", None, {"name": "mfrl"}, {"name": "mfrl", "fingerprint": 5}, []])
def test_a_header_without_a_proper_vehicle_is_refused(tmp_path, stated: object) -> None:
    policy, classifier = tmp_path / "policy.npz", tmp_path / "classifier.npz"
    save_policy(policy, SMALL, parameters(), {}, vehicle=load_vehicle())
    save_classifier(classifier, model(), {}, vehicle=load_vehicle())
    for path, load in ((policy, load_policy), (classifier, load_classifier)):
        rewritten(path, lambda header: header.update(vehicle=stated))
        with pytest.raises(FileError, match=rf"{path.name}.*vehicle is"):
            load(path)


def test_headers_come_back(small_vehicle: Vehicle) -> None:
    assert from_header({"vehicle": to_header(small_vehicle)}) == identify(small_vehicle)
    assert from_header({}) == UNSTATED
    require_same_vehicle("anything", None, small_vehicle)


def test_a_vehicle_is_no_leaf_and_another_one_is_another_program(small_vehicle: Vehicle) -> None:
    mine, other = (make_classifier(model(), identify(vehicle)) for vehicle in (small_vehicle, load_vehicle()))
    assert len(jax.tree.leaves(mine)) == len(jax.tree.leaves(make_classifier(model())))
    assert jax.tree.structure(mine) == jax.tree.structure(make_classifier(model(), identify(small_vehicle)))
    assert jax.tree.structure(mine) != jax.tree.structure(other)
    assert jax.jit(lambda classifier: classifier)(mine).vehicle == identify(small_vehicle)


def test_training_and_scores_refuse_another_vehicle(tmp_path, small_vehicle: Vehicle) -> None:
    start = TrainedPolicy(SMALL, parameters(), identify(load_vehicle()))
    queries, durations = free_queries(np.random.default_rng(0), 2), np.ones((13, 2))
    examples = Examples(
        queries.waypoints, queries.count, initial_states(queries), durations, np.ones(2), np.zeros((13, 2))
    )
    with pytest.raises(InputError, match="pretrained policy: was made for vehicle 'mfrl'"):
        reinforce(tmp_path / "run", examples, small_vehicle, start, MfrlConfig(), LabelConfig())
    assert not (tmp_path / "run").exists()
    with pytest.raises(InputError, match="policy 'mfrl': was made for vehicle 'mfrl'"):
        compare(load_policy("mfrl"), small_vehicle, queries, durations, LabelConfig())


def test_a_dataset_is_of_one_vehicle_even_if_its_file_changes(tmp_path) -> None:
    path, folder = tmp_path / "mine.toml", tmp_path / "data"
    path.write_text(preset_file().read_text(encoding="utf-8"), encoding="utf-8")
    config = DatasetConfig(shards=1, vehicle=str(path))

    def stop(make, numbers):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_dataset(folder, config, each=stop)
    assert fingerprint(dataset_vehicle(folder)) == fingerprint(load_vehicle())
    path.write_text(path.read_text().replace("mass = 0.771", "mass = 0.772"), encoding="utf-8")
    for use in (lambda: dataset_vehicle(folder), lambda: make_dataset(folder, config, each=in_turn)):
        with pytest.raises(InputError, match=r"dataset .*data: was made for vehicle 'mine'"):
            use()
    described = json.loads((folder / "dataset.json").read_text())
    del described["vehicle"]  # as before datasets said so
    (folder / "dataset.json").write_text(json.dumps(described))
    assert dataset_vehicle(folder).mass == 0.772
    assert dataclasses.asdict(config) == described["config"] | {"labels": dataclasses.asdict(config.labels)}
