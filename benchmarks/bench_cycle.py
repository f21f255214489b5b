"""What a cycle takes in closed loop: prediction, plans, the decision, refinement and last looks, as they are flown.

    jaxplan bench cycle [--json FILE]

Interceptions are flown with the vehicle measured and plans refined, as ``jaxplan intercept`` does, several times each:
a flight is the same again, cycle by cycle, so what one of them took at least is what the machine let it take. Rows are
the milliseconds of all cycles of all rooms, by predictor: in every flight, and the least of each cycle; then those of
its stages, likewise the least. ``candidates`` is how many a cycle has at most: predictors that draw are asked for so
many for each of their steps as ``--draws`` says, one after the other.
"""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxplan import interception
from jaxplan.config import InterceptConfig, Predictor
from jaxplan.interception import Episode
from jaxplan.prediction.predictors import PREDICTORS, build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.scenario import Scenario, build_scenario

from . import _harness

SPEED = 5.0
"""m/s at most, as in the arena's family ``stored`` on level 2."""


def fly(world: str, predictor: Predictor, draws: int, targets: Sequence[int], repeats: int) -> list[list[Episode]]:
    """The flights of one room, each as often as asked for, after one that does not count."""
    config = InterceptConfig(world=world, planner="mfrl", predictor=predictor, speed=SPEED, target=f"{world}-01")
    first = build_scenario(config)
    first.planner.warmup(first.start)
    interception.warm_up(first)
    named = [dataclasses.replace(config, target=f"{world}-{target:02d}") for target in targets]
    scenarios = [drawing(draws, one, build_scenario(one, planner=first.planner)) for one in named]
    interception.fly(scenarios[0])
    return [[interception.fly(scenario) for _ in range(repeats)] for scenario in scenarios]


def drawing(draws: int, config: InterceptConfig, scenario: Scenario) -> Scenario:
    """The same with so many draws for each step of its predictor."""
    prediction = dataclasses.replace(PredictionConfig.for_world(scenario.world), batch=draws)
    truth = scenario.target.position
    predictor = build_predictor(config.predictor, prediction, truth, config.seed, world=scenario.world)
    return dataclasses.replace(scenario, predictor=predictor)


def measure(
    worlds: Sequence[str], predictor: Predictor, draws: int, targets: Sequence[int], repeats: int
) -> list[dict[str, Any]]:
    """Rows of one predictor."""
    flights = [flown for world in worlds for flown in fly(world, predictor, draws, targets, repeats)]
    stages = list(dict.fromkeys(stage for flown in flights for cycle in flown[0].cycles for stage in cycle.stage_ms))
    cycles = [same for flown in flights for same in zip(*(episode.cycles for episode in flown), strict=True)]
    taken = np.array([[[cycle.stage_ms.get(stage, 0.0) for stage in stages] for cycle in same] for same in cycles])
    totals = taken.sum(axis=2)
    columns = {"whole cycle": totals.ravel(), "whole cycle, least": totals.min(axis=1)}
    columns |= {stage: taken[:, :, place].min(axis=1) for place, stage in enumerate(stages)}
    most = max(cycle.generated for same in cycles for cycle in same)
    rows = []
    for what, spent in columns.items():
        p50, p99 = np.quantile(spent, [0.5, 0.99])
        row = {"predictor": predictor, "candidates": most, "what": what, "p50_ms": float(p50), "p99_ms": float(p99)}
        rows.append(row | {"mean_ms": float(np.mean(spent)), "cycles": len(cycles), "flights": repeats})
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the rows; write them where ``--json`` says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="save the rows, with hardware, versions and commit")
    parser.add_argument("--worlds", nargs="+", default=["env1", "env2", "env3"])
    parser.add_argument("--predictors", nargs="+", default=["ground-truth", "fused"])
    parser.add_argument("--draws", nargs="+", type=int, default=[20, 103], help="of each step, by those that draw")
    parser.add_argument("--targets", nargs="+", type=int, default=[1, 7])
    parser.add_argument("--repeats", type=int, default=4)
    chosen = parser.parse_args(arguments)
    rows = []
    for predictor in chosen.predictors:
        for draws in chosen.draws if PREDICTORS[predictor].sampling else chosen.draws[:1]:
            rows += measure(chosen.worlds, predictor, draws, chosen.targets, chosen.repeats)
    _harness.show(rows)
    if chosen.json:
        _harness.write(chosen.json, rows)


if __name__ == "__main__":
    main()
