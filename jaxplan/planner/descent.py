"""The compiled station of a refinement: a few steps of descent from given plans (host, docs/decisions/0041)."""

import math
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.arrays import AnyArray
from jaxplan.optimizer.interior_point import DescentConfig
from jaxplan.optimizer.kernels.case import Case, make_tables, mixer_of
from jaxplan.optimizer.kernels.descent import Patience, descend
from jaxplan.optimizer.problem import Limits, TargetTable
from jaxplan.planner.refined import RefinementConfig
from jaxplan.planner.validator import Room
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.tracking.kernels.craft import craft_of
from jaxplan.vehicle.params import Vehicle

BODY_SAMPLES, PLACE_SAMPLES = 10, 28
"""Instants of a segment at which the descent looks at the body and at obstacles; the last look is at all of it."""
MAX_TILT = 78.5
"""Of the thrust from the vertical [degrees], as of the offline reference."""
PATIENCE = Patience(steps=4, least=-0.1)
"""Hardly a descent that violates its margins so much after so many steps comes to a plan (docs/decisions/0061)."""


class Descended(NamedTuple):
    """What became of a plan."""

    time: float
    """When it meets the target [s]."""
    least: float
    """Of the optimiser's margins."""
    variables: Float[np.ndarray, "v"]
    """What it is made of (``optimizer.problem.flatten``)."""
    spline: PiecewisePolynomial
    steps: int
    """Of the descent, fewer than asked for where it was given up."""


@runtime_checkable
class Descend(Protocol):
    """The compiled part of a refinement."""

    def __call__(
        self,
        room: Room,
        state: FlatState,
        target: TargetTable,
        limits: Limits,
        variables: Float[np.ndarray, "k v"],
        descent: DescentConfig,
    ) -> Descended:
        """Optimise a plan from one state, from the best of k starts; the heading is held."""


def build_descent(config: RefinementConfig, vehicle: Vehicle) -> Descend:
    """Bind the vehicle and how it may turn; what is compiled is compiled by the first call."""
    craft, tables = craft_of(vehicle), make_tables(BODY_SAMPLES, PLACE_SAMPLES)
    mixer = mixer_of(craft)

    def descended(
        room: Room,
        state: FlatState,
        target: TargetTable,
        limits: Limits,
        variables: Float[np.ndarray, "k v"],
        descent: DescentConfig,
    ) -> Descended:
        yaw = float(np.asarray(state.yaw)[0])
        case = Case(
            craft=craft,
            mixer=mixer,
            solids=tuple(room.solids),
            corners=tuple(room.bounds.ravel().tolist()),
            start=np.array(state.derivatives, float, order="C"),
            yaw=yaw,
            interval=float(target.interval),
            position=np.array(target.position + np.ravel(target.offset), float, order="C"),
            velocity=np.array(target.velocity, float, order="C"),
            meet_radius=_one(limits.meet_radius),
            kept=(_one(limits.clearance), _one(limits.slow), _one(limits.per_speed), _one(limits.most)),
            dilation=_one(limits.dilation),
            upright=math.cos(math.radians(MAX_TILT)),
            ahead=math.cos(math.radians(config.max_pitch)),
            turning=min(config.max_body_rate, config.max_lag / craft.lag),
            tables=tables,
        )
        found = descend(case, variables, descent, PATIENCE)
        heading = np.zeros((len(found.durations), 6))
        heading[:, 0] = yaw
        spline = PiecewisePolynomial(durations=found.durations, position=found.position, yaw=heading)
        return Descended(found.objective, found.least, found.x, spline, found.steps)

    return descended


def _one(number: Float[AnyArray, "1"]) -> float:
    """Of the one trajectory that there is."""
    return float(np.asarray(number)[0])
