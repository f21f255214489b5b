"""Table II: wall time of the stages of a replan, on the CPU and, where JAX has one, on the GPU.

    jaxplan experiment table2 --preset smoke|small|full

The cycles of ``jaxplan bench planner`` with the predictor's time beside them. Times are wall times: nothing else should
run, and no two runs agree to the last digit.
"""

import dataclasses
import time

import jax
import numpy as np

from jaxplan.errors import InputError
from jaxplan.io.targets import load_target, stored_targets
from jaxplan.policy.checkpoint import resolve_policy
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.target_model import shipped_model
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.registry import bundled
from jaxplan.runner.tables import as_latex, as_markdown
from jaxplan.world.load import ENVIRONMENTS, load_world

from . import SUMMARIES
from .closed_loop import check_names
from .figures.stages import draw_stages

PAPER = {"predict": 18.7, "search + knots": 9.5, "policy": 71.2, "total": 99.4}
"""Milliseconds on a Titan Xp (paper, Table II)."""
STAGES = ("predict", "reject", "search + knots", "policy", "minsnap", "select", "total")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Which cycles are planned again, and with how many candidates."""

    worlds: tuple[str, ...] = ENVIRONMENTS
    """Stored worlds."""

    policy: str = "pretrained"
    """Who allots the times."""

    counts: tuple[int, ...] = (400,)
    """Candidates of a cycle."""

    departures: tuple[float, ...] = (0.5, 1.5, 2.5)
    """One episode each gives the cycles [s]."""

    cycles: int = 100
    """Cycles that are planned again."""

    seed: int = 0
    """Seed of the choice of cycles and candidates."""

    def __post_init__(self) -> None:
        check_names(self.worlds, (self.policy,), ("none",))
        if not self.counts or min(self.counts) < 1 or self.cycles < 1 or self.seed < 0 or not self.departures:
            raise InputError("--counts, --departures and --cycles: want at least one, of at least 1; --seed at least 0")


def devices() -> list[str]:
    """Platforms that JAX has here, the CPU first."""
    return list(dict.fromkeys(["cpu", jax.default_backend()]))


def items(config: Config) -> list[Item]:
    """Every world on every device."""
    found = [(device, world) for device in devices() for world in config.worlds]
    return [Item(f"{device}/{world}", world, {"device": device, "world": world}) for device, world in found]


def evaluate(config: Config, item: Item) -> Row:
    """Median and 99th percentile of every stage."""
    world, bench = item.values["world"], bundled("benchmarks", "bench_planner")
    with jax.default_device(jax.local_devices(backend=item.values["device"])[0]):
        measured = bench.measure(
            world, config.policy, config.counts, config.departures, config.cycles, config.seed, optimiser=False
        )
        spent = prediction_ms(world, config.cycles)
    rows = []
    for count in config.counts:
        mine = {row["stage"]: row for row in measured if row["candidates"] == count}
        for stage in STAGES[1:]:
            rows.append(_row(item, count, stage, mine[stage]["p50_ms"], mine[stage]["p99_ms"]))
        p50, p99 = np.quantile(spent, [0.5, 0.99])
        rows.append(_row(item, count, "predict", float(p50), float(p99)))
        rows[-2] |= {key: rows[-2][key] + rows[-1][key] for key in ("p50_ms", "p99_ms")}
    return {"rows": sorted(rows, key=lambda row: (row["candidates"], STAGES.index(row["stage"])))}


def prediction_ms(world: str, count: int) -> list[float]:
    """Wall times of the mixture's predictions, 400 candidates each, along a stored target."""
    room = load_world(world)
    config = PredictionConfig.for_world(room)
    target = load_target(stored_targets(world)[0], world=world, speed=3.0)
    predict = build_predictor("gmm", config, target.position, 0, shipped_model(world, config.dt), room)
    spent = []
    for cycle in range(count + 1):
        now = config.observations * config.dt + 0.1 * cycle
        times = now + config.dt * np.arange(1 - config.observations, 1)
        seen, began = Observations(times=times, positions=target.position(times)), time.perf_counter()
        predict(seen, cycle)
        spent.append(1e3 * (time.perf_counter() - began))
    return spent[1:]  # the first compiles


def _row(item: Item, count: int, stage: str, p50: float, p99: float) -> Row:
    return {**item.values, "candidates": count, "stage": stage, "p50_ms": p50, "p99_ms": p99}


def report(results: Results[Config]) -> Report:
    """A line for each device, world and number of candidates, and the paper's below."""
    rows = [line for row in results.finished_rows() for line in row["rows"]]
    header = ["device, world, candidates", *(f"{stage} [ms]" for stage in STAGES)]
    lines = []
    for key in dict.fromkeys((row["device"], row["world"], row["candidates"]) for row in rows):
        mine = {r["stage"]: r for r in rows if (r["device"], r["world"], r["candidates"]) == key}
        times = [f"{mine[stage]['p50_ms']:.2f} / {mine[stage]['p99_ms']:.2f}" for stage in STAGES]
        lines.append([", ".join(map(str, key)), *times])
    lines.append(["paper, Titan Xp, 400", *(f"{PAPER[s]:g}" if s in PAPER else "-" for s in STAGES)])
    markdown = "Median / 99th percentile of a warm replan; `total` has the sum of both for prediction and planning.\n\n"
    markdown += as_markdown(header, lines)
    return Report(
        markdown=markdown + "\n![stages](stages.png)\n",
        table=rows,
        latex=as_latex(header, lines, "Wall time of the stages, median / 99th percentile"),
        figures={"stages.png": lambda path: draw_stages(rows, PAPER, path)},
        summary=markdown,
    )


EXPERIMENT = Experiment(
    summary=SUMMARIES["table2"],
    presets={
        "smoke": Config(worlds=("env1",), departures=(0.5,), cycles=10),
        "small": Config(),
        "full": Config(counts=(16, 100, 400, 2048), cycles=300, departures=(0.5, 1.0, 1.5, 2.0, 2.5)),
    },
    items=items,
    evaluate=evaluate,
    report=report,
    artefacts=lambda config: [] if config.policy == "no-policy" else [resolve_policy(config.policy)[0]],
    parallel=False,
)
