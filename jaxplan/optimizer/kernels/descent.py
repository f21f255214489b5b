"""``interior_point.descend`` of one problem, compiled (host)."""

import functools
import math
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.optimizer.interior_point import DescentConfig
from jaxplan.optimizer.kernels.case import Case
from jaxplan.optimizer.kernels.compiled import entry_point, inner, source_digest, within
from jaxplan.optimizer.kernels.margins import Work, look, make_work
from jaxplan.optimizer.kernels.newton import set_up
from jaxplan.optimizer.kernels.splines import shape

LENGTHS = 7
"""Of a step that are tried, each half of the one before, as in ``interior_point``."""
_AMPLE = 1e3
"""A slack with which every margin counts."""


class Found(NamedTuple):
    """Where a descent ended."""

    x: Float[np.ndarray, "v"]
    objective: float
    least: float
    """Of the margins: the worst violation where it is negative."""
    durations: Float[np.ndarray, "m"]
    """[s]"""
    position: Float[np.ndarray, "m 10 3"]
    """The trajectory's ascending coefficients in normalised time [m, world]."""
    steps: int
    """That were tried."""


class Patience(NamedTuple):
    """When a descent is given up that still violates its margins."""

    steps: int
    """After so many,"""
    least: float
    """where the least margin is below this."""


ENDLESS = Patience(0, -math.inf)
"""It is not given up."""


def descend(case: Case, starts: Float[np.ndarray, "k v"], config: DescentConfig, patience: Patience = ENDLESS) -> Found:
    """A local minimum near the start that costs least: its time, and the penalty for its worst violation."""
    work = make_work(starts.shape[1] // 4, case.tables)
    x = np.empty(starts.shape[1])
    pace = (float(config.barrier), float(config.last_barrier), float(config.rate))
    settings = (int(config.iterations), float(config.penalty), float(config.slack), *pace)
    given_up = int(patience.steps), float(patience.least)
    objective, least, steps = _compiled()(case, np.array(starts, float, order="C"), settings, given_up, work, x)
    return Found(x, objective, least, work.spline.durations, work.spline.coefficients, steps)


@runtime_checkable
class _Descend(Protocol):
    def __call__(
        self, case: Case, starts: np.ndarray, settings: tuple, given_up: tuple, work: Work, x: np.ndarray
    ) -> tuple[float, float, int]:
        """Writes ``x`` and its spline; objective, least margin and steps."""


@functools.cache
def _compiled() -> _Descend:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(case, starts, settings, given_up, work, x):
        _ = version
        found = _descend(case, starts, settings, given_up, work, x)
        shape(case, x, work.spline)
        return found

    return entry  # type: ignore[no-any-return]


@within
@no_type_check
def _choose(case, starts, settings, work, x):
    """Write the start that costs least, the first where none is finite; the slack to begin with, and its logarithms."""
    _, penalty, slack, _, _, _ = settings
    least_cost, first, logs = math.inf, slack, 0.0
    for k in range(len(starts) + 1):
        again = k == len(starts)  # once more where it is descended from, with the slack that was found
        time, least, total = look(case, x if again else starts[k], first if again else _AMPLE, work)
        cost = time + penalty * max(-least, 0.0)
        if again:
            logs = total
        elif k == 0 or cost < least_cost:
            least_cost, first = (cost if cost == cost else math.inf), slack + max(-least, 0.0)
            for i in range(len(x)):
                x[i] = starts[k, i]
    return time, least, first, logs


@within
@no_type_check
def _descend(case, starts, settings, given_up, work, x):
    """The steps, in place; objective and least margin of where they end, and how many they are."""
    iterations, penalty, _, barrier, last_barrier, rate = settings
    patience, hope = given_up
    time, least, slack, logs = _choose(case, starts, settings, work, x)
    damping, direction = 1e-2, work.direction
    for step in range(iterations):
        if step == patience and least < hope:
            return time, least, step
        merit = time + penalty * slack - barrier * (logs + math.log(slack))
        set_up(case, x, slack, barrier, penalty, damping, work)
        solve(work.system, direction)
        taken, share = -1, 1.0
        for turn in range(LENGTHS):
            if taken >= 0 and taken != turn - 1:
                break
            for k in range(len(x)):
                work.tried[k] = x[k] + share * direction[k]
            spare = slack + share * direction[len(x)]
            if spare > 0.0:
                tried, worst, total = look(case, work.tried, spare, work)
                cost = tried + penalty * spare - barrier * (total + math.log(spare))
                if total > -math.inf and cost < merit:
                    taken, merit, time, least, logs = turn, cost, tried, worst, total
            share *= 0.5
        if taken < 0:
            damping = min(damping * 10.0, 1e4)
            continue
        share = 0.5**taken
        for k in range(len(x)):
            x[k] += share * direction[k]
        slack += share * direction[len(x)]
        barrier = max(rate * barrier, last_barrier)
        damping = max(damping / 4.0 if taken == 0 else damping if taken <= 2 else min(damping * 3.0, 1e4), 1e-8)
    return time, least, iterations


@inner
@no_type_check
def solve(system, right):
    """Cholesky's factor in place of the lower half of a matrix, and the solution in place of the right-hand side."""
    count = len(right)
    for a in range(count):
        row = system[a]
        for b in range(a + 1):
            other, total = system[b], row[b]
            for k in range(b):
                total -= row[k] * other[k]
            row[b] = math.sqrt(total) if a == b else total / other[b]
        total = right[a]
        for k in range(a):
            total -= row[k] * right[k]
        right[a] = total / row[a]
    for a in range(count - 1, -1, -1):
        right[a] /= system[a, a]
        for k in range(a):
            right[k] -= system[a, k] * right[a]
