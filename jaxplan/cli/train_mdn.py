"""``jaxplan train mdn``: train the network for ``--predictor mdn``."""

import dataclasses
import os
from pathlib import Path
from typing import Any

from jaxplan.cli.parameters import command_line, option_values, with_options
from jaxplan.errors import InputError
from jaxplan.io.target_log import read_target_log, resample
from jaxplan.prediction.mdn.checkpoint import save_network
from jaxplan.prediction.protocol import SPACING
from jaxplan.training.flights.examples import examples_digest
from jaxplan.training.flights.run import MdnConfig, train_mdn
from jaxplan.versions import require_supported_jax

_BESIDE = ("network", "examples")
"""Parts of the configuration whose fields are options like its own."""


@with_options(MdnConfig, beside=_BESIDE)
def mdn(
    *,
    run: Path,
    out: Path,
    recordings: tuple[Path, ...] = (),
    workers: int = 2,
    config: MdnConfig,
    debug: bool = False,
) -> int:
    """Train the network that foretells flights; a run that was cut off goes on.

    Parameters
    ----------
    run
        Folder of the run: its flights, its state, metrics.jsonl and the best weights so far.
    out
        File of the weights (.npz), with their scores.
    recordings
        Recorded flights to learn from too (.csv, ...), without their maps; a tenth of all. Default: none.
    workers
        Processes that draw flights; 0: only this one.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    if out.suffix != ".npz" or not os.path.isdir(out.parent) or workers < 0:
        have = f"--out {out} and --workers {workers}"
        raise InputError(f"train mdn: have {have}, want a .npz file in a folder that exists and 0 or more; correct it")
    flights = [resample(read_target_log(path), SPACING).positions for path in recordings]
    trained, score = train_mdn(run, config, workers=workers, recordings=flights)
    options: dict[str, Any] = {"recordings": tuple(path.name for path in recordings)} if recordings else {}
    card = {
        "command": command_line("train mdn", options, option_values(config, beside=_BESIDE)),
        "config": dataclasses.asdict(config),
        "data_sha256": examples_digest(run / "examples"),
        "held_out": score._asdict(),
    }
    save_network(out, trained, card)
    print(f"{out}: held-out nll {score.nll:.3f}, {out.stat().st_size / 1e6:.2f} MB")
    return 0
