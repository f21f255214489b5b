"""The stored worlds and their targets: what the paper's scenario asks of them."""

import itertools
import json

import numpy as np
import pytest
from scipy import ndimage

from jaxplan.io.targets import target_spline
from jaxplan.precision import in_float64
from jaxplan.world.clearance import free_distance
from jaxplan.world.load import ENVIRONMENTS, environment_path, load_world
from jaxplan.world.occupancy import occupancy_lattices

SIZES = {"env1": [10.0, 10.0, 2.0], "env2": [30.0, 15.0, 3.0], "env3": [30.0, 15.0, 3.0]}


def targets(name: str) -> dict:
    return json.loads(environment_path(name).with_name(f"{name}_targets.json").read_text())


@in_float64
def distance(world, points):
    return np.asarray(free_distance(world, points))


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_size_start_and_connection(name: str) -> None:
    """The padded map is one piece down to the paper's lattices up to 0.5 m, and nearly so at 1 m."""
    world = load_world(name)
    np.testing.assert_allclose(world.bounds[1] - world.bounds[0], SIZES[name])
    assert distance(world, world.start) >= 0.5
    for lattice in occupancy_lattices(world):
        labels, _ = ndimage.label(~lattice.occupied)
        sizes = np.bincount(labels.ravel())[1:]
        home = labels[tuple(np.floor((world.start - lattice.origin) / lattice.resolution).astype(int))]
        assert home > 0
        assert sizes[home - 1] >= (1.0 if lattice.resolution < 1.0 else 0.95) * sizes.sum()


def test_obstacles_are_clearly_different() -> None:
    """Kinds of obstacles, and the share of the room that the padding closes."""
    worlds = [load_world(name) for name in ENVIRONMENTS]
    kinds = [(len(w.boxes.center), len(w.cylinders.center), len(w.capsules.center)) for w in worlds]
    assert all(a != b for a, b in itertools.combinations(kinds, 2))
    assert kinds[1][0] > 3 * kinds[1][1]  # walls
    assert kinds[2][1] > 2 * kinds[2][0]  # pillars


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_stored_targets_keep_their_distance(name: str) -> None:
    world, stored = load_world(name), targets(name)
    assert len(stored["trajectories"]) == 10
    routed = "" if name == "env1" else " --routed"
    assert stored["command"] == f"python -m experiments.generate_targets --world {name} --count 10 --seed 1{routed}"
    ends = set()
    for trajectory in stored["trajectories"].values():
        spline = target_spline(np.array(trajectory["waypoints"]), np.array(trajectory["durations"]))
        curve = spline.evaluate(np.linspace(0.0, float(spline.duration), 2000))[:, :3]
        assert distance(world, curve).min() > 0.499  # the waypoints are rounded to 0.1 mm after the check
        ends.add(tuple(np.round(curve[-1], 3)))
    assert len(ends) == 10


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_targets_pass_obstacles_on_both_sides(name: str) -> None:
    """Several homotopy classes: seen from the start, most targets are hidden at times and in sight at others."""
    world = load_world(name)
    mixed = 0
    for trajectory in targets(name)["trajectories"].values():
        spline = target_spline(np.array(trajectory["waypoints"]), np.array(trajectory["durations"]))
        curve = spline.evaluate(np.linspace(0.0, float(spline.duration), 60))[:, :3]
        lines = world.start + np.linspace(0.0, 1.0, 400)[:, None, None] * (curve - world.start)
        hidden = (distance(world, lines) < 0.0).any(axis=0)
        mixed += 0 < hidden.sum() < len(curve)
    assert mixed >= 5
