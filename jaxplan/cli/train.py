"""``jaxplan train``: remake what was learned from data. Each command writes an artefact and a card beside it.

The commands are read when one of them is asked for: their options are the fields of configurations that stand beside
the code that they configure, which takes seconds to import.
"""

from cyclopts import App

from jaxplan.cli.parameters import SEVERAL

train = App(name="train", help="Learn from simulated data what planning needs.", default_parameter=SEVERAL)
for module, command in (
    ("train_policy", "dataset"),
    ("train_policy", "pretrain"),
    ("train_mfrl", "mfrl"),
    ("train_gmm", "gmm"),
):
    train.command(f"jaxplan.cli.{module}:{command}", name=command)
