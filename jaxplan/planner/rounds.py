"""Rounds of a replan: the best candidates get paths, and are matched, solved and checked until one passes (host).

Where plans are compared by capture a candidate's score is what a flight straight to its goal promises. Beside a
committed plan that decides how many are tried, and whether any is.
"""

import functools
from collections.abc import Callable

import numpy as np

from jaxplan.batching import meanwhile
from jaxplan.planner.parts import Allocation, Parts
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
AT_STAKE, IN_FLIGHT = 0.5, 1.0
"""s; beside a committed plan one width of candidates is tried for each of these until it captures the target: no other
plan gains more (docs/decisions/0047). The second in fast flight, where further rounds hardly ever pass (0054)."""
PROMISING = 0.2
"""s; in fast flight candidates are tried only where the best of them promises to capture so much sooner than a
committed plan: what won promised more (docs/decisions/0054)."""


def most_rounds(parts: Parts, state: FlatState, above: float) -> float:
    """How many widths of candidates are tried beside a committed plan that is worth ``above`` [s], by capture."""
    each = IN_FLIGHT if parts.config.is_fast(state) else AT_STAKE
    return np.inf if above == -np.inf else max(np.ceil(-above / each), 1.0)


def least_promise(parts: Parts, state: FlatState, table: Table, above: float) -> float:
    """What a candidate must promise [s] to be tried beside a committed plan that is worth ``above``, by capture."""
    gain, best = PROMISING if parts.config.is_fast(state) else parts.config.capture.gain, table.best_first()[:1]
    return above - DOUBT if table.score[best].max(initial=-np.inf) > above + gain else np.inf


def outrank_beyond(parts: Parts, table: Table, rounds: float) -> Table:
    """The table without the rows for which so many rounds leave no time: no path is looked for to their goals."""
    if parts.config.exhaustive or rounds == np.inf:
        return table
    return outrank(table, table.best_first()[int(rounds) * PORTION * parts.config.width :])


def until_one_passes(parts: Parts, state: FlatState, table: Table, timer: Timer, rounds: float) -> Table:
    """Search, match, solve and check the best rows first, in at most so many rounds, until a round has a usable one.

    Paths are searched and waypoints placed for few more of them than it takes to fill the next round with what may
    arrive in time. Once the ``timer`` is up there is no further round. Where the first came to nothing two are tried
    at a time, on two cores.
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
            now = soon or functools.partial(_round, parts, state, table, waiting[:width], asked, timer)
            waiting, rounds, asked = waiting[width:], rounds - 1, parts.allocations(state)
            is_next = begun and rounds > 0 and len(waiting) >= least
            soon = _soon(parts, state, table, waiting[:width], asked) if is_next else None
            tried, begun = now(), True
            timer.lap("minsnap")
            table = functools.reduce(enter, tried, table)
            passed = any((checked.reasons == 0).any() for checked in tried)
            if not exhaustive and (passed or timer.is_up or rounds == 0):
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


def _soon(
    parts: Parts, state: FlatState, table: Table, rows: Rows, asked: tuple[Allocation, ...]
) -> Callable[[], list[Checked]]:
    """A round on another core, which counts only where the one before it comes to nothing."""
    return meanwhile(functools.partial(in_float64(_round), parts, state, table, rows, asked, Timer()))


def _round(
    parts: Parts, state: FlatState, table: Table, rows: Rows, asked: tuple[Allocation, ...], timer: Timer
) -> list[Checked]:
    """Ask the time allocations in turn, each for the rows that can still win."""
    tried = []
    for allocation in asked:
        matched = match(parts, allocation, state, table, rows)
        timer.lap("policy", matched.arrival)
        tried.append(check(parts, state, table, matched))
        timer.lap("minsnap")
        passes = tried[-1].reasons == 0
        rows = rows[~passes] if parts.config.exhaustive else rows[np.cumsum(passes) == 0]
        if not len(rows):
            break
    return tried
