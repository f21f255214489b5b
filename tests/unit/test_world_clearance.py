"""Exact clearance against MuJoCo's own distances, against other formulas, and what it promises beyond numbers."""

import inspect

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplan.errors import InputError
from jaxplan.records import replace
from jaxplan.world.clearance import clearance, free_distance, wall_clearance
from jaxplan.world.load import ENVIRONMENTS, environment_path, load_world
from jaxplan.world.mesh import mesh_with_distances
from jaxplan.world.obstacles import (
    Boxes,
    Capsules,
    Cylinders,
    Obstacles,
    Planes,
    Spheres,
    World,
    aligned_boxes,
    make_obstacles,
)
from jaxplan.world.voxels import distance_grid
from oracles import world_distance
from tolerances import assert_close, relative, tolerance

compiled = jax.jit(clearance)

pytestmark = pytest.mark.usefixtures("x64")


def random_obstacles(seed: int, count: int = 3) -> Obstacles:
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    place = [rng.uniform(-2.0, 2.0, (count, 3)) for _ in range(4)]
    return make_obstacles(
        boxes=Boxes(center=place[0], half=rng.uniform(0.1, 0.8, (count, 3)), rotation=rotation),
        cylinders=Cylinders(
            center=place[1],
            axis=rotation[:, :, 0],
            radius=rng.uniform(0.1, 0.6, count),
            half_length=rng.uniform(0.1, 1.0, count),
        ),
        spheres=Spheres(center=place[2], radius=rng.uniform(0.1, 0.6, count)),
        capsules=Capsules(
            center=place[3],
            axis=rotation[:, :, 1],
            radius=rng.uniform(0.1, 0.4, count),
            half_length=rng.uniform(0.1, 1.0, count),
        ),
        planes=Planes(normal=rotation[:1, :, 2], offset=np.array([-2.5])),
    )


def oracle(obstacles: Obstacles, point: np.ndarray) -> float:
    b, c, s, k, p = obstacles.boxes, obstacles.cylinders, obstacles.spheres, obstacles.capsules, obstacles.planes
    values = [world_distance.box(point, *row) for row in zip(b.center, b.half, b.rotation, strict=True)]
    values += [
        world_distance.cylinder(point, *row) for row in zip(c.center, c.axis, c.radius, c.half_length, strict=True)
    ]
    values += [np.linalg.norm(point - center) - radius for center, radius in zip(s.center, s.radius, strict=True)]
    values += [
        world_distance.capsule(point, *row) for row in zip(k.center, k.axis, k.radius, k.half_length, strict=True)
    ]
    values += [float(normal @ point - offset) for normal, offset in zip(p.normal, p.offset, strict=True)]
    return min(values)


@given(seed=st.integers(0, 2**32 - 1))
def test_equals_other_formulas(seed: int) -> None:
    obstacles = random_obstacles(seed)
    points = np.random.default_rng(seed + 1).uniform(-3.0, 3.0, (20, 3))
    with jax.enable_x64(True):
        assert_close(compiled(obstacles, points), [oracle(obstacles, point) for point in points], "formula")


def test_inside_of_overlapping_obstacles_is_the_deepest() -> None:
    obstacles = make_obstacles(
        boxes=aligned_boxes(np.array([[0.0, 0, 0], [0.2, 0.2, 0.2]]), np.array([[1.0, 1, 1], [2.0, 2, 2]])),
    )
    assert_close(clearance(obstacles, np.array([0.5, 0.5, 0.5])), -0.5, "exact")


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_environments_equal_mujoco(name: str) -> None:
    """A mocap sphere of 1 mm is put at random free points; MuJoCo's distance to the nearest geom plus 1 mm."""
    spec = mujoco.MjSpec.from_file(str(environment_path(name)))
    probe = spec.worldbody.add_body(name="probe", mocap=True)
    probe.add_geom(name="probe", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-3, 0, 0])
    model = spec.compile()
    state, world = mujoco.MjData(model), load_world(name)
    solid = [g for g in range(model.ngeom - 1) if model.geom_contype[g] or model.geom_conaffinity[g]]
    points = np.random.default_rng(0).uniform(world.bounds[0], world.bounds[1], (3500, 3))
    ours = np.asarray(compiled(world, points))
    for point, value in zip(points[ours > 0.01], ours[ours > 0.01], strict=True):
        state.mocap_pos[0] = point
        mujoco.mj_kinematics(model, state)
        theirs = min(mujoco.mj_geomDistance(model, state, model.ngeom - 1, g, 50.0, None) for g in solid) + 1e-3
        assert value == pytest.approx(theirs, **relative("solve"))


