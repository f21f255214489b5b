"""``jaxplan train``: options are the fields of configurations; a mixture that can be loaded and remade; bad input."""

import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from jaxplan import cli
from jaxplan.cli import train_mfrl, train_policy
from jaxplan.cli.parameters import command_line, option_values
from jaxplan.errors import InputError
from jaxplan.policy.network import NetworkConfig
from jaxplan.prediction.gmm import FitConfig
from jaxplan.prediction.target_model import load_model
from jaxplan.training.dataset import DatasetConfig
from jaxplan.training.imitation import ImitationConfig
from jaxplan.training.labels import LabelConfig
from jaxplan.training.mfrl import MfrlConfig
from jaxplan.training.pretrain import PretrainConfig
from jaxplan.training.reinforce import ReinforceConfig

SMALL = ["--windows", "200", "--components", "1", "2", "--seed", "3"]


def train(*arguments: str) -> int:
    return cli.run(["train", "gmm", *arguments])


@pytest.mark.parametrize(
    ("arguments", "interval", "anchored"),
    [
        (["--dt", "0.2"], 0.2, False),
        (["--world", "env1"], 0.1, True),
        (["--world", "env1", "--flights", "chains"], 0.1, True),
    ],
    ids=["open space", "tours", "chains"],
)
def test_a_mixture_with_its_card(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], interval: float, anchored: bool
) -> None:
    path = tmp_path / "mine.npy"
    assert train(*arguments, *SMALL, "--out", str(path)) == 0
    model = load_model(path)
    assert (model.observations, model.steps, model.dt) == (10, 20, interval)
    assert (model.bounds is not None) == anchored
    card = json.loads(path.with_suffix(".json").read_text())
    assert set(card["held_out_log_likelihood"]) == {"1", "2"}
    assert card["held_out_scores"]["gmm"]["fde_m"] < card["held_out_scores"]["constant-velocity"]["fde_m"]
    assert "2 components: mean log-likelihood" in capsys.readouterr().out


def test_the_command_of_a_card_makes_the_same_file_again(tmp_path: Path) -> None:
    path, again = tmp_path / "mine.npy", tmp_path / "again"
    assert train(*SMALL, "--out", str(path)) == 0
    card = json.loads(path.with_suffix(".json").read_text())
    again.mkdir()
    command = card["command"].split()[1:]
    command[command.index("mine.npy")] = str(again / "mine.npy")
    assert cli.run(command) == 0
    assert json.loads((again / "mine.json").read_text()) == card


WRONG = [
    (["--out", "absent/mine.npy"], 10, "folder that exists"),
    (["--out", "mine.txt"], 10, ".npy"),
    (["--out", "mine.npy", "--windows", "0"], 10, "--windows 0"),
    (["--out", "mine.npy", "--windows", "10", "--components", "32"], 10, "10 windows"),
    (["--out", "mine.npy", "--components", "0"], 10, "components"),
    (["--out", "mine.npy", "--dt", "-1"], 10, "dt"),
    (["--out", "mine.npy", "--floor", "0"], 10, "floor"),
    (["--out", "mine.npy", "--flights", "tours"], 10, "--flights"),
    (["--out", "mine.npy", "--world", "env1", "--flights", "walks"], 10, "--flights"),
    (["--out", "mine.npy", "--world", "env9"], 10, "env9"),
    (["--out", "mine.npy", "--world", "absent.stl"], 11, "absent.stl"),
    (["--windows", "10"], 2, "--out"),
]


