"""A replan in ten pictures, drawn from a real one: ``python -m tools.replan_pictures`` writes docs/images/replan/.

The planner's own stations are called one after the other, as ``jaxplan.planner.build.plan_batch`` calls them, and what
each has found out is drawn. It also prints the numbers that docs/concepts.md tells.
"""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from jaxplan.config import InterceptConfig
from jaxplan.planner import Plans, select
from jaxplan.planner.parts import Parts
from jaxplan.planner.table import Table, bound, knots, reject, search, table_of
from jaxplan.precision import in_float64
from jaxplan.prediction.candidates import Candidates
from jaxplan.prediction.mixture import Prediction
from jaxplan.prediction.observations import Observations
from jaxplan.scenario import Scenario, build_scenario
from jaxplan.spline import FlatState
from jaxplan.status import Reason, count_reasons
from jaxplan.viz.episode import COMMITTED, DEFENDER, REJECTED, TARGET, USABLE
from jaxplan.viz.scene import draw_world
from jaxplan.world.occupancy import occupancy_lattices

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images" / "replan"
EPISODE = InterceptConfig(world="env1", target="env1-04", speed=2.5, predictor="gmm", departure=1.0, refine=False)
SIDE, DPI = 4.4, 80
"""Inches, dots per inch."""
FLOWN = 0.4
"""Seconds of the first plan after which the second cycle is drawn: the vehicle is on its way then."""
ALPHAS = np.geomspace(0.75, 3.0, 40)
PADDED = "#e9c46a"


class Replan(NamedTuple):
    """Everything that one replan came to, station by station."""

    scenario: Scenario
    now: float
    """Time of the cycle [s]."""
    start: FlatState
    """Where the plan begins."""
    flown: np.ndarray
    """Until then (n, 3) [m]."""
    observations: Observations
    prediction: Prediction
    candidates: Candidates
    table: Table
    """Up to the least times."""
    plans: Plans
    """Every candidate to its end."""
    best: int
    """The one that is committed."""
    times: np.ndarray
    """Until its goal [s] for each of ``ALPHAS``, by the allocation that it has its times from."""


@in_float64
def replan() -> Replan:
    """The cycle of an episode that begins ``FLOWN`` seconds after the departure."""
    scenario = build_scenario(EPISODE, exhaustive=True)
    planner, predictor = scenario.planner, scenario.predictor
    bound_to = inspect.getclosurevars(inspect.unwrap(planner.plan_batch))  # unwrapped: tests check types around it
    parts: Parts = bound_to.nonlocals["parts"]
    first = planner.plan_batch(scenario.start, predictor(_seen(scenario, scenario.departure), 0))
    spline, now = first.spline(select(first)), scenario.departure + FLOWN
    state, flown = spline.state(FLOWN), np.asarray(spline.evaluate(np.linspace(0.0, FLOWN, 40)))[:, :3]
    observations = _seen(scenario, now)
    candidates = predictor(observations, 1)
    table = reject(parts, state, table_of(candidates, parts.score(state, candidates, None)))
    rows = table.usable()
    table = bound(parts, state, knots(parts, search(parts, state, table, rows), rows), rows)
    plans = planner.plan_batch(state, candidates)
    best = select(plans)
    times, known = _times(parts, state, table, plans, best), predictor.predict(observations)
    return Replan(scenario, now, state, flown, observations, known, candidates, table, plans, best, times)


def _seen(scenario: Scenario, now: float) -> Observations:
    """What a sensor without faults has seen of the target by now."""
    times = now - scenario.stream.dt * np.arange(scenario.stream.observations)[::-1]
    return Observations(times=times, positions=scenario.target.position(times))


def _times(parts: Parts, state: FlatState, table: Table, plans: Plans, best: int) -> np.ndarray:
    """Times until the goal of one candidate, for each of ``ALPHAS``."""
    column = int(table.route[best])
    same = {
        name: np.repeat(np.asarray(value)[..., column : column + 1], len(ALPHAS), axis=-1)
        for name, value in table.routes._asdict().items()
    }
    routes, meet = table.routes._replace(**same), int(np.asarray(table.routes.meet)[column])
    each = [parts.durations_at(a, state, routes, ALPHAS)[:meet].sum(axis=0) for a in parts.allocations(state)]
    goal, alpha = float(plans.arrival_times[best]), float(plans.alpha[best])
    return min(each, key=lambda times: abs(np.interp(alpha, ALPHAS, times) - goal))


