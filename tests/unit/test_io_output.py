"""Output appears whole or not at all."""

import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from jaxplan.errors import ResourceError
from jaxplan.io.output import OutputFolder


def text(content: str):
    return lambda path: path.write_text(content)


def test_files_appear_only_when_published(tmp_path: Path) -> None:
    target = tmp_path / "a" / "b with space"
    with OutputFolder(target) as folder:
        folder.write("one.txt", text("1"))
        folder.write("two.txt", text("2"))
        assert not (target / "one.txt").exists()
        folder.publish()
    assert {path.name: path.read_text() for path in target.iterdir()} == {"one.txt": "1", "two.txt": "2"}


def test_a_failure_leaves_nothing_and_keeps_the_old(tmp_path: Path) -> None:
    with OutputFolder(tmp_path / "old") as folder:
        folder.write("one.txt", text("old"))
        folder.publish()
    for name in ("old", "new/deeper"):
        with pytest.raises(RuntimeError), OutputFolder(tmp_path / name) as folder:
            folder.write("one.txt", text("new"))
            raise RuntimeError("the run failed")
    assert [path.name for path in tmp_path.iterdir()] == ["old"]
    assert [path.name for path in (tmp_path / "old").iterdir()] == ["one.txt"]
    assert (tmp_path / "old" / "one.txt").read_text() == "old"


def test_leaving_without_publishing_drops_everything(tmp_path: Path) -> None:
    with OutputFolder(tmp_path / "out") as folder:
        folder.write("one.txt", text("1"))
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_refused_up_front(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    for place in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/jaxplan"), Path("/dev/null")):
        with pytest.raises(ResourceError, match="cannot write") as caught:
            OutputFolder(place)
        assert "\n" not in str(caught.value)
        assert caught.value.exit_code == 12
    assert (tmp_path / "file").read_text() == "in the way"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(ResourceError, match="Permission denied"):
        OutputFolder(tmp_path)


def test_a_disk_that_fills_up_keeps_the_old_files(tmp_path: Path) -> None:
    with OutputFolder(tmp_path) as folder:
        folder.write("big.bin", text("old"))
        folder.publish()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    previous = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(ResourceError, match="big.bin"), OutputFolder(tmp_path) as folder:
            folder.write("big.bin", lambda path: path.write_bytes(b"x" * 100_000) and None)
            folder.publish()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, previous)
    assert [path.name for path in tmp_path.iterdir()] == ["big.bin"]
    assert (tmp_path / "big.bin").read_text() == "old"


@pytest.mark.parametrize("name", ["../up.txt", "a/b.txt", ".hidden", "/etc/x"])
def test_names_that_leave_the_folder_are_bugs(tmp_path: Path, name: str) -> None:
    with OutputFolder(tmp_path / "out") as folder, pytest.raises(ValueError, match="plain name"):
        folder.write(name, text("1"))


def test_a_kill_leaves_every_visible_file_whole(tmp_path: Path) -> None:
    code = f"""
from pathlib import Path
from jaxplan.io.output import OutputFolder
i = 0
while True:
    with OutputFolder({str(tmp_path)!r}) as folder:
        folder.write("x.txt", lambda path: path.write_text(str(i % 10) * 200_000) and None)
        folder.publish()
    i += 1
"""
    for _ in range(5):
        child = subprocess.Popen([sys.executable, "-c", code])
        deadline = time.monotonic() + 20.0
        while not (tmp_path / "x.txt").exists() and time.monotonic() < deadline:
            time.sleep(0.02)
        time.sleep(0.03)
        child.kill()
        child.wait()
        content = (tmp_path / "x.txt").read_text()
        assert len(content) == 200_000
        assert len(set(content)) == 1


def test_one_run_at_a_time_has_a_folder(tmp_path: Path) -> None:
    with OutputFolder(tmp_path / "out") as folder:
        with pytest.raises(ResourceError, match="another run is writing there"):
            OutputFolder(tmp_path / "out")
        folder.write("one.txt", "1")
        folder.publish()
    with OutputFolder(tmp_path / "out"):
        pass
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["one.txt"]


PUBLISHER = """
import sys
from jaxplan.io.output import OutputFolder
for number in range(10**6):
    with OutputFolder(sys.argv[1]) as folder:
        for name in ("flown.csv", "plans.npz", "metrics.json"):
            folder.write(name, f"{number}")
        folder.publish()
    print(number, flush=True)
"""


def vouched(folder: Path) -> set[str]:
    """What the files of a run say, where the last of them is there."""
    if not (folder / "metrics.json").exists():
        return set()
    return {(folder / name).read_text() for name in ("flown.csv", "plans.npz", "metrics.json")}


@pytest.mark.parametrize("kills", [12, pytest.param(200, marks=pytest.mark.slow)])
def test_a_run_that_is_killed_while_it_publishes_leaves_no_mixture(tmp_path: Path, kills: int) -> None:
    rng, seen = random.Random(0), 0
    for _ in range(kills):
        with subprocess.Popen([sys.executable, "-c", PUBLISHER, str(tmp_path)], stdout=subprocess.PIPE) as child:
            assert child.stdout is not None
            assert child.stdout.readline() == b"0\n"
            time.sleep(rng.uniform(0.0, 0.05))
            child.kill()
        assert len(vouched(tmp_path)) <= 1
        seen += len(vouched(tmp_path))
    assert seen > 0
    with OutputFolder(tmp_path) as folder:
        assert len(list(tmp_path.glob(".partial-*"))) == 1, "what the killed ones left is gone"
        folder.write("metrics.json", "last")
        folder.publish()
    assert not list(tmp_path.glob(".partial-*"))
