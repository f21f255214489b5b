"""Files are whole or not there, and a folder belongs to one configuration."""

import dataclasses
import io
import os
from pathlib import Path

import numpy as np
import pytest

from jaxplan import files
from jaxplan.errors import FileError, InputError, ResourceError
from jaxplan.files import (
    LARGEST_ARCHIVE,
    create_folder,
    read_arrays,
    read_limited,
    require_configuration,
    state_configuration,
    write_atomically,
)
from jaxplan.training.active import load_labels
from jaxplan.training.dataset import read_shard
from jaxplan.weights import read_weights

STATED = {"steps": 3, "network": {"hidden": 64, "latent": 32}, "span": (0.5, 2.0), "rounds": 7}


def test_text_bytes_and_writers_arrive_whole(tmp_path: Path) -> None:
    write_atomically(tmp_path / "text.md", "äöü\n")
    write_atomically(tmp_path / "state.bin", b"\x00\xff")
    write_atomically(tmp_path / "arrays.npz", lambda path: np.savez_compressed(path, x=np.arange(3)))
    assert (tmp_path / "text.md").read_text(encoding="utf-8") == "äöü\n"
    assert (tmp_path / "state.bin").read_bytes() == b"\x00\xff"
    with np.load(tmp_path / "arrays.npz", allow_pickle=False) as found:
        np.testing.assert_array_equal(found["x"], np.arange(3))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arrays.npz", "state.bin", "text.md"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt(), ValueError("a bug")])
def test_what_was_there_stays_where_writing_fails(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "state.bin"
    write_atomically(path, b"old")

    def fail(staged: Path) -> None:
        staged.write_bytes(b"ne")
        raise error

    with pytest.raises(type(error)):
        write_atomically(path, fail)
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["state.bin"]


def test_the_content_is_on_the_disk_before_the_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A power failure leaves the old file or the new one: sync the content, rename, sync the folder."""
    done: list[str] = []
    replace, flush = os.replace, files.flush
    monkeypatch.setattr(files.os, "replace", lambda a, b: (done.append("rename"), replace(a, b)))
    monkeypatch.setattr(files, "flush", lambda path: (done.append("sync " + path.name.split("-")[-1]), flush(path)))
    write_atomically(tmp_path / "a.txt", "a")
    assert done == ["sync a.txt", "rename", "sync " + tmp_path.name.split("-")[-1]]


def test_a_folder_is_created_with_those_above_it_or_not_at_all(tmp_path: Path) -> None:
    deep = tmp_path / "a" / "b"
    assert create_folder(deep) == [tmp_path / "a", deep]
    assert create_folder(deep) == []
    assert list(deep.iterdir()) == []
    (tmp_path / "file").write_text("in the way")
    for place in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/jaxplan")):
        with pytest.raises(ResourceError, match=f"cannot write '{place}'"):
            create_folder(place)
    assert (tmp_path / "file").read_text() == "in the way"


def test_a_folder_belongs_to_the_configuration_that_it_states(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    state_configuration(folder, STATED)
    before = (folder / "config.json").stat().st_mtime_ns
    state_configuration(folder, STATED)
    assert (folder / "config.json").stat().st_mtime_ns == before
    other = {**STATED, "network": {"hidden": 8, "latent": 32}, "span": (0.5, 3.0)}
    differ = r"another configuration .hidden is 64 there and 8 here; span is \[0.5, 2.0\] there and \[0.5, 3.0\] here\)"
    with pytest.raises(InputError, match=differ):
        state_configuration(folder, other)
    with pytest.raises(InputError, match="rounds is 7 there and 9 here"):
        state_configuration(folder, {**STATED, "rounds": 9})
    state_configuration(folder, {**STATED, "rounds": 9}, may_differ=("rounds",))
    require_configuration(folder, {**STATED, "rounds": 9})


def test_files_are_read_whole_up_to_a_limit(tmp_path: Path) -> None:
    path = tmp_path / "model.bin"
    path.write_bytes(b"12345")
    assert read_limited(path, 5, "a model") == b"12345"
    with pytest.raises(FileError, match=r"model\.bin: has more than 4 bytes; want a model"):
        read_limited(path, 4, "a model")
    for missing in (tmp_path / "other.bin", tmp_path):
        with pytest.raises(FileError, match=r"no such file; want a model"):
            read_limited(missing, 5, "a model")


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
def test_what_may_not_be_read_says_so(tmp_path: Path) -> None:
    path = tmp_path / "model.bin"
    path.write_bytes(b"12345")
    path.chmod(0)
    with pytest.raises(FileError, match="check its permissions"):
        read_limited(path, 5, "a model")


@pytest.mark.parametrize("content", ["", "[1]", "\x00", "3"])
def test_a_statement_that_cannot_be_read_is_named(tmp_path: Path, content: str) -> None:
    (tmp_path / "config.json").write_text(content)
    with pytest.raises(FileError, match=r"config\.json: cannot be read as a configuration"):
        state_configuration(tmp_path, STATED)


def test_configurations_with_infinity_are_themselves_again(tmp_path: Path) -> None:
    @dataclasses.dataclass
    class Limits:
        ceiling: float = float("inf")

    state_configuration(tmp_path, dataclasses.asdict(Limits()))
    state_configuration(tmp_path, dataclasses.asdict(Limits()))


def packed(**arrays: np.ndarray) -> bytes:
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    return content.getvalue()


def test_arrays_are_not_unpacked_before_their_size_is_known(tmp_path: Path) -> None:
    """Few bytes that would become many are refused by what the archive states."""
    assert read_arrays(packed(a=np.arange(3)))["a"].tolist() == [0, 1, 2]
    bomb = packed(a=np.zeros(LARGEST_ARCHIVE // 8 + 1))
    assert len(bomb) < LARGEST_ARCHIVE / 500
    with pytest.raises(ValueError, match="states 671"):
        read_arrays(bomb)
    file = tmp_path / "bomb.npz"
    file.write_bytes(bomb)
    with pytest.raises(FileError, match="cannot be read as a policy"):
        read_weights(file, "policy")
    with pytest.raises(FileError, match="cannot be read as a shard"):
        read_shard(file)
    with pytest.raises(FileError, match="is not a round of labels"):
        load_labels([file])
