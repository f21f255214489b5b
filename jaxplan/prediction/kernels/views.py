"""What can be seen from where, compiled (host)."""

import functools
import math
from typing import Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from jaxplan.prediction.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.compiled import source_digest as digest_of_search
from jaxplan.search.kernels.solids import Solids, clearance_at

SOLID, STEP = 0.02, 0.05
"""m; nearer to something than this a line of sight is broken; and the shortest step along one."""


def seen_from(
    solids: Solids, eyes: Float[np.ndarray, "k 3"], places: Float[np.ndarray, "n 3"], reach: float
) -> Bool[np.ndarray, "k n"]:
    """Whether nothing solid stands between each eye and each place [m, world], and it is within ``reach`` [m]."""
    seen = np.zeros((len(eyes), len(places)), bool)
    eyes, places = np.ascontiguousarray(eyes, float), np.ascontiguousarray(places, float)
    _compiled_views()(tuple(solids), eyes, places, float(reach), seen)
    return seen


@runtime_checkable
class _Views(Protocol):
    def __call__(self, solids: tuple, eyes: np.ndarray, places: np.ndarray, reach: float, seen: np.ndarray) -> None:
        """Writes ``seen``."""


@functools.cache
def _compiled_views() -> _Views:
    version = source_digest() + digest_of_search()

    @entry_point
    @no_type_check
    def entry(solids, eyes, places, reach, seen):
        _ = version
        for k in range(len(eyes)):
            for n in range(len(places)):
                seen[k, n] = _is_seen(solids, eyes[k], places[n], reach)

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _is_seen(solids, eye, place, reach):
    """Along the line in steps as long as the distance to the nearest thing allows."""
    x, y, z = place[0] - eye[0], place[1] - eye[1], place[2] - eye[2]
    length = math.sqrt(x * x + y * y + z * z)
    if not length <= reach:
        return False
    travelled = 0.0
    while travelled < length:
        share = travelled / length
        free = clearance_at(solids, eye[0] + share * x, eye[1] + share * y, eye[2] + share * z)
        if not free > SOLID:
            return False
        travelled += max(free, STEP)
    return True
