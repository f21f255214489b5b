"""``jaxplan train dataset|pretrain``: how the shipped policies are made."""

import dataclasses
import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxplan.versions import require_supported_jax

if TYPE_CHECKING:
    from jaxplan.training.pretrain import PretrainConfig


def dataset(
    *,
    out: Path,
    shards: int = 48,
    seed: int = 1,
    vehicle: str = "mfrl",
    workers: int = 0,
    scheduler: str | None = None,
    debug: bool = False,
) -> int:
    """Make a training set of labelled waypoint sequences; a run that was cut off goes on.

    Parameters
    ----------
    out
        Folder of the shards.
    shards
        How many, of 2,560 sequences each.
    seed
        Seed of the rooms and sequences.
    vehicle
        A preset's name or a TOML file.
    workers
        Processes on this machine that make shards; 0: only this one, on all cores.
    scheduler
        Address of a dask scheduler with workers of its own, like tcp://host:8786.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    from jaxplan.errors import InputError
    from jaxplan.runner.distribute import spread
    from jaxplan.training.dataset import DatasetConfig, in_turn, make_dataset

    if workers < 0 or (workers and scheduler is not None):
        raise InputError(
            f"train dataset: have --workers {workers} and --scheduler {scheduler}, want 0 or more, or a scheduler"
        )
    spreading = workers > 0 or scheduler is not None
    each = functools.partial(spread, workers=workers, scheduler=scheduler) if spreading else in_turn
    make_dataset(out, DatasetConfig(shards=shards, seed=seed, vehicle=vehicle), each=each)
    return 0


def pretrain(
    *,
    data: Path,
    run: Path,
    out: Path,
    hidden: int = 64,
    attention: int = 32,
    latent: int = 32,
    start: str | None = None,
    steps: int = 30_000,
    batch: int = 512,
    learning_rate: float = 3e-3,
    excess: float = 0.4,
    flights: int = 2_000,
    seed: int = 0,
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
    hidden
        Width of the network's GRUs.
    attention
        Width of its keys, queries and values.
    latent
        Width of its bottleneck.
    start
        Policy to go on from, by name or file; its sizes are kept. Default: random weights.
    steps
        Gradient steps at most.
    batch
        Sequences of each step.
    learning_rate
        At its highest, after a warm-up; a cosine follows.
    excess
        Weight of thrust beyond the rotors' limits [1/s]. With 0 no flight is solved, and a step takes half the time.
    flights
        Held-out sequences that are flown for the scores.
    seed
        Seed of the weights and batches.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    from jaxplan.errors import InputError
    from jaxplan.policy.checkpoint import load_parameters, load_policy, save_policy
    from jaxplan.policy.network import NetworkConfig
    from jaxplan.training.evaluate import score_policy
    from jaxplan.training.imitation import ImitationConfig
    from jaxplan.training.pretrain import PretrainConfig
    from jaxplan.training.pretrain import pretrain as train

    if out.suffix != ".npz" or not out.parent.is_dir():
        raise InputError(f"train pretrain: have --out {out}, want a .npz file in a folder that exists; correct it")
    network, parameters = NetworkConfig(hidden=hidden, attention=attention, latent=latent), None
    options: dict[str, object] = {"hidden": hidden, "attention": attention, "latent": latent}
    if start is not None:
        network, parameters = load_parameters(start)
        options = {"start": start}
    imitation = ImitationConfig(excess=excess)
    config = PretrainConfig(network, steps, batch, learning_rate, imitation, seed=seed)
    state, error = train(run, data, config, start=parameters)
    options |= {"steps": steps, "batch": batch, "learning-rate": learning_rate, "excess": excess, "seed": seed}
    card = _provenance(options, config, start, data)
    card |= {"steps_taken": int(state.step), "held_out_error_of_total_time": error.overall}
    save_policy(out, network, state.averaged, card)
    if flights:
        card["scores"] = score_policy(load_policy(out), data, flights)
        save_policy(out, network, state.averaged, card)
    print(f"{out}: held-out error of the total time {error.overall:.1%}, {out.stat().st_size / 1e6:.2f} MB")
    return 0


def _provenance(options: dict[str, object], config: "PretrainConfig", start: str | None, data: Path) -> dict[str, Any]:
    """Where a pretrained policy came from."""
    from jaxplan.training.dataset import digest, read_config

    return {
        "command": "jaxplan train pretrain " + " ".join(f"--{key} {value}" for key, value in options.items()),
        "config": dataclasses.asdict(config),
        "start": None if start is None else _origin(start),
        "data": {"sha256": digest(data / "dataset.json"), **dataclasses.asdict(read_config(data))},
    }


def _origin(start: str) -> dict[str, Any]:
    """Hash and card of the policy that training went on from."""
    from jaxplan.policy.checkpoint import policy_card, resolve_policy
    from jaxplan.training.dataset import digest

    return {"sha256": digest(resolve_policy(start)[0]), **policy_card(start)}
