"""What the check of a release looks for in the files, on files made for it; all of it is `make release-check`."""

import io
import re
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

from tools import release
from tools.release import ARCHIVE_HAS, WHEEL_HAS, WHEEL_LACKS, content_faults, metadata_faults, names_in

GOOD = {"Name": "jaxplan", "Version": "1.2.3", "License-Expression": "Apache-2.0", "Requires-Python": ">=3.11"}


def wheel(folder: Path, said: dict[str, str], names: tuple[str, ...] = ()) -> Path:
    path = folder / "jaxplan-1.2.3-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("jaxplan-1.2.3.dist-info/METADATA", "".join(f"{key}: {said[key]}\n" for key in said))
        for name in names:
            archive.writestr(name, "")
    return path


@pytest.fixture
def prepared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project of version 1.2.3."""
    monkeypatch.setattr(release, "ROOT", tmp_path)
    (tmp_path / "CITATION.cff").write_text("cff-version: 1.2.0\nversion: 1.2.3\n")
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\n## 1.2.3\n")
    return tmp_path


def test_a_sound_wheel_has_no_faults(prepared: Path) -> None:
    path = wheel(prepared, GOOD, WHEEL_HAS)
    assert metadata_faults(path, "1.2.3") == []
    assert content_faults(names_in(path), WHEEL_HAS, WHEEL_LACKS) == []


@pytest.mark.parametrize("key", GOOD)
def test_wrong_metadata_is_told(prepared: Path, key: str) -> None:
    (fault,) = metadata_faults(wheel(prepared, {**GOOD, key: "other"}), "1.2.3")
    assert fault.startswith(f"{key} is 'other', want '{GOOD[key]}'")


def test_a_forgotten_version_is_told(prepared: Path) -> None:
    (prepared / "CITATION.cff").write_text("cff-version: 1.2.0\nversion: 1.2.2\n")
    (prepared / "CHANGELOG.md").write_text("# Changelog\n\n## 1.2.30\n")
    assert len(metadata_faults(wheel(prepared, GOOD), "1.2.3")) == 2


@pytest.mark.parametrize("name", ["tests/unit/test_a.py", "runs/a.npz", "jaxplan/__pycache__/a.pyc", "jaxplan/.venv/a"])
def test_what_does_not_belong_into_a_wheel_is_told(name: str) -> None:
    assert content_faults([*WHEEL_HAS, name], WHEEL_HAS, WHEEL_LACKS) == [f"contains {name}"]


def test_what_is_missing_is_told() -> None:
    assert content_faults(WHEEL_HAS[1:], WHEEL_HAS, WHEEL_LACKS) == [f"lacks {WHEEL_HAS[0]}"]
    assert content_faults(["jaxplan/io/site/x.py", *WHEEL_HAS], WHEEL_HAS, WHEEL_LACKS) == []


def test_names_in_an_archive_are_below_its_folder(tmp_path: Path) -> None:
    with tarfile.open(tmp_path / "a.tar.gz", "w:gz") as archive:
        archive.addfile(tarfile.TarInfo("jaxplan-1.2.3/docs/a.md"), io.BytesIO())
    assert names_in(tmp_path / "a.tar.gz") == ["docs/a.md"]


def test_the_lists_name_files_that_there_are(repository: Path) -> None:
    """And CITATION.cff has the version of pyproject.toml."""
    for name in (*WHEEL_HAS, *ARCHIVE_HAS):
        assert (repository / re.sub(r"^jaxplan/_(?=[a-z])", "", name)).is_file(), name
    version = tomllib.loads((repository / "pyproject.toml").read_text())["project"]["version"]
    assert f"\nversion: {version}\n" in (repository / "CITATION.cff").read_text()
