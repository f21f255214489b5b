"""The compiled station of a refinement: a few steps of descent from given plans.

It is two programs, the descent and the trajectories of where it ends: each piece of code is compiled once for every
place where it stands, so one program of both takes longer to compile than the two.
"""

import functools
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplan.kept import kept
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.optimizer.interior_point import Descent, DescentConfig, descend
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
    """What became of a plan; a batch of one."""

    times: Float[Array, "1"]
    """When it meets the target [s]."""
    least: Float[Array, "1"]
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
        """Optimise a plan from one state, from the best of k starts."""


@in_float64
def compile_descent(config: RefinementConfig, vehicle: Vehicle) -> Descend:
    """Bind the vehicle and how it may turn, and compile."""
    own = vehicle.astype(jnp.float64)

    def task_of(world: World, state: FlatState, target: TargetTable, limits: Limits) -> Task:
        return Task(
            start=state,
            target=target,
            world=world,
            vehicle=own,
            limits=limits,
            max_tilt=jnp.asarray(np.radians(MAX_TILT)),
            max_pitch=jnp.asarray(np.radians(config.max_pitch)),
            max_body_rate=jnp.minimum(config.max_body_rate, config.max_lag / own.motor_time_constant),
            body_samples=BODY_SAMPLES,
            place_samples=PLACE_SAMPLES,
        )

    @kept
    def optimised(
        world: World,
        state: FlatState,
        target: TargetTable,
        limits: Limits,
        variables: Float[Array, "k v"],
        descent: DescentConfig,
    ) -> Descent:
        task = task_of(world, state, target, limits)
        start = variables[_best(task, variables, descent)][None]
        return descend(functools.partial(values, task), functools.partial(linearise, task), start, descent)

    @kept
    def flown(
        world: World, state: FlatState, target: TargetTable, limits: Limits, variables: Float[Array, "k v"]
    ) -> SplineBatch:
        return splines(task_of(world, state, target, limits), unflatten(variables.T))

    def descended(
        world: World,
        state: FlatState,
        target: TargetTable,
        limits: Limits,
        variables: Float[np.ndarray, "k v"],
        descent: DescentConfig,
    ) -> Descended:
        found = optimised(world, state, target, limits, variables, descent)
        return Descended(found.objective, found.least, flown(world, state, target, limits, found.x))

    return descended


def _best(task: Task, starts: Float[Array, "k v"], descent: DescentConfig) -> Int[Array, ""]:
    """Number of the start that costs least: its time, and the optimiser's penalty for its worst violation."""
    if len(starts) == 1:
        return jnp.int32(0)
    times, margins = jax.vmap(lambda start: values(task, start[None]))(starts)
    cost = times[:, 0] + descent.penalty * jnp.maximum(-jnp.min(margins[:, 0], axis=1), 0.0)
    return jnp.argmin(jnp.where(jnp.isfinite(cost), cost, jnp.inf)).astype(jnp.int32)
