"""``build_planner``, where every decision that depends on configuration is taken, and a replan from top to bottom.

Only what can win is matched, solved and checked: a candidate's score depends on neither its path nor alpha, so they are
taken in order of score, some at a time, until one passes. By the paper's eq. 9 the winner is that of an exhaustive
evaluation; by capture scores are promises, and beside a committed plan only the best of them are tried.
"""

import dataclasses
import inspect
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxplan import programs
from jaxplan.compilation import give_back_memory, uncollected
from jaxplan.errors import InputError
from jaxplan.feasibility.classifier import Classifier
from jaxplan.planner.approach import approach
from jaxplan.planner.border import usual_candidates, usual_spline, usual_state
from jaxplan.planner.brake import brake, impact
from jaxplan.planner.capture import prospect_of
from jaxplan.planner.corrections import correct
from jaxplan.planner.descent import build_descent
from jaxplan.planner.kernels.pieces import body_of
from jaxplan.planner.parts import Parts, Placing
from jaxplan.planner.placed import build_match_placed
from jaxplan.planner.records import (
    Approach,
    Brake,
    Correct,
    Impact,
    InWorld,
    PlanBatch,
    Planner,
    PlannerConfig,
    Plans,
    Update,
    Validate,
    Warmup,
    prospect_for,
)
from jaxplan.planner.refined import Refine
from jaxplan.planner.refinement import refine
from jaxplan.planner.rollouts import RollOut, Rollout, build_flyer
from jaxplan.planner.rounds import least_promise, most_rounds, outrank_beyond, until_one_passes
from jaxplan.planner.stations import compile_stations
from jaxplan.planner.table import outrank, reject, rescored, table_of
from jaxplan.planner.timer import Timer
from jaxplan.planner.validator import Room, Verdict, validate
from jaxplan.planner.warmup import candidates_around, compile_all, compile_first, compile_refinement, fly_once
from jaxplan.policy.placing import SEGMENTS, Place, vehicle_numbers
from jaxplan.policy.protocol import Policy
from jaxplan.precision import in_float64
from jaxplan.prediction.candidates import Candidates
from jaxplan.prediction.futures import Futures
from jaxplan.records import replace
from jaxplan.search.kernels.solids import solids_of
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.search.routes import warmup as warm_up_search
from jaxplan.search.update import update_lattices
from jaxplan.spline import FlatState, PiecewisePolynomial, hover
from jaxplan.validation import require_made_by
from jaxplan.vehicle.identity import require_same_vehicle
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.obstacles import World
from jaxplan.world.update import Change, without_boxes


def build_planner(
    config: PlannerConfig | None = None,
    *,
    world: World,
    vehicle: Vehicle,
    policy: Policy,
    classifier: Classifier | None = None,
    placing: Place | None = None,
) -> Planner:
    """Compose the stations for one world, vehicle and policy.

    Args:
        config: the defaults when omitted.
        world: obstacles and room; ``Planner.in_world`` takes the same planner to another one.
        vehicle: whose limits and radius the checks keep.
        policy: allocates the times between waypoints.
        classifier: decides which trajectories the vehicle can follow; without one the rotor limits do.
        placing: where refinements begin, or what all candidates are asked of, too (``PlannerConfig.place``); without
            one refinements begin at the plans that were chosen.

    Raises:
        InputError: world, vehicle or policy are something else, policy or classifier were made for another vehicle, or
            refined plans have other segments than a placing policy's, or there is none for all candidates.
    """
    require_made_by("build_planner: world", world, World, "load_world")
    require_made_by("build_planner: vehicle", vehicle, Vehicle, "load_vehicle")
    require_made_by("build_planner: policy", policy, Policy, "load_policy or constant_speed_policy")
    require_same_vehicle(f"policy {policy.name!r}", policy.vehicle, vehicle)
    require_same_vehicle("classifier", None if classifier is None else classifier.vehicle, vehicle)
    config = config or PlannerConfig()
    if config.place == "all" and placing is None:
        raise InputError("build_planner: have place 'all' and no placing policy, want placing=load_placing(...)")
    stations = compile_stations(config, vehicle, policy, classifier)
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(in_float64(compile_first), stations, config, hover(np.zeros(3)))
        lattices = build_lattices(world, _search_options(config, vehicle))
        first.result()
    descend = None if config.refinement is None else build_descent(config.refinement, vehicle)
    begin = None if placing is None else _compiled(placing, config, vehicle)
    flyer = None if config.rollouts is None else build_flyer(config.rollouts, vehicle)
    room = _room(lattices, world)
    return _planner(
        Parts(config, stations, lattices, _on_device(world), room, vehicle, body_of(vehicle), descend, begin, flyer)
    )


