"""Table II of the paper: a replan stage by stage, over the cycles of closed-loop pursuits.

    jaxplan bench planner [--json FILE]

In each environment an interception is flown with the noisy predictor (20 steps x 20 samples), and the state and the
candidates of every cycle are kept. Each cycle is then planned again with K of its candidates (more than 400 are drawn
again, moved by centimetres), warm, stage by stage; ``planned`` counts the cycles that found a plan. The last rows are
the same 400 sequences given to our own batched optimiser: without limits (a) and within the rotors' limits (c), from
rest and without arrival matching; and the floor of one evaluation of the policy's network.
"""

import argparse
import dataclasses
import functools
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxplan import interception
from jaxplan.config import ALLOCATIONS, Allocate, InterceptConfig, Planner
from jaxplan.knots import KnotConfig, select_routes
from jaxplan.minsnap.time_allocation import time_allocation
from jaxplan.planner import Plans, Timer, select
from jaxplan.policy.checkpoint import load_parameters
from jaxplan.precision import in_float64
from jaxplan.prediction.candidates import Candidates, candidates_from
from jaxplan.scenario import Scenario, build_scenario
from jaxplan.search.lattice import SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.spline import FlatState
from jaxplan.vehicle.limits import rotor_limit_margin

from . import _harness

COUNTS = (16, 100, 400, 2048)
PAPER = {"search + knots": 9.5, "policy": 71.2, "total": 99.4}
"""Milliseconds on the paper's GPU (Table II; the total includes 18.7 ms of prediction)."""


def recorded_cycles(scenario: Scenario, departures: Sequence[float]) -> list[tuple[FlatState, Candidates]]:
    """(state, candidates) of every cycle of some episodes."""
    kept: list[tuple[FlatState, Candidates]] = []
    planner = scenario.planner

    def recording(
        state: FlatState, candidates: Candidates, timer: Timer | None = None, above: float = -np.inf
    ) -> Plans:
        kept.append((state, jax.tree.map(np.asarray, candidates)))
        return planner.plan_batch(state, candidates, timer, above)

    recorded = dataclasses.replace(scenario, planner=planner._replace(plan_batch=recording))
    for seed, departure in enumerate(departures):
        interception.fly(dataclasses.replace(recorded, departure=departure, seed=seed))
    return kept


def some_candidates(candidates: Candidates, count: int, rng: np.random.Generator) -> Candidates:
    """``count`` of the candidates; those drawn again are moved a little."""
    lanes = np.resize(rng.permutation(len(candidates.goals)), count)
    moved = rng.normal(scale=0.03, size=(count, 3)) * (np.arange(count) >= len(candidates.goals))[:, None]
    return candidates_from(
        np.asarray(candidates.target),
        np.asarray(candidates.goals)[lanes] + moved,
        np.asarray(candidates.arrival_times)[lanes],
        np.log(np.maximum(np.asarray(candidates.likelihood)[lanes], 1e-12)),
    )


def measure(
    world: str,
    policy: Planner,
    counts: Sequence[int],
    departures: Sequence[float],
    cycles: int,
    seed: int = 0,
    optimiser: bool = True,
    allocate: Allocate | None = None,
) -> list[dict[str, Any]]:
    """Rows of one environment, with those of the optimiser on the same sequences unless it is left out."""
    config = InterceptConfig(world=world, predictor="noisy", planner=policy, speed=3.0, allocate=allocate)
    scenario = build_scenario(config)
    planner = scenario.planner
    began = time.perf_counter()
    planner.warmup(scenario.start)
    warmup = time.perf_counter() - began
    interception.warm_up(scenario)
    rng = np.random.default_rng(seed)
    kept = recorded_cycles(scenario, departures)
    kept = [kept[place] for place in rng.permutation(len(kept))[:cycles]]
    rows = []
    for count in counts:
        stages, planned = [], 0
        for state, candidates in kept:
            some, timer = some_candidates(candidates, count, rng), Timer()
            began = time.perf_counter()
            planned += select(planner.plan_batch(state, some, timer)) >= 0
            total = 1e3 * (time.perf_counter() - began)
            joined = {"search + knots": timer.stages["search"] + timer.stages["knots"], "total": total}
            stages.append({**timer.stages, **joined})
        for stage in ("reject", "search + knots", "policy", "minsnap", "select", "total"):
            p50, p99 = np.quantile([row.get(stage, 0.0) for row in stages], [0.5, 0.99])
            row = {"world": world, "policy": policy, "candidates": count, "stage": stage, "p50_ms": float(p50)}
            row |= {"p99_ms": float(p99), "cycles": len(stages), "planned": planned, "warmup_s": warmup}
            rows.append(row | ({"paper_ms": PAPER[stage]} if stage in PAPER and count == 400 else {}))
    return rows + (baseline(scenario, kept) if optimiser else [])