def test_points_that_are_not_finite_are_never_clear() -> None:
    empty = make_obstacles()
    bad = np.array([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf]])
    for obstacles in (empty, random_obstacles(0), load_world("env1").obstacles):
        assert not (np.asarray(compiled(obstacles, bad)) >= 0.0).any()
    assert np.isinf(clearance(empty, np.zeros(3)))
    world = load_world("env1")
    assert not (np.asarray(wall_clearance(world, bad)) >= 0.0).any()


@pytest.mark.parametrize("shape", [(), (2,), (5, 2), (3, 4)])
def test_points_without_three_coordinates_are_refused(shape: tuple[int, ...]) -> None:
    """Two coordinates would broadcast, and pass for a point; the tests' own look at annotations is gone around."""
    with pytest.raises(InputError, match=r"want \(..., 3\)"):
        inspect.unwrap(clearance)(make_obstacles(), np.zeros(shape))


def test_wall_clearance() -> None:
    world = load_world("env1")
    points = np.array([[0.0, 0.0, 0.5], [4.9, 0.0, 1.0], [5.2, 0.0, 1.0], [0.0, 0.0, 2.5]])
    assert_close(wall_clearance(world, points), [0.5, 0.1, -0.2, -0.5], "exact")


def test_free_distance_is_the_nearer_of_obstacle_and_face() -> None:
    """A pillar's face at x = 1.2 m, the ceiling at 2 m, outside the room, inside the pillar, and nowhere."""
    box = aligned_boxes(np.array([[0.8, -0.2, 0.0]]), np.array([[1.2, 0.2, 2.0]]))
    bounds = np.array([[-5.0, -5.0, 0.0], [5.0, 5.0, 2.0]])
    world = World(name="pillar", bounds=bounds, obstacles=make_obstacles(boxes=box), keep_in=0.2)
    points = np.array([[1.5, 0.0, 1.0], [1.9, 0.0, 1.9], [5.3, 0.0, 1.0], [1.1, 0.0, 1.0], [np.nan, 0.0, 1.0]])
    assert_close(free_distance(world, points), [0.3, 0.1, -0.3, -0.1, np.nan], "exact")


def test_one_lipschitz_and_gradient() -> None:
    obstacles = random_obstacles(5)
    points = np.random.default_rng(6).uniform(-3.0, 3.0, (500, 3))
    other = points + np.random.default_rng(7).normal(scale=0.05, size=points.shape)
    change = np.abs(np.asarray(compiled(obstacles, points) - clearance(obstacles, other)))
    assert (change <= np.linalg.norm(points - other, axis=1) + 1e-12).all()
    gradient = np.asarray(jax.jit(jax.grad(lambda p: clearance(obstacles, p).sum()))(jnp.asarray(points)))
    ahead = np.asarray(compiled(obstacles, points + 1e-7 * gradient))
    slope = (ahead - np.asarray(compiled(obstacles, points))) / 1e-7
    assert_close(np.median(slope), 1.0, "gradient")
    assert_close(np.median(np.linalg.norm(gradient, axis=1)), 1.0, "gradient")


@pytest.mark.parametrize("kind", ["boxes", "cylinders", "spheres", "capsules", "planes"])
def test_gradient_is_finite_at_centres_faces_and_edges(kind: str) -> None:
    everything = make_obstacles(
        boxes=aligned_boxes(-np.ones((1, 3)), np.ones((1, 3))),
        cylinders=Cylinders(
            center=np.zeros((1, 3)), axis=np.array([[0, 0, 1.0]]), radius=np.ones(1), half_length=np.ones(1)
        ),
        spheres=Spheres(center=np.zeros((1, 3)), radius=np.ones(1)),
        capsules=Capsules(
            center=np.zeros((1, 3)), axis=np.array([[0, 0, 1.0]]), radius=np.ones(1), half_length=np.ones(1)
        ),
        planes=Planes(normal=np.array([[0, 0, 1.0]]), offset=np.zeros(1)),
    )
    obstacles = make_obstacles(**{kind: getattr(everything, kind)})
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 0, 1], [0, 0, 2], [1, 0, 1], [0, 0, 5.0]])
    assert np.isfinite(jax.grad(lambda p: clearance(obstacles, p).sum())(jnp.asarray(points))).all()


