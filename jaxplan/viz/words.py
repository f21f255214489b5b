"""What cycles and reasons are called where somebody watches."""

from typing import NamedTuple

from jaxplan.status import PlanStatus, Reason

OUTCOMES = {
    "intercepted": "Target intercepted",
    "collision": "Not intercepted: collision",
    "tracking_lost": "Not intercepted: tracking lost",
    "target_ended": "Not intercepted: the target's trajectory ended",
    "no_plan": "Not intercepted: no plan",
    "flying": "In flight",
}
"""Of an episode."""

STATUSES = {
    PlanStatus.NOT_SET: ("hovers", "#5b6472"),
    PlanStatus.INTERCEPT: ("commits an interception", "#00805E"),
    PlanStatus.APPROACH: ("commits an approach", "#0072B2"),
    PlanStatus.KEPT_COMMITTED: ("keeps its plan", "#5b6472"),
    PlanStatus.NO_CANDIDATE: ("no candidate, keeps its plan", "#8C6D46"),
    PlanStatus.TARGET_LOST: ("target lost, keeps its plan", "#3d444d"),
    PlanStatus.LATE: ("planned too late, keeps its plan", "#B36B00"),
    PlanStatus.BRAKE: ("brakes", "#A8327D"),
    PlanStatus.BLOCKED: ("blocked, hits least", "#882255"),
    PlanStatus.RECOVER: ("off its reference, stops", "#A8327D"),
    PlanStatus.SLOWED: ("behind its reference, slower", "#B36B00"),
}
"""What a cycle came to, in words, and its colour."""

REASONS = {
    Reason.NONFINITE: "not finite",
    Reason.GOAL_OUTSIDE: "goal outside the room",
    Reason.GOAL_OCCUPIED: "goal too close to an obstacle",
    Reason.NO_PATH: "no path",
    Reason.T_GOAL_INVALID: "its time is past",
    Reason.ALPHA_NOT_CONVERGED: "no alpha found",
    Reason.ALPHA_LT_1: "alpha below the least",
    Reason.ILL_CONDITIONED: "ill-conditioned",
    Reason.DEVIATION: "too far off its path",
    Reason.CLEARANCE: "too close to an obstacle",
    Reason.LIMITS: "beyond the rotors",
    Reason.OUT_OF_REACH: "out of reach at full thrust",
    Reason.PREFIX_ONLY: "only a part of the path",
    Reason.TARGET_LOST: "target lost",
    Reason.OUTRANKED: "outranked, not looked at",
    Reason.UNTRACKABLE: "unlikely to be tracked",
    Reason.BODY_RATE: "turns too fast",
    Reason.NO_STOP: "no room to stop behind it",
}
"""The reasons in words."""


class Group(NamedTuple):
    """Reasons that mean the same to who watches."""

    name: str
    colour: str
    """Told apart from the others with every common colour vision (Okabe and Ito, 2008, or their shades)."""
    reasons: Reason


GROUPS = (
    Group("usable", "#009E73", Reason(0)),
    Group("target lost, not finite", "#3d444d", Reason.NONFINITE | Reason.TARGET_LOST),
    Group("occupied or no way there", "#8C6D46", Reason.GOAL_OUTSIDE | Reason.GOAL_OCCUPIED | Reason.NO_PATH),
    Group(
        "too late",
        "#E69F00",
        Reason.T_GOAL_INVALID | Reason.ALPHA_NOT_CONVERGED | Reason.ALPHA_LT_1 | Reason.OUT_OF_REACH,
    ),
    Group(
        "too close, or off its path",
        "#CC79A7",
        Reason.DEVIATION | Reason.CLEARANCE | Reason.PREFIX_ONLY | Reason.NO_STOP | Reason.ILL_CONDITIONED,
    ),
    Group("cannot be flown", "#882255", Reason.LIMITS | Reason.UNTRACKABLE | Reason.BODY_RATE),
    Group("outranked", "#A3ACB8", Reason.OUTRANKED),
)
"""A candidate with several reasons is of the first of their groups."""
