"""``jaxplan train gmm``: a mixture that can be loaded and remade, and one line for what cannot be trained."""

import json
from pathlib import Path

import pytest

from jaxplan import cli
from jaxplan.prediction.target_model import load_model

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
