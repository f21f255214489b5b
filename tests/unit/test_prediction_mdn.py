"""The network that foretells flights: what it is shown, what it says, and what becomes of its file."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from experiments.prediction_windows import as_seen, stored_windows
from jaxplan.errors import FileError, InputError
from jaxplan.prediction.mdn.checkpoint import TrainedNetwork, load_network, network_card, save_network
from jaxplan.prediction.mdn.curves import COEFFICIENTS, Curves, coefficients_of, fitted_curves, flights_of, places_at
from jaxplan.prediction.mdn.flights import learned_network
from jaxplan.prediction.mdn.network import (
    NetworkConfig,
    deviations,
    initial_parameters,
    log_densities,
    mixture_of,
)
from jaxplan.prediction.mdn.view import FAR, OBSERVATIONS, PROBES, STEPS, frame_of, mirrored, view_of
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.scores import observe_windows, score
from jaxplan.prediction.survival import surroundings_of
from jaxplan.status import Note
from jaxplan.weights import read_weights, write_weights
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import load_world
from tolerances import assert_close

NAMES = ("mdn", "ensemble")
SMALL = NetworkConfig(width=16, layers=2, components=3, matrices=2)


@pytest.fixture(scope="module")
def room():
    return load_world("env2")


@pytest.fixture(scope="module")
def seen(room):
    """Windows of stored targets at all speeds, and what happened next."""
    windows = stored_windows("env2", PredictionConfig.for_world(room).dt, 40, np.random.default_rng(1))
    return observe_windows(windows, 10, PredictionConfig.for_world(room).dt)


@pytest.fixture(scope="module")
def untrained(seen):
    """A small network with random weights, strong enough to matter."""
    parameters = jax.tree.map(lambda leaf: 3.0 * leaf.astype(np.float32), initial_parameters(SMALL, 0))
    rng = np.random.default_rng(0)
    curves = fitted_curves(np.cumsum(0.1 * np.cumsum(rng.normal(size=(500, STEPS, 3)), axis=1), axis=1))
    return TrainedNetwork(SMALL, parameters, curves, (0.1, 0.2))


def views(seen, room, count=10):
    positions = np.stack([one.positions for one in seen[0]])
    counts = np.full(len(positions), count)
    return view_of(frame_of(positions, counts), positions, counts, 0.2, surroundings_of(room))


def newest(observations, count):
    return Observations(times=observations.times[-count:], positions=observations.positions[-count:])


def test_a_flight_looks_the_same_wherever_it_leads():
    """Turned about the vertical, moved, or twice as fast; without walls."""
    rng = np.random.default_rng(0)
    positions = np.cumsum(rng.normal(size=(5, OBSERVATIONS, 3)), axis=1)
    counts = np.array([2, 3, 5, 9, 10])
    first = view_of(frame_of(positions, counts), positions, counts, 0.1, None)
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    elsewhere = 0.9 * positions @ turn.T + np.array([3.0, -20.0, 5.0])
    other = view_of(frame_of(elsewhere, counts), elsewhere, counts, 0.1, None)
    assert_close(other.relative, first.relative, "formula", np.float32)
    assert_close(other.scale, 0.9 * first.scale, "formula", np.float32)
    assert (first.room == FAR).all()
    assert not first.relative[0, :8].any()
    assert (first.seen.sum(axis=1) == counts - 1).all()
    assert_close(first.relative[0, -1, 1], 0.0, "formula", np.float32)  # x is along the velocity


def test_the_room_is_looked_up_where_the_target_would_go(room):
    """The first probe is the target itself, the last ray's end a whole way ahead of it, straight up or down."""
    positions = np.linspace([4.0, 5.0, 1.0], [6.0, 5.0, 1.0], OBSERVATIONS)[None]
    counts, surroundings = np.array([OBSERVATIONS]), surroundings_of(room)
    frame = frame_of(positions, counts)
    view = view_of(frame, positions, counts, 0.2, surroundings)
    assert_close(frame.scale[0], STEPS * 2.0 / 9.0, "formula")
    ahead = int(np.argmax(PROBES[:, 0]))
    for probe, place in ((0, positions[0, -1]), (ahead, positions[0, -1] + [frame.scale[0], 0.0, 0.0])):
        expected = np.clip(surroundings.free_distances(place[None])[0], -1.0, FAR)
        assert_close(float(view.room[0, probe]), expected, "formula", np.float32)


