"""Worlds as triangles: closed, turned outwards, of the right size."""

import numpy as np
import pytest

from jaxplan.viz.surface import (
    Surface,
    coarsened,
    cut_height,
    joined,
    level_surface,
    padding_surface,
    world_surface,
)
from jaxplan.world.obstacles import (
    Capsules,
    Cylinders,
    DistanceGrid,
    Mesh,
    Spheres,
    World,
    aligned_boxes,
    make_obstacles,
)
from jaxplan.world.occupancy import exact_clearance

UP = np.array([[0.0, 0.0, 1.0]])


def volume(surface: Surface) -> float:
    """By the divergence theorem: of a closed surface whose triangles are counter-clockwise from outside [m^3]."""
    a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
    return float(np.einsum("fa,fa->", a, np.cross(b, c)) / 6.0)


def is_closed(surface: Surface) -> bool:
    """Every edge belongs to two triangles, which run through it in opposite directions."""
    ways = surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    there, back = (set(map(tuple, pairs.tolist())) for pairs in (ways, ways[:, ::-1]))
    return len(there) == len(ways) and there == back


def world(**obstacles: object) -> World:
    bounds = np.array([[-4.0, -4.0, -4.0], [4.0, 4.0, 4.0]])
    return World(name="x", bounds=bounds, obstacles=make_obstacles(**obstacles), keep_in=np.float64(0.1))


SIZES = {"radius": np.array([0.8]), "half_length": np.array([1.0])}
CENTRE = np.array([[0.5, -0.3, 0.2]])
SOLIDS = {
    "box": ({"boxes": aligned_boxes([[-1, -1, -1]], [[1, 0, 2]])}, 2 * 1 * 3, 1e-9),
    "cylinder": ({"cylinders": Cylinders(center=CENTRE, axis=UP, **SIZES)}, np.pi * 0.64 * 2, 0.02),
    "sphere": ({"spheres": Spheres(center=CENTRE, radius=np.array([0.8]))}, 4 / 3 * np.pi * 0.512, 0.05),
    "capsule": ({"capsules": Capsules(center=CENTRE, axis=UP, **SIZES)}, np.pi * (0.64 * 2 + 4 / 3 * 0.512), 0.05),
}


@pytest.mark.parametrize("kind", SOLIDS)
def test_a_solid_has_its_volume(kind: str) -> None:
    obstacles, wanted, facets = SOLIDS[kind]
    surface = world_surface(world(**obstacles))
    assert volume(surface) == pytest.approx(wanted, rel=max(facets, 1e-9))  # inscribed facets take some
    assert volume(surface) <= wanted * (1.0 + 1e-9)


def cells() -> World:
    rng = np.random.default_rng(0)
    occupied = rng.uniform(size=(7, 6, 5)) < 0.3
    squared = np.zeros((8, 7, 6))
    return world(voxels=DistanceGrid(occupied=occupied, squared=squared, origin=np.full(3, -1.0), spacing=0.5))


def test_occupied_cells_have_their_volume() -> None:
    room = cells()
    assert room.voxels is not None
    surface = world_surface(room)
    assert volume(surface) == pytest.approx(0.125 * np.asarray(room.voxels.occupied).sum())
    assert surface.vertices.min() >= -1.0


def test_many_cells_become_larger_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jaxplan.viz.surface.MOST_FACES", 150)
    room = cells()
    assert room.voxels is not None
    surface = world_surface(room)
    assert 0 < len(surface.faces) <= 150
    assert volume(surface) >= 0.125 * np.asarray(room.voxels.occupied).sum()  # nothing that is solid is lost


def test_a_mesh_is_its_own_triangles() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    mesh = Mesh(vertices=vertices, faces=faces, squared=np.zeros((2, 2, 2)), origin=np.zeros(3), spacing=1.0)
    surface = world_surface(world(mesh=mesh))
    assert volume(surface) == pytest.approx(1.0 / 6.0)
    assert is_closed(surface)


def test_a_world_without_obstacles_is_nothing() -> None:
    assert len(world_surface(world()).faces) == 0
    assert len(padding_surface(world(), 0.5).faces) == 0


@pytest.mark.parametrize("kind", ["box", "capsule"])
def test_the_padding_is_so_far_from_the_obstacles(kind: str) -> None:
    """The oracle is the exact distance, which the grid that traced the surface knows at its nodes only."""
    room = world(**SOLIDS[kind][0])
    surface = padding_surface(room, 0.5)
    assert is_closed(surface)
    assert volume(surface) > volume(world_surface(room))
    away = exact_clearance(room.obstacles, surface.vertices)
    np.testing.assert_allclose(away, 0.5, atol=0.03)  # m; the grid's side is 0.15


def test_a_level_surface_of_a_ball() -> None:
    side = np.linspace(-1.5, 1.5, 31)
    nodes = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1)
    surface = level_surface(np.linalg.norm(nodes, axis=-1) - 1.0, np.full(3, -1.5), np.full(3, 0.1))
    assert is_closed(surface)
    assert volume(surface) == pytest.approx(4 / 3 * np.pi, rel=0.02)
    np.testing.assert_allclose(np.linalg.norm(surface.vertices, axis=1), 1.0, atol=0.01)  # m, of cells of 0.1


def test_coarser_triangles_keep_the_shape() -> None:
    side = np.linspace(-1.5, 1.5, 61)
    nodes = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1)
    ball = level_surface(np.linalg.norm(nodes, axis=-1) - 1.0, np.full(3, -1.5), np.full(3, 0.05))
    coarse = coarsened(ball, most=2000)
    assert 200 < len(coarse.faces) <= 2000 < len(ball.faces)
    assert volume(coarse) == pytest.approx(volume(ball), rel=0.1)
    assert coarsened(coarse, most=2000).faces.shape == coarse.faces.shape


def test_a_room_with_a_ceiling_is_cut_open() -> None:
    ceiling = world_surface(world(boxes=aligned_boxes([[-3, -3, 2]], [[3, 0, 3]])))
    flight = np.array([[0.0, y, 1.0 + 0.1 * y] for y in np.linspace(-2.5, 2.5, 60)])
    assert cut_height(ceiling, flight[:20]) == pytest.approx(flight[19, 2] + 0.4)
    assert cut_height(ceiling, flight[35:]) == np.inf  # in the open
    assert cut_height(ceiling, flight[:20] + np.array([0.0, 0.0, 5.0])) == np.inf  # above it


def test_surfaces_are_joined_without_mixing() -> None:
    box = world_surface(world(boxes=aligned_boxes([[0, 0, 0]], [[1, 1, 1]])))
    both = joined([box, Surface(box.vertices + 2.0, box.faces)])
    assert volume(both) == pytest.approx(2.0 * volume(box))
