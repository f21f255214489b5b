"""Bad input to the real command: one line, the promised exit code, and nothing left behind."""

import os
from pathlib import Path

import pytest

import jaxplan
from jaxplan import cli

FLIGHT = "t,x,y,z\n0,-4,4,1\n5,0,4.3,1\n10,4,4,1\n"

ENV1 = str(Path(jaxplan.__file__).parent / "prediction" / "models" / "env1.npy")

MFRL = str(Path(jaxplan.__file__).parent / "policy" / "weights" / "mfrl.npz")

LONG = "a" * 300
CASES = {
    "unknown world": (["--world", "env9"], 10, "env9"),
    "unknown target": (["--target", "nobody"], 10, "nobody"),
    "start outside": (["--start", "50", "0", "1"], 10, "start"),
    "start in a pillar": (["--start", "1", "-0.05", "1"], 10, "start"),
    "missing world": (["--world", "absent.stl"], 11, "absent.stl"),
    "missing target model": (["--predictor", "gmm", "--target-model", "absent.npy"], 11, "absent.npy"),
    "text as target model": (["--predictor", "gmm", "--target-model", "text.npy"], 11, "text.json"),
    "target model of another room": (["--world", "env2", "--predictor", "gmm", "--target-model", ENV1], 10, "dt"),
    "missing policy": (["--policy", "absent.npz"], 11, "absent.npz"),
    "text as policy": (["--policy", "text.npy"], 11, "text.npy"),
    "policy as classifier": (["--policy", MFRL, "--classifier", MFRL], 11, "holds a policy, want a classifier"),
    "policy of another vehicle": (["--policy", MFRL, "--vehicle", "racer5"], 10, "was made for vehicle 'mfrl'"),
    "missing target": (["--target", "absent.csv"], 11, "absent.csv"),
    "target with nan": (["--target", "nan.csv"], 11, "line 3"),
    "target without z": (["--target", "short.csv"], 11, "z"),
    "target backwards": (["--target", "backwards.csv"], 11, "line 2"),
    "target outside": (["--target", "outside.csv"], 10, "outside"),
    "target in north, east, down": (["--target", "ned.csv"], 10, "--frame ned"),
    "target in millimetres": (["--target", "mm.csv"], 10, "x [mm]"),
    "frame of a stored target": (["--frame", "ned"], 10, "give --target a file"),
    "three columns": (["--target", "good.csv", "--columns", "t", "x", "y", ""], 10, "--columns"),
    "target in a pillar": (["--target", "pillar.csv"], 10, "inside an obstacle"),
    "text as mesh": (["--world", "text.stl"], 11, "text.stl"),
    "empty mesh": (["--world", "empty.stl", "--target", "good.csv"], 11, "empty.stl"),
    "text as boxes": (["--world", "text.json"], 11, "text.json"),
    "text as mjcf": (["--world", "text.xml"], 11, "text.xml"),
    "unknown ending": (["--world", "good.csv"], 11, "good.csv"),
    "world of a name that is too long": (["--world", LONG], 10, LONG[:9]),
    "map of a name that is too long": (["--world", f"{LONG}.stl"], 11, "no such file"),
    "target of a name that is too long": (["--target", f"{LONG}.csv"], 11, "does not exist"),
    "model of a name that is too long": (["--predictor", "gmm", "--target-model", f"{LONG}.npy"], 11, "no such file"),
    "a folder as target": (["--target", "."], 11, "."),
}
ELSEWHERE = {
    "a module that begins with a dot": (["experiment", ".x"], 10, "is no module"),
    "results of too long a name": (
        ["experiment", "table1", "--preset", "smoke", "--out", LONG],
        12,
        "too long",
    ),
}


@pytest.fixture
def inputs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Files to trip over, in the current folder."""
    contents = {
        "good.csv": FLIGHT,
        "nan.csv": FLIGHT.replace("0,4.3", "nan,4.3"),
        "short.csv": "t,x,y\n0,0,0\n1,1,1\n",
        "backwards.csv": "0,0,0,1\n-1,0,0,1\n",
        "outside.csv": FLIGHT.replace("10,4,4,1", "10,40,4,1"),
        "ned.csv": "t,x,y,z\n0,4,-4,-1\n5,4.3,0,-1\n10,4,4,-1\n",
        "mm.csv": "t,x,y,z\n0,-4000,4000,1000\n5,0,4300,1000\n10,4000,4000,1000\n",
        "pillar.csv": "t,x,y,z\n0,1,-0.05,1\n0.5,1,-0.04,1\n",
        "text.stl": "this is no mesh",
        "empty.stl": "solid nothing\nendsolid nothing\n",
        "text.json": "this is no json",
        "text.npy": "this is no array",
        "text.xml": "this is no xml",
    }
    for name, content in contents.items():
        (tmp_path / name).write_text(content)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", CASES)
def test_one_line_one_code_nothing_left(inputs: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    arguments, code, text = CASES[name]
    refuse(["intercept", *arguments, "--out", "new/folder"], code, text, inputs, capsys)


@pytest.mark.parametrize("name", ELSEWHERE)
def test_other_commands_too(inputs: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    refuse(*ELSEWHERE[name], inputs, capsys)


def refuse(arguments: list[str], code: int, text: str, inputs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(os.listdir(inputs))
    assert cli.run(arguments) == code
    printed = capsys.readouterr()
    assert text in printed.err
    assert printed.err.startswith("jaxplan: ")
    assert printed.err.count("\n") == 1
    assert "internal" not in printed.err
    assert printed.out == ""
    assert sorted(os.listdir(inputs)) == before