def test_left_and_right_are_exchanged(room):
    """By a mirror across the plane in which the target flies, and the room with it."""
    rng = np.random.default_rng(3)
    positions = np.cumsum(rng.uniform(0.0, 0.4, size=(4, OBSERVATIONS, 3)), axis=1)
    positions[:, -4:, 1] = positions[:, -1:, 1]  # along x, so that y is mirrored
    counts = np.full(4, OBSERVATIONS)
    flip = np.array([1.0, -1.0, 1.0])
    there = view_of(frame_of(positions, counts), positions, counts, 0.1, None)
    other = view_of(frame_of(positions * flip, counts), positions * flip, counts, 0.1, None)
    assert_close(mirrored(there).relative, other.relative, "formula", np.float32)
    by_place = {tuple(np.round(probe, 6)): index for index, probe in enumerate(PROBES)}
    pairs = [by_place[tuple(np.round(probe * flip, 6) + 0.0)] for probe in PROBES]
    some = there._replace(room=rng.normal(size=there.room.shape).astype(np.float32))
    np.testing.assert_array_equal(mirrored(some).room, some.room[:, pairs])


def test_numpy_and_jax_say_the_same(untrained, seen, room):
    view = views(seen, room)
    there = mixture_of(jax.tree.map(jnp.asarray, untrained.parameters), jax.tree.map(jnp.asarray, view))
    here = mixture_of(untrained.parameters, view, np)
    for ours, theirs in zip(here, there, strict=True):
        assert ours.dtype == theirs.dtype == np.float32
        assert_close(ours, theirs, "solve", np.float32)
    assert_close(np.exp(here.log_weights).sum(axis=1), np.ones(len(view.scale)), "formula", np.float32)


def test_densities_and_deviations_are_those_of_one_mixture(untrained, seen, room):
    """SciPy's normal distributions with the covariances that the deviations have."""
    view = views(seen, room)
    mixture = mixture_of(untrained.parameters, view, np)
    mixture = mixture._replace(couplings=mixture.couplings + np.float32(0.3), log_precisions=mixture.log_precisions / 3)
    roots = deviations(mixture).astype(float)
    points = np.random.default_rng(0).normal(size=(len(view.scale), COEFFICIENTS)).astype(np.float32)
    found = log_densities(jax.tree.map(jnp.asarray, mixture), jnp.asarray(points))
    for index in range(0, len(points), 10):
        parts = [
            weight + multivariate_normal.logpdf(points[index], mean, root @ root.T)
            for weight, mean, root in zip(mixture.log_weights[index], mixture.means[index], roots[index], strict=True)
        ]
        assert_close(float(found[index]), float(logsumexp(parts)), "solve", np.float32)


def test_smooth_flights_survive_their_coefficients():
    """To a hundredth of what they are long: cubics in time, of which six curves know more than enough."""
    rng, times = np.random.default_rng(0), np.linspace(0.05, 1.0, STEPS)
    powers = times[:, None] ** np.arange(1, 4)
    flights = np.einsum("sp,npa->nsa", powers, rng.normal(size=(300, 3, 3)))
    curves = fitted_curves(flights)
    back = flights_of(curves, coefficients_of(curves, flights.astype(np.float32)))
    assert np.abs(back - flights).max() < 0.01 * np.abs(flights).max()
    assert_close(np.asarray(curves.shapes).T @ np.asarray(curves.shapes), np.eye(6), "formula", np.float32)
    some = rng.normal(size=COEFFICIENTS).astype(np.float32)
    assert_close(
        places_at(curves, 3) @ some, flights_of(curves, some[None])[0, :3].astype(float), "formula", np.float32
    )


def test_what_it_would_have_said_is_its_density(untrained, seen, room):
    """Half a second ago, of the positions that came: means and spreads of many draws, to 2 m, which hides little."""
    config = PredictionConfig.for_world(room)
    told = learned_network(config, untrained, room)(seen[0][12], held=2, noise=2.0)
    before = seen[0][12].positions[:-2]
    padded = np.concatenate([before[:1], before[:1], before])[None]
    frame = frame_of(padded, np.array([8]))
    view = view_of(frame, padded, np.array([8]), config.dt, surroundings_of(room))
    mixture, rng = mixture_of(untrained.parameters, view, np), np.random.default_rng(0)
    component = rng.choice(
        SMALL.components, 40_000, p=np.exp(mixture.log_weights[0]) / np.exp(mixture.log_weights[0]).sum()
    )
    normal = rng.normal(size=(len(component), COEFFICIENTS, 1))
    drawn = mixture.means[0, component] + (deviations(mixture)[0, component] @ normal)[..., 0]
    own = flights_of(untrained.curves, drawn.astype(np.float32)).astype(float)
    flights = frame.to_world(own.reshape(1, -1, 3)).reshape(own.shape)
    for step, place in enumerate(seen[0][12].positions[-2:]):
        parts = []
        for k in np.unique(component):
            cloud = flights[component == k, step]
            spread = np.cov(cloud.T) + (2.0**2 + 0.05**2) * np.eye(3)
            share = np.log((component == k).mean())
            parts.append(share + multivariate_normal.logpdf(place, cloud.mean(axis=0), spread))
        np.testing.assert_allclose(float(told.foreseen[step]), float(logsumexp(parts)), atol=0.1)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("count", [1, 2, 10])
