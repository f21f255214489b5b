"""What goes wrong around a closed loop: sensors, clocks, the planner's time, the air, the rotors, the room.

``Trouble`` puts one fault into an episode: as its ``watch`` it spoils what is seen of the target, as its ``guide`` it
stands before the replanner, and ``disturbed`` gives the episode a plant that is blown, pushed or weakened. What it does
depends on nothing but the fault and a seed.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.planner import Planner
from jaxplan.prediction.candidates import Candidates
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.stream import ObservationStream
from jaxplan.records import replace
from jaxplan.replanner import CommittedPlan, Cycle, Measured, Replanner, ReplannerConfig
from jaxplan.scenario import Scenario
from jaxplan.spline import FlatState
from jaxplan.tracking.disturbance import Disturbance
from jaxplan.tracking.plant import PlantState
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.rollout import FlightLog, Plant
from jaxplan.vehicle.reach import sideways_acceleration
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.obstacles import World
from jaxplan.world.update import update_world, with_spare_boxes

SENSOR = ("late", "lost", "noisy", "teleporting", "shuffled")
TIME = ("slow", "stalled", "clock")
VEHICLE = ("gust", "push", "thrust loss")
ROOM = ("box",)
FAULTS = ("none", *SENSOR, *TIME, *VEHICLE, *ROOM)
DELAY = 0.3
"""s; by which what is seen is late."""
LOST, JUMPS = 0.5, 0.1
"""Shares of what is seen that is lost, or is somewhere else."""
NOISE, JUMP = 0.1, 5.0
"""m; standard deviation along each axis, and how far the target seems to jump."""
SLOWEST = 0.5
"""s; the longest time that a cycle of a slow planner takes, the shortest is 0."""
STALLS, LONGEST = 0.3, 2.0
"""Share of its cycles in which a planner stalls, and s: how long at most; it does nothing else meanwhile."""
BACKWARDS = 1.0
"""s; by which a clock goes back, once in ten cycles."""
GUST, LACK, PUSH = 10.0, 0.25, 0.35
"""m/s at the peak of a gust of 1 s; share of one rotor's thrust that is missing; m that the vehicle is moved."""
AFTER = (0.4, 1.2)
"""s after the departure, between which the single events happen."""
BRAKING, REACTION = 0.9, 0.25
"""Share of the acceleration that plans ask for, and s: a box appears beyond a stop with these, which the vehicle
certainly can (arbitrary)."""
HALF = (0.15, 0.4)
"""m; half sides of boxes."""


