"""Which versions of JAX are refused, and what is reported."""

import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from jaxplan import versions
from jaxplan.errors import ResourceError, UnsupportedVersion

BAD = ["0.4.35", "0.9.1", "0.10.0", "0.10.1", "0.10.2", "0.11.0", "0.11.1", "0.11.0.dev20260101"]
GOOD = ["0.9.2", "0.9.3", "0.12.0", "0.12.0.1", "0.13.0", "1.0.0"]


def pretend(monkeypatch: pytest.MonkeyPatch, jax: str | None, jaxlib: str | None) -> None:
    have = {"jax": jax, "jaxlib": jaxlib}
    monkeypatch.setattr(versions, "_version", lambda package: have.get(package))


@pytest.mark.parametrize("version", BAD)
@pytest.mark.parametrize("package", ["jax", "jaxlib"])
def test_known_bad_versions_are_refused_in_one_sentence(
    monkeypatch: pytest.MonkeyPatch, package: str, version: str
) -> None:
    pretend(monkeypatch, **{"jax": "0.9.2", "jaxlib": "0.9.2", package: version})
    with pytest.raises(UnsupportedVersion, match=f"{package} {version}") as caught:
        versions.require_supported_jax()
    assert "\n" not in str(caught.value)
    assert "pip install" in str(caught.value)
    assert isinstance(caught.value, ResourceError)
    assert isinstance(caught.value, ImportError)


@pytest.mark.parametrize("version", GOOD)
def test_good_versions_pass(monkeypatch: pytest.MonkeyPatch, version: str) -> None:
    pretend(monkeypatch, version, version)
    versions.require_supported_jax()


def test_a_missing_jax_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, None, None)
    with pytest.raises(UnsupportedVersion, match="not installed"):
        versions.require_supported_jax()


def test_the_installed_one_passes_and_is_reported() -> None:
    versions.require_supported_jax()
    found = versions.installed_versions()
    assert found["jax"] == metadata.version("jax")
    assert found["python"]
    assert set(versions.REPORTED) < set(found)


def test_pip_is_told_the_same(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = [Requirement(line) for line in (*project["dependencies"], *extras["gpu"])]
    pins = [requirement.specifier for requirement in wanted if requirement.name == "jax"]
    assert len(pins) == 2
    for pin in pins:
        assert [version for version in BAD if version in pin] == []
        assert [version for version in GOOD if version not in pin] == []
