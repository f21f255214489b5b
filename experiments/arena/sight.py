"""What a defender sees of a target: noisy, late, with gaps, and only what nothing stands before."""

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


@dataclasses.dataclass(frozen=True)
class SightConfig:
    """How well a target is seen. A sensor looks in all directions: a camera on a gimbal."""

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


class Sight:
    """A sensor in one episode; ``look_from`` tells it where the defender is."""

    def __init__(self, world: World, config: SightConfig, start: Float[np.ndarray, "3"], seed: int) -> None:
        self._world, self._config, self._from = world, config, np.asarray(start, dtype=float)
        self._rng = np.random.default_rng((seed, 1))
        self._under_way: list[tuple[float, Float[np.ndarray, "3"]]] = []
        self.seen, self.asked = 0, 0
        """Detections, and instants at which there could have been one."""

    def look_from(self, now: float, position: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"]) -> None:
        """Where the defender is [m]; it moves on by the next cycle."""
        self._from = np.asarray(position, dtype=float)

    def watch(self, stream: ObservationStream, now: float, position: Float[np.ndarray, "3"]) -> None:
        """Detect the target where that is possible, and hand on what has become known by ``now`` [s]."""
        detected = self._detects(position)
        noise, lost = self._rng.normal(scale=1.0, size=3), self._rng.random() < self._config.dropouts
        self.asked += 1
        if detected and not lost:
            self.seen += 1
            self._under_way.append((now, position + self._config.noise * noise))
        known = [one for one in self._under_way if one[0] + self._config.latency <= now + 1e-9]
        self._under_way = self._under_way[len(known) :]
        for time, where in known:
            stream.add(time, where, now)

    def _detects(self, position: Float[np.ndarray, "3"]) -> bool:
        if np.linalg.norm(position - self._from) > self._config.sight_range:
            return False
        return not self._config.occluded or bool(in_sight(self._world, self._from, position[None])[0])


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
