"""Why a candidate cannot be used: one bit per check, merged by bitwise or, stable under ``vmap``.

Bits are append-only. ``reasons == 0`` is the only test for "usable"; what merely deserves mention goes
into the second mask, ``Note``.
"""

import enum

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, UInt32


class Reason(enum.IntFlag):
    """A check that a candidate failed."""

    NONFINITE = 1 << 0
    """The goal or the trajectory has a value that is not finite."""
    GOAL_OUTSIDE = 1 << 1
    """The goal is outside the room, or closer to one of its faces than the world's ``keep_in``."""
    GOAL_OCCUPIED = 1 << 2
    """The goal is closer to an obstacle than the padding."""
    NO_PATH = 1 << 3
    """No lattice has a path to the goal."""
    T_GOAL_INVALID = 1 << 4
    """The arrival time is past or not finite."""
    ALPHA_NOT_CONVERGED = 1 << 5
    """The alpha iteration ended before the durations added up to the arrival time."""
    ALPHA_LT_1 = 1 << 6
    """Arriving in time would take a scale factor below the least one: a faster flight than is looked at."""
    ILL_CONDITIONED = 1 << 7
    """Not set by this version."""
    DEVIATION = 1 << 8
    """The trajectory leaves its path by too much."""
    CLEARANCE = 1 << 9
    """The trajectory comes too close to an obstacle."""
    LIMITS = 1 << 10
    """A rotor would have to turn faster or slower than it can, or all together to give more than they can."""
    OUT_OF_REACH = 1 << 11
    """Even straight on with all rotors at full thrust the goal is reached too late."""
    PREFIX_ONLY = 1 << 12
    """The path has more points than fit, or the search ended before the goal: its trajectory can approach the goal but
    not meet the target."""
    TARGET_LOST = 1 << 13
    """The target has been silent for too long."""
    OUTRANKED = 1 << 14
    """A better candidate passed every check, or the cycle's time was used up, so this one was not evaluated."""
    UNTRACKABLE = 1 << 15
    """By the feasibility classifier, too unlikely to be tracked."""
    BODY_RATE = 1 << 16
    """The thrust would have to turn faster than the body is asked to."""
    NO_STOP = 1 << 17
    """The target is to be met at its own velocity, and there is no room behind the meeting to stop from that."""


class Note(enum.IntFlag):
    """Something worth telling about a candidate that does not make it unusable."""

    START_PADDED = 1 << 0
    """The start is within the padding of an obstacle; the path leaves it by an escape point."""
    FINER_LATTICE = 1 << 1
    """The path needed a finer lattice than the distance between the drones calls for."""
    PREDICTOR_FALLBACK = 1 << 2
    """Too little was seen of the target, or nothing like it in training: constant velocity instead."""
    LESS_PADDING = 1 << 3
    """No path keeps the padding from all obstacles; this one comes closer."""
    SEARCH_ENDED = 1 << 4
    """The search ended by its budget: this is the best path known, which need not be the shortest."""
    SEARCHING = 1 << 5
    """Nobody sees the target: the goals are a place from which it may be seen (``jaxplan.prediction.lookout``)."""


class PlanStatus(enum.IntEnum):
    """What a replan cycle came to."""

    NOT_SET = 0
    """Before the first cycle: hovering at the start."""
    INTERCEPT = 1
    """A trajectory that meets the target was committed."""
    APPROACH = 2
    """None meets the target; one that comes closer was committed."""
    KEPT_COMMITTED = 3
    """The committed trajectory stays: it still meets the target at least as well, or nothing found is better."""
    NO_CANDIDATE = 4
    """No candidate can even be approached; the committed trajectory stays."""
    TARGET_LOST = 5
    """The target has been silent for too long; the committed trajectory stays."""
    LATE = 6
    """A better trajectory was ready only after it would have had to take over, or was not looked for any more, since it
    would have been; the committed one stays."""
    BRAKE = 7
    """The world has changed, the committed trajectory is not clear any more, and none other was found but a stop."""
    BLOCKED = 8
    """As for BRAKE, but no stop is clear either: the one that hits least hard is flown, where the committed trajectory
    would hit harder, and the next cycle looks again."""
    RECOVER = 9
    """The vehicle is far off its reference: it stops from where it is."""
    SLOWED = 10
    """The vehicle has fallen behind its reference: it flies on as planned, from where it is and as fast as it is."""


def bit(bad: Bool[Array, "*batch"], reason: enum.IntFlag) -> UInt32[Array, "*batch"]:
    """``reason``, of any set of bits, where ``bad``, else 0. Write ``bad`` as ``~(good)`` so that NaN counts as bad."""
    return jnp.where(bad, jnp.uint32(int(reason)), jnp.uint32(0))


def count_reasons(reasons: UInt32[np.ndarray, "k"]) -> dict[str, int]:
    """How many candidates carry each bit (host); names in lower case, only those that occur."""
    values = np.asarray(reasons, dtype=np.uint32)
    counts = np.count_nonzero(values & _BITS[:, None], axis=1).tolist()
    return {name: count for name, count in zip(_NAMES, counts, strict=True) if count}


_NAMES = [reason.name.lower() for reason in Reason if reason.name]
_BITS = np.array([int(reason) for reason in Reason if reason.name], np.uint32)
