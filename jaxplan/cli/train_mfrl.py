"""``jaxplan train mfrl``: reinforce a pretrained policy with the feasibility classifier as its judge."""

import dataclasses
from pathlib import Path
from typing import Literal

from jaxplan.versions import require_supported_jax


def mfrl(
    *,
    data: Path,
    run: Path,
    out: Path,
    classifier: Path,
    start: str = "pretrained",
    method: Literal["gradient", "ppo"] = "gradient",
    bonus: float = 1.0,
    anchor: float = 0.01,
    rounds: int = 40,
    steps: int = 100,
    first_labels: int = 12_000,
    learning_rate: float = 1e-4,
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
        Of the policy.
    flights
        Held-out sequences that are flown for the scores.
    seed
        Seed of sequences, noise and batches.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    from jaxplan.errors import InputError
    from jaxplan.feasibility.checkpoint import load_classifier, save_classifier
    from jaxplan.policy.checkpoint import load_parameters, load_policy, save_policy
    from jaxplan.training.dataset import digest, read_config
    from jaxplan.training.evaluate import score_classifier, score_policy
    from jaxplan.training.examples import load_examples
    from jaxplan.training.mfrl import MfrlConfig, reinforce
    from jaxplan.training.reinforce import ReinforceConfig
    from jaxplan.vehicle.params import load_vehicle

    for path in (out, classifier):
        if path.suffix != ".npz" or not path.parent.is_dir():
            raise InputError(f"train mfrl: have {path}, want a .npz file in a folder that exists; correct it")
    made = read_config(data)
    network, parameters = load_parameters(start)
    config = MfrlConfig(
        reinforce=ReinforceConfig(method=method, bonus=bonus, anchor=anchor, learning_rate=learning_rate),
        rounds=rounds,
        steps=steps,
        first_labels=first_labels,
        seed=seed,
    )
    examples = load_examples(data, held_out=False)
    found = reinforce(run, examples, load_vehicle(made.vehicle), network, parameters, config, made.labels)
    options = {"start": start, "method": method, "bonus": bonus, "anchor": anchor, "rounds": rounds, "steps": steps}
    options |= {"first-labels": first_labels, "learning-rate": learning_rate, "seed": seed}
    card = {
        "command": "jaxplan train mfrl " + " ".join(f"--{key} {value}" for key, value in options.items()),
        "config": dataclasses.asdict(config),
        "data": {"sha256": digest(data / "dataset.json"), **dataclasses.asdict(made)},
        "rollouts": config.first_labels + (rounds - 1) * (config.chosen + config.random),
    }
    save_policy(out, network, found.learner.parameters, card)
    save_classifier(classifier, config.classifier.features, found.model, card)
    if flights:
        scores = score_policy(load_policy(out), data, flights)
        save_policy(out, network, found.learner.parameters, {**card, "scores": scores})
        scores = score_classifier(load_classifier(classifier), load_policy(out), data, flights)
        save_classifier(classifier, config.classifier.features, found.model, {**card, "scores": scores})
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB; {classifier}: {classifier.stat().st_size / 1e6:.2f} MB")
    return 0
