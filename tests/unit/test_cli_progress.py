"""What the bar says while programs are compiled: what, how far, how long still; remembered from run to run."""

import json
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import pytest

from jaxplan.cli import progress
from jaxplan.cli.progress import USUAL, Expected, compiling
from jaxplan.compilation import Watch

TWO = Expected(10.0, {"solve": [1, 8.0], "route": [1, 2.0]})


def watching(ended: dict[str, int], running: list[str]) -> Any:
    return SimpleNamespace(ended=lambda: ended, running=lambda: running)


def test_the_share_never_goes_back_and_the_time_never_stands_still() -> None:
    moments = [
        (0.5, {}, []),
        (1.0, {}, ["route", "solve"]),
        (3.0, {}, ["route", "solve"]),
        (4.0, {"route": 1}, ["solve"]),
        (8.0, {"route": 1}, ["solve"]),
        (9.0, {"route": 1, "solve": 1}, []),
    ]
    said = [compiling(watching(ended, running), TWO, elapsed) for elapsed, ended, running in moments]
    shares = [share for _, share in said]
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] < shares[-1] < 1.0
    assert said[0][0].startswith("loading, about 10 s left") or said[0][0].startswith("loading, about 9")
    assert said[1][0].startswith("compiling waypoints, trajectories, about 9 s left")
    assert said[3][0].startswith("compiling trajectories, about 6 s left")


def test_a_slow_machine_is_told_by_its_own_pace() -> None:
    text, share = compiling(watching({"solve": 1}, ["route"]), TWO, 40.0)
    assert share == pytest.approx(0.99)
    assert int(text.split("about ")[1].split()[0]) <= 10
    text, share = compiling(watching({"half": 1}, ["rest"]), Expected(10.0, {"half": [1, 5.0], "rest": [1, 5.0]}), 9.0)
    assert 0.5 <= share <= 0.99


def test_the_usual_programs_have_words() -> None:
    assert set(USUAL.programs) <= set(progress._WORDS)


def test_programs_are_seen_while_and_after_they_are_compiled() -> None:
    def peculiar(x: jax.Array) -> jax.Array:
        return jnp.sin(x) * 3.25

    with Watch() as watch:
        jax.jit(peculiar)(jnp.float32(1.0))
    assert watch.ended()["peculiar"] == 1
    assert watch.seconds()["peculiar"] > 0.0
    assert watch.running() == []
    before = watch.ended()
    jax.jit(lambda x: x * 7.25)(jnp.float32(1.0))
    assert watch.ended() == before


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"format": 1}', '{"format": 2, "seconds": 1, "programs": {}}', "null"]
)
def test_what_cannot_be_read_is_the_usual(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv("JAXPLAN_CACHE_DIR", str(tmp_path))
    (tmp_path / "compiling-flight.json").write_text(text)
    assert progress._recall("flight") == USUAL


def test_a_run_is_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JAXPLAN_CACHE_DIR", str(tmp_path / "new"))
    assert progress._recall("flight") == USUAL
    with progress.progress_bar("flight") as tell:
        tell("loading", 0.0)
        time.sleep(0.01)
        tell("flying", 0.1)
        tell("flying", 0.2)
    assert json.loads((tmp_path / "new" / "compiling-flight.json").read_text())["seconds"] >= 0.01
    assert progress._recall("flight").seconds >= 0.01
    assert progress._recall("realtime") == USUAL
    monkeypatch.setenv("JAXPLAN_CACHE_DIR", "")
    progress._remember("flight", TWO)
    assert progress._recall("flight") == USUAL