class Trouble:
    """One fault in one episode."""

    def __init__(self, scenario: Scenario, fault: str) -> None:
        """``scenario`` is what is flown without it; its planner must have a spare box where one is to appear."""
        self.fault, self._scenario = fault, scenario
        self._rng = np.random.default_rng(scenario.seed)
        self.event = scenario.departure + float(self._rng.uniform(*AFTER))
        """When a single event happens [s]."""
        self._disturbance = self._blown_or_weak()
        self.states: dict[int, PlantState] = {}
        """Of the plant at the beginning of each period, by its control step."""
        self._seconds, self._busy_until = 0.0, -np.inf
        self._replanner = Replanner(
            scenario.planner, self._predict, scenario.start, ReplannerConfig(drop_late=True), self._clock
        )
        self.world: World | None = None
        """The room after a change."""
        self.appeared = np.inf
        """When it changed [s]."""
        self.refused_clocks = 0

    @property
    def ever_planned(self) -> bool:
        """As the replanner's."""
        return self._replanner.ever_planned

    @property
    def planner(self) -> Planner:
        """The replanner's, of the room as it is now."""
        return self._replanner.planner

    @property
    def plans(self) -> list[CommittedPlan]:
        """As the replanner's."""
        return self._replanner.plans

    def reference(self, times: Float[np.ndarray, "n"]) -> FlatState:
        """As the replanner's."""
        return self._replanner.reference(times)

    def watch(self, stream: ObservationStream, now: float, position: Float[np.ndarray, "3"]) -> None:
        """What the sensor tells."""
        where = position
        if self.fault == "lost" and self._rng.random() < LOST:
            return
        if self.fault == "noisy":
            where = position + self._rng.normal(scale=NOISE, size=3)
        if self.fault == "teleporting" and self._rng.random() < JUMPS:
            direction = self._rng.normal(size=3)
            where = position + JUMP * direction / np.linalg.norm(direction)
        if self.fault == "late":
            if now >= DELAY:
                stream.add(now - DELAY, self._scenario.target.position(np.array([now - DELAY]))[0], now)
            return
        stream.add(now, where, now)
        if self.fault == "shuffled" and now > 0.2:
            for before in (0.2, 0.1, 0.0):
                stream.add(now - before, self._scenario.target.position(np.array([now - before]))[0], now)

    def step(self, now: float, observations: Observations, measured: Measured | None = None) -> Cycle | None:
        """One cycle of the replanner; None where it refuses a clock that went back, or is still at an earlier one."""
        if now < self._busy_until:
            return None
        if self.fault == "box" and self.world is None and now >= self.event:
            self._place_a_box(now)
        if self.fault == "clock" and self._rng.random() < 0.1 and self.ever_planned:
            try:
                self._replanner.step(now - BACKWARDS, observations, measured)
            except InputError:
                self.refused_clocks += 1
                return None
        began = self._seconds
        cycle = self._replanner.step(now, observations, measured)
        self._busy_until = now + self._seconds - began if self.fault == "stalled" else -np.inf
        return cycle

    def disturbed(self) -> Scenario:
        """What is flown: with a plant that the fault troubles, where it is the vehicle's, and whose states are kept."""
        return dataclasses.replace(self._scenario, plant=Plant(self._scenario.plant.reset, self._fly))

    def flown_along(self, state: PlantState, references: FlatState) -> FlightLog:
        """What would become of the vehicle from a state that it was in, in the same air and with the same rotors."""
        return self._scenario.plant.fly(state, references, self._disturbance)[1]

    def state_at(self, step: int) -> PlantState | None:
        """The vehicle's after so many steps, flown there from the one that was kept before; None where it never was."""
        kept = max((known for known in self.states if known <= step), default=None)
        if kept is None or step - kept > round(self._scenario.replanning.period * CONTROL_RATE):
            return None
        if kept == step:
            return self.states[kept]
        references = self.reference((kept + np.arange(step - kept + 1)) / CONTROL_RATE)
        return self._scenario.plant.fly(self.states[kept], references, self._disturbance)[0]

    def _fly(
        self, state: PlantState, references: FlatState, calm: Disturbance | None = None
    ) -> tuple[PlantState, FlightLog]:
        if self.fault == "push":
            state = self._pushed(state, len(references.yaw) - 1)
        self.states[int(state.step)] = state
        return self._scenario.plant.fly(state, references, self._disturbance)

    def _blown_or_weak(self) -> Disturbance | None:
        """What the air and the rotors do, of which the controller is not told."""
        if self.fault not in VEHICLE:
            return None
        direction = self._rng.normal(size=3) * [1.0, 1.0, 0.2]
        direction /= np.linalg.norm(direction)
        if self.fault == "gust":
            return Disturbance(gust=tuple(GUST * direction), gust_start=self.event, gust_duration=1.0)
        if self.fault == "thrust loss":
            return Disturbance(thrust_loss=tuple(LACK * (np.arange(4) == self._rng.integers(4))))
        return None

    def _predict(self, observations: Observations, cycle: int) -> Candidates:
        """The scenario's prediction, which takes its time where the planner is slow."""
        if self.fault == "slow":
            self._seconds += float(self._rng.uniform(0.0, SLOWEST))
        if self.fault == "stalled" and self._rng.random() < STALLS:
            self._seconds += float(self._rng.uniform(0.0, LONGEST))
        return self._scenario.predictor(observations, cycle)

    def _clock(self) -> float:
        """Time passes where it is said to, so that an episode does not depend on the machine."""
        return self._seconds

    def _pushed(self, state: PlantState, steps: int) -> PlantState:
        """Moved once, to where there is most room, if the event falls into these control steps."""
        now = int(state.step) / CONTROL_RATE
        if not now <= self.event < now + steps / CONTROL_RATE:
            return state
        turns = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
        there = np.asarray(state.pos, float) + PUSH * np.stack([np.cos(turns), np.sin(turns), 0.0 * turns], axis=1)
        free = host_free_distance(self._scenario.world, there, 16)
        return replace(state, pos=np.asarray(there[np.argmax(free)], np.float32))

    def _place_a_box(self, now: float) -> None:
        """On the committed path, beyond a stop along it and straight on; nowhere where it is too short for that."""
        plan = self._replanner.committed
        times = np.arange(now, plan.start_time + float(plan.spline.duration), 0.01)
        if len(times) < 2:
            return
        states = self.reference(times)
        ready = int(np.searchsorted(times, now + REACTION).clip(max=len(times) - 1))
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(states.pos, axis=0), axis=1))])
        half = float(self._rng.uniform(*HALF))
        braking = BRAKING * sideways_acceleration(self._scenario.vehicle)
        stopping = np.linalg.norm(states.vel[ready]) ** 2 / (2.0 * braking) + half * np.sqrt(3.0) + 0.3
        away = np.linalg.norm(states.pos[:, None] - states.pos[None, : ready + 1], axis=2).min(axis=1)
        beyond = (way - way[ready] > stopping) & (away > stopping)
        if not beyond.any():
            return
        middle = states.pos[int(np.argmax(beyond))]
        change = update_world(with_spare_boxes(self._scenario.world, 1), add_box=(middle - half, middle + half))
        self.world, self.appeared = change.world, now
        self._replanner.update(change)


def with_a_spare_box(scenario: Scenario) -> Scenario:
    """The same with a planner whose world can get a box."""
    return dataclasses.replace(scenario, planner=scenario.planner.in_world(with_spare_boxes(scenario.world, 1)))
