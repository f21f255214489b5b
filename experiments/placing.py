"""A policy that places waypoints and times, beside times alone and beside the optimiser, for vehicles it never flew.

    jaxplan experiment placing --preset smoke|small|full [--placing FILE] [--vehicles N] [--clutter] [--workers N]

Courses in random rooms that no training has seen, from hover and from flight: what is left of the policy's own plans
at a random instant, to goals that have moved. Each is planned by the profile of speeds on the course's own points
(times alone), by the placing policy, and by the planner's refinement of either; the soonest plan of all, those of
longer descents (``--most`` steps) among them, stands for the optimum. A plan is kept where the last look finds
nothing, with rotors out of their range for 0.1 s at most; kept plans are flown in the plant, and count as tracked
within the error of the trial flights of ``jaxplan vehicle``: 0.2 m, less for small vehicles in proportion to their
radius.
"""

import dataclasses
import functools
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.planner import Planner, PlannerConfig, RefinementConfig, Seed, build_planner
from jaxplan.planner.validator import ValidatorConfig
from jaxplan.policy.checkpoint import load_policy
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.policy.placing import Courses, Placed, placing_policy
from jaxplan.policy.placing_checkpoint import KIND, WEIGHTS, TrainedPlacing, load_placing_parameters
from jaxplan.policy.protocol import Policy
from jaxplan.policy.speed_profile import speed_profile_policy
from jaxplan.precision import in_float64
from jaxplan.prediction.candidates import Candidates, candidates_from
from jaxplan.runner.definition import Experiment, Item, Row
from jaxplan.spline import FlatState, FlatStateBatch, PiecewisePolynomial
from jaxplan.tracking.result import held_error
from jaxplan.tracking.track import track
from jaxplan.training.placing.courses import CourseConfig, CourseSet, courses_in, load_courses, make_courses
from jaxplan.training.placing.problems import Problems, solved
from jaxplan.training.placing.run import PlacingConfig, build_draw
from jaxplan.training.placing.vehicles import fleet, random_vehicle
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.reach import sideways_acceleration
from jaxplan.vehicle.report import thrust_to_weight
from jaxplan.weights import resolve_weights
from jaxplan.world.clearance import clearance
from jaxplan.world.obstacles import World

from . import SUMMARIES
from .arena.families import CLUTTER, cluttered_room
from .placing_report import OPTIMUM, OWN, STARTS, report

SEEDS = 1_000_000
"""Added to the seed: no training has rooms or vehicles of as large a one."""
LONGEST = 20.0
"""s; until when the target waits at its goal."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Which policy, for how many vehicles and courses."""

    placing: str = "fleet"
    """A shipped placing policy, or a file of jaxplan train placing."""

    vehicles: int = 12
    """Random ones, beside the preset mfrl."""

    rooms: int = 8
    """Random ones, the same for all vehicles; at most 32."""

    courses: int = 12
    """Of each room, at most 64."""

    clutter: bool = False
    """Whether rooms are the arena's, where 5 to 12, 12 to 20 and 20 to 35 % of the floor are taken up in turn, and not
    such as policies are trained in, of which few are as full."""

    most: int = 90
    """Steps of the descent that stands for the optimum."""

    seed: int = 0
    """Of rooms, vehicles and states in flight."""

    def __post_init__(self) -> None:
        good = 1 <= self.rooms <= 32 and 1 <= self.courses <= 64 and 0 <= self.vehicles <= 1000 and self.seed >= 0
        if not good or self.most < 1:
            have = f"--vehicles {self.vehicles} --rooms {self.rooms} --courses {self.courses} --most {self.most}"
            raise InputError(f"{have}: want up to 1000 vehicles, 1 to 32 rooms, 1 to 64 courses, and steps")


class _Course(NamedTuple):
    """One problem: where it begins, whom it meets, and the plans there are."""

    state: FlatState
    goal: Float[np.ndarray, "3"]
    plans: dict[str, PiecewisePolynomial]
    """By who made them, before any descent."""


def items(config: Config) -> list[Item]:
    """One for each vehicle: its own one, then the random ones by their numbers."""
    others = [Item(f"random vehicle {number}", "vehicles", {"number": number}) for number in range(config.vehicles)]
    return [Item(OWN, "vehicles", {"number": None}), *others]


