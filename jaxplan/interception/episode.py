"""One closed-loop episode in simulated time, which stands still while a plan is made."""

import time
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
from jaxtyping import Float

from jaxplan import programs
from jaxplan.compilation import compilations, give_back_memory, uncollected
from jaxplan.config import InterceptConfig
from jaxplan.interception.judging import flight_rows, measured_state, until_decided
from jaxplan.interception.records import FLYING, Episode, Flight, Follow, Guide, Progress, React, Watch, tell_nobody
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.stream import ObservationStream
from jaxplan.replanner import Cycle, Replanner
from jaxplan.scenario import Scenario, build_scenario


def run(config: InterceptConfig, progress: Progress | None = None) -> Episode:
    """Load, compile and fly one interception.

    Raises:
        InputError, FileError: the configuration, a file, the target or the start cannot be used.
    """
    report = progress or tell_nobody
    began = time.perf_counter()
    report("loading", 0.0)
    scenario = build_scenario(config)
    report("compiling", 0.0)
    warm_up(scenario)
    return fly(scenario, report, warmup_s=time.perf_counter() - began)


def warm_up(scenario: Scenario) -> None:
    """Compile everything that an episode calls, the planner's part beside the rest."""
    with uncollected(), ThreadPoolExecutor(1) as pool:
        planning = pool.submit(scenario.planner.warmup, scenario.start)
        _warm_up_flight(scenario)
        planning.result()
    give_back_memory()
    programs.vouch()


def _warm_up_flight(scenario: Scenario) -> None:
    """Compile what predicts, flies and judges."""
    count = scenario.stream.observations
    still = Observations(
        times=scenario.stream.dt * np.arange(count), positions=np.tile(np.asarray(scenario.start.pos), (count, 1))
    )
    scenario.predictor(still, 0)
    state = scenario.plant.reset(scenario.start, jax.random.key(scenario.seed))
    state, log = scenario.plant.fly(state, _replanner(scenario).reference(scenario.control_times(0.0)))
    scenario.clearance(np.asarray(log.pos, dtype=float))
    jax.block_until_ready(state)


def fly(
    scenario: Scenario,
    progress: Progress | None = None,
    *,
    guide: Guide | None = None,
    watch: Watch | None = None,
    follow: Follow | None = None,
    react: React | None = None,
    warmup_s: float = 0.0,
) -> Episode:
    """Fly a scenario until it is decided.

    Args:
        scenario: what is flown; nothing compiles where ``warm_up`` has seen it.
        progress: told after every cycle.
        guide: what commands the defender instead of a ``Replanner`` with the scenario's planner and predictor.
        watch: what sees the target, instead of a sensor that sees it exactly and at once.
        follow: shown the episode after every period.
        react: told in every cycle where the defender is, after that has decided; what makes targets evade.
        warmup_s: wall time spent before, for the record.
    """
    compiled, began = compilations(), time.perf_counter()
    report, guide, watch = progress or tell_nobody, guide or _replanner(scenario), watch or _see
    target, period = scenario.target, scenario.replanning.period
    state = scenario.plant.reset(scenario.start, jax.random.key(scenario.seed))
    stream, flights = ObservationStream(scenario.stream), list[Flight]()
    cycles, seen = list[Cycle | None](), list[Observations | None]()

    def episode(outcome: str) -> Episode:
        decided = [(cycle, given) for cycle, given in zip(cycles, seen, strict=True) if cycle is not None]
        return Episode(
            outcome=outcome,
            flight=Flight(*(np.concatenate(rows) for rows in zip(*flights, strict=True))),
            replans=len(cycles),
            cycles=tuple(cycle for cycle, _ in decided),
            plans=tuple(guide.plans[1:]),
            scenario=scenario,
            warmup_s=warmup_s,
            wall_s=time.perf_counter() - began,
            compilations_after_warmup=compilations() - compiled,
            observations=tuple(given for _, given in decided),
        )

    for index in range(int(np.ceil(target.duration / period))):
        now = index * period
        watch(stream, now, target.position(np.array([now]))[0])
        observations = stream.observe(now)
        if now >= scenario.departure - 1e-9:
            measured = measured_state(state, scenario.vehicle)
            if observations is not None:
                cycles.append(guide.step(now, observations, measured))
                seen.append(observations)
            elif isinstance(guide, Replanner) and guide.searches:
                cycles.append(guide.step(now, None, measured))
                seen.append(None)
        if react is not None:
            react(now, np.asarray(state.pos, dtype=float), np.asarray(state.vel, dtype=float))
        times = scenario.control_times(now)
        reference = guide.reference(times)
        state, log = scenario.plant.fly(state, reference)
        flight, outcome = until_decided(flight_rows(times[1:], log, np.asarray(reference.pos)[1:], scenario), scenario)
        flights.append(flight)
        report("flying", (now + period) / target.duration)
        if follow is not None:
            follow(episode(outcome or FLYING))
        if outcome:
            return episode(outcome)
    return episode("target_ended" if guide.ever_planned else "no_plan")


def _see(stream: ObservationStream, now: float, position: Float[np.ndarray, "3"]) -> None:
    """A sensor without faults."""
    stream.add(now, position, now)


def _replanner(scenario: Scenario) -> Replanner:
    """A new one, which has committed nothing but the hover at the start."""
    return Replanner(scenario.planner, scenario.predictor, scenario.start, scenario.replanning)
