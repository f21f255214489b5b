"""The learned policy: symmetries, masking, sensitivity to the initial state, and what its files refuse.

The weights are random here; all of this holds for any weights.
"""

import functools
import io
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.errors import FileError
from jaxplan.policy.checkpoint import load_policy, policy_card, policy_vehicle, resolve_policy, save_policy
from jaxplan.policy.features import SEGMENT_FEATURES, STATE_FEATURES, segment_features, sequence_frame, state_features
from jaxplan.policy.network import NetworkConfig, PolicyNetwork
from jaxplan.policy.neural import neural_policy
from jaxplan.spline import FlatStateBatch
from jaxplan.vehicle.load import load_vehicle
from jaxplan.weights import signed
from tolerances import tolerance

CONFIG = NetworkConfig(hidden=16, attention=8, latent=4)


@functools.cache
def random_parameters(seed=0):
    network = PolicyNetwork(CONFIG)
    shapes = (13, SEGMENT_FEATURES, 2), (13, 2), (STATE_FEATURES, 2)
    features, real, state = (jnp.ones(shape, jnp.float32) for shape in shapes)
    parameters = jax.jit(network.init)(jax.random.key(seed), features, real > 0.0, state)
    return jax.tree.map(lambda leaf: np.asarray(2.0 * leaf), parameters)


@pytest.fixture(scope="module")
def policy():
    return neural_policy("random", CONFIG, random_parameters())


def sequences(counts, seed=0, scale=2.0):
    rng = np.random.default_rng(seed)
    counts = np.asarray(counts)
    points = np.cumsum(rng.normal(size=(14, 3, len(counts))) * scale, axis=0)
    for lane, count in enumerate(counts):
        points[count:, :, lane] = points[count - 1, :, lane]
    derivatives = rng.normal(size=(5, 3, len(counts))) * np.array([0.0, 3.0, 5.0, 10.0, 40.0])[:, None, None]
    return points, counts, FlatStateBatch(derivatives=derivatives, yaw=rng.normal(size=(3, len(counts))))


@functools.lru_cache
def compiled(policy):
    return jax.jit(lambda points, counts, initial: policy.decode(policy.encode(points, counts), initial))


def durations(policy, points, counts, initial):
    with jax.enable_x64(True):
        return np.asarray(compiled(policy)(points, counts, initial))


def test_durations_are_positive_on_segments_and_0_on_padding(policy):
    points, counts, initial = sequences(range(2, 15))
    found = durations(policy, points, counts, initial)
    real = np.arange(13)[:, None] < counts - 1
    assert found.dtype == np.float64
    assert np.isfinite(found).all()
    assert (found[real] > 0.0).all()
    assert (found[~real] == 0.0).all()


def test_padding_and_neighbours_do_not_matter(policy):
    points, counts, initial = sequences([2, 5, 7, 3])
    whole = durations(policy, points, counts, initial)
    np.testing.assert_allclose(
        durations(policy, points[:7], counts, initial), whole[:6], **tolerance("exact", np.float32)
    )
    second = jax.tree.map(lambda leaf: leaf[..., 1:2], (points, counts, initial))
    alone = durations(policy, *second)
    np.testing.assert_allclose(alone[:, 0], whole[:, 1], **tolerance("exact", np.float32))


def test_the_room_and_the_heading_do_not_matter(policy):
    points, counts, initial = sequences([4, 9, 14])
    turn = 2.1
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    moved = np.einsum("ij,njk->nik", rotation, points) + np.array([30.0, -12.0, 1.0])[:, None]
    yaw = initial.yaw + np.array([[turn], [0.0], [0.0]])
    turned = FlatStateBatch(derivatives=np.einsum("ij,njk->nik", rotation, initial.derivatives), yaw=yaw)
    np.testing.assert_allclose(
        durations(policy, moved, counts, turned), durations(policy, points, counts, initial), rtol=2e-4
    )


def test_every_derivative_is_seen_over_its_whole_range(policy):
    """Nothing saturates: doubling any derivative changes the durations, however large it is."""
    points, counts, initial = sequences([6] * 5, scale=1.0)
    points[:] = points[..., :1]
    derivatives = np.repeat(0.1 * initial.derivatives[..., :1], 5, axis=-1)
    for order in range(1, 5):
        for size in (1.0, 10.0, 100.0):
            scales = np.ones((2, 5, 1, 1))
            scales[:, order, 0, 0] = size, 2.0 * size
            one, two = (FlatStateBatch(derivatives=derivatives * scale, yaw=initial.yaw) for scale in scales)
            slow, fast = durations(policy, points, counts, one)[:5], durations(policy, points, counts, two)[:5]
            assert np.abs(slow / fast - 1.0).max() > 1e-4


