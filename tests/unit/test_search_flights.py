"""Which trajectories keep clear: against the traced check of the same bound, and against dense samples of the truth."""

import dataclasses

import jax
import numpy as np
import pytest

from jaxplan.minsnap.spline_batch import SplineBatch, fit
from jaxplan.planner.validator import Keep
from jaxplan.records import replace
from jaxplan.search.kernels import flights
from jaxplan.search.kernels.flights import Cut, flights_keep_clear
from jaxplan.search.kernels.solids import solids_of
from jaxplan.selection import CheckConfig, Margins, check_clearance
from jaxplan.spline import hover
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.clearance import free_distance
from jaxplan.world.load import ENVIRONMENTS, load_world
from jaxplan.world.obstacles import World
from oracles.solid_rooms import WORLDS
from tolerances import tolerance

WIDTH, CHECKS = 48, CheckConfig()
ROUNDED = {"rtol": 0.0, "atol": 1e-5}  # m; distances at a grid's nodes are single precision


def splines_in(world: World) -> SplineBatch:
    """Trajectories all over a room, some shorter than the others."""
    rng = np.random.default_rng(3)
    start = np.array([-2.2, -2.2, 1.2]) if world.start is None else np.asarray(world.start)
    steps = rng.uniform(-1.0, 1.0, (5, 3, WIDTH)) * np.array([1.0, 1.0, 0.2])[:, None] * rng.uniform(0.2, 1.5, WIDTH)
    steps[0] = 0.0
    waypoints = start[:, None] + np.cumsum(steps, axis=0)
    durations = np.linalg.norm(np.diff(waypoints, axis=0), axis=1) / rng.uniform(0.5, 5.0, WIDTH)
    durations[3, ::3] = 0.0
    with jax.enable_x64(True):
        found = jax.jit(lambda w, d: fit(hover(waypoints[0, :, 0]), w, d, 3.0))(waypoints, durations)
    return jax.tree.map(np.asarray, found)


def by_tracing(splines: SplineBatch, world: World, checks: CheckConfig) -> Margins:
    none = np.full(WIDTH, np.nan)
    unknown = Margins(
        deviation=none, clearance=none, rotor_speed=none, probability=none, reasons=np.zeros(WIDTH, np.uint32)
    )
    with jax.enable_x64(True):
        found = jax.jit(lambda m, s: check_clearance(m, s, world, load_vehicle(), checks))(unknown, splines)
    return jax.tree.map(np.asarray, found)


def looked_at(splines: SplineBatch, world: World, finer: int) -> tuple[np.ndarray, np.ndarray]:
    radius = float(load_vehicle().radius)
    keep = Keep(radius + CHECKS.tracking_margin, CHECKS.slow, CHECKS.margin_per_speed, radius + CHECKS.most_margin)
    return flights_keep_clear(
        tuple(solids_of(world)),
        np.asarray(world.bounds, float),
        np.asarray(splines.durations).T,
        np.moveaxis(np.asarray(splines.position), -1, 0),
        tuple(keep),  # type: ignore[arg-type]
        Cut(CHECKS.samples_per_segment, finer),
    )


@pytest.mark.parametrize("name", WORLDS)
def test_the_bound_is_that_of_the_traced_check(name: str) -> None:
    """Cut no finer it decides the same; the distance is the same where the whole trajectory was looked at."""
    world = WORLDS[name]()
    splines = splines_in(world)
    traced, (clear, least) = by_tracing(splines, world, CHECKS), looked_at(splines, world, 1)
    np.testing.assert_array_equal(clear, traced.reasons == 0)
    assert 2 <= clear.sum() <= WIDTH - 2
    rounded = ROUNDED if name == "grids" else tolerance("formula")
    np.testing.assert_allclose(least[clear], traced.clearance[clear], **rounded)
    assert (least[~clear] >= traced.clearance[~clear] - rounded["atol"]).all()


@pytest.mark.parametrize("name", WORLDS)
def test_what_is_clear_is_clear_everywhere(name: str) -> None:
    """Between the pieces' middles too; and what cutting all pieces more finely accepts is accepted."""
    world, radius = WORLDS[name](), float(load_vehicle().radius)
    splines = splines_in(world)
    clear, least = looked_at(splines, world, 4)
    fine = dataclasses.replace(CHECKS, samples_per_segment=4 * CHECKS.samples_per_segment)
    assert (clear | (by_tracing(splines, world, fine).reasons != 0)).all()
    assert (clear >= looked_at(splines, world, 1)[0]).all()
    distance = jax.jit(lambda points: free_distance(world, points))
    for lane in np.flatnonzero(clear):
        spline = splines.spline(int(lane))
        with jax.enable_x64(True):
            true = np.asarray(distance(spline.evaluate(np.linspace(0, float(spline.duration), 1500))[:, :3]))
        assert radius + CHECKS.tracking_margin <= least[lane] <= true.min() + 1e-9


def test_numbers_that_mean_nothing_are_not_clear() -> None:
    world = load_world("env1")
    splines = splines_in(world)
    position, durations = np.array(splines.position), np.array(splines.durations)
    good = looked_at(splines, world, 4)[0]
    position[0, 3, 1, 0], position[1, 0, 2, 1], durations[0, 2], position[0, 0, 0, 3] = np.nan, np.inf, np.nan, 1e300
    clear, _ = looked_at(replace(splines, position=position, durations=durations), world, 4)
    assert not clear[:4].any()
    np.testing.assert_array_equal(clear[4:], good[4:])


def test_one_program_serves_all_worlds_and_numbers() -> None:
    flights._compiled.cache_clear()
    for name in ENVIRONMENTS:
        world = load_world(name)
        splines = splines_in(world)
        looked_at(splines, world, 4)
        few = jax.tree.map(lambda leaf: leaf[..., :1], splines)
        looked_at(few, world, 1)
        none = jax.tree.map(lambda leaf: leaf[..., :0], splines)
        assert len(looked_at(none, world, 4)[0]) == 0
    assert len(flights._compiled().signatures) == 1  # type: ignore[attr-defined]
