"""Calls of the public functions with hostile arguments: each gives a finite result, or a status, or one declared error.

    PYTHONPATH=tests python -m faults.fuzz --calls 1000000 --seed 0

Prints what was called how often, what was refused, and everything that should not be: errors that are not declared,
numbers that are not finite without a status, programs compiled in flight. Arguments that a call cannot but take as they
are (records of the library's own) are built from spoilt numbers.
"""

import argparse
import collections
import json
import math
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxplan
from jaxplan.config import FRAMES
from jaxplan.io.export import FORMATS, ExportConfig, export_trajectory, read_trajectory
from jaxplan.prediction.observations import Observations
from jaxplan.replanner.records import Measured
from jaxplan.search.lattice import build_lattices
from jaxplan.search.routes import find_routes

COMPILED = "/jax/core/compile/backend_compile_duration"
DTYPES = ["f2", "f4", "i4", "O", "S8", "U4", "c16", "?", "M8[s]", "u1", "V8"]
THINGS = [
    None,
    "",
    "env1",
    "mfrl",
    "no such thing",
    "a\0b",
    "../../etc",
    b"bytes",
    -1,
    3,
    0.5,
    math.nan,
    [],
    {},
    (),
    "x" * 300,
]
PLANNING = ("plan_batch", "approach", "brake", "validate", "step")
"""Calls that never compile anything."""


def spoilt(rng: np.random.Generator, values: Any) -> Any:
    """The same numbers, some of them wild, or all of another size, shape or type; or left alone."""
    array = np.array(values, float)
    place = int(rng.integers(max(array.size, 1)))
    kind = int(rng.integers(0, 16))
    if kind < 3 and array.size:
        array.flat[place] = (np.nan, np.inf, -np.inf)[kind]
    elif kind == 3 and array.size:
        array.flat[place] = 10.0 ** rng.uniform(-300, 300) * rng.choice([-1, 1])
    elif kind == 4:
        array *= 10.0 ** rng.uniform(-12, 12)
    elif kind == 5 and array.ndim:
        return array[..., : int(rng.integers(0, array.shape[-1] + 1))]
    elif kind == 6:
        return array[None]
    elif kind == 7:
        return array.astype(rng.choice(DTYPES))
    elif kind == 8:
        return array.tolist()
    elif kind == 9:
        return THINGS[int(rng.integers(len(THINGS)))]
    return array


