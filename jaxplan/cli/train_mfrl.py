"""``jaxplan train mfrl``: reinforce a pretrained policy with the feasibility classifier as its judge."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from jaxplan.versions import require_supported_jax

if TYPE_CHECKING:
    from jaxplan.training.mfrl import MfrlConfig


def mfrl(
    *,
    data: Path,
    run: Path,
    out: Path,
    classifier: Path,
    start: str = "pretrained",
    method: Literal["gradient", "ppo"] = "gradient",
    bonus: float = 0.6,
    anchor: float = 0.001,
    rounds: int = 50,
    steps: int = 120,
    first_labels: int = 10_000,
    learning_rate: float = 3e-4,
    flights: int = 2_000,
    seed: int = 0,
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
    method
        ppo: proximal policy optimisation; gradient: along the reward's own gradient.
    bonus
        Reward of a feasible flight that is no faster than the minimum-snap label; 0 is the paper's.
    anchor
        Weight of the divergence from the pretrained policy.
    rounds
        Rounds of labelling, training of the classifier, and reinforcement.
    steps
        Gradient steps of the policy in each round.
    first_labels
        Rollouts of the first round.
    learning_rate
        Of the policy, at first; half of it after 2,000 steps, a third after 4,000.
    flights
        Held-out sequences that are flown for the scores.
    seed
        Seed of sequences, noise and batches.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    from jaxplan.errors import InputError
    from jaxplan.training.mfrl import MfrlConfig
    from jaxplan.training.reinforce import ReinforceConfig

    for path in (out, classifier):
        if path.suffix != ".npz" or not path.parent.is_dir():
            raise InputError(f"train mfrl: have {path}, want a .npz file in a folder that exists; correct it")
    chosen = ReinforceConfig(method=method, bonus=bonus, anchor=anchor, learning_rate=learning_rate)
    config = MfrlConfig(reinforce=chosen, rounds=rounds, steps=steps, first_labels=first_labels, seed=seed)
    options = {"start": start, "method": method, "bonus": bonus, "anchor": anchor, "rounds": rounds, "steps": steps}
    options |= {"first-labels": first_labels, "learning-rate": learning_rate, "seed": seed}
    command = "jaxplan train mfrl " + " ".join(f"--{key} {value}" for key, value in options.items())
    _make(data, run, out, classifier, start, config, command, flights)
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB; {classifier}: {classifier.stat().st_size / 1e6:.2f} MB")
    return 0


def _make(
    data: Path, run: Path, out: Path, judge: Path, start: str, config: "MfrlConfig", command: str, flights: int
) -> None:
    """Reinforce, save both artefacts, then score both and save them with their scores."""
    from jaxplan.feasibility.checkpoint import load_classifier, save_classifier
    from jaxplan.policy.checkpoint import load_parameters, load_policy, save_policy
    from jaxplan.training.dataset import digest, read_config
    from jaxplan.training.evaluate import score_classifier, score_policy
    from jaxplan.training.examples import load_examples
    from jaxplan.training.mfrl import reinforce
    from jaxplan.vehicle.load import load_vehicle

    made = read_config(data)
    network, parameters = load_parameters(start)
    examples = load_examples(data, held_out=False)
    found = reinforce(run, examples, load_vehicle(made.vehicle), network, parameters, config, made.labels)
    card = {
        "command": command,
        "config": dataclasses.asdict(config),
        "data": {"sha256": digest(data / "dataset.json"), **dataclasses.asdict(made)},
        "rollouts": config.first_labels + (config.rounds - 1) * (config.chosen + config.random) + config.calibration,
    }
    save_policy(out, network, found.learner.parameters, card)
    save_classifier(judge, found.model, card)
    if flights:
        scores = score_policy(load_policy(out), data, flights)
        save_policy(out, network, found.learner.parameters, {**card, "scores": scores})
        scores = score_classifier(load_classifier(judge), load_policy(out), data, flights)
        save_classifier(judge, found.model, {**card, "scores": scores})
