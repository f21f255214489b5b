"""The viewer that viser serves: what is in its scene and its panel, and how it refuses."""

import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxplan.errors import InputError, ResourceError
from jaxplan.viz.replay import Replay, at, read_replay
from jaxplan.viz.viewer import HOST, Viewer, panel
from made_up import free_port, made_up_run


@pytest.fixture
def replay(tmp_path: Path) -> Replay:
    made_up_run(tmp_path / "run")
    return read_replay(tmp_path / "run")


@pytest.fixture
def viewer(replay: Replay) -> Iterator[Viewer]:
    pytest.importorskip("viser", reason="needs the extra `view`")
    made = Viewer(replay, free_port())
    yield made
    made.stop()


def drawn(viewer: Viewer) -> dict[str, Any]:
    return dict(viewer._scene._handle_from_node_name)


def test_the_scene_has_what_there_is_to_see(viewer: Viewer) -> None:
    assert {"/world", "/padding", "/defender", "/quarry"} <= set(drawn(viewer))
    viewer._controls.time.value = 1.5
    viewer.draw()
    nodes = drawn(viewer)
    assert {"/meeting", "/stop", "/met", "/flown", "/ahead"} <= set(nodes)
    assert len(nodes["/candidates"].points) == 6
    assert len([name for name in nodes if name.startswith("/prediction/")]) == 10
    np.testing.assert_allclose(nodes["/stop"].position, [-4.0, 3.4, 1.0], atol=1e-6)  # m, single precision
    assert "keeps its plan" in viewer._controls.panel.content


def test_it_steps_and_plays(viewer: Viewer) -> None:
    for by, wanted in ((1, 0.5), (1, 0.6), (1, 1.0), (1, 1.0), (-1, 0.6)):
        viewer.step(by)
        assert viewer._controls.time.value == pytest.approx(wanted)
    viewer._toggle()
    viewer.serve(0.3)
    assert 0.6 < viewer._controls.time.value < 0.6 + 0.5 * 3.0


def test_it_shows_an_episode_as_it_grows(viewer: Viewer, replay: Replay) -> None:
    from dataclasses import replace

    some = slice(0, 50)
    parts = {name: getattr(replay, name)[some] for name in ("times", "position", "quat_wxyz", "target")}
    viewer.show(replace(replay, cycles=replay.cycles[:2], outcome="flying", **parts))
    assert viewer._controls.time.value == pytest.approx(replay.times[49])
    assert "In flight" in viewer._controls.title.content
    assert len(drawn(viewer)["/candidates"].points) == 90
    viewer.show(replay)
    assert len(drawn(viewer)["/candidates"].points) == 6
    assert "Target intercepted" in viewer._controls.title.content


def test_the_panel_has_the_cycles_numbers(replay: Replay) -> None:
    said = panel(replay, at(replay, 0.55))
    for part in ("cycle 1 of 3", "commits an interception", "0.90", "1.10", "too close to an obstacle", "2.2 ms"):
        assert part in said
    assert "cycle" not in panel(replay, at(replay, 0.2))


def test_a_port_that_is_taken_is_refused(replay: Replay) -> None:
    pytest.importorskip("viser", reason="needs the extra `view`")
    with socket.socket() as taken:
        taken.bind((HOST, 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ResourceError, match=f"--port: {port} cannot be used"):
            Viewer(replay, port)
    with pytest.raises(InputError, match="want a number from 1 to 65535"):
        Viewer(replay, 99999)


def test_without_viser_it_says_what_to_do(replay: Replay, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(ResourceError, match=r"pip install 'jaxplan\[view\]', or write a page with --html FILE"):
        Viewer(replay, 8080)
