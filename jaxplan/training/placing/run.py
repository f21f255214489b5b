"""Training of the placing policy.

A run is a folder: ``state.msgpack`` to go on from, ``metrics.jsonl``, and the best weights so far.
"""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import serialization
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxplan.files import state_configuration, write_atomically
from jaxplan.policy.network import NetworkConfig, PolicyNetwork
from jaxplan.policy.placing import OUTPUTS, place_waypoints, start_placing
from jaxplan.precision import in_float64
from jaxplan.training.gradient import State, annealed_adamw, begin, stepped
from jaxplan.training.placing.courses import CourseSet, load_courses
from jaxplan.training.placing.loss import PlacingLoss, judge, keep_of, placing_loss
from jaxplan.training.placing.problems import Problems, distance_in, from_hover, in_flight, mean_of, solved
from jaxplan.training.placing.vehicles import Fleet, fleet, random_vehicle
from jaxplan.validation import require_at_least, require_positive, require_within
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.obstacles import World

FLEET = 256
"""Random vehicles that are trained with, beside the one that it is for."""
TESTED = 24
"""Rooms of the held-out courses that each evaluation looks at."""


@dataclasses.dataclass(frozen=True)
class PlacingConfig:
    """How a placing policy is trained."""

    network: NetworkConfig = NetworkConfig()
    """Sizes of the network."""
    vehicle: str = "mfrl"
    """Which it is for above all: a preset's name or a TOML file."""
    others: float = 0.5
    """Share of the problems that are for random vehicles."""
    steps: int = 30_000
    """Gradient steps."""
    rooms: int = 8
    """Rooms of each step."""
    courses: int = 24
    """Courses in each of them: as many problems from hover, and in each generation."""
    generations: int = 2
    """How often what is left of the plans is asked again."""
    learning_rate: float = 3e-3
    """At its highest; warmed up and annealed by a cosine."""
    average: float = 0.998
    """Decay of the running mean of the weights, which is what is kept."""
    evaluate_every: int = 500
    """Gradient steps between two evaluations on held-out courses."""
    loss: PlacingLoss = PlacingLoss()
    """What counts how much."""
    seed: int = 0
    """Seed of the weights, vehicles and batches."""

    def __post_init__(self) -> None:
        require_at_least("placing", self, 1, "steps", "rooms", "courses", "evaluate_every")
        require_at_least("placing", self, 0, "generations")
        require_positive("placing", self, "learning_rate")
        require_within("placing", self, 0.0, 1.0, "average", "others")


class Score(NamedTuple):
    """On held-out courses, by generation; the first is from hover."""

    loss: list[float]
    meeting: list[float]
    """Mean time to the meeting [s]."""
    kept: list[float]
    """Share whose margins are above 0."""


@runtime_checkable
class Draw(Protocol):
    """Problems of all generations."""

    def __call__(self, parameters: Any, courses: CourseSet, crew: Fleet, key: PRNGKeyArray, /) -> list[Problems]:
        """From courses of a few rooms, and a vehicle for each."""


@runtime_checkable
class Advance(Protocol):
    """One compiled gradient step."""

    def __call__(
        self, state: State, problems: list[Problems], worlds: World, crew: Fleet, /
    ) -> tuple[State, Float[Array, ""]]:
        """The state after it, and the loss before."""