def test_no_goal_is_outside_the_room_or_in_an_obstacle(room, seen, name, count):
    """Also where noise puts what was seen outside."""
    predictor = build_predictor(name, PredictionConfig.for_world(room), world=room)
    noisy = as_seen(seen[0], 0.4, 0.0, np.random.default_rng(0))
    for observations in [*seen[0][::8], *noisy[::8]]:
        candidates = predictor(newest(observations, count), cycle=0)
        assert host_free_distance(room, candidates.goals).min() > 0.0
        assert 0.0 < candidates.likelihood.min() <= candidates.likelihood.max() == 1.0
        assert (candidates.note == int(Note.PREDICTOR_FALLBACK)) == (count == 1)


@pytest.mark.parametrize("name", NAMES)
def test_the_same_window_gives_the_same_goals(room, seen, name):
    predictor = build_predictor(name, PredictionConfig.for_world(room), world=room)
    np.testing.assert_array_equal(predictor(seen[0][3], 0).goals, predictor(seen[0][3], 7).goals)


def test_it_knows_where_flights_turn(room, seen):
    """A mean error over all steps below that of the filter by 25 %, and a 90 % region that is honest."""
    config = PredictionConfig.for_world(room)
    found = {}
    for name in ("imm", *NAMES):
        predictor = build_predictor(name, config, world=room)
        found[name] = score([predictor.predict(one) for one in seen[0]], seen[1]).summary()
    assert found["mdn"]["ade_m"] < 0.75 * found["imm"]["ade_m"]
    assert found["ensemble"]["ade_m"] < 0.8 * found["imm"]["ade_m"]
    assert 0.8 < found["mdn"]["coverage_90"] < 0.995


def test_a_flight_that_nobody_learned_goes_over_to_the_filter():
    """Straight on at 3 m/s and then round and round at 12 m/s^2: the network is off, the ensemble nearer."""
    config, times = PredictionConfig(), 0.1 * np.arange(30)
    place = 0.75 * np.stack([np.cos(4.0 * times), np.sin(4.0 * times), 0.0 * times], axis=-1)
    found = {}
    for name in ("imm", *NAMES):
        predictor = build_predictor(name, config)
        windows, futures = observe_windows(place[None], 10, 0.1)
        found[name] = score([predictor.predict(windows[0])], futures).errors[0, :10].mean()
    assert found["ensemble"] < found["mdn"]


def test_other_windows_are_refused():
    for wrong in ({"dt": 0.15}, {"observations": 8}, {"steps": 12}):
        name, value = next(iter(wrong.items()))
        for kind in NAMES:
            with pytest.raises(InputError, match=f"have {name} = {value}, want"):
                build_predictor(kind, PredictionConfig(**wrong))


def test_weights_survive_their_file_and_damage_is_seen(tmp_path, untrained):
    path = tmp_path / "mine.npz"
    save_network(path, untrained, {"seed": 3})
    again = load_network(path)
    assert network_card(path) == {"seed": 3}
    assert again.network == SMALL
    assert again.intervals == (0.1, 0.2)
    for ours, theirs in zip(jax.tree.leaves(again), jax.tree.leaves(untrained), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    header, arrays = read_weights(path, "flight network")
    arrays["network/means/bias"] = arrays["network/means/bias"] + 1.0
    write_weights(tmp_path / "changed.npz", "flight network", header, dict(arrays))
    with pytest.raises(FileError, match="do not give the flights"):
        load_network(tmp_path / "changed.npz")
    header["network"]["width"] = "wide"
    del arrays["curves/shapes"]
    write_weights(tmp_path / "less.npz", "flight network", json.loads(json.dumps(header)), dict(arrays))
    with pytest.raises(FileError, match="flight network"):
        load_network(tmp_path / "less.npz")
    with pytest.raises(FileError, match="rooms"):
        load_network("romos")


def test_the_shipped_weights_say_how_they_were_made():
    card = network_card()
    assert card["command"].startswith("jaxplan train mdn ")
    assert card["held_out"]["error"] < 0.25
    assert isinstance(load_network().curves, Curves)
