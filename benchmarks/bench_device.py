"""One replan, and batches of closed loops, as programs of one device: on a GPU and on the CPU beside it.

    jaxplan bench device [--devices gpu cpu] [--parts host replan episodes] [--widths 256 1024 2048] [--json FILE]

Replans are those of the noisy predictor in environment 3, from a hover and goals along a stored target's way, warm; the
median of 30. Episodes are those of Table I with the same predictor, 20 draws a step, all in environment 3. The
planner on the host is timed on the same goals in the same run.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxplan.device.replan import ReplanConfig, build_replan
from jaxplan.device.stations import Goals
from jaxplan.feasibility.checkpoint import load_classifier
from jaxplan.io.targets import load_target
from jaxplan.policy.checkpoint import load_policy
from jaxplan.precision import in_float64
from jaxplan.prediction.candidates import candidates_from
from jaxplan.runner.registry import bundled
from jaxplan.spline import hover
from jaxplan.vehicle.load import load_vehicle

from . import _harness

closed_loop, on_device, table1 = (bundled("experiments", name) for name in ("closed_loop", "on_device", "table1"))

WORLD = "env3"
COUNTS = (20, 400, 2048)
DEFENDER = closed_loop.Defender("mfrl")
REPLANS = 4
"""Different sets of goals."""


def goal_sets(count: int) -> list[Goals]:
    """Goals around a target's way, at several instants."""
    target, rng = load_target(None, world=WORLD, speed=3.0), np.random.default_rng(0)
    draws = max(count // 20, 1)
    sets = []
    for now in np.linspace(0.5, 3.0, REPLANS):
        offsets = 0.2 * np.repeat(np.arange(1, 21), draws)
        offsets = np.resize(offsets, count)
        noise = rng.normal(size=(count, 3)) * (0.05 * np.sqrt(offsets / 0.2))[:, None] * (count > 20)
        log_densities = -0.5 * rng.chisquare(3, size=count)
        likelihood = np.exp(log_densities - log_densities.max())
        sets.append(Goals(target.position(now + offsets) + noise, offsets, likelihood))
    return sets


@in_float64
def replan_rows(device: str, counts: Sequence[int]) -> list[dict[str, Any]]:
    """Milliseconds of one replan."""
    scene = on_device.scene(DEFENDER, WORLD)
    config = ReplanConfig(
        planner=on_device.planner_config_of(DEFENDER),
        tried_at_once=on_device.AT_ONCE_ON_GPU if device == "gpu" else 1,
    )
    replan = jax.jit(build_replan(config, load_vehicle(), load_policy("mfrl"), load_classifier("mfrl")))
    rows, start = [], hover(np.asarray(scene.start))
    with jax.default_device(on_device.device_named(device)):
        room, start = jax.device_put((scene.room, start))
        for count in counts:
            sets = jax.device_put(goal_sets(count))
            began = time.perf_counter()
            found = sum(bool(replan(room, start, goals, -np.inf).found) for goals in sets)
            first = time.perf_counter() - began
            times = [_harness.timed(replan, room, start, goals, -np.inf, repeats=30)["median_ms"] for goals in sets]
            rows.append({"what": "replan", "device": device, "goals": count, "median_ms": float(np.median(times))})
            rows[-1] |= {"worst_ms": max(times), "first_s": first, "found": found, "of": len(sets)}
    return rows


def host_rows(counts: Sequence[int]) -> list[dict[str, Any]]:
    """The same by the planner that users call."""
    planner = closed_loop.scenario_in(WORLD, DEFENDER).planner
    state = hover(np.asarray(on_device.scene(DEFENDER, WORLD).start))
    planner.warmup(state)
    rows = []
    for count in counts:
        times = []
        for goals in goal_sets(count):
            candidates = candidates_from(
                np.asarray(goals.positions)[0], goals.positions, goals.times, np.log(goals.likelihood)
            )
            times.append(_harness.timed(planner.plan_batch, state, candidates, repeats=10)["median_ms"])
        rows.append({"what": "replan", "device": "host", "goals": count, "median_ms": float(np.median(times))})
        rows[-1] |= {"worst_ms": max(times)}
    return rows


def episode_row(device: str, predictor: str, width: int, count: int) -> dict[str, Any]:
    """Episodes a second, of ``count`` of them, ``width`` at a time; the first go compiles."""
    config = table1.Config(worlds=(WORLD,), episodes=min(count, 1000))
    chosen = [table1.chosen(config)[i % config.episodes] for i in range(count)]
    episodes = [
        closed_loop.EpisodeConfig(**{**vars(one), "planner": DEFENDER.planner, "predictor": predictor, "seed": number})
        for number, one in enumerate(chosen)
    ]
    seconds = []
    for _ in range(2):
        began = time.perf_counter()
        rows = on_device.fly_together(episodes, device, width)
        seconds.append(time.perf_counter() - began)
    cycles = sum(row["replans"] for row in rows)
    return {
        "what": "episodes",
        "device": device,
        "predictor": predictor,
        "width": width,
        "episodes": count,
        "first_s": seconds[0],
        "again_s": seconds[1],
        "episodes_per_s": count / seconds[1],
        "replans_per_s": cycles / seconds[1],
        "met": sum(row["outcome"] == "intercepted" for row in rows) / count,
        "collisions": sum(row["outcome"] == "collision" for row in rows),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and, with --json, save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", nargs="+", choices=("gpu", "cpu"), default=[jax.default_backend()])
    parser.add_argument("--parts", nargs="+", choices=("host", "replan", "episodes"), default=["host", "replan"])
    parser.add_argument("--predictors", nargs="+", default=["ground-truth", "noisy-0.05"])
    parser.add_argument("--widths", nargs="+", type=int, default=[16])
    parser.add_argument("--counts", nargs="+", type=int, default=list(COUNTS), help="goals of a replan")
    parser.add_argument("--rounds", type=int, default=2, help="episodes flown are so many times the width")
    parser.add_argument("--json", type=Path, default=None)
    options = parser.parse_args(arguments)
    rows: list[dict[str, Any]] = []

    def keep(row: dict[str, Any]) -> None:
        rows.append(row)
        _harness.show([row])
        if options.json is not None:
            _harness.write(options.json, rows)

    if "host" in options.parts:
        for row in host_rows(options.counts):
            keep(row)
    for device in options.devices:
        for row in replan_rows(device, options.counts) if "replan" in options.parts else []:
            keep(row)
        for predictor in options.predictors if "episodes" in options.parts else []:
            for width in options.widths:
                keep(episode_row(device, predictor, width, options.rounds * width))


if __name__ == "__main__":
    main()