def room(done: Replan, padded: bool = False) -> tuple[Figure, Axes]:
    """The room from above, with the vehicle and what was seen of the target."""
    figure, axes = plot()
    world, start = done.scenario.world, np.asarray(done.start.pos)
    (left, low), (right, high) = np.asarray(world.bounds)[:, :2]
    if padded:
        lattice = occupancy_lattices(world, (0.1,))[0]
        cut = lattice.near_obstacle[:, :, int((start[2] - lattice.origin[2]) / lattice.resolution)].T
        image = np.ma.masked_where(~cut, np.ones(cut.shape))
        axes.imshow(image, origin="lower", extent=(left, right, low, high), cmap=ListedColormap([PADDED]), alpha=0.35)
    draw_world(axes, world, 2, float(start[2]))
    seen = done.observations.positions
    axes.plot(*seen[:, :2].T, ".", color=TARGET, markersize=5, zorder=7)
    axes.plot(*seen[-1, :2], "o", color=TARGET, markeredgecolor="white", markersize=8, zorder=8)
    axes.plot(*done.flown[:, :2].T, color=DEFENDER, lw=2.0, zorder=7)
    axes.plot(*start[:2], "o", color=DEFENDER, markeredgecolor="white", markersize=9, zorder=8)
    axes.set_aspect("equal")
    axes.set_xlim(left - 0.2, right + 0.2)
    axes.set_ylim(low - 0.2, high + 0.2)
    return figure, axes


