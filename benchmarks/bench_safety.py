"""What safety costs in a cycle: the last looks at plans, and their flights in the vehicle's model.

    jaxplan bench safety [--json FILE]

Interceptions are flown with what is predicted from what is seen of the target, the vehicle measured in every cycle. A
*look* is the validator's, at what is left of the committed plan and at each plan before it is committed; *flights* are
those of the model up to where the vehicle is, along what is committed, and along each such plan. Rows are milliseconds
a cycle, beside the whole cycle of the same run.
"""

import argparse
import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxplan import interception
from jaxplan.config import InterceptConfig
from jaxplan.planner import Planner, Rollout, RolloutConfig, Rollouts
from jaxplan.scenario import Scenario, build_scenario
from jaxplan.spline import FlatState

from . import _harness


class _Watch:
    """Adds up what calls take."""

    def __init__(self) -> None:
        self.looks, self.flights = 0.0, 0.0

    def looking(self, validate: Callable[..., Any]) -> Callable[..., Any]:
        """The same, timed."""

        def timed(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            verdict = validate(*args, **kwargs)
            self.looks += 1e3 * (time.perf_counter() - began)
            return verdict

        return timed

    def flying(self, roll_out: Callable[..., Rollout | None]) -> Callable[..., Any]:
        """The same, with a model whose flights are timed."""

        def timed(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            model = roll_out(*args, **kwargs)
            self.flights += 1e3 * (time.perf_counter() - began)
            return None if model is None else _Timed(model, self)

        return timed


class _Timed(Rollout):
    """A model whose flights are timed."""

    def __init__(self, model: Rollout, watch: _Watch) -> None:
        vars(self).update(vars(model))  # the next cycle's model goes on from this one
        self._model, self._watch = model, watch

    @property
    def config(self) -> RolloutConfig:
        """As the model's."""
        return self._model.config

    def along(self, references: FlatState, since: int = 0) -> Rollouts:
        """As the model's."""
        began = time.perf_counter()
        found = self._model.along(references, since)
        self._watch.flights += 1e3 * (time.perf_counter() - began)
        return found


def measure(world: str, departures: Sequence[float], targets: Sequence[int]) -> list[dict[str, Any]]:
    """Rows of one environment."""
    config = InterceptConfig(world=world, planner="mfrl", predictor="fused", speed=3.0, target=f"{world}-01")
    first = build_scenario(config)
    first.planner.warmup(first.start)
    interception.warm_up(first)
    watch, spent = _Watch(), []
    watched = _watched(first.planner, watch)
    for target in targets:
        scenario = build_scenario(dataclasses.replace(config, target=f"{world}-{target:02d}"), planner=first.planner)
        for departure in departures:
            flown = dataclasses.replace(scenario, planner=watched, departure=departure)
            spent += _cycles(flown, watch)
    rows = []
    for column, name in enumerate(("looks", "flights", "both", "whole cycle")):
        p50, p99 = np.quantile([row[column] for row in spent], [0.5, 0.99])
        rows.append({"world": world, "what": name, "p50_ms": float(p50), "p99_ms": float(p99), "cycles": len(spent)})
    return rows


def _watched(planner: Planner, watch: _Watch) -> Planner:
    return planner._replace(validate=watch.looking(planner.validate), roll_out=watch.flying(planner.roll_out))


def _cycles(scenario: Scenario, watch: _Watch) -> list[tuple[float, float, float, float]]:
    """What each cycle of an episode spends: looks, flights, both, all of it [ms]."""
    seen: list[tuple[float, float]] = [(watch.looks, watch.flights)]

    def note(text: str, share: float) -> None:
        seen.append((watch.looks, watch.flights))

    episode = interception.fly(scenario, note)
    spent = [row for row in np.diff(seen, axis=0).tolist() if sum(row) > 0.0]
    totals = [sum(cycle.stage_ms.values()) for cycle in episode.cycles]
    return [(look, flight, look + flight, total) for (look, flight), total in zip(spent, totals, strict=True)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the rows; write them where ``--json`` says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="save the rows, with hardware, versions and commit")
    parser.add_argument("--worlds", nargs="+", default=["env1", "env2", "env3"])
    parser.add_argument("--departures", nargs="+", type=float, default=[0.5, 1.5])
    parser.add_argument("--targets", nargs="+", type=int, default=[1, 4, 7])
    chosen = parser.parse_args(arguments)
    rows = [row for world in chosen.worlds for row in measure(world, chosen.departures, chosen.targets)]
    _harness.show(rows)
    if chosen.json:
        _harness.write(chosen.json, rows)


if __name__ == "__main__":
    main()
