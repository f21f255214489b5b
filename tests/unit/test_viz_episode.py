"""The picture of an episode: what is drawn, from made-up episodes in real worlds."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.status import PlanStatus, Reason
from jaxplan.viz.candidates import candidate_curves, illustrative_cycle
from jaxplan.viz.episode import OUTCOMES, draw_episode
from jaxplan.viz.scene import draw_world, enclosed, section, sharp_edges, solids
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import (
    Boxes,
    Capsules,
    Cylinders,
    Mesh,
    Spheres,
    World,
    aligned_boxes,
    make_obstacles,
)
from tolerances import tolerance


def cube_mesh() -> Mesh:
    """The surface of [0, 1]^3, every triangle with its own vertices as in an .stl file."""
    triangles = []
    for axis in range(3):
        for side in (0.0, 1.0):
            square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
            corners = np.insert(square, axis, side, axis=1)
            triangles += [corners[[0, 1, 2]], corners[[0, 2, 3]]]
    vertices = np.concatenate(triangles)
    return Mesh(
        vertices=vertices,
        faces=np.arange(len(vertices)).reshape(-1, 3),
        squared=np.zeros((2, 2, 2)),
        origin=np.zeros(3),
        spacing=np.float64(1.0),
    )


def made_up_splines(start: np.ndarray, goals: np.ndarray) -> SplineBatch:
    """One bent segment to each goal, and one segment of padding that stays there."""
    bend = np.random.default_rng(0).normal(scale=1.5, size=goals.shape) * [1.0, 1.0, 0.2]
    position = np.zeros((2, 10, 3, len(goals)))
    position[0, 0], position[0, 1], position[0, 2] = start[:, None], (goals - start + bend).T, -bend.T
    position[1, 0] = goals.T
    durations = np.stack([np.full(len(goals), 1.2), np.zeros(len(goals))])
    return SplineBatch(durations=durations, position=position, yaw=np.zeros((2, 6, 1, len(goals))))


def made_up_cycle(start: np.ndarray, goals: np.ndarray, time: float = 0.5, chosen: int = 2) -> SimpleNamespace:
    """A cycle whose odd candidates failed a check, and whose last two were never planned."""
    traced = len(goals) - 2
    splines = made_up_splines(start, goals[:traced])
    reasons = np.where(np.arange(len(goals)) % 2, Reason.CLEARANCE, 0).astype(np.uint32)
    reasons[traced:] = int(Reason.OUT_OF_REACH)
    lanes = np.concatenate([np.arange(traced), [-1, -1]])
    plans = SimpleNamespace(goals=goals, reasons=reasons, trajectory=lanes, splines=splines)
    counts = {"generated": len(goals), "rejected": {"clearance": int((reasons > 0).sum())}, "refused": 0}
    numbers = {"deviation": 0.01, "latency": 0.1, "sooner": 0.0, "stage_ms": {"search": 3.0, "minsnap": 9.5}}
    return SimpleNamespace(time=time, status=PlanStatus.INTERCEPT, plans=plans, chosen=chosen, **counts, **numbers)


def made_up_episode(world: World, outcome: str = "intercepted") -> Any:
    """A straight chase through a room."""
    lower, upper = np.asarray(world.bounds)
    times = np.arange(1, 801) / 200.0
    share = times[:, None] / times[-1]
    target = lower + (upper - lower) * ([0.2, 0.85, 0.4] + share * [0.6, -0.1 * np.sin(4.0), 0.3])
    position = lower + (upper - lower) * [0.1, 0.1, 0.4] * (1.0 - share**2) + (target[-1] - lower) * share**2
    goals = target[np.linspace(300, 799, 22).astype(int)]
    flight = SimpleNamespace(
        times=times,
        position=position,
        velocity=np.gradient(position, times, axis=0),
        target=target,
        target_velocity=np.gradient(target, times, axis=0),
        position_error=0.08 * np.abs(np.sin(3.0 * times)),
        yaw_error=0.2 * np.abs(np.sin(2.0 * times)),
        twist_error=0.1 * np.abs(np.sin(2.0 * times)),
    )
    return SimpleNamespace(
        outcome=outcome,
        success=outcome == "intercepted",
        flight=flight,
        cycles=(made_up_cycle(position[100], goals),),
        scenario=SimpleNamespace(world=world, departure=0.5),
    )


METRICS = {
    "time_to_intercept_s": None,
    "min_distance_m": 0.39,
    "min_clearance_m": np.inf,
    "max_position_error_m": 0.08,
    "max_yaw_error_deg": 11.0,
}


def is_a_picture(path: Path) -> bool:
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("RGB"))
    return min(pixels.shape[:2]) > 500 and len(np.unique(pixels @ np.array([1, 256, 65536]))) > 100


@pytest.mark.parametrize("outcome", OUTCOMES)
def test_every_outcome_has_a_picture(tmp_path: Path, outcome: str) -> None:
    draw_episode(made_up_episode(load_world("env1"), outcome), METRICS, tmp_path / "episode.png")
    assert is_a_picture(tmp_path / "episode.png")


def test_an_episode_without_plans_has_one(tmp_path: Path) -> None:
    episode = made_up_episode(load_world("env1"), "no_plan")
    episode.cycles = ()
    draw_episode(episode, METRICS, tmp_path / "episode.png")
    assert is_a_picture(tmp_path / "episode.png")


@pytest.mark.parametrize("name", ["kr_skir.stl", "kr_simple.stl"])
def test_a_mesh_world_has_one(tmp_path: Path, examples: Path, name: str) -> None:
    draw_episode(made_up_episode(load_world(examples / "maps" / name)), METRICS, tmp_path / "episode.png")
    assert is_a_picture(tmp_path / "episode.png")


def test_drawing_leaves_no_global_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib as mpl

    before = dict(mpl.rcParams)
    draw_episode(made_up_episode(load_world("env1")), METRICS, tmp_path / "episode.png")
    assert dict(mpl.rcParams) == before


def test_all_candidates_are_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **options: saved.append(figure))
    draw_episode(made_up_episode(load_world("env1")), METRICS, tmp_path / "episode.png")
    views = saved[0].axes[:2]
    for view in views:
        collections = [len(c.get_paths()) for c in view.collections if type(c).__name__ == "LineCollection"]
        assert sorted(collections) == [10, 10]
        dots = [len(c.get_offsets()) for c in view.collections if type(c).__name__ == "PathCollection"]
        assert sorted(dots) == [10, 12]


def test_sampled_curves_are_the_splines() -> None:
    goals = np.random.default_rng(1).uniform(-3.0, 3.0, size=(8, 3))
    cycle = made_up_cycle(np.zeros(3), goals)
    curves = candidate_curves(cycle, samples=5)
    assert curves.curves.shape == (6, 10, 3)
    assert curves.usable.sum() == 3
    for lane in range(6):
        spline = cycle.plans.splines.spline(lane)
        points = spline.evaluate(np.linspace(0.0, 1.2, 5))[..., :3]
        np.testing.assert_allclose(curves.curves[lane, :5], points, **tolerance("exact", np.float32))
        np.testing.assert_array_equal(curves.curves[lane, 5:], np.tile(goals[lane], (5, 1)))
    np.testing.assert_array_equal(curves.chosen, curves.curves[2])


def test_a_cycle_in_which_nothing_is_traced_has_no_curves() -> None:
    cycle = made_up_cycle(np.zeros(3), np.ones((6, 3)))
    cycle.plans.trajectory = np.full(6, -1)
    curves = candidate_curves(cycle)
    assert curves.curves.shape[0] == 0
    assert curves.chosen is None


def test_a_lane_of_nan_is_left_out() -> None:
    cycle = made_up_cycle(np.zeros(3), np.ones((6, 3)))
    position = np.array(cycle.plans.splines.position)
    position[..., 1] = np.nan
    cycle.plans.splines = SplineBatch(durations=np.ones((2, 4)), position=position, yaw=np.zeros((2, 6, 1, 4)))
    assert candidate_curves(cycle).curves.shape[0] == 3


def test_the_cycle_that_shows_most_is_chosen() -> None:
    few, many = (made_up_cycle(np.zeros(3), np.ones((count, 3))) for count in (5, 9))
    kept = made_up_cycle(np.zeros(3), np.ones((20, 3)))
    kept.status = PlanStatus.KEPT_COMMITTED
    assert illustrative_cycle([few, many, kept]) is many
    assert illustrative_cycle([kept]) is kept
    assert illustrative_cycle([]) is None


def test_primitives_keep_their_extent() -> None:
    center, up = np.array([[1.0, 2.0, 3.0]]), np.array([[0.0, 0.0, 1.0]])
    sizes = {"radius": np.array([0.5]), "half_length": np.array([1.0])}
    obstacles = make_obstacles(
        boxes=aligned_boxes(np.array([[0.5, 1.5, 2.0]]), np.array([[1.5, 2.5, 4.0]])),
        cylinders=Cylinders(center=center, axis=up, **sizes),
        spheres=Spheres(center=center, radius=np.array([0.5])),
        capsules=Capsules(center=center, axis=up, **sizes),
    )
    world = World(name="x", bounds=np.array([[0.0, 0, 0], [9.0, 9, 9]]), obstacles=obstacles, keep_in=np.float64(0.2))
    heights = [1.0, 1.0, 0.5, 1.5]
    for solid, height in zip(solids(world), heights, strict=True):
        half = np.array([0.5, 0.5, height])
        np.testing.assert_allclose(solid.max(axis=0), center[0] + half, **tolerance("formula"))
        np.testing.assert_allclose(solid.min(axis=0), center[0] - half, **tolerance("formula"))


def test_a_turned_box_is_turned() -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    boxes = Boxes(center=np.zeros((1, 3)), half=np.array([[2.0, 1.0, 0.5]]), rotation=turn[None])
    bounds = np.array([[-5.0, -5, -5], [5.0, 5, 5]])
    world = World(name="x", bounds=bounds, obstacles=make_obstacles(boxes=boxes), keep_in=np.float64(0.1))
    np.testing.assert_allclose(next(iter(solids(world))).max(axis=0), [1.0, 2.0, 0.5])


def test_the_section_of_a_cube_is_a_square() -> None:
    for across in range(3):
        segments = section(cube_mesh(), across, 0.3)
        np.testing.assert_allclose(segments[..., across], 0.3)
        assert np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum() == pytest.approx(4.0)
    assert section(cube_mesh(), 2, 2.0).shape == (0, 2, 3)


def test_the_sharp_edges_of_a_cube_are_its_twelve() -> None:
    edges = sharp_edges(cube_mesh())
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    np.testing.assert_allclose(lengths, 1.0)
    assert len(edges) == 12


def test_what_a_section_encloses() -> None:
    """A unit square in a ring of 4 m: between them is enclosed, as of a wall around a room with a pillar."""

    def square(half: float) -> np.ndarray:
        corners = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)

    places = np.array([-2.5, -1.0, 0.0, 1.0, 2.5])
    found = enclosed(np.concatenate([square(0.5), square(2.0)]), places, np.array([0.0, 1.5]))
    np.testing.assert_array_equal(found, [[False, True, False, True, False], [False, True, True, True, False]])
    assert not enclosed(square(1.0)[1:2], places, places).any()  # one side alone encloses nothing


def test_a_mesh_is_filled_where_nobody_flies() -> None:
    bounds = np.array([[-1.0, -1.0, -1.0], [2.0, 2.0, 2.0]])
    world = World(name="x", bounds=bounds, obstacles=make_obstacles(mesh=cube_mesh()), keep_in=np.float64(0.1))
    for free, share in ((np.array([-0.5, -0.5, 0.5]), 1.0 / 9.0), (np.array([0.5, 0.5, 0.5]), 8.0 / 9.0)):
        axes = Figure().subplots()
        draw_world(axes, world, 2, 0.5, free)
        filled = axes.images[0].get_array()
        assert 1.0 - np.mean(np.ma.getmaskarray(filled)) == pytest.approx(share, abs=0.01)
