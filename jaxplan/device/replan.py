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

from jaxplan.arrays import AnyArray, Scalar
from jaxplan.arrival import match_arrival, sped_up, time_to
from jaxplan.config import Meet
from jaxplan.device.paths import Ways, sees, shortest_ways
from jaxplan.device.room import Room
from jaxplan.feasibility.classifier import Classifier
from jaxplan.knots import SelectedRoutes, select_routes
from jaxplan.minsnap.spline_batch import SplineBatch, fit
from jaxplan.numerics import safe_norm
from jaxplan.planner.approach import PACES
from jaxplan.planner.records import PlannerConfig
from jaxplan.policy.protocol import Context, Policy
from jaxplan.prediction.candidates import Candidates, reject_early
from jaxplan.search.stops import OPTIONS
from jaxplan.selection import Margins, check_clearance, check_flight
from jaxplan.spline import FlatState
from jaxplan.status import Reason, bit
from jaxplan.validation import require_one_of, require_within
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.reach import reach
from jaxplan.world.clearance import clearance_at_once, wall_clearance
from jaxplan.world.obstacles import World

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


class Goals(NamedTuple):
    """Where and when a target could be met; k of them."""

    positions: Float[AnyArray, "k 3"]
    """[m, world]"""
    times: Float[AnyArray, "k"]
    """[s from the start state]"""
    likelihood: Float[AnyArray, "k"]
    """In [0, 1]."""


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


class _Allotted(NamedTuple):
    """All goals' waypoints, and what the policy makes of them."""

    routes: SelectedRoutes
    waypoints: Float[Array, "n 3 k"]
    samples: Float[Array, "p 3 k"]
    context: Context

    def some(self, rows: Int[Array, "w"]) -> "_Allotted":
        """Those of some rows."""
        first = jax.tree.map(lambda leaf: leaf[rows], self.routes)
        last = jax.tree.map(lambda leaf: leaf[..., rows], (self.waypoints, self.samples, self.context))
        return _Allotted(first, *last)


class _Tried(NamedTuple):
    """Trajectories of some rows."""

    splines: SplineBatch
    margins: Margins
    alpha: Float[Array, "w"]
    arrival: Float[Array, "w"]
    """When each is at its goal [s]."""


def build_replan(
    config: ReplanConfig, vehicle: Vehicle, policy: Policy, classifier: Classifier | None = None
) -> Replan:
    """Bind configuration, vehicle and what was learned; the result is pure, to be traced in float64."""
    planner, meets = config.planner, config.planner.meet
    stations = _Stations(config, vehicle, policy, classifier)

    def replan(room: Room, state: FlatState, goals: Goals, above: Scalar) -> Decision:
        score = planner.likelihood_weight * jnp.asarray(goals.likelihood) - jnp.asarray(goals.times)
        rejected = stations.reject(room, state, goals)
        ways = shortest_ways(room, jnp.asarray(state.pos), jnp.asarray(goals.positions), config.tried_at_once)
        late = ways.length.astype(score.dtype) > stations.reach(state, goals)
        reasons = rejected | bit(~ways.found, Reason.NO_PATH) | bit(late, Reason.OUT_OF_REACH)
        every = stations.allot(room, ways, meets)
        least = stations.least_times(every, state)
        slowest = planner.arrival.least_alpha * (1.0 - planner.arrival.tolerance)
        in_vain = ~(planner.arrival.least_alpha * jnp.asarray(goals.times) / least >= slowest)
        reasons |= bit(in_vain, Reason.ALPHA_LT_1) | bit(~every.routes.whole, Reason.PREFIX_ONLY)
        near = stations.approached(goals, rejected | bit(~ways.found, Reason.NO_PATH))
        offered = jnp.where(score > above, score, -jnp.inf)
        return stations.best_first(room, state, goals, every, offered, reasons, near)

    return replan


class _Near(NamedTuple):
    """What is approached where nothing can be met: a few goals, each at several paces."""

    rows: Int[Array, "a"]
    paces: Float[Array, "a"]
    possible: Bool[Array, "a"]