@pytest.mark.parametrize(("arguments", "code", "said"), WRONG, ids=lambda value: str(value))
def test_one_line_and_no_file_for_what_cannot_be_trained(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert train(*arguments) == code
    printed = capsys.readouterr()
    assert said in printed.err
    assert printed.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


PARTS = {
    "dataset": (DatasetConfig, (), ()),
    "pretrain": (PretrainConfig, ("network", "imitation"), ()),
    "mfrl": (MfrlConfig, ("reinforce",), ("classifier",)),
    "gmm": (FitConfig, (), ()),
}
"""Of each command: its configuration, the parts whose fields stand beside its own, and those that are fixed."""


@pytest.mark.parametrize("command", PARTS)
def test_every_field_is_an_option_with_its_default_and_says_what_it_is(command: str) -> None:
    kind, beside, fixed = PARTS[command]
    options = {
        found.name: found for found in cli.app["train"][command].assemble_argument_collection(parse_docstring=True)
    }
    assert [name for name, found in options.items() if name != "*" and found.show and not found.parameter.help] == []
    for name, value in option_values(kind(), beside, fixed).items():
        if not dataclasses.is_dataclass(value):
            assert options["--" + name.replace("_", "-")].field_info.default == value, name


@pytest.fixture
def taken(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the commands hand to training, which is not begun."""
    found: dict[str, Any] = {}

    def begin(name: str) -> Callable[..., None]:
        def begun(*arguments: Any, **options: Any) -> None:
            found[name] = next(a for a in arguments if isinstance(a, DatasetConfig | PretrainConfig | MfrlConfig))
            raise InputError("begun")

        return begun

    monkeypatch.setattr(train_policy, "make_dataset", begin("dataset"))
    monkeypatch.setattr(train_policy, "train", begin("pretrain"))
    monkeypatch.setattr(train_mfrl, "reinforce", begin("mfrl"))
    monkeypatch.setattr(train_mfrl, "read_config", lambda folder: DatasetConfig())
    monkeypatch.setattr(train_mfrl, "dataset_vehicle", lambda folder: None)
    monkeypatch.setattr(train_mfrl, "load_examples", lambda folder, held_out: None)
    return found


def test_options_reach_the_configuration_that_they_are_named_after(tmp_path: Path, taken: dict[str, Any]) -> None:
    """Nested ones too; what is not given keeps the default, also where that is not its own type's."""
    folders = ["--data", str(tmp_path), "--run", str(tmp_path), "--out", str(tmp_path / "policy.npz")]
    lines = (
        ["dataset", "--out", str(tmp_path), "--shards", "3", "--labels.rounds", "4", "--labels.span", "0.5", "3"],
        ["pretrain", *folders, "--hidden", "8", "--excess", "0", "--learning-rate", "1e-3", "--seed", "2"],
        ["mfrl", *folders, "--classifier", str(tmp_path / "c.npz"), "--method", "ppo", "--bonus", "1", "--rounds", "9"],
    )
    for line in lines:
        assert cli.run(["train", *line]) == 10
    assert taken == {
        "dataset": DatasetConfig(shards=3, labels=LabelConfig(rounds=4, span=(0.5, 3.0))),
        "pretrain": PretrainConfig(
            network=NetworkConfig(hidden=8), imitation=ImitationConfig(excess=0.0), learning_rate=1e-3, seed=2
        ),
        "mfrl": MfrlConfig(reinforce=ReinforceConfig(method="ppo", bonus=1.0), rounds=9),
    }
    assert all(type(config) in (DatasetConfig, PretrainConfig, MfrlConfig) for config in taken.values())


def test_without_options_the_defaults_are_taken(tmp_path: Path, taken: dict[str, Any]) -> None:
    assert cli.run(["train", "dataset", "--out", str(tmp_path)]) == 10
    assert taken == {"dataset": DatasetConfig()}


def test_the_line_of_a_card_is_read_back_as_the_same_configuration(tmp_path: Path, taken: dict[str, Any]) -> None:
    config = PretrainConfig(network=NetworkConfig(latent=4), imitation=ImitationConfig(growth=1.5), steps=7)
    line = command_line("train pretrain", option_values(config, beside=("network", "imitation")))
    assert line.startswith("jaxplan train pretrain --hidden 64 --attention 32 --latent 4 --steps 7 ")
    folders = ["--data", str(tmp_path), "--run", str(tmp_path), "--out", str(tmp_path / "policy.npz")]
    cli.run([*line.split()[1:], *folders])
    assert taken["pretrain"] == config


def test_the_command_line_starts_without_what_training_imports() -> None:
    """Reading the options of training imports JAX and Flax; no other command waits for that."""
    code = "import sys; from jaxplan import cli; cli.run(['--help']); print('imported', 'flax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "train" in done.stdout
    assert done.stdout.strip().endswith("imported False")


NOWHERE = ["--data", "x", "--run", "y", "--out", "z.npz", "--classifier", "c.npz"]


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["dataset", "--out", "x", "--shards", "0"], 10, "shards is 0"),
        (["dataset", "--out", "x", "--shards", "1.5"], 2, "--shards"),
        (["pretrain", "--data", "x", "--run", "y", "--out", "z.npz", "--hidden", "0"], 10, "hidden is 0"),
        (["pretrain", "--data", "x", "--run", "y", "--out", "z.txt"], 10, "--out z.txt"),
        (
            ["mfrl", "--data", "x", "--run", "y", "--out", "z.npz", "--classifier", "c.npz", "--rounds", "0"],
            10,
            "rounds",
        ),
        (
            ["mfrl", "--data", "x", "--run", "y", "--out", "z.npz", "--classifier", "c.npz", "--nosuch", "0"],
            2,
            "nosuch",
        ),
    ],
    ids=str,
)
def test_training_refuses_in_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.run(["train", *arguments]) == code
    printed = capsys.readouterr()
    assert said in printed.err
    assert printed.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