class Calls:
    """What is called, with what it needs."""

    def __init__(self) -> None:
        self.world = jaxplan.load_world("env1")
        self.vehicle = jaxplan.load_vehicle()
        self.lattices = build_lattices(self.world)
        self.planner = jaxplan.build_planner(
            jaxplan.PlannerConfig(allocate="profile"),
            world=self.world,
            vehicle=self.vehicle,
            policy=jaxplan.constant_speed_policy(),
        )
        self.start = jaxplan.hover(np.asarray(self.world.start))
        self.planner.warmup(self.start)
        self.spline = self.planner.brake(self.start).spline(0)
        self.room = jaxplan.with_spare_boxes(self.world, 2)
        predictor = jaxplan.build_predictor("constant-velocity", jaxplan.PredictionConfig.for_world(self.world))
        self.predictor = predictor
        self.replanner = jaxplan.Replanner(self.planner, predictor, self.start)
        self.stream = jaxplan.ObservationStream()
        self.now = 0.0
        self.kinds: dict[str, tuple[int, Callable[[np.random.Generator], bool]]] = {
            "minimum_snap": (100, self.minimum_snap),
            "minimum_snap_batch": (6, self.minimum_snap_batch),
            "candidates_from": (250, self.candidates_from),
            "plan_batch": (6, self.plan_batch),
            "approach": (2, self.approach),
            "brake": (6, self.brake),
            "validate": (20, self.validate),
            "step": (6, self.step),
            "stream": (250, self.observe),
            "hover": (150, self.hover),
            "spline": (60, self.evaluate),
            "update_world": (15, self.update_world),
            "config": (150, self.config),
            "predict": (30, self.predict),
            "routes": (15, self.routes),
            "load": (15, self.load),
            "export": (60, self.export),
        }

    def minimum_snap(self, rng: np.random.Generator) -> bool:
        """One problem."""
        count = int(rng.integers(1, 4))
        numbers = rng.normal(size=(count + 1, 3)), rng.uniform(0.3, 2.0, count), rng.normal(size=(4, 3))
        waypoints, durations, initial = (spoilt(rng, part) for part in numbers)
        found = jaxplan.minimum_snap(waypoints, durations, initial=initial)
        return finite(found.position, found.durations)

    def minimum_snap_batch(self, rng: np.random.Generator) -> bool:
        """Four problems of four waypoints; other sizes compile anew, so arrays keep theirs."""
        waypoints, durations = (
            keeping_shape(rng, part) for part in (rng.normal(size=(4, 3, 4)), rng.uniform(0.3, 2.0, (3, 4)))
        )
        found = jaxplan.minimum_snap_batch(waypoints, durations)
        good = np.isfinite(found.splines.position).all(axis=(0, 1, 2))
        return bool((good | (np.asarray(found.status) != 0)).all())

    def candidates_from(self, rng: np.random.Generator) -> bool:
        """Goals as users give them."""
        numbers = rng.normal(size=3), rng.normal(size=(5, 3)), rng.uniform(0.5, 3.0, 5), -rng.random(5)
        found = jaxplan.candidates_from(*(spoilt(rng, part) for part in numbers))
        bad = ~np.isfinite(np.asarray(found.goals)).all(axis=1)
        return bool((np.asarray(found.reasons)[bad] != 0).all())

    def made_up_candidates(self, rng: np.random.Generator) -> Any:
        """A record with one spoilt field."""
        goals = rng.uniform(*np.asarray(self.world.bounds), (20, 3))
        whole = jaxplan.candidates_from(goals[0], goals, rng.uniform(0.5, 5.0, 20), -rng.random(20))
        fields = {name: getattr(whole, name) for name in ("goals", "arrival_times", "likelihood", "reasons", "target")}
        name = rng.choice(list(fields))
        fields[name] = spoilt(rng, fields[name])
        return jaxplan.Candidates(**fields)

    def state(self, rng: np.random.Generator) -> Any:
        """A state of flight, or what is none."""
        derivatives = np.zeros((5, 3))
        derivatives[0] = rng.uniform(*np.asarray(self.world.bounds))
        derivatives[1:3] = rng.normal(size=(2, 3)) * rng.choice([0.0, 1.0, 8.0])
        return jaxplan.FlatState(derivatives=spoilt(rng, derivatives), yaw=spoilt(rng, rng.normal(size=3)))

    def plan_batch(self, rng: np.random.Generator) -> bool:
        """A replan."""
        plans = self.planner.plan_batch(self.state(rng), self.made_up_candidates(rng))
        chosen = jaxplan.select(plans)
        return chosen < 0 or finite(plans.spline(chosen).position)

    def approach(self, rng: np.random.Generator) -> bool:
        """The way towards what cannot be met."""
        found = self.planner.approach(self.state(rng), self.made_up_candidates(rng))
        usable = np.flatnonzero(found.reasons == 0)
        return all(finite(found.splines.spline(int(index)).position) for index in usable[:3])

    def brake(self, rng: np.random.Generator) -> bool:
        """Stops."""
        found = self.planner.brake(self.state(rng), self.made_up_spline(rng), spoilt(rng, 0.3))
        usable = np.flatnonzero(found.reasons == 0)
        return all(finite(found.spline(int(index)).position) for index in usable[:3])

    def validate(self, rng: np.random.Generator) -> bool:
        """The last look, at splines of spoilt numbers: what is not finite never passes."""
        spline = self.made_up_spline(rng)
        verdict = self.planner.validate(spline, float(rng.choice([0.0, 0.5, 1e9])))
        return bool(verdict.faults) or finite(spline.durations, spline.position, spline.yaw)

    def made_up_spline(self, rng: np.random.Generator) -> Any:
        """A record with one spoilt field."""
        fields = {"durations": self.spline.durations, "position": self.spline.position, "yaw": self.spline.yaw}
        name = str(rng.choice(list(fields)))
        fields[name] = spoilt(rng, fields[name])
        return jaxplan.PiecewisePolynomial(**fields)

    def step(self, rng: np.random.Generator) -> bool:
        """A cycle; the clock goes on by a little, or does not."""
        self.now += 0.1
        now = float(rng.choice([self.now, self.now, self.now, self.now - 5.0, math.nan, math.inf]))
        times, positions = self.now - np.arange(5)[::-1] * 0.1, np.cumsum(rng.normal(size=(5, 3)) * 0.1, axis=0)
        seen = Observations(times=spoilt(rng, times), positions=spoilt(rng, positions), age=float(rng.random()))
        reference = self.replanner.reference(np.array([self.now]))
        where = np.asarray(reference.pos)[0] + rng.normal(size=3) * rng.choice([0.0, 0.1, 0.3])
        attitude = spoilt(rng, rng.normal(size=4)) if rng.random() < 0.3 else None
        measured = Measured(spoilt(rng, where), spoilt(rng, np.asarray(reference.vel)[0]), None, attitude)
        try:
            self.replanner.step(now, seen, measured if rng.random() < 0.5 else None)
        finally:
            after = self.replanner.reference(self.now + np.array([0.0, 0.1, 1.0, 100.0]))
        return finite(after.derivatives, after.yaw)

    def observe(self, rng: np.random.Generator) -> bool:
        """Samples of a target."""
        now = float(self.stream_time(rng))
        self.stream.add(spoilt(rng, now), spoilt(rng, rng.normal(size=3)), now)
        seen = self.stream.observe(now)
        return seen is None or finite(seen.positions, seen.times)

    def stream_time(self, rng: np.random.Generator) -> float:
        """On by a little."""
        self.now += 1e-3
        return self.now - float(rng.choice([0.0, 0.0, 0.2, 10.0]))

    def hover(self, rng: np.random.Generator) -> bool:
        """A state at rest."""
        found = jaxplan.hover(spoilt(rng, rng.normal(size=3)), spoilt(rng, 0.3))
        return finite(found.derivatives, found.yaw)

    def evaluate(self, rng: np.random.Generator) -> bool:
        """A trajectory at any time."""
        times = keeping_shape(rng, rng.uniform(-1.0, 4.0, 3))
        found = self.spline.state(times)
        bad = ~np.isfinite(np.asarray(times, float))
        return bool((np.isfinite(np.asarray(found.pos)).all(axis=1) | bad).all())

    def update_world(self, rng: np.random.Generator) -> bool:
        """A box more."""
        low = rng.uniform(*np.asarray(self.world.bounds))
        box = spoilt(rng, low), spoilt(rng, low + rng.uniform(0.1, 1.0, 3))
        change = jaxplan.update_world(self.room, add_box=box)
        return finite(change.world.boxes.center, change.world.boxes.half)

    def config(self, rng: np.random.Generator) -> bool:
        """Configurations with one strange field."""
        kind = (jaxplan.InterceptConfig, jaxplan.PlannerConfig, jaxplan.PredictionConfig, jaxplan.TrackConfig)[
            int(rng.integers(4))
        ]
        name = str(rng.choice(list(kind.__dataclass_fields__)))
        value = THINGS[int(rng.integers(len(THINGS)))]
        kind(**{name: value})
        return True

    def predict(self, rng: np.random.Generator) -> bool:
        """Candidates of what was seen."""
        times, positions = np.arange(5) * 0.1, np.cumsum(rng.normal(size=(5, 3)) * 0.1, axis=0)
        seen = Observations(times=spoilt(rng, times), positions=spoilt(rng, positions), age=float(rng.random()))
        found = self.predictor(seen, 3)
        bad = ~np.isfinite(np.asarray(found.goals)).all(axis=1)
        return bool((np.asarray(found.reasons)[bad] != 0).all())

    def routes(self, rng: np.random.Generator) -> bool:
        """Paths."""
        start, goals = rng.uniform(*np.asarray(self.world.bounds)), rng.uniform(*np.asarray(self.world.bounds), (6, 3))
        found = find_routes(self.lattices, self.world, spoilt(rng, start), spoilt(rng, goals), 1.0, alternatives=2)
        return finite(found.points[found.reasons == 0])

    def load(self, rng: np.random.Generator) -> bool:
        """Names of things."""
        call = (jaxplan.load_world, jaxplan.load_vehicle, jaxplan.load_policy, jaxplan.load_classifier)[
            int(rng.integers(4))
        ]
        call(THINGS[int(rng.integers(len(THINGS)))])
        return True

    def export(self, rng: np.random.Generator) -> bool:
        """Trajectories for other programs, and files that are none."""
        name = str(rng.choice([*FORMATS, "", "rosbag"]))
        frame = THINGS[int(rng.integers(len(THINGS)))] if rng.random() < 0.1 else str(rng.choice(FRAMES))
        config = ExportConfig(frame, spoilt(rng, 50.0), spoilt(rng, 1e-3))
        content = export_trajectory(self.made_up_spline(rng), name, config).content
        with tempfile.NamedTemporaryFile() as file:
            damaged = bytearray(content)
            for place in rng.integers(len(damaged), size=int(rng.integers(0, 3))):
                damaged[place] = int(rng.integers(256))
            file.write(bytes(damaged))
            file.flush()
            if name == "setpoints":
                return b"nan" not in content
            again = read_trajectory(Path(file.name), name)
        return finite(again.durations, again.position)