def _search_options(config: PlannerConfig, vehicle: Vehicle) -> SearchConfig:
    """How paths are searched for a vehicle."""
    least = min(config.padding, float(vehicle.radius) + config.checks.tracking_margin)
    factors = (1,) if config.search == "roadmap" else (1, 2, 5, 10)
    return SearchConfig(
        method=config.search,
        resolutions=tuple(config.resolution * factor for factor in factors),
        distance_fractions=SearchConfig().distance_fractions[: len(factors) - 1],
        padding=config.padding,
        fallback_budget=config.fallback_budget,
        least_padding=least if config.narrow_passages else None,
        from_faces=least,
    )


def _compiled(placing: Place, config: PlannerConfig, vehicle: Vehicle) -> Placing:
    """The policy for a refinement's starts, and for all candidates."""
    refinement = config.refinement
    if refinement is not None and refinement.segments != SEGMENTS:
        raise InputError(
            f"refinement: have {refinement.segments} segments, want {SEGMENTS} for a placing policy, or none"
        )
    return Placing(jax.jit(placing), vehicle_numbers(vehicle), build_match_placed(placing, config.arrival))


def _planner(parts: Parts) -> Planner:
    """The functions of a planner with these parts."""
    return Planner(
        plan_batch=_bound(PlanBatch, in_float64(plan_batch), parts),
        approach=_bound(Approach, in_float64(approach), parts),
        correct=_bound(Correct, in_float64(correct), parts),
        refine=_bound(Refine, in_float64(refine), parts),
        validate=_bound(Validate, _validate, parts),
        impact=_bound(Impact, impact, parts),
        brake=_bound(Brake, in_float64(brake), parts),
        roll_out=_bound(RollOut, _roll_out, parts),
        warmup=_bound(Warmup, in_float64(_warmup), parts),
        in_world=_bound(InWorld, _in_world, parts),
        update=_bound(Update, _updated, parts),
        config=parts.config,
    )


def _bound(kind: Any, function: Callable, parts: Parts) -> Any:
    """A function of a planner with its parts, with the arguments and the documentation of its Protocol ``kind``."""
    call = kind.__call__

    def bound(*args: Any, **kwargs: Any) -> Any:
        return function(parts, *args, **kwargs)

    signature = inspect.signature(call)
    bound.__signature__ = signature.replace(parameters=list(signature.parameters.values())[1:])  # type: ignore[attr-defined]
    bound.__doc__ = f"{kind.__doc__}\n\n{inspect.getdoc(call)}"
    bound.__name__ = function.__name__.strip("_")
    bound.__qualname__ = f"Planner.{bound.__name__}"
    return bound


def _in_world(parts: Parts, world: World, resolution: float | None = None) -> Planner:
    """A planner for another world; what is compiled without looking at the world is shared."""
    config = parts.config if resolution is None else dataclasses.replace(parts.config, resolution=resolution)
    lattices = build_lattices(world, _search_options(config, parts.vehicle))
    room, none = _room(lattices, world), frozenset[int]()
    return _planner(parts._replace(config=config, lattices=lattices, world=_on_device(world), room=room, moving=none))


def _updated(parts: Parts, change: Change, moving: bool = False) -> Planner:
    """A planner for the same world after a change; shapes stay, so all that is compiled is shared."""
    lattices, world = update_lattices(parts.lattices, change), change.world
    changed = frozenset(_changed_boxes(parts.world, world).tolist())
    movers = parts.moving | changed if moving else parts.moving - changed
    room = parts.room if moving else _room(lattices, world, movers)
    return _planner(parts._replace(lattices=lattices, world=_on_device(world), room=room, moving=movers))


