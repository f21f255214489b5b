"""One replan as a single traced function: goals in, the trajectory that is best by the paper's eq. 9 out.

Stations in order: early rejection, shortest ways, waypoints, the policy's least times, and then, for the best rows some
at a time until one passes, arrival matching, minimum snap and all checks, that for obstacles included. ``vmap`` it over
rooms' defenders; nothing in it depends on how many there are.
"""

import dataclasses
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from jaxplan.arrays import Scalar
from jaxplan.arrival import match_arrival
from jaxplan.device.paths import shortest_ways
from jaxplan.device.room import Room
from jaxplan.device.stations import Allotted, Goals, Stations, Tried
from jaxplan.feasibility.classifier import Classifier
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner.approach import PACES
from jaxplan.planner.records import PlannerConfig
from jaxplan.policy.protocol import Policy
from jaxplan.records import replace
from jaxplan.spline import FlatState, FlatStateBatch
from jaxplan.status import Reason, bit
from jaxplan.validation import require_one_of, require_within
from jaxplan.vehicle.identity import require_same_vehicle
from jaxplan.vehicle.params import Vehicle

APPROACHED = 4
"""Of the latest goals, so many are approached where none can be met (arbitrary)."""


@dataclasses.dataclass(frozen=True)
class ReplanConfig:
    """What differs from the planner on the host: everything else is its configuration."""

    planner: PlannerConfig = PlannerConfig()
    """Of which the search, its fall-backs, refinement, capture and rollouts are not used."""
    width: int = 64
    """Rows that are matched, solved and checked at a time."""
    rounds: int = 4
    """So many widths are tried at most: bounds what one defender makes all others of a batch wait."""
    tried_at_once: int = 1
    """Places of the roadmap that are tried for each goal at a time (``paths.shortest_ways``); several on a GPU."""
    pieces: int = 64
    """Into which the clearance check cuts a segment: the host cuts 16 ones again where their bound is too loose."""

    def __post_init__(self) -> None:
        require_within("replan", self, 1, 4096, "width")
        require_within("replan", self, 1, 64, "rounds")
        require_within("replan", self, 1, 16, "tried_at_once")
        require_within("replan", self, 2, 256, "pieces")
        require_one_of("replan", self.planner, ("pass", "rest"), "meet")
        require_one_of("replan", self.planner, ("hold", "path"), "heading")


class Decision(NamedTuple):
    """What one replan comes to."""

    found: Bool[Array, ""]
    """Whether any trajectory meets the target."""
    approaches: Bool[Array, ""]
    """Whether, where none does, one comes nearer."""
    score: Float[Array, ""]
    """Of the trajectory that meets it: likelihood times its weight, less its arrival time [s]; -inf without one."""
    candidate: Int[Array, ""]
    """Number of its goal, or of that which is approached."""
    arrival_time: Float[Array, ""]
    """When the trajectory is there [s from the start state]."""
    alpha: Float[Array, ""]
    """Scale factor of its durations."""
    spline: SplineBatch
    """The trajectory, a batch of one; of no use where there is none."""
    reasons: UInt32[Array, "k"]
    """Against each goal, as far as it was looked at; OUTRANKED where it was not."""


@runtime_checkable
class Replan(Protocol):
    """From goals to a decision."""

    def __call__(self, room: Room, state: FlatState, goals: Goals, above: Scalar) -> Decision:
        """Traced. ``state`` is where the plan begins; nothing is tried that scores no better than ``above`` [s]."""


def build_replan(
    config: ReplanConfig, vehicle: Vehicle, policy: Policy, classifier: Classifier | None = None
) -> Replan:
    """Bind configuration, vehicle and what was learned; the result is pure, to be traced in float64.

    Raises InputError where policy or classifier were made for another vehicle.
    """
    require_same_vehicle(f"policy {policy.name!r}", policy.vehicle, vehicle)
    require_same_vehicle("classifier", None if classifier is None else classifier.vehicle, vehicle)
    planner = config.planner
    stations = Stations(planner, config.pieces, vehicle, policy, classifier)
    rounds = _Rounds(config, stations)

    def replan(room: Room, state: FlatState, goals: Goals, above: Scalar) -> Decision:
        score = planner.likelihood_weight * jnp.asarray(goals.likelihood) - jnp.asarray(goals.times)
        rejected = stations.reject(room, state, goals)
        ways = shortest_ways(room, jnp.asarray(state.pos), jnp.asarray(goals.positions), config.tried_at_once)
        late = ways.length.astype(score.dtype) > stations.reach(state, goals)
        reasons = rejected | bit(~ways.found, Reason.NO_PATH) | bit(late, Reason.OUT_OF_REACH)
        every = stations.allot(room, ways)
        least = stations.least_times(every, state)
        slowest = planner.arrival.least_alpha * (1.0 - planner.arrival.tolerance)
        in_vain = ~(planner.arrival.least_alpha * jnp.asarray(goals.times) / least >= slowest)
        reasons |= bit(in_vain, Reason.ALPHA_LT_1) | bit(~every.routes.whole, Reason.PREFIX_ONLY)
        near = _approached(goals, rejected | bit(~ways.found, Reason.NO_PATH))
        offered = jnp.where(score > above, score, -jnp.inf)
        return rounds.best_first(_Known(room, state, goals, every, near), offered, reasons)

    return replan


class _Near(NamedTuple):
    """What is approached where nothing can be met: a few goals, each at several paces."""

    rows: Int[Array, "a"]
    paces: Float[Array, "a"]
    possible: Bool[Array, "a"]