def keeping_shape(rng: np.random.Generator, values: Any) -> Any:
    """Spoilt numbers of the same shape and type."""
    array = np.array(values, float)
    other = spoilt(rng, array)
    return other if isinstance(other, np.ndarray) and other.shape == array.shape and other.dtype == float else array


def finite(*arrays: Any) -> bool:
    """Whether there is no other number in them."""
    return all(bool(np.isfinite(np.asarray(array, float)).all()) for array in arrays if array is not None)


def run(count: int, seed: int) -> dict[str, Any]:
    """Make so many calls; what came of them."""
    calls, rng, compiled = Calls(), np.random.default_rng(seed), [0]
    jax.monitoring.register_event_duration_secs_listener(lambda event, *_, **__: compiled.append(event == COMPILED))
    names, weights = list(calls.kinds), np.array([weight for weight, _ in calls.kinds.values()], float)
    made, refused = collections.Counter[str](), collections.Counter[str]()
    wrong: collections.Counter[str] = collections.Counter()
    warnings.simplefilter("ignore")
    for name in rng.choice(names, count, p=weights / weights.sum()):
        made[name] += 1
        del compiled[1:]
        try:
            if not calls.kinds[name][1](rng):
                wrong[f"{name}: not finite"] += 1
        except jaxplan.JaxplanError as error:
            refused[name] += 1
            if "\n" in str(error) or error.exit_code == 70:
                wrong[f"{name}: {type(error).__name__}: {error}"[:200]] += 1
        except Exception as error:
            wrong[f"{name}: {type(error).__name__}: {error}"[:200]] += 1
        if name in PLANNING and any(compiled):
            wrong[f"{name}: compiled"] += 1
    return {"calls": sum(made.values()), "made": dict(made), "refused": dict(refused), "wrong": dict(wrong)}


def main() -> int:
    """Make the calls that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calls", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    found = run(options.calls, options.seed)
    print(json.dumps(found, indent=1))
    return 1 if found["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
