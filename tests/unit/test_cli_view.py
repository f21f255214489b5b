"""``jaxplan view``: the files it writes, and one line for every mistake."""

from pathlib import Path

import numpy as np
import pytest

from jaxplan import cli
from made_up import free_port, made_up_run


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    made_up_run(tmp_path / "run")
    return tmp_path / "run"


def test_it_writes_a_page_and_an_animation(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from jaxplan.viz import animation

    with pytest.MonkeyPatch.context() as fewer:
        fewer.setattr(animation, "MOST_FRAMES", 2)
        fewer.setattr(animation, "HOLD", 0.0)
        assert cli.run(["view", "run", "--html", "replay.html", "--gif", "flight.gif"]) == 0
    assert Path("replay.html").read_text().startswith("<!doctype html>")
    assert Path("flight.gif").read_bytes()[:4] == b"GIF8"
    said = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in said] == ["replay.html", "flight.gif"]


MISTAKES = {
    "nothing": ([], 10, "give one of them"),
    "a folder and live": (["run", "--live"], 10, "give one of them"),
    "options without live": (["run", "--speed", "3", "--html", "x.html"], 10, "need --live"),
    "a page of a live flight": (["--live", "--html", "x.html"], 10, "writes no --html"),
    "no such folder": (["absent"], 11, "absent"),
    "an empty folder": (["empty"], 11, "plans.npz"),
    "a truncated plans.npz": (["truncated/plans.npz", "--html", "x.html"], 11, "is no plans.npz"),
    "cycles of another version": (["newer", "--html", "x.html"], 11, "another version of jaxplan wrote it"),
    "a page in no folder": (["run", "--html", "nowhere/x.html"], 10, "in a folder that exists"),
    "a page that is none": (["run", "--html", "x.png"], 10, "want a .html file"),
    "an animation that is none": (["run", "--gif", "x.mp4"], 10, "want a .gif file"),
    "a port that is none": (["run", "--port", "0"], None, "--port"),
    "a word as port": (["run", "--port", "web"], 2, "port"),
    "a live flight that cannot be": (["--live", "--world", "env9", "--out", "o"], 10, "env9"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line(run: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    if name == "a port that is none":
        pytest.importorskip("viser", reason="needs the extra `view`")
    Path("empty").mkdir()
    Path("truncated").mkdir()
    Path("truncated/plans.npz").write_bytes((run / "plans.npz").read_bytes()[:300])
    made_up_run(Path("newer"))
    with np.load("newer/cycles.npz") as data:
        np.savez_compressed("newer/cycles.npz", **{**data, "version": np.int32(7)})
    before = set(Path().iterdir())
    options, code, said = MISTAKES[name]
    assert cli.run(["view", *options]) == (10 if code is None else code)
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert said in error[0]
    assert set(Path().iterdir()) == before


@pytest.mark.slow
def test_a_live_flight_is_shown_and_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The real planner and the real server; nobody looks, so that it takes off at once."""
    pytest.importorskip("viser", reason="needs the extra `view`")
    from jaxplan.viz.replay import Replay, read_replay
    from jaxplan.viz.viewer import Viewer

    shown: list[Replay] = []
    at_first = Viewer.show

    def show(viewer: Viewer, replay: Replay) -> None:
        shown.append(replay)
        at_first(viewer, replay)

    monkeypatch.setattr(Viewer, "wait", lambda viewer, seconds: None)
    monkeypatch.setattr(Viewer, "show", show)
    monkeypatch.setattr(Viewer, "serve", lambda viewer: None)
    arguments = ["view", "--live", "--port", str(free_port()), "--predictor", "noisy", "--out", str(tmp_path / "live")]
    assert cli.run(arguments) == 0
    assert [replay.outcome for replay in shown[:-1]] == ["flying"] * (len(shown) - 1)
    assert [len(replay.cycles) for replay in shown] == sorted(len(replay.cycles) for replay in shown)
    written = read_replay(tmp_path / "live")
    assert written.outcome == shown[-1].outcome == "intercepted"
    assert len(written.cycles) == len(shown[-1].cycles) > 5
    np.testing.assert_allclose(written.position, shown[-1].position, atol=1e-8)  # m; nine digits are written
