"""Rooms with what is solid of every kind, for everything that takes distances."""

import functools

import numpy as np

from jaxplan.world.load import ENVIRONMENTS, load_world
from jaxplan.world.mesh import mesh_with_distances
from jaxplan.world.obstacles import Boxes, Capsules, Cylinders, Planes, Spheres, World, make_obstacles
from jaxplan.world.voxels import distance_grid


def room_of_all_kinds() -> World:
    """A box turned about the vertical, a pillar, a slope, a ball and a rod."""
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    obstacles = make_obstacles(
        boxes=Boxes(center=np.array([[1.5, 1.0, 1.0]]), half=np.array([[0.4, 0.2, 1.0]]), rotation=turn[None]),
        cylinders=Cylinders(
            center=np.array([[-1.5, 1.0, 1.0]]),
            axis=np.array([[0.0, 0.0, 1.0]]),
            radius=np.full(1, 0.3),
            half_length=np.ones(1),
        ),
        planes=Planes(normal=np.array([[0.0, 0.6, 0.8]]), offset=np.full(1, -1.2)),
        spheres=Spheres(center=np.array([[0.0, -1.0, 1.2]]), radius=np.full(1, 0.4)),
        capsules=Capsules(
            center=np.array([[1.5, -1.5, 1.0]]),
            axis=np.array([[1.0, 0.0, 0.0]]),
            radius=np.full(1, 0.1),
            half_length=np.ones(1),
        ),
    )
    return World(name="all", bounds=np.array([[-3.0, -3, 0], [3, 3, 2.5]]), obstacles=obstacles, keep_in=0.2)


def room_of_grids() -> World:
    """A mesh, a pyramid, and occupied cells, both known by distances at nodes."""
    vertices = np.array([[-1.0, -1.0, 0.0], [0.5, -1.0, 0.0], [-0.2, 0.4, 0.0], [-0.3, -0.5, 1.8]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3]], np.int32)
    occupied = np.zeros((60, 60, 25), bool)
    occupied[38:42, 10:50, :12] = True
    grid = distance_grid(occupied, np.array([-3.0, -3.0, 0.0]), 0.1)
    obstacles = make_obstacles(mesh=mesh_with_distances(vertices, faces), voxels=grid)
    return World(name="grids", bounds=np.array([[-3.0, -3, 0], [3, 3, 2.5]]), obstacles=obstacles, keep_in=0.2)


WORLDS = {"all kinds": room_of_all_kinds, "grids": room_of_grids} | {
    name: functools.partial(load_world, name) for name in ENVIRONMENTS
}