def train_placing(
    folder: Path, data: Path, config: PlacingConfig, report: Callable[[str], None] = print, start: Any = None
) -> tuple[Any, Score]:
    """Train until the end; goes on where ``folder`` was left. Gives the best weights and their score.

    Args:
        folder: of the run.
        data: folder of the courses.
        config: how to train.
        report: takes a line of progress.
        start: weights that a new run begins with; random ones by default.
    """
    training, held_out = load_courses(data, held_out=False), load_courses(data, held_out=True)
    state, best = _resume(folder, config, start)
    draw, advance, measure = build_draw(config), build_advance(config), build_measure(config)
    vehicles = _vehicles(config)
    own = vehicles.of(np.arange(1))
    for step in range(int(state.step), config.steps):
        rng = np.random.default_rng([config.seed, step])
        key = jax.random.fold_in(jax.random.key(config.seed), step)
        some, crew = _drawn(training, config, rng), _crew(vehicles, config, rng)
        state, loss = advance(state, draw(state.parameters, some, crew, key), some.worlds, crew)
        if (step + 1) % config.evaluate_every and step + 1 < config.steps:
            continue
        score = measure(state.averaged, held_out, own)
        if sum(score.loss) < best:
            best = sum(score.loss)
            write_atomically(folder / "best.msgpack", serialization.to_bytes(state.averaged))
        write_atomically(folder / "state.msgpack", serialization.to_bytes((state._asdict(), best)))
        with (folder / "metrics.jsonl").open("a") as log:
            log.write(json.dumps({"step": step + 1, "train_loss": float(loss), **score._asdict()}) + "\n")
        meeting, kept = (", ".join(f"{part:.3f}" for part in parts) for parts in (score.meeting, score.kept))
        report(f"step {step + 1}: loss {float(loss):.3f}; held out: meeting after {meeting} s, kept {kept}")
    weights = serialization.from_bytes(state.averaged, (folder / "best.msgpack").read_bytes())
    return weights, measure(weights, held_out, own)


def build_draw(config: PlacingConfig) -> Draw:
    """Problems, compiled once."""
    network = PolicyNetwork(config.network, OUTPUTS)

    @jax.jit
    def first(points: Float[Array, "7 3 k"], worlds: World, crew: Fleet, key: PRNGKeyArray) -> Problems:
        distance = distance_in(worlds, len(worlds.bounds))
        return from_hover(points, crew, keep_of(crew.vehicles), distance, key)

    @jax.jit
    def onward(parameters: Any, problems: Problems, worlds: World, crew: Fleet, key: PRNGKeyArray) -> Problems:
        placed = place_waypoints(network, parameters, problems.courses, problems.initial)
        flown, meeting = solved(problems.initial, placed), jnp.sum(placed.durations[:-1], axis=0)
        distance = distance_in(worlds, len(worlds.bounds))
        return in_flight(flown, meeting, crew, keep_of(crew.vehicles), distance, key)

    def draw(parameters: Any, courses: CourseSet, crew: Fleet, key: PRNGKeyArray) -> list[Problems]:
        points = np.moveaxis(courses.points.reshape(-1, *courses.points.shape[2:]), 0, -1)
        keys = jax.random.split(key, config.generations + 1)
        found = [first(points, courses.worlds, crew, keys[0])]
        for number in range(config.generations):
            found.append(onward(parameters, found[-1], courses.worlds, crew, keys[number + 1]))
        return found

    return in_float64(draw)


def build_advance(config: PlacingConfig) -> Advance:
    """The gradient step, compiled once: all generations are one batch."""
    network, optimiser = PolicyNetwork(config.network, OUTPUTS), _optimiser(config)

    @jax.jit
    def advance(state: State, problems: list[Problems], worlds: World, crew: Fleet) -> tuple[State, Float[Array, ""]]:
        several = len(problems)
        together = jax.tree.map(lambda *leaves: jnp.concatenate(leaves, axis=-1), *problems)
        rooms, all_crew = (
            jax.tree.map(lambda leaf: jnp.concatenate([leaf] * several), part) for part in (worlds, crew)
        )
        distance = distance_in(rooms, len(rooms.bounds))
        cost = lambda p: placing_loss(network, p, together, all_crew, distance, config.loss)  # noqa: E731
        loss, slope = jax.value_and_grad(cost)(state.parameters)
        slope = jax.tree.map(jnp.nan_to_num, slope)  # a problem that cannot be solved must not spoil the weights
        return stepped(state, slope, optimiser, config.average), loss

    return in_float64(advance)


