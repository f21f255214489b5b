"""How large the policy's network should be: held-out error of the total time against the time of an evaluation.

    jaxplan experiment network-size --preset smoke|small|full [--data DIR]

Each size is pretrained alike, on a dataset made by ``jaxplan train dataset`` or, without one, on shards made for the
purpose; the error is that of shards held out. Timed are 400 sequences of 14 waypoints: the encoder with one decoder
pass, and the decoder alone, which the arrival matching repeats.
"""

import dataclasses
import functools
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxplan.errors import InputError
from jaxplan.policy.network import NetworkConfig
from jaxplan.policy.neural import neural_policy
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.tables import as_latex, as_markdown, number
from jaxplan.training.dataset import (
    HELD_OUT,
    DatasetConfig,
    build_flights,
    build_labels,
    make_shard,
    shard_path,
    write_shard,
)
from jaxplan.training.examples import load_examples, take_examples
from jaxplan.training.imitation import ImitationConfig
from jaxplan.training.pretrain import PretrainConfig, pretrain
from jaxplan.vehicle.load import load_vehicle

from . import SUMMARIES
from .figures.network_size import draw_network_size

CANDIDATES = 400


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Which sizes, and how long each is trained."""

    hidden: tuple[int, ...] = (16, 32, 64, 128)
    """Widths of the decoder's GRU; attention and bottleneck are half as wide."""

    steps: int = 2000
    """Gradient steps of each size."""

    batch: int = 384
    """Sequences of a step."""

    data: str | None = None
    """A folder made by jaxplan train dataset. Default: shards are made first."""

    shards: int = 8
    """Of 2,560 sequences each, where they have to be made, at most 8; the last is held out."""

    repeats: int = 30
    """Timed evaluations."""

    seed: int = 0
    """Seed of the weights and batches."""

    def __post_init__(self) -> None:
        if (
            min(self.hidden, default=0) < 2
            or min(self.steps, self.batch, self.repeats) < 1
            or not 2 <= self.shards <= HELD_OUT
        ):
            have = f"--hidden {self.hidden} --steps {self.steps} --batch {self.batch} --shards {self.shards}"
            raise InputError(f"{have}: want sizes from 2, steps, batches and repeats from 1, and 2 to 8 shards")


def items(config: Config) -> list[Item]:
    """One item for each width."""
    return [Item(f"hidden {width}", "sizes", {"hidden": width}) for width in config.hidden]


def evaluate(config: Config, item: Item) -> Row:
    """Train a network of this width, then measure its error and its time."""
    width = item.values["hidden"]
    network = NetworkConfig(hidden=width, attention=width // 2, latent=width // 2)
    settings = PretrainConfig(
        network=network,
        imitation=ImitationConfig(excess=0.0),
        steps=config.steps,
        batch=config.batch,
        evaluate_every=min(500, config.steps),
        seed=config.seed,
    )
    with tempfile.TemporaryDirectory() as folder:
        state, error = pretrain(Path(folder) / "run", _data(config), settings, report=lambda text: None)
    weights = sum(leaf.size for leaf in jax.tree.leaves(state.averaged))
    return {"hidden": width, "weights": weights, "error": error.overall, **_timed(config, network, state.averaged)}


def _data(config: Config) -> Path:
    """The dataset asked for, or one of our own."""
    return Path(_own(config.shards).name if config.data is None else config.data)


@functools.cache
def _own(shards: int) -> tempfile.TemporaryDirectory:
    """A dataset of few shards, the last of them held out, that lives as long as this process."""
    kept, made = tempfile.TemporaryDirectory(), DatasetConfig(shards=HELD_OUT)
    folder = Path(kept.name)
    (folder / "dataset.json").write_text(json.dumps({"config": dataclasses.asdict(made)}))
    label, fly = build_labels(load_vehicle(made.vehicle), made.labels), build_flights(made.labels)
    for index in (*range(shards - 1), HELD_OUT - 1):
        write_shard(shard_path(folder, index), make_shard(made, index, label, fly))
    return kept


def _timed(config: Config, network: NetworkConfig, parameters: Any) -> Row:
    """Median milliseconds of encoding with one pass, and of a pass, over held-out sequences."""
    policy, held_out = neural_policy("sized", network, parameters), load_examples(_data(config), held_out=True)
    longest = np.argsort(-held_out.count, kind="stable")
    some = take_examples(held_out, np.resize(longest, CANDIDATES))
    state = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), some.initial)
    encode, decode = jax.jit(policy.encode), jax.jit(policy.decode)
    memory = encode(some.waypoints, some.count)
    whole, each = [], []
    for _ in range(config.repeats + 1):
        began = time.perf_counter()
        jax.block_until_ready(decode(encode(some.waypoints, some.count), state))
        between = time.perf_counter()
        jax.block_until_ready(decode(memory, state))
        whole.append(between - began)
        each.append(time.perf_counter() - between)
    return {"evaluation_ms": 1e3 * float(np.median(whole[1:])), "pass_ms": 1e3 * float(np.median(each[1:]))}


def report(results: Results[Config]) -> Report:
    """A line for each width, and the picture."""
    rows = results.finished_rows()
    header = ["hidden", "weights", "held-out error [%]", "evaluation [ms]", "decoder pass [ms]"]
    lines = [
        [
            str(row["hidden"]),
            str(row["weights"]),
            number(row["error"], ".2%").rstrip("%"),
            f"{row['evaluation_ms']:.2f}",
            f"{row['pass_ms']:.2f}",
        ]
        for row in rows
    ]
    markdown = as_markdown(header, lines)
    return Report(
        markdown=f"{markdown}\n![error against time](network_size.png)\n",
        table=rows,
        latex=as_latex(header, lines, "Size of the policy's network"),
        figures={"network_size.png": lambda path: draw_network_size(rows, path, shipped=NetworkConfig().hidden)},
        summary=markdown,
    )


EXPERIMENT = Experiment(
    summary=SUMMARIES["network-size"],
    presets={
        "smoke": Config(hidden=(8, 16), steps=20, shards=2, repeats=3),
        "small": Config(),
        "full": Config(hidden=(16, 32, 48, 64, 96, 128), steps=12_000),
    },
    items=items,
    evaluate=evaluate,
    report=report,
    parallel=False,
)
