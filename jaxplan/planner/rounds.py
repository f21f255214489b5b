"""Rounds of a replan: the best candidates get paths, and are matched, solved and checked until one passes (host).

Where plans are compared by capture a candidate's score is what a flight straight to its goal promises. Beside a
committed plan that decides how many are tried, and whether any is.
"""

import functools
from collections.abc import Callable

import numpy as np

from jaxplan.batching import meanwhile
from jaxplan.planner.parts import Allocation, Parts
from jaxplan.planner.records import prospect_for
from jaxplan.planner.table import Checked, Rows, Table, bound, check, enter, knots, match, outrank, search
from jaxplan.planner.timer import Timer
from jaxplan.precision import in_float64
from jaxplan.spline import FlatState

PORTION = 2
"""Widths of candidates that get their waypoints at a time: of about so many one width may arrive in time (measured)."""
SEARCHED = 2
"""Portions that paths are searched to at a time: each search settles the roads anew (measured)."""
DOUBT = 0.25
"""s; how much sooner a candidate's trajectory may capture than a straight flight promises (arbitrary)."""
AT_STAKE = 1.0
"""s; beside a committed plan one width of candidates is tried for each of these until it captures the target: no other
plan gains more (docs/decisions/0047, 0054),"""
MOST, MOST_IN_FLIGHT = 3, 2
"""and so many at most, the second in fast flight: of 76 further ones none passed (0063)."""
AMONG_MOVERS = 0.5
"""s; the same as ``AT_STAKE`` from slow starts where something moves, and as many as that gives: the map holds still
what will be swept, and more of the best candidates are in vain (0064)."""
PROMISING = 0.2
"""s; candidates are tried only where the best of them promises to capture so much sooner than a committed plan: what
won promised more (docs/decisions/0054, 0063)."""


def most_rounds(parts: Parts, state: FlatState, above: float) -> float:
    """How many widths of candidates are tried beside a committed plan that is worth ``above`` [s], by capture."""
    if above == -np.inf:
        return np.inf
    fast = parts.config.is_fast(state)
    if parts.moving:
        return float(max(np.ceil(-above / (AT_STAKE if fast else AMONG_MOVERS)), 1.0))
    return float(np.clip(np.ceil(-above / AT_STAKE), 1.0, MOST_IN_FLIGHT if fast else MOST))


def least_promise(table: Table, above: float) -> float:
    """What a candidate must promise [s] to be tried beside a committed plan that is worth ``above``, by capture."""
    best = table.best_first()[:1]
    return above - DOUBT if table.score[best].max(initial=-np.inf) > above + PROMISING else np.inf


def outrank_beyond(parts: Parts, table: Table, rounds: float) -> Table:
    """The table without the rows for which so many rounds leave no time: no path is looked for to their goals."""
    if parts.config.exhaustive or rounds == np.inf:
        return table
    return outrank(table, table.best_first()[int(rounds) * PORTION * parts.config.width :])


def until_one_passes(parts: Parts, state: FlatState, table: Table, timer: Timer, rounds: float) -> Table:
    """Search, match, solve and check the best rows first, in at most so many rounds, until a round has a usable one.

    Paths are searched and waypoints placed for few more of them than it takes to fill the next round with what may
    arrive in time. As soon as the first round has come to nothing, or its first time allocation has, two are tried at a
    time, on two cores. Once the ``timer`` is up no other is begun, but what has begun is waited for.
    """
    width, exhaustive, asked = parts.config.width, parts.config.exhaustive, parts.tried(state)
    rows = table.usable() if exhaustive else table.best_first()
    waiting, size, begun = rows[:0], len(rows) if exhaustive else PORTION * width, False
    while len(rows):
        table, soon = _searched(parts, state, table, rows, size, timer), None
        some, rows = rows[:size], rows[size:]
        table = _bounded(parts, state, table, some[table.reasons[some] == 0], timer)
        waiting = np.concatenate([waiting, some[table.reasons[some] == 0]])
        while len(waiting) >= (least := width if len(rows) else 1):
            now, waiting, rounds = waiting[:width], waiting[width:], rounds - 1
            following = _Following()
            if not exhaustive and rounds > 0 and len(waiting) >= least and not timer.is_up:
                later = parts.allocations(state)
                following = _Following(functools.partial(_round, parts, state, table, waiting[:width], later, Timer()))
            if begun:
                following.begin()
            tried = soon() if soon else _round(parts, state, table, now, asked, timer, following)
            soon, asked, begun = following.soon, parts.allocations(state), True
            timer.lap("minsnap")
            table = functools.reduce(enter, tried, table)
            passed = any((checked.reasons == 0).any() for checked in tried)
            if not exhaustive and (passed or rounds == 0 or (timer.is_up and soon is None)):
                return outrank(table, np.concatenate([waiting, rows]))
    return table


def _searched(parts: Parts, state: FlatState, table: Table, rows: Rows, size: int, timer: Timer) -> Table:
    """Paths to the first ``size`` of the rows, and to portions behind them; where they have none yet."""
    if (table.path[rows[:size]] >= 0).any():
        return table
    table = search(parts, state, table, np.sort(rows[: SEARCHED * size]))
    timer.lap("search")
    return table


def _bounded(parts: Parts, state: FlatState, table: Table, rows: Rows, timer: Timer) -> Table:
    """Waypoints for ``rows``, and which of them may be reached in time."""
    if not len(rows):
        return table
    table = knots(parts, table, rows)
    timer.lap("knots")
    table = bound(parts, state, table, rows)
    timer.lap("policy")
    return table


class _Following:
    """The round after one, on another core once it is likely to be wanted; it counts only where that one is in vain."""

    def __init__(self, run: Callable[[], list[Checked]] | None = None) -> None:
        self._run = run
        self.soon: Callable[[], list[Checked]] | None = None
        """Gives what it came to; None where it has not begun."""

    def begin(self) -> None:
        """At most once."""
        if self._run is not None and self.soon is None:
            self.soon = meanwhile(in_float64(self._run))


def _round(
    parts: Parts,
    state: FlatState,
    table: Table,
    rows: Rows,
    asked: tuple[Allocation, ...],
    timer: Timer,
    following: _Following | None = None,
) -> list[Checked]:
    """Ask the time allocations in turn, each for the rows that can still win; the ``following`` round if one fails.

    By capture the first that has a plan is enough: scores are promises, and of what the others found little won.
    """
    enough, tried = not parts.config.exhaustive and prospect_for(parts.config, table.candidates) is not None, []
    for allocation in asked:
        matched = match(parts, allocation, state, table, rows)
        timer.lap("policy", matched.arrival)
        tried.append(check(parts, state, table, matched))
        timer.lap("minsnap")
        passes = tried[-1].reasons == 0
        rows = rows[~passes] if parts.config.exhaustive else rows[np.cumsum(passes) == 0]
        if not len(rows) or (enough and passes.any()):
            break
        if following is not None and not passes.any():
            following.begin()
    return tried