@runtime_checkable
class Measure(Protocol):
    """How good weights are."""

    def __call__(self, parameters: Any, courses: CourseSet, crew: Fleet, /) -> Score:
        """On courses that are not trained on, for vehicles of ``crew`` in turn (host)."""


def build_measure(config: PlacingConfig) -> Measure:
    """Scores on ``TESTED`` rooms, with a seed of their own."""
    network, draw = PolicyNetwork(config.network, OUTPUTS), build_draw(config)

    @jax.jit
    def scored(parameters: Any, problems: Problems, worlds: World, crew: Fleet) -> Float[Array, "3"]:
        distance = distance_in(worlds, len(worlds.bounds))
        judged = judge(network, parameters, problems, crew, distance, config.loss)
        kept = (judged.least >= 0.0).astype(judged.loss.dtype)
        return jnp.stack([mean_of(part, problems.good) for part in (judged.loss, judged.meeting, kept)])

    exact = in_float64(scored)

    def measure(parameters: Any, courses: CourseSet, crew: Fleet) -> Score:
        rows = []
        for first in range(0, min(TESTED, len(courses.points)), config.rooms):
            members = np.arange(first, first + config.rooms) % len(courses.points)
            some = _take(courses, members, np.arange(config.courses)[None].repeat(config.rooms, axis=0))
            lanes = np.arange(config.rooms * config.courses) % len(crew.numbers)
            flown = crew.of(lanes)
            problems = draw(parameters, some, flown, jax.random.key(first))
            rows.append([np.asarray(exact(parameters, part, some.worlds, flown)) for part in problems])
        means = np.mean(rows, axis=0)
        return Score(*(means[:, column].tolist() for column in range(3)))

    return measure


def _vehicles(config: PlacingConfig) -> Fleet:
    """The vehicle that it is for, then ``FLEET`` random ones."""
    rng = np.random.default_rng([config.seed, 77])
    return fleet([load_vehicle(config.vehicle), *(random_vehicle(rng) for _ in range(FLEET))])


def _crew(vehicles: Fleet, config: PlacingConfig, rng: np.random.Generator) -> Fleet:
    """A vehicle for each lane."""
    lanes = config.rooms * config.courses
    other = rng.random(lanes) < config.others
    return vehicles.of(np.where(other, rng.integers(1, FLEET + 1, lanes), 0))


def _drawn(courses: CourseSet, config: PlacingConfig, rng: np.random.Generator) -> CourseSet:
    """Random courses in random rooms, long ones more often: there is more flight in them."""
    members = rng.integers(0, len(courses.points), config.rooms)
    chances = np.cumsum(np.linalg.norm(courses.points[members, :, -2] - courses.points[members, :, 0], axis=-1), axis=1)
    drawn = rng.random((config.rooms, config.courses)) * chances[:, -1:]
    which = [np.searchsorted(of_room, some) for of_room, some in zip(chances, drawn, strict=True)]
    return _take(courses, members, np.minimum(which, courses.points.shape[1] - 1))


def _take(courses: CourseSet, rooms: Int[np.ndarray, "r"], which: Int[np.ndarray, "r c"]) -> CourseSet:
    worlds = jax.tree.map(lambda leaf: leaf[rooms], courses.worlds)
    return CourseSet(worlds, courses.points[rooms[:, None], which])


def _optimiser(config: PlacingConfig) -> optax.GradientTransformation:
    return annealed_adamw(config.learning_rate, config.steps, warmup=300, last=1e-2, weight_decay=1e-3)


def _resume(folder: Path, config: PlacingConfig, start: Any) -> tuple[State, float]:
    """The run in ``folder``, or a new one."""
    state_configuration(folder, dataclasses.asdict(config))
    parameters = start or start_placing(config.network, jax.random.key(config.seed))
    fresh = begin(parameters, _optimiser(config))
    saved = folder / "state.msgpack"
    if not saved.exists():
        return fresh, np.inf
    fields, best = serialization.from_bytes((fresh._asdict(), 0.0), saved.read_bytes())
    return State(**fields), float(best)
