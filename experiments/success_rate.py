"""Success in closed loop: stored targets at several speeds and departure times, for chosen planners and predictors.

    python -m experiments.success_rate --planner no-policy pretrained --predictor ground-truth gmm
    python -m experiments.success_rate --world env3 --targets 10 --speeds 1 3 5.5 --departures 0.5 --out success.json

Every combination of world, target, speed and departure is one episode; a cell shares its compiled functions. Success is
an interception (0.4 m) with position error below 0.4 m and yaw error below 45 degrees throughout; a collision by exact
geometry is a failure (paper, Sec. IV). Intervals are Wilson's, 95 %.
"""

import collections
import dataclasses
import itertools
import json
import time
from pathlib import Path
from typing import Annotated

import cyclopts
import numpy as np
from cyclopts import Parameter

from jaxplan import interception
from jaxplan.config import InterceptConfig
from jaxplan.io.targets import load_target, stored_targets
from jaxplan.replanner import Replanner

Several = Parameter(consume_multiple=True)


def wilson(successes: int, count: int) -> tuple[float, float]:
    """The 95 % interval of a share."""
    z = 1.959964
    centre = (successes + 0.5 * z * z) / (count + z * z)
    half = z / (count + z * z) * np.sqrt(successes * (count - successes) / count + 0.25 * z * z)
    return centre - half, centre + half


def cell(world, planner, predictor, targets, speeds, departures):
    """Outcomes and times to intercept of one planner with one predictor in one world."""
    config = InterceptConfig(world=world, planner=planner, predictor=predictor)
    first = interception.prepare(config)
    interception.warm_up(first)
    rows = []
    for index, (name, speed, departure) in enumerate(itertools.product(targets, speeds, departures)):
        asked = dataclasses.replace(config, target=name, speed=speed, departure=departure, seed=index)
        target = load_target(name, world=world, speed=speed)
        predict = interception.predictor_for(asked, first.world, target)
        replanner = Replanner(first.replanner.planner, predict, first.start)
        scenario = dataclasses.replace(first, target=target, replanner=replanner, departure=departure, seed=index)
        episode = interception.fly(scenario, lambda text, share: None)
        taken = float(episode.flight.times[-1]) - departure
        rows.append({"target": name, "speed": speed, "departure": departure, "outcome": episode.outcome, "time": taken})
    return rows


app = cyclopts.App(name="success_rate", help=__doc__)


@app.default
def main(
    *,
    world: Annotated[tuple[str, ...], Several] = ("env1", "env2", "env3"),
    planner: Annotated[tuple[str, ...], Several] = ("no-policy", "pretrained"),
    predictor: Annotated[tuple[str, ...], Several] = ("ground-truth",),
    targets: int = 10,
    speeds: Annotated[tuple[float, ...], Several] = (1.0, 3.0, 5.5),
    departures: Annotated[tuple[float, ...], Several] = (0.5,),
    out: Path | None = None,
) -> None:
    """Fly all combinations and print a table."""
    kept = []
    for place, who, how in itertools.product(world, planner, predictor):
        began = time.perf_counter()
        rows = cell(place, who, how, stored_targets(place)[:targets], speeds, departures)
        outcomes = collections.Counter(row["outcome"] for row in rows)
        good = [row["time"] for row in rows if row["outcome"] == "intercepted"]
        low, high = wilson(len(good), len(rows))
        mean = f"{np.mean(good):.1f} s" if good else "-"
        failed = ", ".join(f"{n} {kind}" for kind, n in outcomes.items() if kind != "intercepted") or "none"
        share = f"{len(good)}/{len(rows)}  [{low:.2f}, {high:.2f}]"
        took = time.perf_counter() - began
        print(f"{place}  {who:<11} {how:<18} {share}  mean {mean}  failed: {failed}  ({took:.0f} s)", flush=True)
        kept += [{"world": place, "planner": who, "predictor": how, **row} for row in rows]
        if out:
            out.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    app()
