"""``jaxplan train courses|placing``: how a placing policy is made."""

import dataclasses
import os
from pathlib import Path

from jaxplan.cli.parameters import command_line, option_values, with_options
from jaxplan.errors import InputError
from jaxplan.policy.placing_checkpoint import load_placing_parameters, save_placing
from jaxplan.training.dataset import digest
from jaxplan.training.placing.courses import CourseConfig, make_courses, read_course_config
from jaxplan.training.placing.run import PlacingConfig, train_placing
from jaxplan.versions import require_supported_jax

_BESIDE = ("network", "loss")
"""Parts of a training's configuration whose fields are options like its own."""


@with_options(CourseConfig)
def courses(*, out: Path, config: CourseConfig, debug: bool = False) -> int:
    """Find ways through random rooms, for train placing; a run that was cut off goes on.

    Parameters
    ----------
    out
        Folder of the shards.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    make_courses(out, config)
    return 0


@with_options(PlacingConfig, beside=_BESIDE)
def placing(
    *, data: Path, run: Path, out: Path, start: Path | None = None, config: PlacingConfig, debug: bool = False
) -> int:
    """Train the policy that places waypoints and times; a run that was cut off goes on.

    Parameters
    ----------
    data
        Folder of courses (jaxplan train courses).
    run
        Folder of the run: its state, metrics.jsonl and the best weights so far.
    out
        File of the policy (.npz), with its scores.
    start
        Placing policy (.npz) to go on from, to tune it for one --vehicle; its sizes are kept. Default: random
        weights.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    if out.suffix != ".npz" or not os.path.isdir(out.parent):
        raise InputError(f"train placing: have --out {out}, want a .npz file in a folder that exists; correct it")
    options, parameters = option_values(config, beside=_BESIDE), None
    if start is not None:
        network, parameters = load_placing_parameters(start)
        config = dataclasses.replace(config, network=network)
        options = {"start": str(start), **option_values(config, beside=_BESIDE, fixed=("network",))}
    weights, score = train_placing(run, data, config, start=parameters)
    card = {
        "command": command_line("train placing", options),
        "config": dataclasses.asdict(config),
        "data": dataclasses.asdict(read_course_config(data)) | {"sha256": digest(data / "config.json")},
        "held_out": score._asdict(),
    }
    save_placing(out, config.network, weights, card)
    meeting = ", ".join(f"{part:.2f}" for part in score.meeting)
    print(f"{out}: held-out meetings after {meeting} s, {out.stat().st_size / 1e6:.2f} MB")
    return 0