def floor(policy: str, candidates: int = 400, segments: int = 13) -> dict[str, Any]:
    """The least time of one evaluation of a policy's network: its operations at the rate of a large matrix product.

    Nearly every weight is multiplied once for every segment of every candidate; attention is left out.
    """
    weights = sum(leaf.size for leaf in jax.tree.leaves(load_parameters(policy).parameters))
    side = 2048
    matrix = jax.numpy.ones((side, side), jax.numpy.float32)
    product = _harness.timed(jax.jit(lambda x: x @ x), matrix, repeats=10)["min_ms"]
    operations = 2.0 * weights * segments * candidates
    floor_ms = product * operations / (2.0 * side**3)
    return {"policy": policy, "candidates": candidates, "stage": "floor of one evaluation", "floor_ms": floor_ms} | {
        "gflop": 1e-9 * operations,
        "gflop_per_s": 2e-6 * side**3 / product,
    }


@in_float64
def baseline(scenario: Scenario, kept: list[tuple[FlatState, Candidates]]) -> list[dict[str, Any]]:
    """Our own optimiser on the sequences of one cycle."""
    lattices = build_lattices(scenario.world, SearchConfig(padding=0.5))
    select = jax.jit(lambda paths: select_routes(paths, KnotConfig()).knots)
    margin = functools.partial(rotor_limit_margin, scenario.vehicle)
    state, candidates = kept[0]
    distance = float(np.linalg.norm(candidates.target - state.pos))
    paths = find_routes(lattices, scenario.world, np.asarray(state.pos), candidates.goals, distance)
    good = np.flatnonzero(paths.reasons == 0)
    knots = select(paths.points[np.resize(good, len(candidates.goals))])
    waypoints, segments = np.moveaxis(np.asarray(knots.waypoints), 0, -1), np.asarray(knots.count) - 1
    rows = []
    kinds: dict[str, dict[str, Any]] = {"optimiser (a)": {"time_weight": 100.0}, "optimiser (c)": {"margin": margin}}
    for name, options in kinds.items():
        found = _harness.timed(functools.partial(time_allocation, segments=segments, **options), waypoints, repeats=3)
        rows.append({"world": scenario.world.name, "policy": name, "candidates": len(segments), **found})
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the rows; write them where ``--json`` says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="save the rows, with hardware, versions and commit")
    parser.add_argument("--worlds", nargs="+", default=["env1", "env2", "env3"])
    parser.add_argument("--policy", default="mfrl")
    parser.add_argument("--allocate", choices=ALLOCATIONS, help="who allots the times (default: the planner's)")
    parser.add_argument("--counts", nargs="+", type=int, default=list(COUNTS))
    parser.add_argument("--departures", nargs="+", type=float, default=[0.5, 1.5, 2.5])
    parser.add_argument("--cycles", type=int, default=100)
    chosen = parser.parse_args(arguments)
    rows = []
    for world in chosen.worlds:
        rows += measure(world, chosen.policy, chosen.counts, chosen.departures, chosen.cycles, allocate=chosen.allocate)
    if chosen.policy != "no-policy":
        rows.append(floor(chosen.policy))
    _harness.show(rows)
    if chosen.json:
        _harness.write(chosen.json, rows)


if __name__ == "__main__":
    main()
