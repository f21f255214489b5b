"""``jaxplan train mfrl``: reinforce a pretrained policy under the feasibility classifier."""

import dataclasses
import os
from pathlib import Path
from typing import Any

from jaxplan.cli.parameters import command_line, option_values, with_options
from jaxplan.errors import InputError
from jaxplan.feasibility.checkpoint import load_classifier, save_classifier
from jaxplan.policy.checkpoint import load_parameters, load_policy, save_policy
from jaxplan.policy.network import NetworkConfig
from jaxplan.training.dataset import dataset_vehicle, digest, read_config
from jaxplan.training.evaluate import score_classifier, score_policy
from jaxplan.training.examples import load_examples
from jaxplan.training.mfrl import MfrlConfig, Run, reinforce
from jaxplan.versions import require_supported_jax

_BESIDE, _FIXED = ("reinforce",), ("classifier",)
"""Parts of a run's configuration whose fields are options like its own, and those that cannot be chosen."""


@with_options(MfrlConfig, beside=_BESIDE, fixed=_FIXED)
def mfrl(
    *,
    data: Path,
    run: Path,
    out: Path,
    classifier: Path,
    start: str = "pretrained",
    flights: int = 2_000,
    config: MfrlConfig,
    debug: bool = False,
) -> int:
    """Reinforce a policy for speed at the same safety; a run that was cut off goes on.

    Parameters
    ----------
    data
        Folder of a training set (jaxplan train dataset).
    run
        Folder of the run: its state, labels and metrics.jsonl.
    out
        File of the policy (.npz), with its scores.
    classifier
        File of the feasibility classifier (.npz), with its scores.
    start
        The pretrained policy, by name or file.
    flights
        Held-out sequences that are flown for the scores.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    for path in (out, classifier):
        if path.suffix != ".npz" or not os.path.isdir(path.parent):
            raise InputError(f"train mfrl: have {path}, want a .npz file in a folder that exists; correct it")
    made, pretrained = read_config(data), load_parameters(start)
    examples = load_examples(data, held_out=False)
    found = reinforce(run, examples, dataset_vehicle(data), pretrained, config, made.labels)
    card = {
        "command": command_line("train mfrl", {"start": start}, option_values(config, _BESIDE, _FIXED)),
        "config": dataclasses.asdict(config),
        "data": {"sha256": digest(data / "dataset.json"), **dataclasses.asdict(made)},
        "rollouts": config.first_labels + (config.rounds - 1) * (config.chosen + config.random) + config.calibration,
    }
    _save(found, pretrained.network, out, classifier, card, data, flights)
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB; {classifier}: {classifier.stat().st_size / 1e6:.2f} MB")
    return 0


def _save(
    found: Run, network: NetworkConfig, out: Path, classifier: Path, card: dict[str, Any], data: Path, flights: int
) -> None:
    """Save both artefacts for the dataset's vehicle, then score both and save them with their scores."""
    vehicle = dataset_vehicle(data)
    save_policy(out, network, found.learner.parameters, card, vehicle=vehicle)
    save_classifier(classifier, found.model, card, vehicle=vehicle)
    if flights:
        scores = score_policy(load_policy(out), data, flights)
        save_policy(out, network, found.learner.parameters, {**card, "scores": scores}, vehicle=vehicle)
        scores = score_classifier(load_classifier(classifier), load_policy(out), data, flights)
        save_classifier(classifier, found.model, {**card, "scores": scores}, vehicle=vehicle)
