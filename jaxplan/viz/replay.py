"""An episode to watch again: the one model behind the page, the viewer and the animations.

A replay comes from the folder of a run, from its ``plans.npz`` alone, or from an episode, which may still be flown.
``at`` says what there is to see at an instant.
"""

import dataclasses
import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt32

from jaxplan.errors import FileError, InputError
from jaxplan.files import read_limited
from jaxplan.io.cycles import SavedCycle, read_cycles, saved_cycle
from jaxplan.io.plans import SavedCommitment, SavedPlan, commanded, read_commitments, saved_commitment
from jaxplan.status import PlanStatus
from jaxplan.viz.words import GROUPS, OUTCOMES
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World, make_obstacles

if TYPE_CHECKING:
    from jaxplan.interception import Episode
    from jaxplan.scenario import Scenario

SMOOTH_RATE = 50.0
"""Samples of the flight kept a second; it is interpolated between them."""
_LARGEST_TEXT = 64 * 2**20
_USUAL_PADDING = 0.5
"""m; where a run does not say."""


@dataclasses.dataclass(frozen=True)
class Replay:
    """What happened, all of it in the world frame, metres and seconds on the episode's clock."""

    world: World
    times: Float[np.ndarray, "n"]
    position: Float[np.ndarray, "n 3"]
    """Of the defender."""
    quat_wxyz: Float[np.ndarray, "n 4"]
    """Its attitude, body to world."""
    target: Float[np.ndarray, "n 3"]
    """NaN where nobody knows it."""
    plans: tuple[SavedCommitment, ...]
    """In the order of their commitment."""
    cycles: tuple[SavedCycle, ...]
    """Empty for runs that kept none."""
    outcome: str = ""
    """As ``Episode.outcome``; empty where nobody knows it."""
    subtitle: str = ""
    padding: float = _USUAL_PADDING
    """What the planner kept from obstacles [m]."""

    @property
    def title(self) -> str:
        """What came of it, in words."""
        return OUTCOMES.get(self.outcome, self.outcome or "Plans")


class Instant(NamedTuple):
    """What there is to see at an instant; curves in metres, world."""

    time: float
    row: int
    """The newest row of the flight."""
    position: Float[np.ndarray, "3"]
    target: Float[np.ndarray, "3"]
    cycle: int
    """The newest cycle; -1 before the first one."""
    plan: int
    """The newest plan that was committed, which may not have taken over yet; -1 before the first one."""


def at(replay: Replay, time: float) -> Instant:
    """What there is to see at ``time`` [s], which is held within the flight."""
    time = float(np.clip(time, replay.times[0], replay.times[-1]))
    row = int(np.searchsorted(replay.times, time + 1e-9, side="right")) - 1
    place = [
        np.array([np.interp(time, replay.times, xs) for xs in path.T]) for path in (replay.position, replay.target)
    ]
    cycle = int(np.searchsorted([c.time for c in replay.cycles], time + 1e-9, side="right")) - 1
    return Instant(time, row, place[0], place[1], cycle, _newest_plan(replay, time, cycle))


class Curves(NamedTuple):
    """The paths that are drawn at an instant [m, world], each of p points; p may be 0."""

    flown: Float[np.ndarray, "p 3"]
    target: Float[np.ndarray, "p 3"]
    """The target's path so far."""
    plan_flown: Float[np.ndarray, "p 3"]
    """The part of the newest plan that is behind the vehicle."""
    ahead: Float[np.ndarray, "p 3"]
    """The part that will be flown, until the next plan takes over."""
    rest: Float[np.ndarray, "p 3"]
    """The part that will not, because a later plan takes over."""
    meeting: Float[np.ndarray, "p 3"]
    """Where the plan meets the target: one point or none."""
    stop: Float[np.ndarray, "p 3"]
    """Where it comes to rest: one point or none."""


def curves_at(replay: Replay, now: Instant) -> Curves:
    """The paths that are drawn at an instant."""
    rows, nothing = slice(0, now.row + 1), np.zeros((0, 3))
    flown = np.concatenate([replay.position[rows], now.position[None]])
    target = np.concatenate([replay.target[rows], now.target[None]])
    target = target[np.isfinite(target).all(axis=1)]
    if now.plan < 0:
        return Curves(flown, target, *[nothing] * 5)
    plan = replay.plans[now.plan]
    later = replay.plans[now.plan + 1].start_time if now.plan + 1 < len(replay.plans) else np.inf
    return Curves(
        flown=flown,
        target=target,
        plan_flown=_part(plan, -np.inf, now.time),
        ahead=_part(plan, now.time, later),
        rest=_part(plan, max(now.time, later), np.inf),
        meeting=meeting_point(plan),
        stop=np.asarray(plan.spline.sample(2)[1])[-1:, :3],
    )


