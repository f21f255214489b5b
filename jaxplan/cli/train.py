"""``jaxplan train``: remake what was learned from data. Each command writes an artefact and a card beside it.

The commands are read when one of them is asked for: their options are the fields of configurations that stand beside
the code that they configure, which takes seconds to import. What each is for stands here too, for ``--help``.
"""

from collections.abc import Sequence

from cyclopts import App

from jaxplan.cli.parameters import SEVERAL
from jaxplan.names import meant

COMMANDS = {
    "dataset": ("train_policy", "Make a training set of labelled waypoint sequences; a run that was cut off goes on."),
    "pretrain": ("train_policy", "Train a policy to imitate the optimiser; a run that was cut off goes on."),
    "mfrl": ("train_mfrl", "Reinforce a policy for speed at the same safety; a run that was cut off goes on."),
    "courses": ("train_placing", "Find ways through random rooms, for train placing; a run that was cut off goes on."),
    "placing": ("train_placing", "Train the policy that places waypoints and times; a run that was cut off goes on."),
    "gmm": ("train_gmm", "Fit a Gaussian mixture to windows of random minimum-snap flights, for --predictor gmm."),
    "mdn": ("train_mdn", "Train the network for --predictor mdn; a run that was cut off goes on."),
}

train = App(name="train", help="Learn from simulated data what planning needs.", default_parameter=SEVERAL)
for command, (module, said) in COMMANDS.items():
    train.command(f"jaxplan.cli.{module}:{command}", name=command, help=said)


def unknown_trainer(arguments: Sequence[str]) -> str | None:
    """What is wrong where it is none of the commands; the parser would import all of them before it says so."""
    if not arguments or arguments[0].startswith("-") or arguments[0] in COMMANDS:
        return None
    return f"train: have {arguments[0]!r}, want one of {', '.join(COMMANDS)}{meant(arguments[0], COMMANDS)}"