class _Stations:
    """The stations of a replan, each traced."""

    def __init__(self, config: ReplanConfig, vehicle: Vehicle, policy: Policy, classifier: Classifier | None) -> None:
        self._config, self._vehicle, self._policy, self._classifier = config, vehicle, policy, classifier

    def reject(self, room: Room, state: FlatState, goals: Goals) -> UInt32[Array, "k"]:
        """Early reasons against each goal."""
        times = jnp.asarray(goals.times)
        candidates = Candidates(
            goals=goals.positions,
            arrival_times=times,
            likelihood=goals.likelihood,
            reasons=jnp.zeros(times.shape, jnp.uint32),
            target=jnp.asarray(goals.positions)[0],
        )
        world = _in_precision_of(room.world, times)
        far = self.reach(state, goals)
        marked = reject_early(
            candidates, world, jnp.asarray(state.pos), self._config.planner.padding, far, clearance_at_once
        )
        return jnp.asarray(marked.reasons)

    def reach(self, state: FlatState, goals: Goals) -> Float[Array, "k"]:
        """What no flight exceeds until each goal's time [m]."""
        return jnp.asarray(reach(self._vehicle, safe_norm(jnp.asarray(state.vel)), jnp.asarray(goals.times)))

    def allot(self, room: Room, ways: Ways, meets: Meet) -> _Allotted:
        """Waypoints along all ways, stop points behind their goals, and the policy's view of them."""
        stops = ways.points[:, -1] if meets == "rest" else stop_points(room, ways.points)
        wide = jnp.result_type(float)
        routes = select_routes(ways.points.astype(wide), self._config.planner.knots, stops=stops.astype(wide))
        waypoints = jnp.moveaxis(routes.knots.waypoints, 0, -1)
        context = self._policy.encode(waypoints, routes.knots.count)
        return _Allotted(routes, waypoints, jnp.moveaxis(routes.samples, 0, -1), context)

    def least_times(self, every: _Allotted, state: FlatState) -> Float[Array, "k"]:
        """Until each goal, at the least scale factor [s]."""
        width = every.waypoints.shape[-1]
        least = jnp.full(width, self._config.planner.arrival.least_alpha, every.waypoints.dtype)
        durations = self._policy.decode(every.context, sped_up(state.repeated(width), least))
        return least * jnp.asarray(time_to(durations, every.routes.meet))

    def approached(self, goals: Goals, reasons: UInt32[Array, "k"]) -> _Near:
        """A few of the latest goals, at several paces; ``reasons`` against flying there at all."""
        times = jnp.asarray(goals.times)
        possible = (reasons & ~jnp.uint32(int(Reason.OUT_OF_REACH))) == 0
        count = min(APPROACHED, times.shape[0])
        latest = jax.lax.top_k(jnp.where(possible, times, -jnp.inf), count)[1].astype(jnp.int32)
        rows = jnp.repeat(latest, len(PACES))
        return _Near(rows, jnp.tile(jnp.asarray(PACES, times.dtype), count), possible[rows])

    def best_first(
        self,
        room: Room,
        state: FlatState,
        goals: Goals,
        every: _Allotted,
        score: Float[Array, "k"],
        reasons: UInt32[Array, "k"],
        near: _Near,
    ) -> Decision:
        """Rows in the order of their scores, one width after the other, until one passes; approaches beside them."""
        times, count = jnp.asarray(goals.times), score.shape[0]
        width = min(self._config.width, count)
        usable = (reasons == 0) & jnp.isfinite(score)
        order = jnp.argsort(jnp.where(usable, -score, jnp.inf), stable=True)
        order = jnp.concatenate([order, jnp.zeros(-count % width, order.dtype)]).astype(jnp.int32)
        left, most = jnp.sum(usable), min(self._config.rounds, -(-count // width))

        def unfinished(carry: tuple[Int[Array, ""], Decision]) -> Bool[Array, ""]:
            number, decision = carry
            return (number == 0) | (~decision.found & (number < most) & (number * width < left))

        def step(carry: tuple[Int[Array, ""], Decision]) -> tuple[Int[Array, ""], Decision]:
            number, before = carry
            rows = jax.lax.dynamic_slice(order, (number * width,), (width,))
            counts = number * width + jnp.arange(width, dtype=jnp.int32) < left
            tried = self._try(room, state, every, rows, times[rows], near)
            against = tried.margins.reasons
            passed = (against[:width] == 0) & counts
            lateness = tried.arrival[width:] - times[near.rows]
            lateness = jnp.where((against[width:] == 0) & near.possible, lateness, jnp.inf)
            found, best = jnp.any(passed), jnp.argmin(lateness)
            place = jnp.where(found, jnp.argmax(passed), width + best)
            row = jnp.where(found, rows[jnp.argmax(passed)], near.rows[best])
            return number + 1, Decision(
                found=found,
                approaches=~found & jnp.isfinite(lateness[best]),
                score=jnp.where(found, score[row], -jnp.inf),
                candidate=row,
                arrival_time=tried.arrival[place],
                alpha=tried.alpha[place],
                spline=_one(tried.splines, place),
                reasons=before.reasons.at[jnp.where(counts, rows, count)].set(against[:width], mode="drop"),
            )

        first = jnp.where(usable, jnp.uint32(int(Reason.OUTRANKED)), reasons)
        return jax.lax.while_loop(unfinished, step, (jnp.int32(0), _nothing(every, first)))[1]

    def _try(
        self,
        room: Room,
        state: FlatState,
        every: _Allotted,
        rows: Int[Array, "w"],
        times: Float[Array, "w"],
        near: _Near,
    ) -> _Tried:
        """Rows slowed down until each arrives in time, and approaches at their paces: solved and checked together.

        For an arrival time of 0 the iteration ends after one call, which has the durations at the least scale factor.
        """
        width, some = len(rows), every.some(jnp.concatenate([rows, near.rows]))
        least = jnp.full(width, self._config.planner.arrival.least_alpha, times.dtype)
        least = jnp.concatenate([least, near.paces])
        arrival = match_arrival(
            lambda initial: self._policy.decode(some.context, initial),
            state,
            jnp.concatenate([times, jnp.zeros_like(near.paces)]),
            self._config.planner.arrival,
            some.routes.meet,
            least,
        )
        matched = jnp.arange(len(least)) < width
        durations = jnp.where(matched[None], arrival.durations, arrival.least_durations)
        alpha, reasons = jnp.where(matched, arrival.alpha, least), jnp.where(matched, arrival.reasons, 0)
        tried = self._solve(room, state, some, durations, alpha)
        return tried._replace(margins=dataclasses.replace(tried.margins, reasons=tried.margins.reasons | reasons))

    def _solve(
        self,
        room: Room,
        state: FlatState,
        some: _Allotted,
        durations: Float[Array, "m w"],
        alpha: Float[Array, "w"],
    ) -> _Tried:
        """Minimum snap and every check."""
        planner = self._config.planner
        rate = 0.0 if planner.heading == "hold" else planner.max_yaw_rate
        splines = fit(state, some.waypoints, durations, rate)
        probability = None
        if self._classifier is not None:
            probability = self._classifier.predict(splines, self._vehicle).probability
        world = _in_precision_of(room.world, durations)
        flown = check_flight(splines, some.samples, self._vehicle, planner.checks, probability)
        finer = dataclasses.replace(planner.checks, samples_per_segment=self._config.pieces)
        margins = check_clearance(flown, splines, world, self._vehicle, finer, _free_distance)
        return _Tried(splines, margins, alpha, jnp.asarray(time_to(durations, some.routes.meet)))


def _nothing(every: _Allotted, reasons: UInt32[Array, "k"]) -> Decision:
    """Before anything was tried."""
    segments, dtype = every.waypoints.shape[0] - 1, every.waypoints.dtype
    no, zero = jnp.zeros((), bool), jnp.zeros((), dtype)
    spline = SplineBatch(
        durations=jnp.zeros((segments, 1), dtype),
        position=jnp.zeros((segments, 10, 3, 1), dtype),
        yaw=jnp.zeros((segments, 6, 1, 1), dtype),
    )
    return Decision(no, no, zero, jnp.int32(0), zero, zero, spline, reasons)


def stop_points(room: Room, points: Float[Array, "k l 3"]) -> Float[Array, "k 3"]:
    """Behind each way's goal the best point to stop at that is seen from there, or the goal itself [m, world].

    What is best is in ``jaxplan.search.stops``: as straight on and as far as there is room for.
    """
    goals, before = points[:, -1], _before_the_goal(points)
    along = goals - before
    length = safe_norm(along)
    directions = along / jnp.maximum(length, 1e-9)[:, None]
    distance, turn, rise = (jnp.asarray(column, points.dtype) for column in OPTIONS.T)
    cos, sin, (x, y, z) = jnp.cos(turn), jnp.sin(turn), directions.T
    ahead = jnp.stack(
        [
            x[:, None] * cos[None] - y[:, None] * sin[None],
            x[:, None] * sin[None] + y[:, None] * cos[None],
            z[:, None] * rise[None],
        ],
        axis=-1,
    )
    ahead = ahead * (distance[None] / jnp.maximum(safe_norm(ahead), 1e-3))[..., None]
    options = goals[:, None] + ahead
    from_goal = jnp.broadcast_to(goals[:, None], options.shape)
    clear = sees(room, from_goal.reshape(-1, 3), options.reshape(-1, 3), strictly=True).reshape(options.shape[:2])
    first = jnp.argmax(clear, axis=1)
    usable = jnp.any(clear, axis=1) & (length > 1e-6)
    chosen = jnp.take_along_axis(options, first[:, None, None], axis=1)[:, 0]
    return jnp.where(usable[:, None], chosen, goals)


def _before_the_goal(points: Float[Array, "k l 3"]) -> Float[Array, "k 3"]:
    """The last corner of each way that is not its goal; its start where all are."""
    apart = safe_norm(points - points[:, -1:]) > 1e-6
    corners = jnp.arange(points.shape[1])
    last = jnp.max(jnp.where(apart, corners[None], 0), axis=1)
    return jnp.take_along_axis(points, last[:, None, None], axis=1)[:, 0]


def _one(splines: SplineBatch, at: Int[Array, ""]) -> SplineBatch:
    return jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, at, 1, axis=leaf.ndim - 1), splines)


def _free_distance(world: World, points: Float[AnyArray, "*n 3"], /) -> Float[Array, "*n"]:
    return jnp.minimum(clearance_at_once(world, points), wall_clearance(world, points))


def _in_precision_of(world: World, like: Float[Array, "k"]) -> World:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf).astype(like.dtype), world)
