"""What a cycle takes in closed loop: prediction, plans, the decision, refinement and last looks, as they are flown.

    jaxplan bench cycle [--json FILE]

Interceptions are flown with the vehicle measured and plans refined, as ``jaxplan intercept`` does, several times each:
a flight is the same again, cycle by cycle, so what one of them took at least is what the machine let it take. Rows are
the milliseconds of all cycles of all rooms, by predictor: in every flight, in as many more for whose cycles there is
only a budget, and the least of each cycle; then those of its stages, likewise the least. ``candidates`` is how many a
cycle has at most: predictors that draw are asked for so many for each of their steps as ``--draws`` says, one after the
other.
"""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxplan import interception
from jaxplan.config import InterceptConfig, Predictor
from jaxplan.interception import Episode
from jaxplan.prediction.predictors import PREDICTORS, build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.scenario import Scenario, build_scenario
from jaxplan.status import PlanStatus

from . import _harness

SPEED = 5.0
"""m/s at most, as in the arena's family ``stored`` on level 2."""


def scenarios_of(world: str, predictor: Predictor, draws: int, targets: Sequence[int]) -> list[Scenario]:
    """The scenarios of one room, compiled, after a flight that does not count."""
    config = InterceptConfig(world=world, planner="mfrl", predictor=predictor, speed=SPEED, target=f"{world}-01")
    first = build_scenario(config)
    first.planner.warmup(first.start)
    interception.warm_up(first)
    named = [dataclasses.replace(config, target=f"{world}-{target:02d}") for target in targets]
    scenarios = [drawing(draws, one, build_scenario(one, planner=first.planner)) for one in named]
    interception.fly(scenarios[0])
    return scenarios


def hurried(scenario: Scenario, budget: float) -> Scenario:
    """The same with so many milliseconds for a cycle: what would be late is left out, what is late is dropped."""
    loop = dataclasses.replace(scenario.replanning, latency=1e-3 * budget, drop_late=True)
    return dataclasses.replace(scenario, replanning=loop)


def drawing(draws: int, config: InterceptConfig, scenario: Scenario) -> Scenario:
    """The same with so many draws for each step of its predictor."""
    prediction = dataclasses.replace(PredictionConfig.for_world(scenario.world), batch=draws)
    truth = scenario.target.position
    predictor = build_predictor(config.predictor, prediction, truth, config.seed, world=scenario.world)
    return dataclasses.replace(scenario, predictor=predictor)


def measure(
    worlds: Sequence[str], predictor: Predictor, draws: int, targets: Sequence[int], repeats: int, budget: float
) -> list[dict[str, Any]]:
    """Rows of one predictor."""
    flights, hurrying = list[list[Episode]](), list[Episode]()
    for world in worlds:  # the compiled programs of one room at a time
        for scenario in scenarios_of(world, predictor, draws, targets):
            flights.append([interception.fly(scenario) for _ in range(repeats)])
            hurrying += [interception.fly(hurried(scenario, budget)) for _ in range(repeats)]
    cycles = [same for flown in flights for same in zip(*(episode.cycles for episode in flown), strict=True)]
    stages = list(dict.fromkeys(stage for same in cycles for stage in same[0].stage_ms))
    taken = np.array([[[cycle.stage_ms.get(stage, 0.0) for stage in stages] for cycle in same] for same in cycles])
    totals = taken.sum(axis=2)
    common = {"predictor": predictor, "candidates": max(cycle.generated for same in cycles for cycle in same)}
    flown = [episode for same in flights for episode in same]
    rows = [common | of_times("whole cycle", totals.ravel()) | of_flights(flown)]
    rows.append(
        common | of_times(f"whole cycle, for which there are {budget:g} ms", durations(hurrying)) | of_flights(hurrying)
    )
    rows.append(common | of_times("whole cycle, least", totals.min(axis=1)))
    rows += [common | of_times(stage, taken[:, :, place].min(axis=1)) for place, stage in enumerate(stages)]
    return [row | {"flights": repeats} for row in rows]


def durations(episodes: Sequence[Episode]) -> Float[np.ndarray, "n"]:
    """Of all cycles [ms]."""
    return np.array([sum(cycle.stage_ms.values()) for episode in episodes for cycle in episode.cycles])


def of_times(what: str, spent: Float[np.ndarray, "n"]) -> dict[str, Any]:
    """Columns about times [ms]."""
    p50, p99 = np.quantile(spent, [0.5, 0.99])
    return {
        "what": what,
        "p50_ms": float(p50),
        "p99_ms": float(p99),
        "mean_ms": float(np.mean(spent)),
        "cycles": len(spent),
    }


def of_flights(episodes: Sequence[Episode]) -> dict[str, Any]:
    """Columns about what came of the cycles: the targets met, how soon on average [s], and plans dropped as late."""
    met = [episode.flight.times[-1] - episode.scenario.departure for episode in episodes if episode.success]
    late = [cycle.status is PlanStatus.LATE for episode in episodes for cycle in episode.cycles]
    return {
        "met": len(met) / len(episodes),
        "met_s": float(np.mean(met)) if met else None,
        "late": float(np.mean(late)),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the rows; write them where ``--json`` says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="save the rows, with hardware, versions and commit")
    parser.add_argument("--worlds", nargs="+", default=["env1", "env2", "env3"])
    parser.add_argument("--predictors", nargs="+", default=["ground-truth", "fused"])
    parser.add_argument("--draws", nargs="+", type=int, default=[20, 103], help="of each step, by those that draw")
    parser.add_argument("--targets", nargs="+", type=int, default=[1, 7])
    parser.add_argument("--repeats", type=int, default=4)
    parser.add_argument("--budget", type=float, default=30.0, help="ms of a cycle, after which its plan is late")
    chosen = parser.parse_args(arguments)
    rows = []
    for predictor in chosen.predictors:
        for draws in chosen.draws if PREDICTORS[predictor].sampling else chosen.draws[:1]:
            rows += measure(chosen.worlds, predictor, draws, chosen.targets, chosen.repeats, chosen.budget)
    _harness.show(rows)
    if chosen.json:
        _harness.write(chosen.json, rows)


if __name__ == "__main__":
    main()
