"""Programs on disk: used where a user wants them, never from elsewhere, never damaged, never in the way."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from jax._src.compilation_cache import compress_executable

from jaxplan import cli, programs
from jaxplan.errors import InputError, ResourceError

CHILD = """
import json, sys
from jaxplan import programs
said = programs.use()
import jax, jax.numpy as jnp
hits = []
jax.monitoring.register_event_listener(lambda event, **kwargs: hits.append(event))
with jax.enable_x64(True):
    value = float(jax.jit(lambda x: jnp.sum(jnp.sin(x) @ jnp.cos(x)))(jnp.arange(2500.0).reshape(50, 50))).hex()
print(json.dumps([said, value, sum("cache_hits" in event for event in hits)]))
"""


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("JAXPLAN_CACHE_DIR", str(tmp_path))
    return tmp_path / "programs"


def started(root: Path) -> tuple[str | None, str, int, str]:
    """What a new process was told, what it has computed, how much it loaded, and what it wrote on stderr."""
    ours = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "TF_CPP"))}
    child = subprocess.run([sys.executable, "-c", CHILD], env=ours, capture_output=True, text=True, check=True)
    return *json.loads(child.stdout), child.stderr


def test_programs_are_loaded_by_the_next_process(root: Path) -> None:
    programs.switch(False)
    assert started(root)[2] == 0
    assert [path.name for path in root.iterdir()] == ["off"]
    programs.switch(True)
    said, value, hits, _ = started(root)
    assert (said, hits) == (None, 0)
    said, again, hits, errors = started(root)
    assert (said, again, errors) == (None, value, "")
    assert hits > 0
    entries = sorted((root / programs.folder_name()).glob("*-cache"))
    assert len(entries) == programs.status().programs > 0
    programs.switch(False)
    assert started(root)[2] == 0


def test_what_is_damaged_is_compiled_anew(root: Path) -> None:
    programs.switch(True)
    _, value, _, _ = started(root)
    folder = root / programs.folder_name()
    largest = max(folder.glob("*-cache"), key=lambda path: path.stat().st_size)
    content = largest.read_bytes()
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 1
    largest.write_bytes(flipped)
    said, again, _, errors = started(root)
    assert said == f"cache: 1 damaged entries removed from {folder}"
    assert (again, errors) == (value, "")
    assert largest.is_file()
    assert started(root)[:2] == (None, value)


def test_whatever_is_wrong_with_an_entry_is_seen(tmp_path: Path) -> None:
    entry, content = tmp_path / "a-cache", compress_executable(bytes(range(256)) * 40)
    for damage in (b"", content[:100], content[:-1], content + b"0", bytes(len(content))):
        entry.write_bytes(content)
        programs.seal(tmp_path)
        assert programs._remove_unsound(tmp_path) == 0
        entry.write_bytes(damage)
        assert programs._remove_unsound(tmp_path) == 1
        assert list(tmp_path.iterdir()) == []
    entry.write_bytes(content[:-9])  # whoever wrote it was killed: it gets no sum
    programs.seal(tmp_path)
    assert programs._remove_unsound(tmp_path) == 0
    assert list(tmp_path.iterdir()) == []


BESIDE = """
import os, subprocess
if sys.argv[1] == "vouch":
    programs.vouch()
ours = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "TF_CPP"))}
print(subprocess.run([sys.executable, "-c", sys.argv[2]], env=ours, capture_output=True, text=True).stdout)
"""


@pytest.mark.parametrize("vouched", [True, False])
def test_what_was_compiled_is_vouched_for_before_the_process_ends(root: Path, vouched: bool) -> None:
    """Another process that starts meanwhile loads it, or compiles it anew, and complains of nothing."""
    ours = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "TF_CPP"))}
    command = [sys.executable, "-c", CHILD + BESIDE, "vouch" if vouched else "not yet", CHILD]
    lines = subprocess.run(command, env=ours, capture_output=True, text=True, check=True).stdout.splitlines()
    (said, value, hits), (told, again, loaded) = map(json.loads, lines[:2])
    assert (said, hits, told) == (None, 0, None)
    assert value == again
    assert (loaded > 0) == vouched


def test_entries_of_other_machines_and_versions_are_not_looked_at(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = programs.folder_name()
    monkeypatch.setattr(programs, "_processor", lambda: "another one")
    assert programs.folder_name() != own
    monkeypatch.undo()
    monkeypatch.setenv("JAXPLAN_CACHE_DIR", str(root.parent))
    versions = programs.installed_versions()
    for name in ("jaxplan", "jax", "jaxlib"):
        monkeypatch.setattr(programs, "installed_versions", lambda name=name: {**versions, name: "0"})
        assert programs.folder_name() != own
    monkeypatch.setattr(programs, "installed_versions", lambda: versions)
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=true")
    assert programs.folder_name() != own


def test_an_own_cache_of_jax_is_left_alone(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    programs.switch(True)
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "elsewhere")
    assert programs.use() is None
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == "elsewhere"
    assert not (root / programs.folder_name()).exists()


def test_a_folder_that_cannot_be_used_is_one_line(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    programs.switch(True)
    root.mkdir()
    (root / programs.folder_name()).write_text("in the way")
    said = programs.use()
    assert said is not None
    assert said.startswith("cache: ")
    assert "\n" not in said
    assert "JAX_COMPILATION_CACHE_DIR" not in os.environ


def test_the_oldest_entries_are_forgotten(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = root / "x"
    folder.mkdir(parents=True)
    for age, name in enumerate(("new", "old", "oldest")):
        entry = folder / f"{name}-cache"
        entry.write_bytes(bytes(100))
        (folder / f"{name}-cache.sha256").write_text("")
        os.utime(entry, (1e9 - age, 1e9 - age))
    monkeypatch.setattr(programs, "KEPT", 250)
    programs.seal(folder)
    assert sorted(path.name for path in folder.iterdir() if path.suffix != ".sha256") == ["new-cache", "old-cache"]
    assert not (folder / "oldest-cache.sha256").exists()


def test_the_command(root: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def said(*arguments: str) -> str:
        assert cli.run(["cache", *arguments]) == 0
        return capsys.readouterr().out

    assert said().startswith("on: 0 programs, 0.0 MB, in ")
    assert said("off").startswith("off: 0 programs")
    assert said("on").startswith("on: 0 programs")
    folder = root / programs.folder_name()
    folder.mkdir(parents=True)
    (folder / "a-cache").write_bytes(bytes(2_000_000))
    (root / "elsewhere").mkdir()
    assert said("status").splitlines() == [
        f"on: 1 programs, 2.0 MB, in {folder}",
        "1 folders of other machines or versions, which are not used: jaxplan cache clear",
    ]
    assert said("clear") == f"on: 0 programs, 0.0 MB, in {folder}\n"
    assert list(root.iterdir()) == []
    assert said("off").startswith("off: ")
    monkeypatch.setenv("JAXPLAN_CACHE_DIR", "")
    assert cli.run(["cache", "on"]) == InputError.exit_code
    assert "JAXPLAN_CACHE_DIR is empty" in capsys.readouterr().err
    monkeypatch.setenv("JAXPLAN_CACHE_DIR", "/proc/jaxplan")
    assert cli.run(["cache", "off"]) == ResourceError.exit_code
    assert capsys.readouterr().err.count("\n") == 1
