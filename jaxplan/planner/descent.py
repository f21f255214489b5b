"""The compiled station of a refinement: a few steps of descent from given plans."""

import functools
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.optimizer.interior_point import DescentConfig, descend
from jaxplan.optimizer.margins import linearise, values
from jaxplan.optimizer.problem import Limits, TargetTable, Task, splines, unflatten
from jaxplan.planner.refined import RefinementConfig
from jaxplan.precision import in_float64
from jaxplan.spline import FlatState
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.obstacles import World

BODY_SAMPLES, PLACE_SAMPLES = 10, 28
"""Instants of a segment at which the descent looks at the body and at obstacles; the last look is at all of it."""
MAX_TILT = 78.5
"""Of the thrust from the vertical [degrees], as of the offline reference."""


class Descended(NamedTuple):
    """What became of k plans."""

    times: Float[Array, "k"]
    """When each meets the target [s]."""
    least: Float[Array, "k"]
    """Of the optimiser's margins."""
    splines: SplineBatch


@runtime_checkable
class Descend(Protocol):
    """The compiled part of a refinement."""

    def __call__(
        self,
        world: World,
        state: FlatState,
        target: TargetTable,
        limits: Limits,
        variables: Float[np.ndarray, "k v"],
        descent: DescentConfig,
    ) -> Descended:
        """Optimise k plans from one state."""


@in_float64
def compile_descent(config: RefinementConfig, vehicle: Vehicle) -> Descend:
    """Bind the vehicle and how it may turn, and compile."""
    own = vehicle.astype(jnp.float64)

    @jax.jit
    def descended(
        world: World,
        state: FlatState,
        target: TargetTable,
        limits: Limits,
        variables: Float[Array, "k v"],
        descent: DescentConfig,
    ) -> Descended:
        task = Task(
            start=state,
            target=target,
            world=world,
            vehicle=own,
            limits=limits,
            max_tilt=jnp.asarray(np.radians(MAX_TILT), variables.dtype),
            max_pitch=jnp.asarray(np.radians(config.max_pitch), variables.dtype),
            max_body_rate=jnp.minimum(config.max_body_rate, config.max_lag / own.motor_time_constant),
            body_samples=BODY_SAMPLES,
            place_samples=PLACE_SAMPLES,
        )
        found = descend(functools.partial(values, task), functools.partial(linearise, task), variables, descent)
        return Descended(found.objective, found.least, splines(task, unflatten(found.x.T)))

    return descended