def evaluate(config: Config, item: Item) -> Row:
    """Plan all courses with one vehicle, and fly what is kept."""
    vehicle = _vehicle(config, item.values["number"])
    problems, rooms = _problems(config, vehicle), _rooms(config)
    first = build_planner(_settings(), world=rooms[0], vehicle=vehicle, policy=constant_speed_policy())
    planners, filled = [first, *(first.in_world(room) for room in rooms[1:])], [_filled(room) for room in rooms]
    rows: list[Row] = []
    for start, part in zip(STARTS, problems, strict=True):
        made = _made(config, vehicle, item.values["number"] is None, part)
        for lane in np.flatnonzero(np.asarray(part.good)).tolist():
            course = _Course(
                state=_states(part.initial).at(lane),
                goal=np.asarray(part.courses.points, float)[-2, :, lane],
                plans={name: plans.spline(lane) for name, plans in made.items()},
            )
            room = lane // config.courses
            found = _planned(planners[room], course, config.most)
            rows.append({"start": start, "filled": filled[room], "plans": found})
    return {
        "name": item.name,
        "mass": float(vehicle.mass),
        "thrust_to_weight": thrust_to_weight(vehicle),
        "motor_time_constant": float(vehicle.motor_time_constant),
        "courses": _flown(vehicle, rows),
    }


def _vehicle(config: Config, number: int | None) -> Vehicle:
    if number is None:
        return load_vehicle(OWN)
    return random_vehicle(np.random.default_rng([SEEDS + config.seed, number]))


@functools.cache
def _course_set(config: Config) -> CourseSet:
    """The first courses of the first rooms."""
    if config.clutter:
        return _cluttered(config)
    with tempfile.TemporaryDirectory() as folder:
        make_courses(Path(folder), CourseConfig(shards=1, seed=SEEDS + config.seed), report=lambda text: None)
        every = load_courses(Path(folder), held_out=False)
    worlds = jax.tree.map(lambda leaf: leaf[: config.rooms], every.worlds)
    return CourseSet(worlds, every.points[: config.rooms, : config.courses])


def _cluttered(config: Config) -> CourseSet:
    """Rooms of the arena's levels in turn, of as many boxes each."""
    rooms = [cluttered_room(*CLUTTER[n % len(CLUTTER)], SEEDS + config.seed + n) for n in range(config.rooms)]
    points = np.stack([courses_in(room, config.seed + n, config.courses) for n, room in enumerate(rooms)])
    nameless = [room.nameless() for room in rooms]
    return CourseSet(jax.tree.map(lambda *leaves: np.stack(leaves).astype(np.float32), *nameless), points)


@functools.cache
def _trained(source: str) -> TrainedPlacing:
    return load_placing_parameters(source)


def _rooms(config: Config) -> list[World]:
    worlds = jax.tree.map(lambda leaf: np.asarray(leaf, float), _course_set(config).worlds)
    return [jax.tree.map(lambda leaf: leaf[nth], worlds) for nth in range(config.rooms)]  # noqa: B023


def _problems(config: Config, vehicle: Vehicle) -> list[Problems]:
    """Courses from hover and from flight, all to be met within the planner's radius."""
    asked = PlacingConfig(network=_trained(config.placing).network, generations=1)
    courses, lanes = _course_set(config), config.rooms * config.courses
    crew = fleet([vehicle]).of(np.zeros(lanes, int))
    found = build_draw(asked)(_trained(config.placing).parameters, courses, crew, jax.random.key(config.seed))
    radius = np.full(lanes, RefinementConfig().meet_radius)
    return [part._replace(courses=part.courses._replace(meet_radius=radius)) for part in found]


def _settings() -> PlannerConfig:
    """The last look is at all plans as it is at refined ones."""
    refinement = RefinementConfig(soonest=0.1)
    return PlannerConfig(refinement=refinement, validator=ValidatorConfig(most_excess=refinement.most_excess))


def _states(initial: FlatStateBatch) -> FlatStateBatch:
    """In float64, with a heading that is held: what plans begin with."""
    derivatives, yaw = np.array(initial.derivatives, float), np.array(initial.yaw, float)
    yaw[1:] = 0.0
    return FlatStateBatch(derivatives=derivatives, yaw=yaw)


