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
    GOAL_OUTSIDE = 1 << 1
    GOAL_OCCUPIED = 1 << 2
    NO_PATH = 1 << 3
    T_GOAL_INVALID = 1 << 4
    ALPHA_NOT_CONVERGED = 1 << 5
    ALPHA_LT_1 = 1 << 6
    ILL_CONDITIONED = 1 << 7
    DEVIATION = 1 << 8
    CLEARANCE = 1 << 9
    LIMITS = 1 << 10
    OUT_OF_REACH = 1 << 11
    PREFIX_ONLY = 1 << 12
    TARGET_LOST = 1 << 13
    OUTRANKED = 1 << 14
    UNTRACKABLE = 1 << 15


class Note(enum.IntFlag):
    """Something worth telling about a candidate that does not make it unusable."""

    START_PADDED = 1 << 0
    FINER_LATTICE = 1 << 1
    PREDICTOR_FALLBACK = 1 << 2


class PlanStatus(enum.IntEnum):
    """What a replan cycle came to."""

    NOT_SET = 0
    INTERCEPT = 1
    APPROACH = 2
    KEPT_COMMITTED = 3
    NO_CANDIDATE = 4
    TARGET_LOST = 5


def bit(bad: Bool[Array, "..."], reason: Reason) -> UInt32[Array, "..."]:
    """``reason`` where ``bad``, else 0. Write ``bad`` as ``~(good)`` so that NaN counts as bad."""
    return jnp.where(bad, jnp.uint32(int(reason)), jnp.uint32(0))


def count_reasons(reasons: np.ndarray) -> dict[str, int]:
    """How many candidates carry each bit (host); names in lower case, only those that occur."""
    values = np.asarray(reasons, dtype=np.uint32)
    counts = {reason.name.lower(): int(np.count_nonzero(values & int(reason))) for reason in Reason if reason.name}
    return {name: count for name, count in counts.items() if count}
