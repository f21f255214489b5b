"""Random rooms to train in: other ones than the three in which the planner is tested.

Every room has the same number of obstacles of each kind, the unused ones out of sight, so that all rooms share the
compiled functions of one.
"""

import numpy as np
from jaxtyping import Float

from jaxplan.world.obstacles import Cylinders, Spheres, World, aligned_boxes, make_obstacles

BOXES, CYLINDERS, SPHERES = 24, 24, 8
"""Obstacles of each kind in every room."""
SIZES = np.array([[8.0, 8.0, 2.0], [32.0, 18.0, 5.0]])
"""Least and largest sides of a room [m]; the rooms of the paper lie between them."""
SHARES = {"pillars": 0.3, "boxes": 0.25, "walls": 0.2, "mixed": 0.2, "open": 0.05}
"""How often each layout is drawn (arbitrary)."""
DOOR = (1.6, 3.0)
"""Width [m] of the gaps in walls."""
WALL = 0.2
"""Thickness [m] of walls."""
FAR = -1e3
"""Where unused obstacles are [m]."""


def random_world(rng: np.random.Generator, index: int) -> World:
    """A room of random size and layout; ``index`` names it."""
    size = rng.uniform(*SIZES)
    layout = rng.choice(list(SHARES), p=list(SHARES.values()))
    crowd = rng.uniform(0.3, 1.0) * size[0] * size[1] / 12.0
    few = int(np.clip(crowd, 2, 24))
    counts = {"pillars": (0, few, 0), "boxes": (few, 0, 0), "mixed": (few // 2, few // 2, min(few // 3, SPHERES))}
    boxes, cylinders, spheres = counts.get(layout, (0, 0, 0))
    lower, upper = _walls(rng, size) if layout == "walls" else _blocks(rng, size, boxes)
    return World(
        name=f"training-{index:05d}",
        bounds=np.stack([np.zeros(3), size]),
        obstacles=make_obstacles(
            boxes=aligned_boxes(_fill(lower, BOXES), _fill(upper, BOXES, 0.1)),
            cylinders=_pillars(rng, size, cylinders),
            spheres=_balls(rng, size, spheres),
        ),
        keep_in=np.array(0.2),
        provenance=f"random {layout}",
    )


def _blocks(
    rng: np.random.Generator, size: Float[np.ndarray, "3"], count: int
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Boxes, most of them from floor to ceiling."""
    sides = rng.uniform([0.3, 0.3, 0.3], [2.0, 2.0, size[2]], (count, 3))
    lower = rng.uniform(0.0, 1.0, (count, 3)) * np.maximum(size - sides, 0.0)
    tall = rng.random(count) < 0.7
    lower[tall, 2], sides[tall, 2] = 0.0, size[2]
    return lower, lower + sides


def _walls(
    rng: np.random.Generator, size: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Walls across the room's longer side, each with one or two doors."""
    lower, upper = [], []
    for place in np.sort(rng.uniform(2.0, size[0] - 2.0, rng.integers(1, 6))):
        doors = np.sort(rng.uniform(0.5, size[1] - 0.5 - DOOR[1], rng.integers(1, 3)))
        edges = [0.0]
        for door in doors:
            edges += [max(door, edges[-1]), max(door, edges[-1]) + rng.uniform(*DOOR)]
        edges.append(size[1])
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if end - begin > 0.05:
                lower.append([place, begin, 0.0])
                upper.append([place + WALL, end, size[2]])
    return np.array(lower), np.array(upper)


def _pillars(rng: np.random.Generator, size: Float[np.ndarray, "3"], count: int) -> Cylinders:
    center = np.full((CYLINDERS, 3), FAR)
    center[:count] = rng.uniform(0.0, 1.0, (count, 3)) * size
    center[:count, 2] = size[2] / 2.0
    return Cylinders(
        center=center,
        axis=np.tile([0.0, 0.0, 1.0], (CYLINDERS, 1)),
        radius=rng.uniform(0.15, 0.6, CYLINDERS),
        half_length=np.full(CYLINDERS, size[2] / 2.0),
    )


def _balls(rng: np.random.Generator, size: Float[np.ndarray, "3"], count: int) -> Spheres:
    center = np.full((SPHERES, 3), FAR)
    center[:count] = rng.uniform(0.0, 1.0, (count, 3)) * size
    return Spheres(center=center, radius=rng.uniform(0.2, 0.8, SPHERES))


def _fill(corners: Float[np.ndarray, "n 3"], count: int, side: float = 0.0) -> Float[np.ndarray, "c 3"]:
    """``corners`` and as many far ones as are missing."""
    filled = np.full((count, 3), FAR + side)
    filled[: len(corners)] = corners[:count]
    return filled
