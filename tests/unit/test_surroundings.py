"""What a refinement is told of a world: the same shapes whatever it holds, and the distances that matter to it."""

import jax
import numpy as np
import pytest
import trimesh

from jaxplan.compilation import compilations
from jaxplan.planner import PlannerConfig, RefinementConfig, Seed, build_planner
from jaxplan.planner.surroundings import AROUND, CAPACITY, surroundings
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.search.kernels.solids import BOX, solids_of
from jaxplan.spline import PiecewisePolynomial, hover
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.clearance import clearance
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World, aligned_boxes, make_obstacles
from tolerances import tolerance

STORED = ("env1", "env2", "env3")


def a_line(world, count=24):
    """Places across the middle of a room."""
    lower, upper = np.asarray(world.bounds)
    return lower + np.linspace(0.2, 0.8, count)[:, None] * (upper - lower)


def shapes_of(obstacles):
    return [np.shape(leaf) for leaf in jax.tree.leaves(obstacles)]


@pytest.mark.parametrize("name", STORED)
def test_stored_rooms_are_told_in_full(name, x64):
    world = load_world(name)
    told, line = surroundings(solids_of(world), a_line(world)), a_line(world, 200)
    np.testing.assert_allclose(clearance(told, line), clearance(world, line), **tolerance("solve"))


def test_shapes_are_those_of_any_other_world():
    told = [surroundings(solids_of(world), a_line(world)) for world in map(load_world, STORED)]
    assert shapes_of(told[0]) == shapes_of(told[1]) == shapes_of(told[2])


def test_of_many_obstacles_the_nearest_are_told(x64):
    """Along a line through 20 x 20 boxes distances stay exact although most of the boxes are left out."""
    corners = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0), [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    obstacles = make_obstacles(boxes=aligned_boxes(corners + 0.4, corners + np.array([0.6, 0.6, 3.0])))
    bounds = np.array([[0.0, 0.0, 0.0], [20.0, 20.0, 3.0]])
    world = World(name="forest", bounds=bounds, obstacles=obstacles, keep_in=0.2)
    line = np.linspace([3.0, 5.1, 1.0], [8.0, 5.2, 1.5], 24)
    told = surroundings(solids_of(world), line)
    assert len(told.boxes.center) == CAPACITY[BOX] < len(corners)
    np.testing.assert_allclose(clearance(told, line), clearance(world, line), **tolerance("solve"))


@pytest.mark.parametrize("length", [3.0, 12.0])
def test_of_a_mesh_the_distances_around_are_told_never_too_large(length, tmp_path, x64):
    """A long path is told on a coarser grid: distances fall short by more then, and are never beyond the true one."""
    pillars, floor = np.stack([np.arange(1.0, 14.0, 1.5), np.full(9, 1.5), np.ones(9)], axis=1), [7.0, 1.5, -0.05]
    places, half = np.vstack([pillars, floor]), np.vstack([np.tile([0.25, 0.25, 1.0], (9, 1)), [7.5, 3.0, 0.05]])
    moved = [trimesh.transformations.translation_matrix(place) for place in places]
    blocks = trimesh.util.concatenate([trimesh.creation.box(*one) for one in zip(2.0 * half, moved, strict=True)])
    blocks.export(tmp_path / "blocks.stl")
    world = load_world(tmp_path / "blocks.stl")
    line = np.linspace([0.5, 0.7, 1.0], [0.5 + length, 0.7, 1.0], 24)
    told = surroundings(solids_of(world), line)
    exact = clearance(make_obstacles(boxes=aligned_boxes(places - half, places + half)), line)
    found, spacing = np.asarray(clearance(told, line)), float(told.mesh.spacing)
    assert spacing == pytest.approx(0.1 if length < 4.0 else 0.3)
    assert (found <= exact + 1e-3).all()
    assert (found >= exact - 0.9 * spacing - 1e-3).all()
    beside = line - np.array([0.0, AROUND / 2.0, 0.0])
    assert np.isfinite(clearance(told, beside)).all()


def test_a_planner_in_another_world_refines_without_compiling():
    """Nothing but the roadmap and what looks at all obstacles depends on how many there are."""
    config = PlannerConfig(refinement=RefinementConfig())
    planner = build_planner(config, world=load_world("env1"), vehicle=load_vehicle(), policy=constant_speed_policy())
    start = np.array([0.0, 0.0, 1.0])
    times = 0.1 * np.arange(1, 20)
    line = start + times[:, None] * np.array([0.5, 0.1, 0.0])
    candidates = candidates_from(line[0], line, times, np.zeros(len(line)))
    still = PiecewisePolynomial(durations=np.ones(2), position=np.zeros((2, 10, 3)), yaw=np.zeros((2, 6)))
    seed = Seed(still, 0.0, 1.0, start, 1.0)
    assert planner.refine(hover(start), candidates, seed) is not None
    compiled = compilations()
    for name in ("env2", "env3"):
        assert planner.in_world(load_world(name)).refine(hover(start), candidates, seed) is not None
    assert compilations() == compiled
