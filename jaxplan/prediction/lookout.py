"""Looking for a target that nobody sees: a predictor that, while another one has nothing to go by, says where to look.

The room is a few hundred places. Each carries the probability that a target which is there has not been seen: it
vanishes where the vehicle looks, and comes back later, since targets move. A target that was seen before is most likely
near where it was last. The vehicle is sent to the place from which it will see most of that for each second that the
way there takes, as if the target hovered there, by the same plans as ever (docs/decisions/0059).
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from jaxplan.prediction.candidates import Candidates, candidates_from
from jaxplan.prediction.futures import Futures
from jaxplan.prediction.kernels.views import seen_from
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.protocol import PredictionConfig, Predictor
from jaxplan.records import replace
from jaxplan.search.kernels.solids import Solids, solids_of
from jaxplan.status import Note
from jaxplan.validation import as_finite, as_number, require_positive
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.obstacles import World

MOST_PLACES = 600
"""Of a room (arbitrary: what is seen from each of them is found in a tenth of a second)."""
STOREY = 1.5
"""m; rooms twice as high have two layers of places (arbitrary)."""
NEIGHBOURS = 1.8
"""Places that see each other and are not farther apart than this times the spacing are on one way (arbitrary)."""
SPENT = 0.3
"""Share of what a place was chosen for, below which another one is chosen (arbitrary)."""
BETTER = 1.5
"""How many times as good another place must be to be chosen before (arbitrary)."""
SETTLING = 1.0
"""s; what a look takes beside the way there (arbitrary)."""
NEAR = 2.0
"""m; how far a target may be at once from where it was last seen (arbitrary)."""


@dataclasses.dataclass(frozen=True)
class LookoutConfig:
    """What the sensor can do, and how targets hide."""

    sight_range: float = np.inf
    """m."""
    dwell: float = 0.2
    """Seconds in view after which a place where no target was seen counts as looked at (as 1 - 1/e); of a camera that
    turns, how long it takes to come round."""
    forgotten: float = 10.0
    """Seconds after which a target may be there again (as 1 - 1/e)."""
    pace: float = 4.0
    """m/s; how fast the vehicle is taken to get there."""
    target_speed: float = 3.0
    """m/s; how fast a target that was seen may have gone from there."""
    clearance: float = 0.6
    """m; what places keep from obstacles and faces: a little more than goals have to."""

    def __post_init__(self) -> None:
        require_positive("lookout", self, "dwell", "forgotten", "pace", "target_speed", "clearance")
        if not self.sight_range > 0.0:  # which may be infinite, other than what has to be positive
            require_positive("lookout", self, "sight_range")


class Views(NamedTuple):
    """The places of a room, and what is seen from each."""

    solids: Solids
    places: Float[np.ndarray, "n 3"]
    """[m, world]"""
    seen: Bool[np.ndarray, "n n"]
    """Row by row from each place."""
    ways: csr_array
    """Metres between neighbours; 0 where there is no way."""


def views_of(world: World, config: LookoutConfig | None = None) -> Views:
    """The places of a room, once for all flights in it."""
    config = config or LookoutConfig()
    lower, upper = np.asarray(world.bounds, dtype=float)
    inside = np.array([config.clearance, -config.clearance])[:, None] + [lower, upper]
    inside = np.where(inside[0] < inside[1], inside, inside.mean(axis=0))
    layers = max(int((upper[2] - lower[2]) / STOREY), 1)
    spacing = max(1.0, float(np.sqrt(np.prod(inside[1, :2] - inside[0, :2]) * layers / MOST_PLACES)))
    counts = [max(int((b - a) / spacing) + 1, 1) for a, b in inside.T[:2]] + [layers]
    axes = [a + (np.arange(n) + 0.5) / n * (b - a) for n, (a, b) in zip(counts, inside.T, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    places = places[host_free_distance(world, places, 256) >= min(config.clearance, 0.5 * np.min(upper - lower)) - 1e-9]
    solids = solids_of(world)
    seen = seen_from(solids, places, places, config.sight_range)
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    near = seen & (apart <= max(NEIGHBOURS * spacing, NEIGHBOURS * STOREY)) & (apart > 0.0)
    return Views(solids, places, seen, csr_array(np.where(near, apart, 0.0)))


class Lookout:
    """Another predictor, and where to look while that has nothing to go by; ``Replanner`` tells it where it is."""

    def __init__(
        self,
        predictor: Predictor,
        world: World,
        prediction: PredictionConfig,
        config: LookoutConfig | None = None,
        views: Views | None = None,
    ) -> None:
        """``prediction`` says how far ahead goals are, and when a target is lost; ``views`` those of this world."""
        self.config = config or LookoutConfig()
        self._predictor, self._prediction = predictor, prediction
        self._views = views_of(world, self.config) if views is None else views
        self.unseen = np.ones(len(self._views.places))
        """By place, how likely a target that is there has not been seen."""
        self._now, self._from = -np.inf, np.full(3, np.nan)
        self._last: tuple[float, Float[np.ndarray, "3"]] | None = None
        self._goal, self._worth = -1, 0.0

    def look_from(self, now: float, position: Float[np.ndarray, "3"]) -> None:
        """The vehicle is there [m, world] at ``now`` [s], and has told all that it sees."""
        now, position = as_number("lookout: now", now), as_finite("lookout: position", position, (3,))
        elapsed = max(now - self._now, 0.0)
        self.unseen += (1.0 - self.unseen) * (1.0 - np.exp(-elapsed / self.config.forgotten))
        seen = seen_from(self._views.solids, position[None], self._views.places, self.config.sight_range)[0]
        self.unseen[seen] *= np.exp(-min(elapsed, self.config.dwell) / self.config.dwell)
        self._now, self._from = now, position

    def __call__(self, observations: Observations | None, cycle: int) -> Candidates:
        """What the predictor says of a target that is seen; otherwise a place to look from, as if it hovered there."""
        if observations is not None:
            self._last = self._now - observations.age, np.asarray(observations.positions)[-1]
            if observations.age <= self._prediction.lost_after:
                self._goal = -1
                return self._predictor(observations, cycle)
        self._choose()
        if self._goal < 0:
            return self._nowhere()
        goal, offsets = self._views.places[self._goal], self._prediction.offsets
        still = np.repeat(goal[None], len(offsets), axis=0)
        futures = Futures(
            times=np.append(0.0, offsets), positions=np.append(goal[None], still, axis=0)[None], weights=np.ones(1)
        )
        return replace(
            candidates_from(goal, still, offsets, np.zeros(len(offsets))), futures=futures, note=int(Note.SEARCHING)
        )

    def _choose(self) -> None:
        """Keep the place that was chosen, or choose another one; -1 where there is no way to any."""
        times, hidden = self._times(), self._hidden()
        gains = self._views.seen @ hidden
        worth = np.where(np.isfinite(times), gains / (times + SETTLING), 0.0)
        best, old = int(np.argmax(worth)) if worth.any() else -1, self._goal
        if best < 0 or old < 0 or gains[old] < SPENT * self._worth or worth[best] > BETTER * worth[old]:
            self._goal, self._worth = best, float(gains[best]) if best >= 0 else 0.0

    def _hidden(self) -> Float[np.ndarray, "n"]:
        """How likely the target is at each place, to within a factor: unseen, and near where it was last seen."""
        if self._last is None:
            return self.unseen
        time, place = self._last
        radius = NEAR + self.config.target_speed * max(self._now - time, 0.0)
        apart = np.linalg.norm(self._views.places - place, axis=1)
        return np.asarray(self.unseen * np.exp(-0.5 * (apart / radius) ** 2))

    def _times(self) -> Float[np.ndarray, "n"]:
        """Seconds to each place along ways; inf where there is none."""
        places = self._views.places
        apart = np.linalg.norm(places - self._from, axis=1)
        seen = seen_from(self._views.solids, self._from[None], places, np.inf)[0]
        near: Int[np.ndarray, "k"] = np.flatnonzero(seen)
        near = near[np.argsort(apart[near], kind="stable")][:8]
        if not len(near):
            return np.full(len(places), np.inf)
        ways = dijkstra(self._views.ways, directed=False, indices=near) + apart[near, None]
        return np.asarray(np.min(ways, axis=0) / self.config.pace)

    def _nowhere(self) -> Candidates:
        """Nothing to fly to: the vehicle stays."""
        offsets = self._prediction.offsets
        return candidates_from(self._from, np.full((len(offsets), 3), np.nan), offsets, np.zeros(len(offsets)))
