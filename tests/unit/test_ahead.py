"""What is compiled in a second process: who compiles what, and that nothing depends on it."""

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from jaxplan import ahead, programs
from jaxplan.native import entries
from tools.record_ahead import written

TOLD = "import sys; sys.stdin.readline(); print('a:b', flush=True); sys.stdin.read()"
"""Says that a function is compiled when it gets a line, and ends with its input."""
GONE = "raise SystemExit(3)"


@pytest.fixture
def helper(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[ahead._Helper]:
    claims = tmp_path / "claims"
    claims.mkdir()
    child = subprocess.Popen(
        [sys.executable, "-c", request.param], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    made = ahead._Helper(claims, child)
    yield made
    made.end(0.0)


def test_the_table_names_entry_points_and_their_types():
    for name, signatures in json.loads(ahead.TABLE.read_text()).items():
        module, _, factory = name.partition(":")
        entry = getattr(ahead.importlib.import_module(module), factory)()
        assert ahead.name_of(entry.py_func) == name
        assert entry in entries()
        for signature in signatures:
            assert [written(ahead._type(kind)) for kind in signature] == signature


@pytest.mark.parametrize("helper", [TOLD], indirect=True)
def test_what_the_other_process_has_begun_is_waited_for(helper):
    assert ahead._claimed(helper.claims, "a:b")  # the other one, so to speak
    waiting = threading.Thread(target=helper.wait_for, args=["a:b"])
    waiting.start()
    waiting.join(0.2)
    assert waiting.is_alive()
    helper.child.stdin.write("\n")
    helper.child.stdin.flush()
    waiting.join(60.0)
    assert not waiting.is_alive()


@pytest.mark.parametrize("helper", [TOLD], indirect=True)
def test_what_it_has_not_begun_is_compiled_here_and_not_there(helper):
    helper.wait_for("a:b")  # comes back at once
    assert not ahead._claimed(helper.claims, "a:b")


@pytest.mark.parametrize("helper", [GONE], indirect=True)
def test_nobody_waits_for_a_process_that_is_gone(helper):
    ahead._claimed(helper.claims, "a:b")
    helper.wait_for("a:b")
    helper.end(60.0)
    assert helper.child.returncode == 3
    assert not helper.claims.exists()
    helper.wait_for("a:b")


def test_it_ends_with_its_parent(tmp_path):
    child = subprocess.Popen(
        [sys.executable, "-m", "jaxplan.ahead", str(tmp_path / "nowhere"), str(tmp_path / "stamp")],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
    )
    child.stdin.close()
    assert child.wait(60.0) == 0
    assert not (tmp_path / "stamp").exists()


def test_what_is_there_is_written_down(tmp_path, monkeypatch, capsys):
    table = json.loads(ahead.TABLE.read_text())
    name = "jaxplan.tracking.kernels.sampling:_compiled_sample"
    monkeypatch.setattr(ahead, "TABLE", tmp_path / "table.json")
    ahead.TABLE.write_text(json.dumps({name: table[name]}))
    stamp = tmp_path / "stamp"
    assert not ahead._is_compiled(stamp)
    ahead._compile_all(tmp_path, stamp)
    assert capsys.readouterr().out == f"{name}\n"
    assert ahead._is_compiled(stamp)
    stamp.write_text(json.dumps([*json.loads(stamp.read_text()), str(tmp_path / "gone.nbi")]))
    assert not ahead._is_compiled(stamp)
    stamp.write_text("{")
    assert not ahead._is_compiled(stamp)


@pytest.mark.parametrize("why", ["nothing is kept", "one core", "all is there", "no process can be started"])
def test_it_is_not_started_where_it_does_not_help(why, tmp_path, monkeypatch):
    def start(*args, **kwargs):
        raise OSError if why == "no process can be started" else AssertionError

    monkeypatch.setattr(ahead, "_helpers", [])
    monkeypatch.setattr(ahead.subprocess, "Popen", start)
    monkeypatch.setattr(ahead, "_cores", lambda: 1 if why == "one core" else 2)
    monkeypatch.setattr(programs, "folder_in_use", lambda: None if why == "nothing is kept" else tmp_path)
    if why == "all is there":
        ahead._stamp(tmp_path).write_text("[]")
    ahead.begin()
    assert ahead._helpers == []
    ahead.wait_for("a:b")


@pytest.mark.slow
def test_the_table_is_what_a_warm_up_calls(repository):
    subprocess.run([sys.executable, "-m", "tools.record_ahead", "--check"], cwd=repository, check=True)