def _made(config: Config, vehicle: Vehicle, own: bool, part: Problems) -> dict[str, Any]:
    """Batches of plans without any descent."""
    courses, initial = part.courses, _states(part.initial)
    points = np.asarray(courses.points, float)
    trained = _trained(config.placing)
    allotted: dict[str, Policy] = {"profile": speed_profile_policy(sideways_acceleration(vehicle))}
    if own:
        allotted[OWN] = load_policy(OWN)
    every = {name: _with_times(policy, points, initial) for name, policy in allotted.items()}
    exact = Courses(points, courses.room, courses.meet_radius, courses.vehicle)
    placed = jax.jit(placing_policy(trained.network, trained.parameters))(exact, initial)
    every["placed"] = (placed.durations, placed.points)
    solve = in_float64(jax.jit(solved))
    return {
        name: solve(initial, Placed(np.asarray(times, float), np.asarray(through, float)))
        for name, (times, through) in every.items()
    }


def _with_times(policy: Policy, points: Float[np.ndarray, "7 3 k"], initial: FlatStateBatch) -> tuple[Any, Any]:
    """Times alone: the points stay where they are."""
    count = np.full(points.shape[-1], len(points))
    times = in_float64(jax.jit(lambda: policy.decode(policy.encode(points, count), initial)))()
    return times, points


def _planned(planner: Planner, course: _Course, most: int) -> Row:
    """When the plans of everyone meet, None where the last look is against one, and the splines of the others."""
    found: Row = {}
    for name, spline in course.plans.items():
        kept = not planner.validate(spline, 0.0, course.state).faults
        found[name] = (float(np.sum(spline.durations[:-1])) if kept else None, spline)
    still = _waiting(course.goal)
    for name in ("profile", "placed"):
        for steps, title in ((None, f"{name}, refined"), (most, f"{name}, {OPTIMUM}")):
            refined = planner.refine(course.state, still, _seed(course, course.plans[name]), steps)
            good = refined is not None and not refined.reasons
            found[title] = (refined.arrival_time, refined.spline) if refined is not None and good else (None, None)
    kept = [pair for pair in found.values() if pair[0] is not None]
    found[OPTIMUM] = min(kept, key=lambda pair: pair[0], default=(None, None))
    return {name: pair for name, pair in found.items() if not name.endswith(f", {OPTIMUM}")}


def _seed(course: _Course, spline: PiecewisePolynomial) -> Seed:
    return Seed(spline, 0.0, float(np.sum(spline.durations[:-1])), course.goal, 1.0)


def _waiting(goal: Float[np.ndarray, "3"]) -> Candidates:
    """A target that stays where it is."""
    times = np.linspace(0.0, LONGEST, 41)
    return candidates_from(goal, np.repeat(goal[None], len(times), axis=0), times, np.zeros(len(times)))


def _filled(room: World) -> float:
    """Share of the room that is solid."""
    points = np.random.default_rng(0).uniform(*np.asarray(room.bounds), (4096, 3))
    return float(np.mean(np.asarray(clearance(room, points)) < 0.0))


def _flown(vehicle: Vehicle, rows: list[Row]) -> list[Row]:
    """The same with what became of each plan in the plant, in place of its spline."""
    limit = held_error(vehicle)
    kept = [(row, name) for row in rows for name, (time, _) in row["plans"].items() if time is not None]
    splines = [row["plans"][name][1] for row, name in kept]
    errors = np.asarray(track(splines, vehicle=vehicle).max_position_error) if splines else np.zeros(0)
    tracked = {(id(row), name): bool(error < limit) for (row, name), error in zip(kept, errors, strict=True)}
    return [
        {
            **row,
            "plans": {
                name: {"time": time, "tracked": tracked.get((id(row), name))}
                for name, (time, _) in row["plans"].items()
            },
        }
        for row in rows
    ]


EXPERIMENT = Experiment(
    summary=SUMMARIES["placing"],
    presets={
        "smoke": Config(vehicles=1, rooms=1, courses=6, most=24),
        "small": Config(),
        "full": Config(vehicles=48, rooms=32, courses=24),
    },
    items=items,
    evaluate=evaluate,
    report=report,
    artefacts=lambda config: [resolve_weights(config.placing, WEIGHTS, KIND)[0]],
)