def test_jit_vmap_and_loop_agree_with_one_bad_lane() -> None:
    obstacles = random_obstacles(9)
    points = np.random.default_rng(10).uniform(-3.0, 3.0, (4, 5, 3))
    points[2, 3] = np.nan
    eager = clearance(obstacles, points)
    assert_close(compiled(obstacles, points), eager, "exact")
    assert_close(jax.vmap(clearance, (None, 0))(obstacles, points), eager, "exact")
    assert np.isnan(eager[2, 3])
    assert np.isnan(eager).sum() == 1
    rows = [[compiled(obstacles, point) for point in row] for row in points]
    assert_close(rows, eager, "exact")


def test_a_world_is_a_jit_argument_and_compiles_once(compilations) -> None:  # type: ignore[no-untyped-def]
    function = jax.jit(lambda world, points: clearance(world, points))
    world = load_world("env1")
    points = jnp.asarray(np.random.default_rng(0).uniform(-5.0, 5.0, (50, 3)))
    function(world, points).block_until_ready()
    compilations.count = 0
    function(load_world("env1"), points + 0.0).block_until_ready()
    assert compilations.count <= 1  # the addition


def central_differences(obstacles: Obstacles, points: np.ndarray, step: float) -> np.ndarray:
    slopes = [
        np.asarray(compiled(obstacles, points + axis) - compiled(obstacles, points - axis)) for axis in step * np.eye(3)
    ]
    return np.stack(slopes, axis=-1) / (2.0 * step)


compiled_gradient_of_points = jax.jit(jax.grad(lambda points, obstacles: clearance(obstacles, points).sum()))


def test_gradient_equals_finite_differences() -> None:
    """Apart from the few points between two nearest surfaces."""
    obstacles = random_obstacles(11, count=12)
    points = np.random.default_rng(12).uniform(-3.0, 3.0, (400, 3))
    gradient = np.asarray(compiled_gradient_of_points(points, obstacles))
    agree = np.isclose(gradient, central_differences(obstacles, points, 1e-6), **tolerance("gradient")).all(axis=1)
    assert agree.mean() > 0.99


def test_gradient_towards_obstacles_equals_finite_differences() -> None:
    """Moving and growing all boxes: the derivative of the sum over many points."""
    obstacles = make_obstacles(boxes=random_obstacles(13).boxes)
    points = np.random.default_rng(14).uniform(-3.0, 3.0, (300, 3))
    towards = jax.grad(lambda obstacles: compiled(obstacles, points).sum())(obstacles).boxes

    def moved(amount: float) -> float:
        boxes = obstacles.boxes
        changed = Boxes(center=boxes.center + amount, half=boxes.half * (1 + amount), rotation=boxes.rotation)
        return float(compiled(replace(obstacles, boxes=changed), points).sum())

    slope = (moved(1e-6) - moved(-1e-6)) / 2e-6
    assert_close(np.sum(towards.center) + np.sum(towards.half * obstacles.boxes.half), slope, "gradient")


@pytest.mark.parametrize("kind", ["voxels", "mesh"])
def test_gradient_of_grids_equals_finite_differences(kind: str) -> None:
    """Inside cells of the distance grid, where the bound is smooth and above 0."""
    rng = np.random.default_rng(15)
    if kind == "voxels":
        grid = distance_grid(rng.random((20, 18, 12)) < 0.01, np.zeros(3), 0.1)
    else:
        grid = mesh_with_distances(*tetrahedron_and_shelf())
    obstacles = make_obstacles(**{kind: grid})
    shape = np.array(grid.squared.shape)
    cells = rng.integers(0, shape - 1, (500, 3)) + rng.uniform(0.05, 0.95, (500, 3))
    points = np.asarray(grid.origin) + cells * float(grid.spacing)
    points = points[np.asarray(compiled(obstacles, points)) > 0.02]
    assert len(points) > 300
    gradient = np.asarray(compiled_gradient_of_points(points, obstacles))
    np.testing.assert_allclose(gradient, central_differences(obstacles, points, 1e-6), **tolerance("gradient"))
    outside = points + np.array([0.0, 0.0, 10.0])
    gradient = np.asarray(compiled_gradient_of_points(outside, obstacles))
    np.testing.assert_allclose(gradient, central_differences(obstacles, outside, 1e-6), **tolerance("gradient"))


