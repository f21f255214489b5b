"""``jaxplan train dataset|pretrain``: how the shipped policies are made."""

import dataclasses
import functools
import os
from pathlib import Path
from typing import Any

from jaxplan.cli.parameters import command_line, option_values, with_options
from jaxplan.errors import InputError
from jaxplan.policy.checkpoint import load_parameters, load_policy, policy_card, resolve_policy, save_policy
from jaxplan.runner.distribute import map_on_workers
from jaxplan.training.dataset import DatasetConfig, dataset_vehicle, digest, in_turn, make_dataset, read_config
from jaxplan.training.evaluate import score_policy
from jaxplan.training.pretrain import PretrainConfig
from jaxplan.training.pretrain import pretrain as train
from jaxplan.versions import require_supported_jax

_BESIDE = ("network", "imitation")
"""Parts of a pretraining's configuration whose fields are options like its own."""


@with_options(DatasetConfig)
def dataset(
    *, out: Path, config: DatasetConfig, workers: int = 0, scheduler: str | None = None, debug: bool = False
) -> int:
    """Make a training set of labelled waypoint sequences; a run that was cut off goes on.

    Parameters
    ----------
    out
        Folder of the shards.
    workers
        Processes on this machine that make shards; 0: only this one, on all cores.
    scheduler
        Address of a dask scheduler with workers of its own, like tcp://host:8786.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    if workers < 0 or (workers and scheduler is not None):
        raise InputError(
            f"train dataset: have --workers {workers} and --scheduler {scheduler}, want 0 or more, or a scheduler"
        )
    elsewhere = workers > 0 or scheduler is not None
    each = functools.partial(map_on_workers, workers=workers, scheduler=scheduler) if elsewhere else in_turn
    make_dataset(out, config, each=each)
    return 0


@with_options(PretrainConfig, beside=_BESIDE)
def pretrain(
    *,
    data: Path,
    run: Path,
    out: Path,
    start: str | None = None,
    flights: int = 2_000,
    config: PretrainConfig,
    debug: bool = False,
) -> int:
    """Train a policy to imitate the optimiser; a run that was cut off goes on.

    Parameters
    ----------
    data
        Folder of a training set (jaxplan train dataset).
    run
        Folder of the run: its state, metrics.jsonl and the best weights so far.
    out
        File of the policy (.npz), with its scores.
    start
        Policy to go on from, by name or file; its sizes are kept. Default: random weights.
    flights
        Held-out sequences that are flown for the scores.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    if out.suffix != ".npz" or not os.path.isdir(out.parent):
        raise InputError(f"train pretrain: have --out {out}, want a .npz file in a folder that exists; correct it")
    options, parameters = option_values(config, beside=_BESIDE), None
    if start is not None:
        network, parameters, _ = load_parameters(start)
        config = dataclasses.replace(config, network=network)
        options = {"start": start, **option_values(config, beside=_BESIDE, fixed=("network",))}
    state, error = train(run, data, config, start=parameters)
    card = _provenance(command_line("train pretrain", options), config, start, data)
    card |= {"steps_taken": int(state.step), "held_out_error_of_total_time": error.overall}
    vehicle = dataset_vehicle(data)
    save_policy(out, config.network, state.averaged, card, vehicle=vehicle)
    if flights:
        card["scores"] = score_policy(load_policy(out), data, flights)
        save_policy(out, config.network, state.averaged, card, vehicle=vehicle)
    print(f"{out}: held-out error of the total time {error.overall:.1%}, {out.stat().st_size / 1e6:.2f} MB")
    return 0


def _provenance(command: str, config: PretrainConfig, start: str | None, data: Path) -> dict[str, Any]:
    """Where a pretrained policy came from."""
    return {
        "command": command,
        "config": dataclasses.asdict(config),
        "start": None if start is None else _origin(start),
        "data": {"sha256": digest(data / "dataset.json"), **dataclasses.asdict(read_config(data))},
    }


def _origin(start: str) -> dict[str, Any]:
    """Hash and card of the policy that training went on from."""
    return {"sha256": digest(resolve_policy(start)[0]), **policy_card(start)}