def _approached(goals: Goals, reasons: UInt32[Array, "k"]) -> _Near:
    """A few of the latest goals, at several paces; ``reasons`` against flying there at all."""
    times = jnp.asarray(goals.times)
    possible = (reasons & ~jnp.uint32(int(Reason.OUT_OF_REACH))) == 0
    count = min(APPROACHED, times.shape[0])
    latest = jax.lax.top_k(jnp.where(possible, times, -jnp.inf), count)[1].astype(jnp.int32)
    rows = jnp.repeat(latest, len(PACES))
    return _Near(rows, jnp.tile(jnp.asarray(PACES, times.dtype), count), possible[rows])


class _Known(NamedTuple):
    """What all rounds of a replan look at."""

    room: Room
    state: FlatState
    goals: Goals
    every: Allotted
    near: _Near


class _Rounds:
    """Rows in the order of their scores, one width after the other, until one passes; approaches beside them."""

    def __init__(self, config: ReplanConfig, stations: Stations) -> None:
        self._config, self._stations = config, stations

    def best_first(self, known: _Known, score: Float[Array, "k"], reasons: UInt32[Array, "k"]) -> Decision:
        """The best row without a reason against it that passes, or the least late approach."""
        count, width = score.shape[0], min(self._config.width, score.shape[0])
        usable = (reasons == 0) & jnp.isfinite(score)
        order = jnp.argsort(jnp.where(usable, -score, jnp.inf), stable=True)
        order = jnp.concatenate([order, jnp.zeros(-count % width, order.dtype)]).astype(jnp.int32)
        left, most = jnp.sum(usable, dtype=jnp.int32), min(self._config.rounds, -(-count // width))

        def unfinished(carry: tuple[Int[Array, ""], Decision]) -> Bool[Array, ""]:
            number, decision = carry
            return (number == 0) | (~decision.found & (number < most) & (number * width < left))

        def step(carry: tuple[Int[Array, ""], Decision]) -> tuple[Int[Array, ""], Decision]:
            number, before = carry
            rows = jax.lax.dynamic_slice(order, (number * width,), (width,))
            counts = number * width + jnp.arange(width, dtype=jnp.int32) < left
            return number + 1, self._round(known, rows, counts, score, before.reasons)

        first = jnp.where(usable, jnp.uint32(int(Reason.OUTRANKED)), reasons)
        return jax.lax.while_loop(unfinished, step, (jnp.int32(0), _nothing(known.every, first)))[1]

    def _round(
        self,
        known: _Known,
        rows: Int[Array, "w"],
        counts: Bool[Array, "w"],
        score: Float[Array, "k"],
        reasons: UInt32[Array, "k"],
    ) -> Decision:
        """What some rows come to, of which those that ``counts`` says are to be looked at."""
        times, near, width = jnp.asarray(known.goals.times), known.near, rows.shape[0]
        tried = self._try(known, rows, times[rows])
        against = tried.margins.reasons
        passed = (against[:width] == 0) & counts
        lateness = tried.arrival[width:] - times[near.rows]
        lateness = jnp.where((against[width:] == 0) & near.possible, lateness, jnp.inf)
        found, best, least_late = jnp.any(passed), jnp.argmax(passed), jnp.argmin(lateness)
        place = jnp.where(found, best, width + least_late)
        row = jnp.where(found, rows[best], near.rows[least_late])
        return Decision(
            found=found,
            approaches=~found & jnp.isfinite(lateness[least_late]),
            score=jnp.where(found, score[row], -jnp.inf),
            candidate=row,
            arrival_time=tried.arrival[place],
            alpha=tried.alpha[place],
            spline=_one(tried.splines, place),
            reasons=reasons.at[jnp.where(counts, rows, score.shape[0])].set(against[:width], mode="drop"),
        )

    def _try(self, known: _Known, rows: Int[Array, "w"], times: Float[Array, "w"]) -> Tried:
        """Rows slowed down until each arrives in time, and approaches at their paces: solved and checked together.

        For an arrival time of 0 the iteration ends after one call, which has the durations at the least scale factor.
        """
        near, config, policy = known.near, self._config.planner.arrival, self._stations.policy
        some = known.every.some(jnp.concatenate([rows, near.rows]))
        least = jnp.concatenate([jnp.full(rows.shape, config.least_alpha, times.dtype), near.paces])
        until = jnp.concatenate([times, jnp.zeros_like(near.paces)])

        def decode(initial: FlatStateBatch) -> Float[Array, "m w"]:
            return policy.decode(some.context, initial)

        arrival = match_arrival(decode, known.state, until, config, some.routes.meet, least)
        matched = jnp.arange(len(least)) < len(rows)
        durations = jnp.where(matched[None], arrival.durations, arrival.least_durations)
        alpha, reasons = jnp.where(matched, arrival.alpha, least), jnp.where(matched, arrival.reasons, 0)
        tried = self._stations.solve(known.room, known.state, some, durations, alpha)
        return tried._replace(margins=replace(tried.margins, reasons=tried.margins.reasons | reasons))


def _nothing(every: Allotted, reasons: UInt32[Array, "k"]) -> Decision:
    """Before anything was tried."""
    segments, dtype = every.waypoints.shape[0] - 1, every.waypoints.dtype
    no, zero = jnp.zeros((), bool), jnp.zeros((), dtype)
    spline = SplineBatch(
        durations=jnp.zeros((segments, 1), dtype),
        position=jnp.zeros((segments, 10, 3, 1), dtype),
        yaw=jnp.zeros((segments, 6, 1, 1), dtype),
    )
    return Decision(no, no, zero, jnp.int32(0), zero, zero, spline, reasons)


def _one(splines: SplineBatch, at: Int[Array, ""]) -> SplineBatch:
    return jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, at, 1, axis=leaf.ndim - 1), splines)