def tetrahedron_and_shelf() -> tuple[np.ndarray, np.ndarray]:
    """A slanted tetrahedron, a long thin triangle and a degenerate one."""
    vertices = np.array(
        [[0, 0, 0], [1.3, 0.1, 0.2], [0.3, 1.1, 0.4], [0.4, 0.2, 1.2], [-1, -1, 0.5], [2, 2.0, 0.6], [2, 1.9, 0.7]]
    )
    return vertices, np.array([[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3], [4, 5, 6], [0, 3, 3]])


def test_mesh_never_overestimates_and_is_tight() -> None:
    vertices, faces = tetrahedron_and_shelf()
    obstacles = make_obstacles(mesh=mesh_with_distances(vertices, faces))
    points = np.random.default_rng(0).uniform(vertices.min(0), vertices.max(0), (400, 3))
    truth = np.array([min(world_distance.triangle(p, vertices[face]) for face in faces[:5]) for p in points])
    ours = np.asarray(compiled(obstacles, points))
    assert (ours <= truth + 1e-9).all()
    assert (ours >= 0.0).all()
    assert (ours**2 >= np.maximum(truth - np.sqrt(0.75) * 0.1, 0.0) ** 2 - 0.75 * 0.1**2 - 1e-9).all()
    assert np.median(truth - ours) < 0.005


def test_mesh_outside_its_grid_is_bounded_by_the_truth() -> None:
    """No clamping surprise: far outside, the distance grows with the point."""
    vertices, faces = tetrahedron_and_shelf()
    obstacles = make_obstacles(mesh=mesh_with_distances(vertices, faces))
    points = np.random.default_rng(1).normal(size=(200, 3)) * [3.0, 3.0, 30.0]
    truth = np.array([min(world_distance.triangle(p, vertices[face]) for face in faces[:5]) for p in points])
    ours = np.asarray(compiled(obstacles, points))
    assert (ours <= truth + 1e-9).all()
    assert (ours >= truth - np.linalg.norm(np.ptp(vertices, axis=0)) - 0.5).all()
    assert not (np.asarray(compiled(obstacles, np.array([[np.nan, 0, 0], [1e300, 0, np.inf]]))) >= 0.0).any()


def test_mesh_gradient_is_finite_everywhere() -> None:
    vertices, faces = tetrahedron_and_shelf()
    obstacles = make_obstacles(mesh=mesh_with_distances(vertices, faces))
    points = np.concatenate([vertices, vertices.mean(0, keepdims=True), vertices + 10.0, vertices - 10.0])
    assert np.isfinite(jax.grad(lambda p: clearance(obstacles, p).sum())(jnp.asarray(points))).all()


def test_target_of_the_example_scenario_is_clear_in_its_arena(examples) -> None:  # type: ignore[no-untyped-def]
    """Exact minimum, against trimesh: 0.814 m; the padding of 0.5 m leaves the whole flight free."""
    import trimesh

    path = examples / "maps" / "kr_skir.stl"
    world = load_world(path)
    flight = np.loadtxt(examples / "scenarios" / "oda_010__in__kr_skir_0.csv", delimiter=",", skiprows=1)[:, 1:]
    ours = np.asarray(compiled(world, flight))
    sample = slice(None, None, 40)
    truth = trimesh.proximity.closest_point_naive(trimesh.load(path), flight[sample])[1]
    assert (ours[sample] <= truth + 1e-9).all()
    assert (ours[sample] >= truth - 0.025).all()
    assert ours.min() > 0.8
    assert np.asarray(wall_clearance(world, flight)).min() > 0.8


def test_bad_worlds_are_refused() -> None:
    for bounds in ([[0, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, np.nan, 1]], [[2, 0, 0], [1, 1, 1]]):
        with pytest.raises(InputError, match="bounds"):
            World(name="w", bounds=np.array(bounds, float), obstacles=make_obstacles(), keep_in=np.float64(0.1))
    for keep_in in (-0.1, np.nan, 0.5):
        with pytest.raises(InputError, match="keep_in"):
            World(name="w", bounds=np.array([[0.0] * 3, [1.0] * 3]), obstacles=make_obstacles(), keep_in=keep_in)