def _changed_boxes(before: World, after: World) -> Int[np.ndarray, "n"]:
    """The numbers of the boxes that are not what they were."""
    pairs = zip(jax.tree.leaves(before.boxes), jax.tree.leaves(after.boxes), strict=True)
    differ = [(np.asarray(a) != np.asarray(b)).reshape(len(a), -1).any(axis=1) for a, b in pairs]
    return np.flatnonzero(np.any(differ, axis=0))


def _room(lattices: Lattices, world: World, moving: frozenset[int] = frozenset()) -> Room:
    """The world for checks and the last look at a plan, but what moves; a roadmap knows what is solid already."""
    if moving or lattices.roadmap is None:
        solids = tuple(solids_of(without_boxes(world, moving)))
    else:
        solids = lattices.roadmap.field.solids
    return Room(solids, np.asarray(world.bounds, dtype=np.float64))


def _validate(
    parts: Parts, spline: PiecewisePolynomial, since: float = 0.0, start: FlatState | None = None, wider: float = 0.0
) -> Verdict:
    """The last look at a plan, with the planner's room, vehicle and limits."""
    keep, config = parts.keep.wider(wider), parts.config.validator
    return validate(usual_spline(spline), parts.room, parts.body, keep, config, since=since, start=start)


def _roll_out(
    parts: Parts,
    flown: FlatState,
    position: Float[np.ndarray, "3"],
    velocity: Float[np.ndarray, "3"],
    acceleration: Float[np.ndarray, "3"] | None = None,
    attitude: Float[np.ndarray, "4"] | None = None,
    before: Rollout | None = None,
) -> Rollout | None:
    """The model where the vehicle is, with the planner's room and limits."""
    if parts.flyer is None:
        return None
    return Rollout(parts.flyer, parts.room, parts.radius, flown, position, velocity, acceleration, attitude, before)


@in_float64
def _on_device(world: World) -> World:
    """The world as the compiled stations take it, without its names, which would be part of what is compiled for."""
    return jax.device_put(world.nameless())


def plan_batch(
    parts: Parts, state: FlatState, candidates: Candidates, timer: Timer | None = None, above: float = -np.inf
) -> Plans:
    """One replan: trajectories from one state timed to meet each candidate (paper, Sec. III-B)."""
    state, candidates = usual_state(state), usual_candidates(candidates)
    timer = timer or Timer()
    prospect = prospect_for(parts.config, candidates)
    table = reject(parts, state, table_of(candidates, parts.score(state, candidates, prospect)))
    promise = table.promise()
    if not parts.config.exhaustive:
        least = above if prospect is None else least_promise(table, above)
        table = outrank(table, np.flatnonzero(table.score <= least))
    timer.lap("reject")
    rounds = np.inf if prospect is None else most_rounds(parts, state, above)
    table = until_one_passes(parts, state, outrank_beyond(parts, table, rounds), timer, rounds)
    plans = (table if prospect is None else rescored(table, prospect)).plans(promise)
    timer.lap("select")
    return plans


@uncollected()
def _warmup(parts: Parts, state: FlatState) -> None:
    """Compile every station, then run the whole chain once."""
    state = usual_state(state)
    candidates = candidates_around(state, parts.config.width)
    with ThreadPoolExecutor(2) as pool:
        descent = pool.submit(in_float64(compile_refinement), parts, state, candidates)
        search = pool.submit(in_float64(warm_up_search), parts.lattices, parts.world, parts.config.path_capacity)
        asked = [allocation.match for allocation in parts.allocations(hover(state.pos))]
        compile_all(parts.stations, asked, parts.config, state)
        descent.result()
        search.result()
    plan_batch(parts, state, candidates)
    approach(parts, state, candidates)
    stops = brake(parts, state)
    _validate(parts, stops.spline(0))
    fly_once(parts, stops)
    if parts.config.captures:
        _capture_once(parts, state, candidates)
    give_back_memory()
    programs.vouch()


def _capture_once(parts: Parts, state: FlatState, candidates: Candidates) -> None:
    """Compile what plans are compared by."""
    still = Futures(times=np.zeros(1), positions=np.asarray(state.pos)[None, None] + 1.0, weights=np.ones(1))
    correct(parts, state, prospect_of(still, parts.config.capture))
    plan_batch(parts, state, replace(candidates, futures=still))
