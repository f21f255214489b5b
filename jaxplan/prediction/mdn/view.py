"""What the network is shown of a target: its newest positions, and how far away everything is around it (host).

All is seen from the newest position, with x along the velocity as far as that is level and z up, and measured in the
way that the target would go on in ``STEPS`` intervals, so that flights of all speeds look alike but for that unit.
Distances to obstacles, in metres, are looked up at ``PROBES``: in these units fixed places on rays, most of them ahead.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.prediction.survival import Surroundings

OBSERVATIONS, STEPS = 10, 20
"""Positions that are looked at, and that are foretold."""
SCALES = (1.0, 40.0)
"""Least and largest unit of length [m]."""
NEAR, FAR = -1.0, 2.0
"""Distances [m] between which differences count; in open space everything is ``FAR``."""
_RECENT = 3
"""Intervals from which the velocity is taken, so that noise counts less."""
_RADII = (0.1, 0.2, 0.35, 0.5, 0.75, 1.0)
_LEVEL = (0.0, 15.0, 30.0, 50.0, 75.0, 105.0, 140.0, 180.0)
_SLOPING, _SLOPE = (0.0, 45.0, 100.0, 180.0), 30.0
"""Degrees from straight ahead, to both sides, in the plane and as far above and below it."""


class View(NamedTuple):
    """n targets as each sees itself; float32."""

    relative: Float[AnyArray, "n 9 3"]
    """Earlier positions, oldest first, in units of ``scale``; 0 where none was seen."""
    seen: Float[AnyArray, "n 9"]
    """1 where one was, else 0."""
    scale: Float[AnyArray, "n"]
    """Unit of length [m]."""
    interval: Float[AnyArray, "n"]
    """Seconds between positions."""
    room: Float[AnyArray, "n p"]
    """Distances to what is nearest [m] at the probes."""


class Frame(NamedTuple):
    """Where n targets see from."""

    newest: Float[np.ndarray, "n 3"]
    """Their positions [m, world]."""
    axes: Float[np.ndarray, "n 3 3"]
    """Their x, y and z (rows) in the world."""
    scale: Float[np.ndarray, "n"]
    """Their units of length [m]."""

    def only(self, number: int) -> "Frame":
        """That of one of them, still as a batch."""
        return Frame(*(part[number, None] for part in self))

    def to_own(self, positions: Float[np.ndarray, "n l 3"]) -> Float[np.ndarray, "n l 3"]:
        """Positions [m, world] as each sees them."""
        apart = (positions - self.newest[:, None]) @ np.swapaxes(self.axes, 1, 2)
        return np.asarray(apart / self.scale[:, None, None])

    def to_world(self, own: Float[np.ndarray, "n l 3"]) -> Float[np.ndarray, "n l 3"]:
        """The inverse."""
        return np.asarray(self.newest[:, None] + self.scale[:, None, None] * (own @ self.axes))


def frame_of(positions: Float[np.ndarray, "n 10 3"], count: Int[np.ndarray, "n"]) -> Frame:
    """From the newest ``count`` positions of each [m, world], at least two; the others may have any finite value."""
    since = np.minimum(count - 1, _RECENT)
    newest = positions[:, -1]
    step = (newest - positions[np.arange(len(positions)), OBSERVATIONS - 1 - since]) / since[:, None]
    level = np.hypot(step[:, 0], step[:, 1])
    along = np.where(level > 0.0, level, 1.0)
    cos, sin = np.where(level > 0.0, step[:, 0] / along, 1.0), step[:, 1] / along
    axes = np.zeros((len(positions), 3, 3))
    axes[:, 0, 0], axes[:, 0, 1], axes[:, 1, 0], axes[:, 1, 1], axes[:, 2, 2] = cos, sin, -sin, cos, 1.0
    return Frame(newest, axes, np.clip(STEPS * np.linalg.norm(step, axis=1), *SCALES))


def view_of(
    frame: Frame,
    positions: Float[np.ndarray, "n 10 3"],
    count: Int[np.ndarray, "n"],
    interval: float,
    room: Surroundings | None,
) -> View:
    """What is seen from a frame.

    Args:
        frame: as ``frame_of`` makes it of the same positions.
        positions: oldest first [m, world]; the newest ``count`` of each are looked at.
        count: how many.
        interval: between them [s].
        room: where all are; None: nothing is known of it.
    """
    seen = (np.arange(OBSERVATIONS - 1) >= OBSERVATIONS - count[:, None]).astype(np.float32)
    relative = frame.to_own(positions[:, :-1]).astype(np.float32) * seen[..., None]
    distances = np.full((len(positions), len(PROBES)), np.float32(FAR))
    if room is not None:
        places = np.ascontiguousarray(frame.to_world(np.broadcast_to(PROBES, (len(positions), *PROBES.shape))))
        distances = room.free_distances(places.reshape(-1, 3)).reshape(distances.shape)
        distances = np.clip(distances, NEAR, FAR).astype(np.float32)
    scale = frame.scale.astype(np.float32)
    return View(relative, seen, scale, np.full(len(positions), np.float32(interval)), distances)


def mirrored(view: View) -> View:
    """The same with left and right exchanged; of NumPy or JAX arrays."""
    flip = np.array([1.0, -1.0, 1.0], np.float32)[None, None]
    return view._replace(relative=view.relative * flip, room=view.room[:, _MIRRORED])


def _probes() -> Float[np.ndarray, "p 3"]:
    fans = [(_LEVEL, 0.0), (_SLOPING, _SLOPE), (_SLOPING, -_SLOPE), ((0.0,), 90.0), ((0.0,), -90.0)]
    rays = [
        (side * angle, slope)
        for angles, slope in fans
        for angle in angles
        for side in ((1.0, -1.0) if 0.0 < angle < 180.0 else (1.0,))
    ]
    azimuth, elevation = np.deg2rad(np.array(rays)).T
    level = np.cos(elevation)
    ways = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
    return np.concatenate([np.zeros((1, 3)), (np.array(_RADII)[:, None, None] * ways).reshape(-1, 3)])


def _mirror_images(probes: Float[np.ndarray, "p 3"]) -> Int[np.ndarray, "p"]:
    flipped = probes * np.array([1.0, -1.0, 1.0])
    return np.linalg.norm(probes[:, None] - flipped, axis=-1).argmin(axis=0)


PROBES: Float[np.ndarray, "p 3"] = _probes()
_MIRRORED = _mirror_images(PROBES)