def meeting_point(plan: SavedCommitment) -> Float[np.ndarray, "p 3"]:
    """Where a plan is when the target is expected at its goal [m]; none for plans that meet nothing."""
    since = plan.arrival_time - plan.start_time
    if plan.status != PlanStatus.INTERCEPT or not 0.0 <= since <= float(plan.spline.duration) + 1e-6:
        return np.zeros((0, 3))
    return np.asarray(plan.spline.evaluate(np.array([since])))[:, :3]


def _part(plan: SavedCommitment, since: float, until: float, points: int = 80) -> Float[np.ndarray, "p 3"]:
    """A plan from one instant to another [s]; nothing where it is not flown between them."""
    first, last = max(since, plan.start_time), min(until, plan.start_time + float(plan.spline.duration))
    if last <= first:
        return np.zeros((0, 3))
    return np.asarray(plan.spline.evaluate(np.linspace(first, last, points) - plan.start_time))[:, :3]


def groups_of(reasons: UInt32[np.ndarray, "k"]) -> Int[np.ndarray, "k"]:
    """The place of each candidate's group in ``GROUPS``."""
    found = np.zeros(len(reasons), dtype=int)
    for index in range(len(GROUPS) - 1, 0, -1):
        found[(np.asarray(reasons) & np.uint32(GROUPS[index].reasons)) != 0] = index
    return found


def replay_of(episode: "Episode", before: Replay | None = None) -> Replay:
    """The replay of an episode, and of as much of it as has been flown; what is in the one ``before`` is kept."""
    scenario, flight = episode.scenario, episode.flight
    cycles = () if before is None else before.cycles
    for index in range(len(cycles), len(episode.cycles)):
        seen = episode.observations[index] if index < len(episode.observations) else None
        cycles += (saved_cycle(episode.cycles[index], seen, index, episode.plans, scenario.predictor),)
    kept = _kept_rows(flight.times)
    return Replay(
        world=scenario.world,
        times=flight.times[kept],
        position=flight.position[kept],
        quat_wxyz=flight.quat_wxyz[kept],
        target=flight.target[kept],
        plans=tuple(saved_commitment(plan) for plan in episode.plans),
        cycles=cycles,
        outcome=episode.outcome,
        subtitle=f"world {scenario.world.name}, target {scenario.target.name}",
        padding=scenario.planner.config.padding,
    )


def replay_before(scenario: "Scenario") -> Replay:
    """The replay of an episode that has not begun: the defender hovers at its start."""
    start, target = np.asarray(scenario.start.pos, dtype=float), scenario.target.position(np.zeros(1))
    return Replay(
        world=scenario.world,
        times=np.zeros(1),
        position=start[None],
        quat_wxyz=np.array([[1.0, 0.0, 0.0, 0.0]]),
        target=target,
        plans=(),
        cycles=(),
        outcome="flying",
        subtitle=f"world {scenario.world.name}, target {scenario.target.name}",
        padding=scenario.planner.config.padding,
    )


def read_replay(source: Path) -> Replay:
    """The replay of a run's folder, or of a ``plans.npz`` on its own, flown as commanded.

    Raises:
        InputError: nothing was flown and nothing planned.
        FileError: no such folder or file, or a file in it is damaged or of another version.
    """
    folder = source if source.is_dir() else source.parent
    plans = tuple(read_commitments(source))
    whole = source.is_dir() and (folder / "flown.csv").is_file()
    config = _read_json(folder / "config.json") if whole else {}
    metrics = _read_json(folder / "metrics.json") if whole else {}
    if whole:
        times, position, quat = _read_tum(folder / "flown.csv")
        target = _target_at(folder / "target.csv", times)
    elif plans:
        times, position, quat = _as_commanded(plans)
        target = np.full_like(position, np.nan)
    else:
        raise InputError(f"{source}: holds no plan and no flight is beside it; choose another one")
    cycles = read_cycles(folder / "cycles.npz", len(plans)) if whole and (folder / "cycles.npz").is_file() else []
    kept = _kept_rows(times)
    return Replay(
        world=_world(config, folder, position, plans),
        times=times[kept],
        position=position[kept],
        quat_wxyz=quat[kept],
        target=target[kept],
        plans=plans,
        cycles=tuple(cycles),
        outcome=str(metrics.get("outcome", "")),
        subtitle=_subtitle(config, metrics) or str(source),
        padding=float(config.get("padding") or _USUAL_PADDING),
    )


