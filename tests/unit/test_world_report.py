"""`jaxplan world`: its numbers, its picture and its refusals."""

from pathlib import Path

import numpy as np
import pytest

from jaxplan.cli import run
from jaxplan.world.obstacles import World, aligned_boxes, make_obstacles
from jaxplan.world.report import lattice_reports, obstacle_counts


def halves(gap: float) -> World:
    """A room of 4 x 4 x 2 m, cut by a wall of ``gap`` m thickness in the middle."""
    boxes = aligned_boxes(np.array([[2.0 - gap / 2, 0.0, 0.0]]), np.array([[2.0 + gap / 2, 4.0, 2.0]]))
    bounds = np.array([[0.0, 0.0, 0.0], [4.0, 4.0, 2.0]])
    return World(name="halves", bounds=bounds, obstacles=make_obstacles(boxes=boxes), keep_in=np.float64(0.2))


def test_shares_and_parts_by_hand() -> None:
    """Free cells of 0.5 m: 3 of 8 columns on each side of the wall (padding 0.1), 8 rows, all 4 levels."""
    (report,) = lattice_reports(halves(0.6), (0.5,), padding=0.1)
    assert report.cells == 8 * 8 * 4
    assert report.parts == 2
    assert report.largest == pytest.approx(0.5)
    assert report.occupied == pytest.approx(1.0 - 6 * 8 * 4 / report.cells)


def test_a_full_room_has_no_part() -> None:
    (report,) = lattice_reports(halves(3.9), (0.5,), padding=0.5)
    assert report.occupied == 1.0
    assert report.parts == 0
    assert np.isnan(report.largest)


def test_counts_name_only_what_is_there() -> None:
    assert obstacle_counts(halves(0.1)) == {"boxes": 1}


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "env1.png"
    assert run(["world", "env1", "--out", str(out)]) == 0
    text = capsys.readouterr().out
    for word in ("10 x 10 x 2 m", "3 boxes, 5 cylinders", "0.1 m     200000     43.3%", "100.0%", str(out)):
        assert word in text
    assert out.read_bytes()[:4] == b"\x89PNG"


def test_command_on_a_grid_of_cells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    occupied = np.zeros((20, 20, 10), bool)
    occupied[8:12, 8:12] = True
    np.savez(tmp_path / "map.npz", occupancy=occupied, origin=np.zeros(3), resolution=0.2)
    assert run(["world", str(tmp_path / "map.npz"), "--out", str(tmp_path / "map.png")]) == 0
    assert "1280 occupied cells" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        (["env9"], 10, "env1"),
        (["missing.bt"], 11, "no such file"),
        (["env1", "--out", "/no/such/folder/a.png"], 10, "--out"),
        (["env1", "--out", "picture.gif"], 10, ".png"),
        (["env1", "--padding", "-1"], 10, "padding"),
        (["env1", "--padding", "nan"], 10, "padding"),
    ],
)
def test_refusals(arguments: list[str], code: int, word: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["world", *arguments]) == code
    error = capsys.readouterr().err
    assert word in error
    assert error.count("\n") == 1


def test_a_room_of_too_many_cells_is_drawn_with_larger_ones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """60 x 60 x 10 m have 36 million cells of 0.1 m; where none is free there is no largest part."""
    room = '{"bounds": {"extents": [0, 60, 0, 60, 0, 10]}, "blocks": [{"extents": [20, 40, 20, 40, 0, 10]}]}'
    (tmp_path / "yard.json").write_text(room)
    assert run(["world", str(tmp_path / "yard.json"), "--padding", "30", "--out", str(tmp_path / "map.png")]) == 0
    text = capsys.readouterr().out
    assert "too large for cells of 0.1 m: jaxplan intercept --resolution 0.14" in text
    assert "nan" not in text
    assert (tmp_path / "map.png").exists()
