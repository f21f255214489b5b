"""The least total time at which a minimum-snap trajectory keeps within a vehicle's limits (paper eq. 6), in a batch.

The limits are tested at sampled instants. At every trial the trajectory is solved anew: with arbitrary initial
derivatives, scaling one trajectory would change them.
"""

import dataclasses
import functools
from typing import Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.minsnap.single import YAW_ORDER, interpolate
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.spline import FlatState
from jaxplan.vehicle.gains import IndiGains, Se3Gains
from jaxplan.vehicle.limits import rotor_limit_margin
from jaxplan.vehicle.params import Vehicle


@runtime_checkable
class Margin(Protocol):
    """A limit of the vehicle, for example ``vehicle.limits.rotor_limit_margin`` of one vehicle."""

    def __call__(self, state: FlatState, /) -> Float[Array, ""]:
        """How far one flat state (SI units, world frame) is from the limit: positive inside, in any unit."""
        ...


@runtime_checkable
class LeastMargin(Protocol):
    """A margin along trajectories."""

    def __call__(self, durations: Float[Array, "m b"], /) -> Float[Array, "b"]:
        """The least margin at the sampled instants of the best trajectories for given durations [s]."""
        ...


@runtime_checkable
class Reshare(Protocol):
    """A distribution of a total time over the segments."""

    def __call__(self, durations: Float[Array, "m b"], total: Float[Array, "b"], /) -> Float[Array, "m b"]:
        """The best durations [s] found from the given ones that add up to ``total`` [s]."""
        ...


def margin_of_vehicle(vehicle: Vehicle) -> Margin:
    """``rotor_limit_margin`` of a vehicle, by its numbers alone: neither its name nor its gains count."""
    numbers = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), vehicle)
    return functools.partial(
        rotor_limit_margin, dataclasses.replace(numbers, name="", indi=IndiGains(), se3=Se3Gains())
    )


def with_traced_numbers(margin: Margin) -> jax.tree_util.Partial:
    """The margin as a tree, whose leaves are the numbers that a ``functools.partial`` has bound, if it is one.

    As an argument of a compiled function it compiles that once for all such numbers, instead of once for each partial.
    """
    if isinstance(margin, functools.partial):
        bound = jax.tree.leaves((margin.args, margin.keywords))
        if all(isinstance(leaf, jax.Array | np.ndarray | np.generic | float | int) for leaf in bound):
            return jax.tree_util.Partial(margin.func, *margin.args, **margin.keywords)
    return jax.tree_util.Partial(margin)


def least_margin(
    margin: Margin,
    points: Float[Array, "n 3 b"],
    initial: Float[Array, "4 3 b"],
    yaw: Float[Array, "n b"] | None,
    durations: Float[Array, "m b"],
    instants: int,
) -> Float[Array, "b"]:
    """The least ``margin`` at instants evenly spread over each minimum-snap trajectory through n = m + 1 points."""
    position, _ = interpolate(durations, points, initial)
    heading = jnp.zeros((len(durations), 6, 1, durations.shape[-1]), durations.dtype)
    if yaw is not None:
        heading, _ = interpolate(durations, yaw[:, None], jnp.zeros((YAW_ORDER, 1, yaw.shape[-1]), yaw.dtype))
    states = SplineBatch(durations=durations, position=position, yaw=heading).states(instants)

    def margin_of(derivatives: Float[AnyArray, "5 3"], yaw: Float[AnyArray, "3"]) -> Float[Array, ""]:
        return margin(FlatState(derivatives=derivatives, yaw=yaw))

    each = jax.vmap(jax.vmap(margin_of, in_axes=-1, out_axes=-1), in_axes=-1, out_axes=-1)
    return jnp.min(each(states.derivatives, states.yaw), axis=0)


def shortest_alternated(
    least: LeastMargin,
    reshare: Reshare,
    durations: Float[Array, "m b"],
    rounds: int,
    bisections: int,
) -> tuple[Float[Array, "m b"], Bool[Array, "b"]]:
    """The shortest feasible total time at the best ratios found for it, and whether there is one.

    ``reshare`` alternates with the search for the total time.
    """
    best, feasible = _shortest(least, durations, bisections)
    for _ in range(rounds - 1):
        total = jnp.where(feasible, jnp.sum(best, axis=0), jnp.sum(durations, axis=0))
        shorter, found = _shortest(least, reshare(best, total), bisections)
        better = found & ~(feasible & (jnp.sum(best, axis=0) <= jnp.sum(shorter, axis=0)))
        best, feasible = jnp.where(better[None], shorter, best), feasible | found
    return best, feasible


def _shortest(
    least: LeastMargin, durations: Float[Array, "m b"], bisections: int
) -> tuple[Float[Array, "m b"], Bool[Array, "b"]]:
    """The least feasible multiple of ``durations``: a grid of factors, then bisection below its first success.

    Feasibility need not be monotone in the factor when the initial derivatives are not 0, hence the grid.
    """

    def inside(durations: Float[Array, "m b"]) -> Bool[Array, "b"]:
        return least(durations) >= 0.0

    factors = jnp.asarray(1.25 ** np.arange(-12.0, 13.0), durations.dtype)
    passed = jax.lax.map(lambda factor: inside(factor * durations), factors)
    feasible = jnp.any(passed, axis=0)
    high = factors[jnp.argmax(passed, axis=0)]

    def halve(_: Int[Array, ""], bracket: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bracket
        middle = jnp.sqrt(low * high)
        good = inside(middle[None] * durations)
        return jnp.where(good, low, middle), jnp.where(good, middle, high)

    _, high = jax.lax.fori_loop(0, bisections, halve, (high / 1.25, high))
    return high[None] * durations, feasible