@pytest.mark.slow
def test_degenerate_sequences_give_finite_durations_and_gradients(policy):
    points, counts, initial = sequences([5, 5, 2, 3])
    points[:, :, 0] = points[:1, :, 0]
    points[:, :2, 1] = points[:1, :2, 1]
    points[2] = points[1]
    initial.derivatives[..., 2:] = 0.0

    def total(points, initial):
        return jnp.sum(policy.decode(policy.encode(points, counts), initial))

    with jax.enable_x64(True):
        value, slopes = jax.jit(jax.value_and_grad(total, argnums=(0, 1)))(points, initial)
    assert np.isfinite(value)
    assert all(np.isfinite(slope).all() for slope in jax.tree.leaves(slopes))


def test_features_have_their_stated_shapes():
    points, counts, initial = sequences([3, 14])

    @jax.jit
    def all_features(points, counts, initial):
        frame = sequence_frame(points, counts)
        return segment_features(points, counts, frame), state_features(initial, frame)

    (features, real), state = all_features(points, counts.astype(float), initial)
    assert features.shape == (13, SEGMENT_FEATURES, 2)
    assert real.sum(axis=0).tolist() == [2, 13]
    assert state.shape == (STATE_FEATURES, 2)


def test_checkpoints_come_back_as_they_were(tmp_path, policy):
    path = tmp_path / "mine.npz"
    save_policy(
        path, CONFIG, random_parameters(), {"command": "none", "scores": {"error": 1.0}}, vehicle=load_vehicle()
    )
    loaded = load_policy(path)
    given = sequences([4, 8, 14])
    np.testing.assert_array_equal(durations(loaded, *given), durations(policy, *given))
    assert loaded.name == "mine"
    assert policy_card(path)["command"] == "none"


def test_one_flipped_bit_anywhere_is_refused_by_name(tmp_path):
    path = tmp_path / "mine.npz"
    save_policy(path, CONFIG, random_parameters(), {}, vehicle=load_vehicle())
    content = path.read_bytes()
    rng = np.random.default_rng(0)
    for place in (0, len(content) - 1, *rng.choice(len(content), 60, replace=False)):
        broken = bytearray(content)
        broken[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(broken))
        with pytest.raises(FileError, match=r"mine\.npz"):
            load_policy(path)


@pytest.mark.parametrize(("change", "expected"), [("format", "format 99"), ("network", "fit"), ("golden", "durations")])
def test_foreign_checkpoints_are_refused(tmp_path, change, expected):
    path = tmp_path / "other.npz"
    save_policy(path, CONFIG, random_parameters(), {}, vehicle=load_vehicle())
    with np.load(path) as data:
        arrays = dict(data)
    header = json.loads(arrays.pop("header").tobytes())
    if change == "format":
        header["format"] = 99
    elif change == "network":
        header["network"]["hidden"] = 32
    else:
        header["golden"][0][0] *= 1.01
    packed = io.BytesIO()
    np.savez(packed, header=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)
    path.write_bytes(signed(packed.getvalue()))
    with pytest.raises(FileError, match=r"other\.npz.*" + expected):
        load_policy(path)


def test_unknown_names_are_refused_with_the_known_ones():
    with pytest.raises(FileError, match="neither a file nor a shipped policy"):
        load_policy("no-such-policy")


def test_the_shipped_policy_says_how_it_was_made_and_gives_sensible_times():
    """Straight flights from hover: longer ones take longer, at mean speeds that the vehicle has."""
    card = policy_card("pretrained")
    assert card["command"].startswith("jaxplan train pretrain")
    assert len(card["data"]["sha256"]) == 64
    assert 0.9 < card["scores"]["relative_time"] < 1.1
    lengths = np.linspace(1.0, 20.0, 20)
    points = np.zeros((14, 3, 20))
    points[1:, 0] = lengths
    derivatives, yaw = np.zeros((5, 3, 20)), np.zeros((3, 20))
    state = FlatStateBatch(derivatives=derivatives, yaw=yaw)
    total = durations(load_policy("pretrained"), points, np.full(20, 2), state).sum(axis=0)
    assert (np.diff(total) > 0.0).all()
    speed = lengths / total
    assert (speed > 0.5).all()
    assert (speed < 8.0).all()


def test_the_shipped_policy_takes_longer_from_a_faster_start_that_must_be_stopped():
    """Flying away from the goal: the faster, the longer."""
    points = np.zeros((14, 3, 6))
    points[1:, 0] = 3.0
    derivatives = np.zeros((5, 3, 6))
    derivatives[1, 0] = -np.arange(6.0)
    state = FlatStateBatch(derivatives=derivatives, yaw=np.zeros((3, 6)))
    total = durations(load_policy("pretrained"), points, np.full(6, 2), state).sum(axis=0)
    assert (np.diff(total) > 0.0).all()


def test_for_whom_a_policy_is_can_be_read_without_running_it(tmp_path, compilations):
    compilations.count = 0
    found = policy_vehicle("mfrl")
    assert compilations.count == 0
    assert found == load_policy("mfrl").vehicle
    damaged = bytearray(resolve_policy("mfrl")[0].read_bytes())
    damaged[-1] ^= 1
    (tmp_path / "own.npz").write_bytes(damaged)
    with pytest.raises(FileError, match="damaged"):
        policy_vehicle(tmp_path / "own.npz")
