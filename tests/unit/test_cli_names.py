"""The first minute: what is misspelt is answered at once, in one line that says what was meant, without JAX."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from jaxplan import cli, names
from jaxplan.errors import FileError, InputError
from jaxplan.world import load

TYPOS = {
    "world": (["intercept", "--world", "evn1"], 10, "'env1'"),
    "target": (["intercept", "--target", "env1-3"], 10, "'env1-03'"),
    "target of another world": (["intercept", "--world", "env2", "--target", "env2_04"], 10, "'env2-04'"),
    "vehicle": (["intercept", "--vehicle", "racr5"], 10, "'racer5'"),
    "predictor": (["intercept", "--predictor", "gm"], 2, "gmm"),
    "planner": (["intercept", "--planner", "mfl"], 2, "mfrl"),
    "policy": (["intercept", "--policy", "pretraind"], 11, "'pretrained'"),
    "option": (["intercept", "--sped", "3"], 2, "--speed"),
    "command": (["intercpt"], 2, "intercept"),
    "format": (["export", "out", "--format", "pol4d", "--out", "x.csv"], 2, "poly4d"),
    "benchmark": (["bench", "minsnp"], 2, "minsnap"),
    "experiment": (["experiment", "tabel1"], 10, "'table1'"),
    "preset": (["experiment", "table1", "--preset", "smal"], 10, "'small'"),
    "trainer": (["train", "pretrian"], 2, "'pretrain'"),
    "world's map": (["world", "env11"], 10, "'env1'"),
    "vehicle's report": (["vehicle", "mfr"], 10, "'mfrl'"),
    "cache": (["cache", "claer"], 2, "clear"),
}
MISSING = {
    "map": (["intercept", "--world", "absent.stl"], 11, "absent.stl: no such file"),
    "vehicle file": (["vehicle", "absent.toml"], 11, "absent.toml (no such file)"),
}
HELP = [
    [],
    ["--help"],
    ["--version"],
    ["intercept", "--help"],
    ["export", "--help"],
    ["world", "--help"],
    ["vehicle", "--help"],
    ["bench", "--help"],
    ["cache", "--help"],
    ["train", "--help"],
    ["vehicle"],
]
CHILD = """
import contextlib, io, json, sys
from jaxplan import cli
answers = []
for arguments in json.load(sys.stdin):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = cli.run(arguments)
    answers.append((code, out.getvalue(), err.getvalue(), "jax" in sys.modules))
json.dump(answers, sys.stdout)
"""


def answers(cases: list[list[str]], folder: Path) -> list[tuple[int, str, str, bool]]:
    """Code, both outputs and whether JAX was imported by then, for each command line, in one process of its own."""
    child = subprocess.run(
        [sys.executable, "-c", CHILD], input=json.dumps(cases), cwd=folder, capture_output=True, text=True, check=True
    )
    return [tuple(answer) for answer in json.loads(child.stdout)]


def test_a_typo_is_answered_before_jax_is_imported(tmp_path: Path) -> None:
    cases = TYPOS | MISSING
    found = answers([arguments for arguments, _, _ in cases.values()], tmp_path)
    for (name, (_, code, said)), (have, out, err, imported) in zip(cases.items(), found, strict=True):
        assert (have, out) == (code, ""), name
        assert said in err, name
        assert ("did you mean" in err.lower()) == (name in TYPOS), name
        assert err.startswith("jaxplan: "), name
        assert err.count("\n") == 1, name
        assert not imported, name
    assert list(tmp_path.iterdir()) == []


def test_help_is_printed_without_jax(tmp_path: Path) -> None:
    found = answers(HELP, tmp_path)
    for arguments, (code, out, err, imported) in zip(HELP, found, strict=True):
        assert (code, err) == (0, ""), arguments
        assert out, arguments
        assert not imported, arguments


def test_without_arguments_it_says_what_to_do_first(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("First:") and "jaxplan intercept" in line for line in lines)
    assert len(lines) <= 12


def test_what_it_says_to_do_can_be_done() -> None:
    commands = {line.split()[0] for line in cli.WELCOME.split("jaxplan ")[1:]}
    assert commands <= {*cli.app, "COMMAND", "--help,"}
    assert "env1-03" in names.stored_targets("env1")


def test_the_package_is_a_command_too(tmp_path: Path) -> None:
    child = subprocess.run(
        [sys.executable, "-m", "jaxplan", "intercpt"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert child.returncode == 2
    assert child.stderr.endswith("train, cache, experiment; did you mean 'intercept'?\n")  # all of them, by name


def test_what_no_error_was_raised_for_has_no_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["--nonsense", "--debug"], ["train", "pretrian", "--debug"]):
        assert cli.run(arguments) == 2
        error = capsys.readouterr().err
        assert error.startswith("jaxplan: ")
        assert error.count("\n") == 1


def test_every_ending_has_a_reader() -> None:
    assert tuple(load._READERS) == names.MAP_ENDINGS


@pytest.mark.parametrize("known", [names.ENVIRONMENTS, names.list_presets(), names.stored_targets("env3")])
def test_names_that_there_are_pass(known: list[str]) -> None:
    require = {"env1": names.require_world, "cf21": names.require_vehicle}.get(
        known[0], lambda name: names.require_target(name, "env3")
    )
    for name in known:
        require(name)
    with pytest.raises(InputError, match="did you mean"):
        require(known[0] + "x")


def test_nothing_is_guessed_from_far_away() -> None:
    assert names.meant("office.world", names.ENVIRONMENTS) == ""
    with pytest.raises(InputError, match="check the name"):
        names.require_world("warehouse")


def test_weights_are_found_by_name_and_by_file(tmp_path: Path) -> None:
    names.require_weights("mfrl", "classifier")
    (tmp_path / "own.npz").write_bytes(b"")
    names.require_weights(tmp_path / "own.npz", "policy")
    with pytest.raises(FileError, match="did you mean 'mfrl'"):
        names.require_weights("mfr", "classifier")


@pytest.mark.parametrize("name", ["bash", "zsh", "fish"])
def test_shells_can_complete(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SHELL", f"/bin/{name}")
    script = cli.app.generate_completion()
    assert "intercept" in script
    assert "constant-velocity" in script
