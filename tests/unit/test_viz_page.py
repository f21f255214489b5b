"""The page in a real browser: what is drawn, by the names and sizes of what was drawn, and what the panel says.

Pixels are not compared: they are the renderer's own. Chromium draws with its software renderer.
"""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from browser import CHROMIUM, Browser
from jaxplan.viz.html import replay_page
from jaxplan.viz.replay import read_replay
from made_up import made_up_run

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed: apt-get install chromium"),
]
ALWAYS = {"floor", "grid", "room", "world", "edges", "defender", "target", "capture", "flown", "target trail"}


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    made_up_run(folder / "run")
    path = folder / "replay.html"
    path.write_text(replay_page(read_replay(folder / "run")), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser(page: Path) -> Iterator[Browser]:
    with Browser(page.parent / "profile") as opened:
        began = time.monotonic()
        opened.open(page)
        opened.wait_for("window.jaxplan && (jaxplan.ready || jaxplan.error)")
        assert opened.evaluate("jaxplan.error") is None
        print(f"from the file to the first picture: {time.monotonic() - began:.1f} s")
        yield opened
        assert opened.problems == []


def state(browser: Browser, seconds: float) -> dict[str, Any]:
    browser.evaluate(f"jaxplan.seek({seconds})")
    return dict(browser.evaluate("jaxplan.state()"))


def text(browser: Browser, name: str) -> str:
    return str(browser.evaluate(f"document.getElementById('{name}').innerText"))


def test_three_instants_are_drawn(browser: Browser, tmp_path: Path) -> None:
    before, first, late = (state(browser, seconds) for seconds in (0.2, 0.55, 1.5))
    for drawn, seconds, cycle in ((before, 0.2, -1), (first, 0.55, 0), (late, 1.5, 2)):
        assert drawn["time"] == pytest.approx(seconds)
        assert drawn["cycle"] == cycle
        assert drawn["covered"] > 0.2  # of the canvas
        assert set(drawn["nodes"]) >= ALWAYS
        browser.picture(tmp_path / "seen.png")
        assert (tmp_path / "seen.png").stat().st_size > 20_000
    assert set(before["nodes"]).isdisjoint({"candidates", "plan ahead", "stop", "meeting"})
    assert first["nodes"]["candidates"] == 90
    assert late["nodes"]["candidates"] == 6
    ball = late["nodes"]["capture"]
    assert first["nodes"]["prediction"] == 10 * ball  # ten instants of one component
    assert {"plan ahead", "plan rest", "stop", "meeting"} <= set(first["nodes"])
    assert {"plan flown", "plan ahead", "stop", "meeting"} <= set(late["nodes"])
    assert "plan rest" not in late["nodes"]


def test_the_panel_says_what_the_cycle_did(browser: Browser) -> None:
    state(browser, 0.55)
    assert text(browser, "title") == "Target intercepted"
    assert "a <b>fleeing</b> target" in text(browser, "subtitle")
    panel = text(browser, "cycle")
    assert "commits an interception" in panel
    assert "0.90" in panel  # probability of being tracked
    assert "1.10" in panel  # alpha
    assert "too close to an obstacle" in panel
    assert "2.3 ms" in panel  # search, 2.25 ms
    assert "cycle 1 of 3, at 0.50 s" in text(browser, "cycle-title").lower()
    state(browser, 1.5)
    assert "keeps its plan" in text(browser, "cycle")
    assert "30.0 ms" in text(browser, "cycle")  # refine
    assert "2.0\n" in text(browser, "now")  # m/s


def test_keys_step_from_cycle_to_cycle_and_play(browser: Browser) -> None:
    state(browser, 0.2)
    instants = []
    for key in ("ArrowRight", "ArrowRight", "ArrowRight", "ArrowRight", "ArrowLeft", "ArrowLeft"):
        browser.key(key)
        instants.append(round(browser.evaluate("jaxplan.state().time"), 3))
    assert instants == [0.5, 0.6, 1.0, 2.0, 1.0, 0.6]
    browser.key(" ")
    browser.wait_for("jaxplan.state().time > 0.7")
    browser.key(" ")
    paused = browser.evaluate("jaxplan.state().time")
    time.sleep(0.3)
    assert browser.evaluate("jaxplan.state().time") == paused


def test_the_slider_scrubs(browser: Browser) -> None:
    browser.evaluate(
        "(() => { const s = document.getElementById('scrub'); s.value = 1.25; s.dispatchEvent(new Event('input')); })()"
    )
    assert browser.evaluate("jaxplan.state().time") == pytest.approx(1.25)
    assert text(browser, "clock") == "1.25 / 2.00 s"


def test_what_is_not_wanted_is_not_drawn(browser: Browser) -> None:
    assert "padding" not in state(browser, 1.5)["nodes"]
    browser.evaluate("jaxplan.layers.padding.box.click(); jaxplan.layers.candidates.box.click()")
    nodes = state(browser, 1.5)["nodes"]
    assert nodes["padding"] > 1000
    assert "candidates" not in nodes
    browser.evaluate("jaxplan.layers.padding.box.click(); jaxplan.layers.candidates.box.click()")


def test_the_camera_turns_and_follows(browser: Browser) -> None:
    state(browser, 1.5)
    camera = "(({azimuth, elevation, centre}) => [azimuth, elevation, ...centre])(jaxplan.player.stage.scene.camera)"
    before = browser.evaluate(camera)
    browser.drag((400.0, 300.0), (500.0, 340.0))
    turned = browser.evaluate(camera)
    assert turned[0] == pytest.approx(before[0] - 0.6)
    assert turned[1] == pytest.approx(before[1] + 0.24)
    browser.evaluate("document.getElementById('follow').click()")
    browser.wait_for("Math.abs(jaxplan.player.stage.scene.camera.centre[1] + 1.0) < 0.05")  # at y = -4 + 2 * 1.5
    browser.evaluate("document.getElementById('whole').click()")
    assert browser.evaluate(camera) == pytest.approx(before)
