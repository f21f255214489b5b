"""What a flight's committed plans come to, sampled densely by code of its own: clearance, rest, hesitation.

Nothing of the planner's checks is used here: polynomials are evaluated by NumPy's own, every few milliseconds over the
whole length of a plan, the part included that another plan took the place of.
"""

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.polynomial import polynomial

from jaxplan.interception import Episode
from jaxplan.spline import PiecewisePolynomial
from jaxplan.status import PlanStatus
from jaxplan.world.host_distance import host_free_distance

INTERVAL = 5e-3
"""Seconds between two samples, at most."""
FAST, SLOW = 3.0, 1.0
"""A flight that has been faster than the one [m/s] and then is slower than the other has hesitated."""


def audit(episode: Episode) -> dict[str, Any]:
    """Plain values: the least clearance beyond the vehicle's radius, the largest speed and acceleration at an end."""
    speed = np.linalg.norm(episode.flight.velocity, axis=1)
    after_fast = speed[np.argmax(speed > FAST) :] if (speed > FAST).any() else np.zeros(0)
    found: dict[str, Any] = {
        "hesitated": bool((after_fast < SLOW).any()),
        "cycles_without_plan": sum(cycle.status is PlanStatus.NO_CANDIDATE for cycle in episode.cycles),
        "plans": len(episode.plans),
        "plan_clearance_m": None,
        "plan_end_speed_m_s": None,
        "plan_end_acceleration_m_s2": None,
    }
    if episode.plans:
        scenario = episode.scenario
        samples = [sampled(plan.spline) for plan in episode.plans]
        free = host_free_distance(scenario.world, np.concatenate([points for points, _, _ in samples]))
        found["plan_clearance_m"] = float(free.min()) - float(np.asarray(scenario.vehicle.radius))
        found["plan_end_speed_m_s"] = max(speed for _, speed, _ in samples)
        found["plan_end_acceleration_m_s2"] = max(acceleration for _, _, acceleration in samples)
    return found


def sampled(spline: PiecewisePolynomial) -> tuple[Float[np.ndarray, "n 3"], float, float]:
    """Positions [m] over the whole length of a plan, and its speed [m/s] and acceleration [m/s^2] at the end."""
    durations, position = np.asarray(spline.durations), np.asarray(spline.position)
    points = []
    for duration, coefficients in zip(durations, position, strict=True):
        instants = np.linspace(0.0, 1.0, 2 + int(duration / INTERVAL))
        points.append(polynomial.polyval(instants, coefficients).T)
    last, duration = position[-1], float(durations[-1])
    ends = [polynomial.polyval(1.0, polynomial.polyder(last, order)) / duration**order for order in (1, 2)]
    return np.concatenate(points), float(np.linalg.norm(ends[0])), float(np.linalg.norm(ends[1]))