def plot() -> tuple[Figure, Axes]:
    """An empty picture."""
    figure = Figure(figsize=(SIDE, SIDE), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.tick_params(labelsize=7)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def draw_known(done: Replan) -> Figure:
    """What is known: the room, where the vehicle is, ten positions of the target."""
    return room(done)[0]


def draw_prediction(done: Replan) -> Figure:
    """The mean of the mixture, and at every fourth step two standard deviations of its likeliest component."""
    figure, axes = room(done)
    axes.plot(*done.prediction.mean[:, :2].T, "-", color=TARGET, lw=1.2, zorder=5)
    strongest = int(np.argmax(done.prediction.log_weights))
    circle = np.stack([np.cos(np.linspace(0, 2 * np.pi, 60)), np.sin(np.linspace(0, 2 * np.pi, 60)), np.zeros(60)])
    for step in range(3, len(done.prediction.mean), 4):
        middle = np.asarray(done.prediction.means)[step, :, strongest]
        ring = middle[:, None] + 2.0 * np.asarray(done.prediction.factors)[step, :, :, strongest] @ circle
        axes.fill(*ring[:2], color=TARGET, alpha=0.15, lw=0, zorder=4)
    return figure


def draw_candidates(done: Replan) -> Figure:
    """Every goal; grey ones are no places to meet in."""
    figure, axes = room(done, padded=True)
    early = done.table.candidates.reasons | _early(done)
    _goals(axes, done, early == 0)
    return figure


def _early(done: Replan) -> np.ndarray:
    bits = Reason.GOAL_OUTSIDE | Reason.GOAL_OCCUPIED | Reason.T_GOAL_INVALID | Reason.OUT_OF_REACH
    return np.asarray(done.plans.reasons) & np.uint32(bits)


def _goals(axes: Axes, done: Replan, good: np.ndarray) -> None:
    goals = np.asarray(done.candidates.goals)
    axes.plot(*goals[~good, :2].T, "x", color=REJECTED, markersize=3, alpha=0.6, zorder=5)
    axes.plot(*goals[good, :2].T, "x", color=USABLE, markersize=3.5, zorder=6)


def draw_paths(done: Replan) -> Figure:
    """The shortest padded path to each goal."""
    figure, axes = room(done, padded=True)
    paths = done.table.paths.points[done.table.paths.count > 0]
    axes.add_collection(LineCollection(list(paths[..., :2]), colors=DEFENDER, linewidths=0.7, alpha=0.35, zorder=5))
    return figure


def draw_waypoints(done: Replan) -> Figure:
    """The best candidate's waypoints, from the start by the meeting to the stop point."""
    figure, axes = room(done, padded=True)
    points, meet = _waypoints(done)
    path = done.table.paths.points[done.table.route[done.best]]
    axes.plot(*path[:, :2].T, "-", color=REJECTED, lw=1.0, zorder=4)
    axes.plot(*points[:, :2].T, "-", color=DEFENDER, lw=1.2, zorder=5)
    axes.plot(*points[1:-1, :2].T, "s", color=DEFENDER, markersize=4, zorder=6)
    axes.plot(*points[meet, :2], "*", color=TARGET, markeredgecolor="white", markersize=14, zorder=7)
    axes.plot(*points[-1, :2], "P", color=COMMITTED, markeredgecolor="white", markersize=9, zorder=7)
    return figure


def _waypoints(done: Replan) -> tuple[np.ndarray, int]:
    routes, column = done.table.routes, int(done.table.route[done.best])
    count = int(np.asarray(routes.count)[column])
    return np.asarray(routes.waypoints)[:count, :, column], int(np.asarray(routes.meet)[column])


def draw_times(done: Replan) -> Figure:
    """The times that were allotted to the best candidate's segments, over the way."""
    figure, axes = plot()
    points, meet = _waypoints(done)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    spline = done.plans.spline(done.best)
    clock = np.concatenate([[0.0], np.cumsum(np.asarray(spline.durations)[: len(points) - 1])])
    axes.plot(way, clock, "s-", color=DEFENDER, markersize=5)
    axes.plot(way[meet], clock[meet], "*", color=TARGET, markersize=15)
    axes.plot(way[-1], clock[-1], "P", color=COMMITTED, markersize=9)
    axes.set_xlabel("way along the waypoints [m]")
    axes.set_ylabel("time [s]")
    axes.grid(alpha=0.3)
    return figure


def draw_arrival(done: Replan) -> Figure:
    """The time to the goal over the scale factor, and when the target is there."""
    figure, axes = plot()
    goal, alpha = float(done.plans.arrival_times[done.best]), float(done.plans.alpha[done.best])
    axes.plot(ALPHAS, done.times, color=DEFENDER)
    axes.axhline(goal, color=TARGET, ls=(0, (5, 1.5)))
    axes.plot(alpha, goal, "*", color=TARGET, markersize=15)
    axes.set_xlabel("scale factor alpha")
    axes.set_ylabel("time until the goal [s]")
    axes.grid(alpha=0.3)
    return figure


def _curves(done: Replan, rows: np.ndarray) -> list[np.ndarray]:
    splines = [done.plans.spline(row) for row in rows]
    return [np.asarray(s.evaluate(np.linspace(0.0, float(s.duration), 80)))[:, :2] for s in splines]


def draw_trajectories(done: Replan) -> Figure:
    """The minimum-snap trajectory of every candidate that can be reached in time."""
    figure, axes = room(done)
    curves = _curves(done, np.flatnonzero(done.plans.trajectory >= 0))
    axes.add_collection(LineCollection(curves, colors=DEFENDER, linewidths=0.7, alpha=0.35, zorder=5))
    return figure


def draw_checks(done: Replan) -> Figure:
    """The same by what the checks say."""
    figure, axes = room(done)
    for good, colour in ((False, REJECTED), (True, USABLE)):
        rows = np.flatnonzero((done.plans.trajectory >= 0) & ((np.asarray(done.plans.reasons) == 0) == good))
        lines = LineCollection(_curves(done, rows), colors=colour, linewidths=0.7, alpha=0.5, zorder=5 + good)
        axes.add_collection(lines)
    return figure


def draw_choice(done: Replan) -> Figure:
    """The plan that is committed, with the meeting, the stop point, and where the target really flies."""
    figure, axes = room(done)
    spline, arrival = done.plans.spline(done.best), float(done.plans.arrival_times[done.best])
    times = np.linspace(0.0, float(spline.duration), 200)
    axes.plot(*np.asarray(spline.evaluate(times))[:, :2].T, color=COMMITTED, lw=2.0, zorder=6)
    future = done.scenario.target.position(done.now + np.linspace(0.0, arrival, 60))
    axes.plot(*future[:, :2].T, color=TARGET, lw=1.5, ls=(0, (5, 1.5)), zorder=5)
    axes.plot(*done.plans.goals[done.best, :2], "*", color=TARGET, markeredgecolor="white", markersize=14, zorder=7)
    end = np.asarray(spline.evaluate(times[-1:]))[0]
    axes.plot(*end[:2], "P", color=COMMITTED, markeredgecolor="white", markersize=9, zorder=7)
    return figure


PICTURES: dict[str, Callable[[Replan], Figure]] = {
    "01-known": draw_known,
    "02-prediction": draw_prediction,
    "03-candidates": draw_candidates,
    "04-paths": draw_paths,
    "05-waypoints": draw_waypoints,
    "06-times": draw_times,
    "07-arrival": draw_arrival,
    "08-trajectories": draw_trajectories,
    "09-checks": draw_checks,
    "10-choice": draw_choice,
}


def numbers(done: Replan) -> dict[str, object]:
    """What the page says in numbers."""
    plans, spline = done.plans, done.plans.spline(done.best)
    return {
        "candidates": len(plans.goals),
        "left after early rejection": int((_early(done) == 0).sum()),
        "with a path": int((done.table.paths.count > 0).sum()),
        "with a trajectory": int((plans.trajectory >= 0).sum()),
        "usable": int((np.asarray(plans.reasons) == 0).sum()),
        "reasons": count_reasons(plans.reasons),
        "chosen": done.best,
        "met after [s]": round(float(plans.arrival_times[done.best]), 2),
        "alpha": round(float(plans.alpha[done.best]), 3),
        "at rest after [s]": round(float(spline.duration), 2),
        "waypoints": len(_waypoints(done)[0]),
        "probability of being tracked": round(plans.probability(done.best), 3),
        "clearance [m]": round(float(np.asarray(plans.margins.clearance)[plans.trajectory[done.best]]), 3),
    }


def main() -> None:
    """Draw all of them."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    done = replan()
    for name, draw in PICTURES.items():
        draw(done).savefig(FOLDER / f"{name}.png", dpi=DPI, pil_kwargs={"optimize": True})
    for name, value in numbers(done).items():
        print(f"{name}: {value}")


if __name__ == "__main__":
    main()
