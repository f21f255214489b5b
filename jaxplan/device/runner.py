"""Many episodes on one device: a batch of places, each of which the next episode takes once one has ended (host)."""

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from jaxplan.device.episodes import Advance, Begin, Ended, Episode, Scene, State, Tally
from jaxplan.errors import InputError
from jaxplan.io.targets import Target
from jaxplan.precision import in_float64
from jaxplan.tracking.rates import CONTROL_RATE

CYCLES_AT_ONCE = 5
"""Periods that are flown between two looks at who has ended (arbitrary)."""
CHUNK = 512
"""Episodes that are computed side by side (arbitrary: as many with 400 goals a cycle take some 40 GB)."""
FEWEST, SHORTEST = 64, 4096
"""Episodes, and control steps of a target, for which arrays have room at least (arbitrary)."""
NOBODY = -1


class Flight(NamedTuple):
    """One episode as a user describes it."""

    target: Target
    departure: float
    """When the defender begins to plan [s]."""
    seed: int
    """Of all noise and draws."""
    predictor: int = 0
    """Number of its predictor among those of the loop."""


class Outcome(NamedTuple):
    """What became of it; the numbers are those up to the instant that decided it."""

    outcome: str
    """intercepted, collision, tracking_lost, target_ended or no_plan."""
    end_time: float
    """[s]"""
    min_distance: float
    """To the target [m]."""
    max_position_error: float
    """[m]"""
    max_yaw_error: float
    """[rad]"""
    min_clearance: float
    """Of the vehicle's centre from obstacles and faces [m]."""
    cycles: int
    plans: int


class Runner:
    """Flies episodes a batch at a time; compiled once for each shape of scene."""

    def __init__(self, begin: Begin, advance: Advance, width: int, chunk: int = CHUNK) -> None:
        """Take the two functions of a loop.

        Args:
            begin, advance: as ``build_loop`` gives them.
            width: how many episodes are under way at once.
            chunk: of these, so many are computed side by side, one chunk after the other: what memory has to hold.

        Raises:
            InputError: ``width`` or ``chunk`` is not at least 1.
        """
        if width < 1 or chunk < 1:
            raise InputError(f"runner: width and chunk are {width} and {chunk}, want at least 1")
        self._width = width
        self._begin = jax.jit(functools.partial(_begun, begin))
        self._advance = jax.jit(functools.partial(_advanced, advance, min(chunk, width)))
        self._refill = jax.jit(_refilled)

    @in_float64
    def fly(self, scene: Scene, flights: Sequence[Flight]) -> list[Outcome]:
        """Every flight's outcome, in the order given; each depends on nothing but itself.

        Raises InputError where there is no flight.
        """
        if not flights:
            raise InputError("episodes: have none, want at least one")
        scene, table = jax.device_put((scene, _table(flights)))
        waiting = list(range(len(flights)))[::-1]
        taken = np.array([waiting.pop() if waiting else NOBODY for _ in range(self._width)])
        outcomes: dict[int, Outcome] = {}
        state = self._begin(scene, table, np.maximum(taken, 0))
        while len(outcomes) < len(flights):
            state = self._advance(scene, table, np.maximum(taken, 0), state)
            tally = jax.device_get(state.tally)
            fresh = np.zeros(self._width, bool)
            for place in np.flatnonzero((taken != NOBODY) & (tally.ended != Ended.FLYING)):
                outcomes[int(taken[place])] = _outcome(jax.tree.map(lambda leaf, i=place: leaf[i], tally))
                taken[place] = waiting.pop() if waiting else NOBODY
                fresh[place] = taken[place] != NOBODY
            if fresh.any():
                state = self._refill(fresh, self._begin(scene, table, np.maximum(taken, 0)), state)
        return [outcomes[member] for member in range(len(flights))]


def _row(table: Episode, member: Int[Array, ""]) -> Episode:
    return jax.tree.map(lambda leaf: leaf[member], table)


def _begun(begin: Begin, scene: Scene, table: Episode, members: Int[Array, "e"]) -> State:
    return jax.vmap(lambda member: begin(scene, _row(table, member)))(members)


def _advanced(
    advance: Advance, chunk: int, scene: Scene, table: Episode, members: Int[Array, "e"], state: State
) -> State:
    """A few periods later."""

    def one(under_way: tuple[Int[Array, ""], State]) -> State:
        member, state = under_way
        return advance(scene, _row(table, member), state)

    def period(_: Int[Array, ""], state: State) -> State:
        return jax.lax.map(one, (members, state), batch_size=chunk)

    return jax.lax.fori_loop(0, CYCLES_AT_ONCE, period, state)


def _refilled(fresh: Bool[Array, "e"], begun: State, state: State) -> State:
    """Episodes that begin in their places, the others as they are."""

    def chosen(new: Array, old: Array) -> Array:
        return jnp.where(fresh.reshape(-1, *(1,) * (new.ndim - 1)), new, old)

    return jax.tree.map(chosen, begun, state)


def _table(flights: Sequence[Flight]) -> Episode:
    """All flights, their targets as long as the longest; filled up, so that few shapes are compiled for."""
    rows = [*flights, *([flights[0]] * (_filled(len(flights), FEWEST) - len(flights)))]
    steps = np.array([math.ceil(flight.target.duration * CONTROL_RATE) for flight in rows])
    instants = np.arange(_filled(int(steps.max()) + 1, SHORTEST)) / CONTROL_RATE
    targets = {id(flight): flight.target.position(instants).astype(np.float32) for flight in flights}
    departures = np.array([math.ceil(flight.departure * CONTROL_RATE - 1e-6) for flight in rows])
    return Episode(
        target=np.stack([targets[id(flight)] for flight in rows]),
        steps=steps.astype(np.int32),
        departure=departures.astype(np.int32),
        predictor=np.array([flight.predictor for flight in rows], np.int32),
        key=jax.vmap(jax.random.key)(jnp.array([flight.seed for flight in rows])),
    )


def _filled(count: int, least: int) -> int:
    """The next one of ``least`` times powers of 2."""
    return least * 2 ** max(0, math.ceil(math.log2(count / least)))


def _outcome(tally: Tally) -> Outcome:
    return Outcome(
        outcome=Ended(int(tally.ended)).name.lower(),
        end_time=float(tally.end),
        min_distance=float(tally.nearest),
        max_position_error=float(tally.position_error),
        max_yaw_error=float(tally.yaw_error),
        min_clearance=float(tally.clearance),
        cycles=int(tally.cycles),
        plans=int(tally.plans),
    )
