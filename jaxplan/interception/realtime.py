"""One closed-loop episode against the clock on the wall: the planner in a process of its own, late where it is late."""

import dataclasses
import time

import jax
import numpy as np
from jaxtyping import Float

from jaxplan.compilation import compilations
from jaxplan.config import InterceptConfig
from jaxplan.interception.judging import flight_rows, measured_state, until_decided
from jaxplan.interception.records import Episode, Flight, Progress, RealTime, tell_nobody
from jaxplan.replanner import Measured
from jaxplan.runtime import Runtime, RuntimeConfig, Setpoint, from_config, settle
from jaxplan.scenario import Scenario, build_scenario
from jaxplan.spline import FlatState
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.rollout import FlightLog

MOST_LATENCY = 0.3
"""Seconds up to which the time until a plan takes over follows what cycles take (arbitrary)."""


def run_in_real_time(config: InterceptConfig, progress: Progress | None = None) -> Episode:
    """Load, compile in both processes, and fly one interception in the time that it takes.

    The planner's process is told what sensors would tell it, and its plans come when they come: what comes of it
    depends on the machine.

    Raises:
        InputError, FileError: the configuration, a file, the target or the start cannot be used.
        ResourceError: the planner's process cannot be started.
    """
    report = progress or tell_nobody
    began = time.perf_counter()
    report("loading", 0.0)
    scenario = build_scenario(config)
    cycles = int(np.ceil(scenario.target.duration / scenario.replanning.period))
    loop = dataclasses.replace(scenario.replanning, drop_late=True, most_latency=MOST_LATENCY)
    settings = RuntimeConfig(replanning=loop, stream=scenario.stream, remembered=cycles + 4)
    with Runtime(from_config(config), scenario.start, settings) as runtime:
        report("compiling", 0.0)
        vehicle, hover = SimulatedVehicle(scenario), runtime.setpoint(0.0)
        log = vehicle.fly(hover, hover)
        scenario.clearance(np.asarray(log.pos, dtype=float))
        runtime.wait_ready()
        settle()
        return fly_in_real_time(scenario, runtime, report, warmup_s=time.perf_counter() - began)


class SimulatedVehicle:
    """The plant of a scenario, flown one control step at a time."""

    def __init__(self, scenario: Scenario) -> None:
        self._plant, self._vehicle = scenario.plant, scenario.vehicle
        self._state = self._plant.reset(scenario.start, jax.random.key(scenario.seed))

    def fly(self, now: Setpoint, then: Setpoint) -> FlightLog:
        """One control step that begins at the first setpoint; errors are against the second."""
        rows = FlatState(derivatives=np.array([now.derivatives, then.derivatives]), yaw=np.array([now.yaw, then.yaw]))
        self._state, log = self._plant.fly(self._state, rows)
        return jax.tree.map(np.asarray, log)

    @property
    def measured(self) -> Measured:
        """As its estimator sees it."""
        return measured_state(self._state, self._vehicle)


def fly_in_real_time(scenario: Scenario, runtime: Runtime, report: Progress, warmup_s: float) -> Episode:
    """Fly a scenario until it is decided, with a runtime that is ready and has not seen anything yet."""
    vehicle, period = SimulatedVehicle(scenario), round(scenario.replanning.period * CONTROL_RATE)
    compiled, began = compilations(), time.perf_counter()
    runtime.restart_clock()
    before, unseen, logs, references, flights = runtime.setpoint(0.0), [], [], [], []
    took, behind, outcome = [], [], None
    for step in range(int(scenario.target.duration * CONTROL_RATE)):
        now, end = step / CONTROL_RATE, (step + 1) / CONTROL_RATE
        if step % period == 0:
            unseen.append(now)
            if now >= scenario.departure - 1e-9:
                _tell(runtime, scenario, unseen)
                unseen = []
        time.sleep(max(end - runtime.now(), 0.0))
        behind.append(1e3 * (runtime.now() - end))
        asked = time.perf_counter()
        setpoint = runtime.setpoint(end)
        took.append(1e6 * (time.perf_counter() - asked))
        logs.append(vehicle.fly(before, setpoint))
        references.append(setpoint.position)
        runtime.odometry(end, *vehicle.measured)
        before = setpoint
        if len(logs) == period:
            log = jax.tree.map(lambda *rows: np.concatenate(rows), *logs)
            ends = end + (np.arange(period) + 1 - period) / CONTROL_RATE
            flight, outcome = until_decided(flight_rows(ends, log, np.array(references), scenario), scenario)
            flights.append(flight)
            logs, references = [], []
            report("flying", end / scenario.target.duration)
            if outcome:
                break
    status = runtime.status()
    return Episode(
        outcome=outcome or ("target_ended" if len(runtime.plans) > 1 else "no_plan"),
        flight=Flight(*(np.concatenate(rows) for rows in zip(*flights, strict=True))),
        replans=status.cycles,
        cycles=runtime.cycles,
        plans=tuple(runtime.plans[1:]),
        scenario=scenario,
        warmup_s=warmup_s,
        wall_s=time.perf_counter() - began,
        compilations_after_warmup=compilations() - compiled + status.compilations_after_warmup,
        real_time=RealTime(np.array(took), np.array(behind), status),
    )


def _tell(runtime: Runtime, scenario: Scenario, instants: list[float]) -> None:
    """Where the target was seen."""
    positions: Float[np.ndarray, "n 3"] = scenario.target.position(np.array(instants))
    for instant, position in zip(instants, positions, strict=True):
        runtime.observe(instant, position)
