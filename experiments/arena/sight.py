"""What a defender sees of a target: noisy, late, with gaps, and only what nothing stands before.

A sensor with a field of view is a camera on a gimbal: the vehicle holds its heading, so the camera turns by itself, to
where the target was last known to be. Where that is too long ago it turns round and round until it sees the target.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from jaxplan.prediction.stream import ObservationStream
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.obstacles import World

SOLID, STEP = 0.02, 0.05
"""m; nearer to something than this a line of sight is broken; and the shortest step along one."""
STEPS = 200
"""Of a line of sight; one that has not arrived by then runs along something all the way, and counts as broken."""


FORGOTTEN = 1.0
"""s after which where the target was is no use any more: as ``PredictionConfig.lost_after``."""


@dataclasses.dataclass(frozen=True)
class SightConfig:
    """How well a target is seen."""

    noise: float = 0.0
    """Standard deviation along each axis [m]."""
    dropouts: float = 0.0
    """Share of the detections that are lost."""
    latency: float = 0.0
    """Seconds from a detection until it is known."""
    sight_range: float = np.inf
    """m."""
    occluded: bool = False
    """Whether obstacles hide what is behind them."""
    field_of_view: float = 2.0 * np.pi
    """Angle [rad] of the cone in which it sees; with the usual one it sees in all directions."""
    turn_rate: float = 3.0
    """rad/s at which it turns (arbitrary: gimbals of cameras for racing and filming reach 2 to 6)."""


class Sight:
    """A sensor in one episode; ``look_from`` tells it where the defender is."""

    def __init__(self, world: World, config: SightConfig, start: Float[np.ndarray, "3"], seed: int) -> None:
        self.config = config
        self._world, self._from = world, np.asarray(start, dtype=float)
        self._rng = np.random.default_rng((seed, 1))
        self._under_way: list[tuple[float, Float[np.ndarray, "3"]]] = []
        self._known: tuple[float, Float[np.ndarray, "3"]] | None = None
        self.looks, self._turned = np.array([1.0, 0.0, 0.0]), 0.0
        """Where the camera looks: a unit vector [world], at first along the vehicle's heading."""
        self.seen, self.asked = 0, 0
        """Detections, and instants at which there could have been one."""

    def look_from(self, now: float, position: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"]) -> None:
        """Where the defender is [m]; it moves on by the next cycle."""
        self._from = np.asarray(position, dtype=float)

    def watch(self, stream: ObservationStream, now: float, position: Float[np.ndarray, "3"]) -> None:
        """Detect the target where that is possible, and hand on what has become known by ``now`` [s]."""
        self._turn(now)
        detected = self._detects(position)
        noise, lost = self._rng.normal(scale=1.0, size=3), self._rng.random() < self.config.dropouts
        self.asked += 1
        if detected and not lost:
            self.seen += 1
            self._under_way.append((now, position + self.config.noise * noise))
        known = [one for one in self._under_way if one[0] + self.config.latency <= now + 1e-9]
        self._under_way = self._under_way[len(known) :]
        for time, where in known:
            stream.add(time, where, now)
            self._known = (time, where)

    def _turn(self, now: float) -> None:
        """Turn the camera as far as it can since the last time."""
        most, self._turned = self.config.turn_rate * (now - self._turned), now
        if self._known is not None and now - self._known[0] <= FORGOTTEN:
            self.looks = _towards(self.looks, self._known[1] - self._from, most)
        else:
            x, y = self.looks[:2] / max(float(np.linalg.norm(self.looks[:2])), 1e-9)
            self.looks = np.array([x * np.cos(most) - y * np.sin(most), x * np.sin(most) + y * np.cos(most), 0.0])

    def _detects(self, position: Float[np.ndarray, "3"]) -> bool:
        way = position - self._from
        distance = float(np.linalg.norm(way))
        if distance > self.config.sight_range:
            return False
        if float(way @ self.looks) < distance * np.cos(min(0.5 * self.config.field_of_view, np.pi)):
            return False
        return not self.config.occluded or bool(in_sight(self._world, self._from, position[None])[0])


def _towards(looks: Float[np.ndarray, "3"], wanted: Float[np.ndarray, "3"], most: float) -> Float[np.ndarray, "3"]:
    """A unit vector turned towards another vector, by an angle of at most ``most`` [rad]."""
    wanted = wanted / max(float(np.linalg.norm(wanted)), 1e-9)
    across = wanted - float(wanted @ looks) * looks
    size, angle = float(np.linalg.norm(across)), float(np.arccos(np.clip(wanted @ looks, -1.0, 1.0)))
    if size < 1e-9:  # there already, or right behind: then by the left
        across = np.array([-looks[1], looks[0], 0.0]) if angle > 1.0 else np.zeros(3)
        size = max(float(np.linalg.norm(across)), 1e-9)
    turn = min(most, angle)
    turned = np.cos(turn) * looks + np.sin(turn) * across / size
    return np.asarray(turned / np.linalg.norm(turned))


def in_sight(world: World, eye: Float[np.ndarray, "3"], places: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n"]:
    """Whether nothing stands between an eye and each of some places [m, world].

    Lines are followed from the eye in steps as long as the distance to the nearest thing allows.
    """
    way = places - eye
    length = np.maximum(np.linalg.norm(way, axis=1), 1e-9)
    travelled, broken = np.zeros(len(places)), np.zeros(len(places), bool)
    for _ in range(STEPS):
        free = host_free_distance(world, eye + (travelled / length)[:, None] * way, 256)
        broken |= (free <= SOLID) & (travelled < length)
        if (broken | (travelled >= length)).all():
            break
        travelled = np.minimum(travelled + np.maximum(free, STEP), length)
    return ~broken & (travelled >= length)
