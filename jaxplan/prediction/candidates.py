"""Goal candidates: where and when the target could be met (paper, Sec. III and III-C)."""

from typing import NamedTuple, no_type_check

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from jaxplan.arrays import AnyArray
from jaxplan.prediction.futures import Futures
from jaxplan.records import record, replace, static
from jaxplan.status import Reason, bit
from jaxplan.validation import as_shaped
from jaxplan.world.clearance import DistanceIn, clearance, wall_clearance
from jaxplan.world.obstacles import World


@record
class Candidates:
    """K goals with their arrival times; candidates with a reason are dropped before the costly stations."""

    goals: Float[AnyArray, "k 3"]
    """Positions [m, world]."""
    arrival_times: Float[AnyArray, "k"]
    """Seconds from the instant of the prediction."""
    likelihood: Float[AnyArray, "k"]
    """Normalised to [0, 1] within the batch."""
    reasons: UInt32[AnyArray, "k"]
    """Why a candidate cannot be used, as ``jaxplan.status.Reason``; 0: it can."""
    target: Float[AnyArray, "3"]
    """Where the target was last seen [m, world]; its distance chooses the search lattice."""
    futures: Futures | None = None
    """The target's possible motions, where they are known as a whole; their times count as ``arrival_times`` do."""
    note: int = static(default=0)
    """What deserves mention about all of them, as ``jaxplan.status.Note``."""


@no_type_check
def candidates_from(
    target: Float[np.ndarray, "3"],
    goals: Float[np.ndarray, "k 3"],
    arrival_times: Float[np.ndarray, "k"],
    log_likelihood: Float[np.ndarray, "k"],
) -> Candidates:
    """Candidates whose likelihood is relative to the best one; equal log-likelihoods all give 1 (host).

    Args:
        target: where it was last seen [m, world].
        goals: where it could be met [m, world].
        arrival_times: when [s from now].
        log_likelihood: of each candidate, to within a constant; one that is not finite gives the likelihood 0.

    Raises:
        InputError: something is no array of numbers, or of another length.
    """
    target, goals = as_shaped("candidates: target", target, (3,)), as_shaped("candidates: goals", goals, (None, 3))
    arrival_times = as_shaped("candidates: arrival_times", arrival_times, (len(goals),))
    log_likelihood = as_shaped("candidates: log_likelihood", log_likelihood, (len(goals),))
    finite = np.isfinite(log_likelihood)
    best = np.max(log_likelihood, initial=-np.inf, where=finite)
    likelihood = np.where(finite, np.exp(np.where(finite, log_likelihood - best, 0.0)), 0.0)
    return Candidates(
        goals=goals,
        arrival_times=arrival_times,
        likelihood=likelihood,
        reasons=np.where(np.isfinite(goals).all(axis=1), np.uint32(0), np.uint32(Reason.NONFINITE)),
        target=target,
    )


def later(candidates: Candidates, seconds: float) -> Candidates:
    """The same in times that count from ``seconds`` later on (host)."""
    futures = candidates.futures
    if futures is not None:
        futures = replace(futures, times=np.asarray(futures.times) - seconds)
    return replace(candidates, arrival_times=np.asarray(candidates.arrival_times) - seconds, futures=futures)


def target_velocities(candidates: Candidates) -> Float[np.ndarray, "k 3"]:
    """How fast the target is expected to fly at each goal [m/s]: the way of the goals' mean over time (host).

    Where all goals have one arrival time nothing is known of it: 0.
    """
    instants, means, _ = mean_motion(candidates)
    if len(instants) < 2:
        return np.zeros(np.shape(candidates.goals))
    column = np.searchsorted(instants, np.asarray(candidates.arrival_times))
    return np.asarray(np.gradient(means, instants, axis=0))[np.minimum(column, len(instants) - 1)]


class Motion(NamedTuple):
    """Where the target is expected, by all candidates together."""

    instants: Float[np.ndarray, "i"]
    """For which there are candidates, in order [s]."""
    means: Float[np.ndarray, "i 3"]
    """Of their goals [m, world]."""
    spread: Float[np.ndarray, "i"]
    """Root of the mean squared distance of the goals from that [m]."""


def mean_motion(candidates: Candidates) -> Motion:
    """The candidates' goals at each instant, in mean and spread (host).

    No instants where a goal or a time is not finite.
    """
    goals, times = np.asarray(candidates.goals), np.asarray(candidates.arrival_times)
    if not (np.isfinite(goals).all() and np.isfinite(times).all()):
        return Motion(np.zeros(0), np.zeros((0, 3)), np.zeros(0))
    instants, column = np.unique(times, return_inverse=True)
    sums, count = np.zeros((len(instants), 3)), np.bincount(column, minlength=1)[: len(instants)]
    np.add.at(sums, column, goals)
    means = sums / count[:, None]
    squared = np.bincount(column, weights=((goals - means[column]) ** 2).sum(axis=1), minlength=len(instants))
    return Motion(instants, means, np.sqrt(squared[: len(instants)] / count))


def reject_early(
    candidates: Candidates,
    world: World,
    start: Float[Array, "3"],
    padding: float,
    reach: Float[Array, "k"],
    free: DistanceIn = clearance,
) -> Candidates:
    """Mark what cannot be a goal: outside the room, in a padded obstacle, at no usable time, out of reach.

    Args:
        candidates: what is proposed; what is marked already stays so.
        world: the room and its obstacles.
        start: where the plan starts [m, world]; arrival times count from that instant.
        padding: clearance that a goal needs from obstacles [m].
        reach: how far [m] the vehicle can get until each arrival; farther goals are out of reach whatever the path.
        free: knows the distances to obstacles in this world.
    """
    goals, left = jnp.asarray(candidates.goals), jnp.asarray(candidates.arrival_times)
    distance = jnp.sqrt(jnp.sum((goals - start[None]) ** 2, axis=-1))
    reasons = (
        bit(~jnp.isfinite(goals).all(axis=-1), Reason.NONFINITE)
        | bit(~(wall_clearance(world, goals) >= world.keep_in), Reason.GOAL_OUTSIDE)
        | bit(~(free(world, goals) >= padding), Reason.GOAL_OCCUPIED)
        | bit(~((left > 0.0) & jnp.isfinite(left)), Reason.T_GOAL_INVALID)
        | bit(~(distance <= reach), Reason.OUT_OF_REACH)
    )
    return replace(candidates, reasons=candidates.reasons | reasons)
