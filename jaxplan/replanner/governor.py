"""What is left of the committed plan, slower, for a vehicle that falls behind it: a reference governor.

Against the wind, or with a weak rotor, a vehicle falls behind a reference that goes on without it, which then asks for
ever more. So the same path is flown on from where the vehicle is along it and as fast as it is: what is asked for falls
with the square of the slowdown (time scaling: Hollerbach, Dynamic scaling of manipulator trajectories, 1984), and the
path is as clear as it was.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.spline import PiecewisePolynomial

BEHIND = 0.25
"""m; so far along the path from where it should be a vehicle has fallen behind (docs/decisions/0048)."""
SLOWDOWNS = (1.0, 1.3, 1.7, 2.2)
"""Tried one after another, beyond what makes the plan as fast as the vehicle (arbitrary)."""
MOST_SLOWDOWN = 3.0
"""To be as fast as the vehicle (arbitrary)."""
LEAST_SPEED = 1.0
"""m/s; slower than this a plan is not made slower (arbitrary)."""
WINDOW = 1.0
"""Seconds of the plan before the takeover among which the vehicle is looked for (arbitrary)."""
INSTANTS = 200
"""Looked at among them (arbitrary: 7 cm apart at 14 m/s)."""


class Lag(NamedTuple):
    """Where along a plan a vehicle is that has fallen behind it."""

    since: float
    """When the plan is where the vehicle is [s of the plan's own time]."""
    slowdown: float
    """How many times as fast as the vehicle the plan is there, at least 1."""


def lag_behind(
    spline: PiecewisePolynomial, since: float, position: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"]
) -> Lag | None:
    """None for a vehicle that is near where it should be, ``since`` [s of the plan's own time] after its beginning.

    ``position`` [m] and ``velocity`` [m/s, both in the world] are the vehicle's at that time.
    """
    end = float(spline.duration)
    latest = min(since, end)
    if not latest > 0.0 or np.linalg.norm(np.asarray(spline.evaluate(latest))[:3] - position) < BEHIND:
        return None
    times = np.linspace(max(latest - WINDOW, 0.0), latest, INSTANTS)
    path = np.asarray(spline.evaluate(times))[:, :3]
    nearest = int(np.argmin(np.linalg.norm(path - position, axis=1)))
    behind = float(np.linalg.norm(np.diff(path[nearest:], axis=0), axis=1).sum())
    planned = np.asarray(spline.evaluate(times[nearest : nearest + 1], 1))[0, :3]
    speed = float(np.linalg.norm(planned))
    if behind < BEHIND or speed < LEAST_SPEED or not 0.0 < times[nearest] < end:
        return None
    along = float(velocity @ planned) / speed
    return Lag(float(times[nearest]), float(np.clip(speed / max(along, 1e-3), 1.0, MOST_SLOWDOWN)))


def slower(spline: PiecewisePolynomial, lag: Lag) -> Iterator[tuple[PiecewisePolynomial, float]]:
    """What is left of a plan from where the vehicle is, and how many times slower, the fastest first."""
    rest = spline.split(lag.since)[1]
    for more in SLOWDOWNS:
        yield rest.dilate(more * lag.slowdown), more * lag.slowdown
