"""Animations: as many pictures as were asked for, in which what moves is where it was."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from jaxplan.errors import ResourceError
from jaxplan.viz import animation
from jaxplan.viz.animation import FRAME_RATE, HOLD, Camera, animate, frame_times
from jaxplan.viz.replay import Replay, read_replay
from made_up import made_up_run

SHARE = 0.015
"""Of the picture's width; half of the defender's marker and more."""


@pytest.fixture
def replay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Replay:
    """A run, drawn in few pictures."""
    monkeypatch.setattr(animation, "MOST_FRAMES", 5)
    monkeypatch.setattr(animation, "HOLD", 2.0 / FRAME_RATE)
    made_up_run(tmp_path / "run")
    return read_replay(tmp_path / "run")


def blue(picture: Image.Image) -> np.ndarray:
    """The middle of the pixels in the defender's colour in the left half, as shares of the picture's width."""
    pixels = np.asarray(picture.convert("RGB")).astype(int)[:, : picture.width // 2]
    rows, columns = np.nonzero(np.abs(pixels - [0, 114, 178]).max(axis=-1) < 12)
    lowest = rows < 0.9 * picture.height  # not the legend
    return np.array([columns[lowest].mean(), rows[lowest].min()]) / picture.width


def test_a_gif_shows_the_flight(replay: Replay, tmp_path: Path) -> None:
    path = tmp_path / "flight.gif"
    assert animate(replay, path) == 7
    assert path.stat().st_size < 1_000_000
    with Image.open(path) as film:
        assert film.size[0] > 700
        assert film.n_frames >= 5  # equal ones at the end become one
        assert film.info["duration"] == 1000 / FRAME_RATE
        film.seek(0)
        first = blue(film)
        film.seek(4)
        last = blue(film)
    times = frame_times(replay)
    moved = 2.0 * (times[4] - times[0]) / 10.2 * 0.48  # m in a room of 10 m and its margin, 0.48 of the width
    assert first[1] - last[1] == pytest.approx(moved, abs=SHARE)  # flies along y, upwards in the picture
    assert first[0] == pytest.approx(last[0], abs=SHARE)


def test_instants_begin_before_the_departure_and_hold_the_end(replay: Replay) -> None:
    times = frame_times(replay)
    assert times[0] == pytest.approx(0.3)
    assert (np.diff(times) >= 0.0).all()
    assert (times[-round(animation.HOLD * FRAME_RATE) :] == 2.0).all()
    assert HOLD == 1.0


def test_the_camera_is_a_pinhole() -> None:
    camera = Camera(np.array([0.0, -10.0, 0.0]), np.zeros(3))
    np.testing.assert_allclose(camera.project(np.zeros(3)), [0.0, 0.0], atol=1e-12)  # the middle, to rounding
    np.testing.assert_allclose(camera.project(np.array([1.0, 0.0, 2.0])), [0.1, 0.2])
    np.testing.assert_allclose(camera.project(np.array([1.0, 10.0, 2.0])), [0.05, 0.1])
    np.testing.assert_allclose(camera.depth(np.array([[3.0, 5.0, 1.0]])), 15.0)


def test_a_video_needs_ffmpeg(replay: Replay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(animation.animation.FFMpegWriter, "isAvailable", classmethod(lambda cls: False))
    with pytest.raises(ResourceError, match="^an MP4 needs ffmpeg, which is not installed"):
        animate(replay, tmp_path / "flight.mp4")
    assert not (tmp_path / "flight.mp4").exists()


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_a_video_is_one(replay: Replay, tmp_path: Path) -> None:
    assert animate(replay, tmp_path / "flight.mp4") == 7
    assert (tmp_path / "flight.mp4").read_bytes()[4:8] == b"ftyp"