def _newest_plan(replay: Replay, time: float, cycle: int) -> int:
    """The plan committed by the newest cycle up to this one that committed any; without cycles, the one in force."""
    committed = [c.plan for c in replay.cycles[: cycle + 1] if c.plan >= 0]
    in_force = int(np.searchsorted([plan.start_time for plan in replay.plans], time + 1e-9, side="right")) - 1
    return max(committed[-1] if committed else -1, in_force)


def _kept_rows(times: Float[np.ndarray, "n"]) -> Int[np.ndarray, "m"]:
    """Rows ``1 / SMOOTH_RATE`` apart, and the last one."""
    step = np.median(np.diff(times)) if len(times) > 1 else 1.0
    stride = max(round(1.0 / (SMOOTH_RATE * max(float(step), 1e-6))), 1)
    return np.unique(np.append(np.arange(0, len(times), stride), len(times) - 1))


def _read_json(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    content = read_limited(path, _LARGEST_TEXT, "a file that jaxplan intercept wrote")
    try:
        return dict(json.loads(content))
    except (ValueError, TypeError, RecursionError) as error:
        raise FileError(f"{path}: cannot be read as JSON ({error}); fly again") from error


def _read_tum(path: Path) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"]]:
    """Times [s], positions [m] and attitudes (wxyz) of a trajectory that ``write_tum`` wrote."""
    content = read_limited(path, _LARGEST_TEXT, "a trajectory that jaxplan intercept wrote")
    try:
        table = np.loadtxt(io.BytesIO(content), ndmin=2)
    except ValueError as error:
        raise FileError(f"{path}: cannot be read as a TUM trajectory ({error}); fly again") from error
    if table.shape[1:] != (8,) or not len(table) or not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0).any():
        raise FileError(f"{path}: want rows of 8 finite numbers at ascending times; fly again")
    return table[:, 0], table[:, 1:4], table[:, [7, 4, 5, 6]]


def _target_at(path: Path, times: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 3"]:
    if not path.is_file():
        return np.full((len(times), 3), np.nan)
    seen, places, _ = _read_tum(path)
    return np.stack([np.interp(times, seen, axis) for axis in places.T], axis=1)


def _as_commanded(
    plans: tuple[SavedCommitment, ...],
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"]]:
    """Times [s], positions [m] and headings (wxyz) of who follows its plans exactly, upright."""
    start, spline = commanded([SavedPlan(plan.start_time, plan.spline) for plan in plans])
    times = np.linspace(0.0, float(spline.duration), 2 + int(SMOOTH_RATE * float(spline.duration)))
    rows = np.asarray(spline.evaluate(times))
    half, zero = 0.5 * rows[:, 3], np.zeros(len(rows))
    return start + times, rows[:, :3], np.stack([np.cos(half), zero, zero, np.sin(half)], axis=1)


def _world(
    config: dict[str, Any], folder: Path, position: Float[np.ndarray, "n 3"], plans: tuple[SavedCommitment, ...]
) -> World:
    """The run's world, as named then from where the command was given; nothing but its extent where nobody says."""
    if isinstance(config.get("world"), str):
        return load_world(config["world"])
    ends = [np.asarray(plan.spline.sample(50)[1])[:, :3] for plan in plans]
    reached = np.concatenate([position, *ends])
    bounds = np.stack([reached.min(axis=0) - 1.0, reached.max(axis=0) + 1.0])
    return World(name=folder.name, bounds=bounds, obstacles=make_obstacles(), keep_in=np.float64(0.0))


def _subtitle(config: dict[str, Any], metrics: dict[str, Any]) -> str:
    """World, target, predictor and vehicle in one line."""
    target = metrics.get("target")
    found = {
        "world": Path(str(config.get("world") or "")).name,
        "target": target.get("name") if isinstance(target, dict) else config.get("target"),
        "predictor": config.get("predictor"),
        "vehicle": config.get("vehicle"),
    }
    return ", ".join(f"{name} {value}" for name, value in found.items() if value)
