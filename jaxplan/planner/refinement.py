"""A chosen plan made sooner: waypoints, durations, meeting point and stop point optimised together (host).

The policy allots times to all candidates at once, on waypoints of shortest paths. For the one that is chosen there is
time for more: a few steps of ``jaxplan.optimizer``, from that plan or from what the placing policy makes of it. The
result is checked like any plan, and only taken where it is sooner.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.optimizer.interior_point import DescentConfig
from jaxplan.optimizer.problem import Limits, TargetTable, flatten, slowed
from jaxplan.planner.border import usual_candidates, usual_state
from jaxplan.planner.descent import Descended
from jaxplan.planner.parts import Parts
from jaxplan.planner.refined import Refined, RefinementConfig, Seed
from jaxplan.planner.starts import Expected, placed_start, seed_start
from jaxplan.planner.validator import Fault, ValidatorConfig, validate
from jaxplan.prediction.candidates import Candidates, mean_motion
from jaxplan.records import replace
from jaxplan.spline import FlatState
from jaxplan.status import Reason

ROWS = 48
"""Instants of the target's motion that the optimiser is told, evenly to the last candidates' (arbitrary)."""
DESCENT = DescentConfig(barrier=3e-3, rate=0.75, slack=0.1)
"""From plans that the policy allotted times to; found by trying on 33 of them (docs/decisions/0028)."""
LATER = 1.3
"""How much longer than until a late meeting the target is taken to wait (arbitrary)."""
VIOLATION = 0.02
"""A margin of the optimiser below 0 by less counts as kept: the last look decides (arbitrary)."""
START_SPARE = 5e-3
"""m; a plan that begins closer to an obstacle than it should keeps so much less than it has there (arbitrary)."""
CAUTION = (1.0, 1.06, 1.19, 1.33)
"""How many times as fast the body must be able to fly a plan, try by try, until the last look and the model agree that
it can fly it (docs/decisions/0058)."""
STILL = 1e-6
"""rad/s; a plan that begins with a turning heading is not refined: the heading of refined ones is held."""


class _Asked(NamedTuple):
    """One interception to be made sooner."""

    expected: Expected
    offset: Float[np.ndarray, "3"]
    """Of the target that is met from the expected one [m]."""
    radius: float
    """Within which it must be passed [m]."""
    starts: Float[np.ndarray, "k v"]
    """Where the descent may begin."""

    def target(self) -> TargetTable:
        """The expected motion as the descent takes it."""
        position, interval = self.expected.position, self.expected.interval
        velocity = np.gradient(position, interval, axis=0)
        return TargetTable(
            interval=np.asarray(interval), position=position, velocity=velocity, offset=self.offset[:, None]
        )


def refine(
    parts: Parts, state: FlatState, candidates: Candidates, seed: Seed, iterations: int | None = None
) -> Refined | None:
    """A plan that is sooner than ``seed`` where there is one, checked.

    Where the vehicle cannot fly it, by the last look or its model, it is looked for again, more cautiously, if there is
    time.
    """
    config = parts.config.refinement
    state, candidates = usual_state(state), usual_candidates(candidates)
    if config is None or parts.descend is None or seed.meeting < config.soonest or abs(float(state.yaw[1])) >= STILL:
        return None
    asked = _asked(parts, state, candidates, seed, config)
    if asked is None:
        return None
    steps = config.iterations if iterations is None else iterations
    descent, target, starts, promise = replace(DESCENT, iterations=steps), asked.target(), asked.starts, np.inf
    for caution, more in zip(CAUTION, (*CAUTION[1:], CAUTION[-1]), strict=True):
        limits = _limits(parts, state, asked.radius, config, caution)
        found = parts.descend(parts.room, state, target, limits, starts, descent)
        promise = min(promise, found.time)
        refined = _judged(parts, state, asked, found, seed, promise)
        if steps < config.iterations or not _is_too_fast(refined, found):
            break
        starts = np.concatenate([slowed(found.variables, more / caution)[None], asked.starts])
    return refined


def _asked(
    parts: Parts, state: FlatState, candidates: Candidates, seed: Seed, config: RefinementConfig
) -> _Asked | None:
    """None where the target's motion is not known."""
    expected = _expected(candidates, LATER * seed.meeting if seed.late else 0.0)
    if expected is None:
        return None
    offset = np.asarray(seed.goal) - expected.at(seed.meeting)
    radius = expected.meet_radius(seed.meeting, config)
    starts = [seed_start(seed, expected.at(seed.meeting) + offset, radius, config.segments)]
    if parts.placing is not None:
        place, numbers, _ = parts.placing
        starts.append(placed_start(place, numbers, parts.room, state, seed, expected, offset, radius))
    return _Asked(expected, offset, radius, np.concatenate([flatten(start).T for start in starts]))


def _judged(parts: Parts, state: FlatState, asked: _Asked, found: Descended, seed: Seed, promise: float) -> Refined:
    """What a descent has found, with all that is against it; the model flies what is good otherwise."""
    config, time, spline = parts.config.refinement, found.time, found.spline
    assert config is not None
    verdict = validate(spline, parts.room, parts.body, parts.keep, _strict(parts, config), start=state)
    late = Reason.ALPHA_LT_1 if time > asked.expected.horizon and not seed.late else Reason(0)
    unkept = Reason(0) if found.least >= -VIOLATION else Reason.LIMITS
    reasons = late | unkept | _against(verdict.faults)
    if not reasons and parts.flyer is not None and not parts.flyer.follows(spline):
        reasons = Reason.UNTRACKABLE
    return Refined(
        spline=spline,
        goal=asked.expected.at(time) + asked.offset,
        arrival_time=time,
        score=parts.config.likelihood_weight * seed.likelihood - time,
        reasons=reasons,
        clearance=verdict.clearance,
        promise=promise,
        steps=found.steps,
    )


def _is_too_fast(refined: Refined, found: Descended) -> bool:
    """Whether the descent has kept its margins, but the vehicle cannot fly what it found."""
    return found.least >= -VIOLATION and refined.reasons in (Reason.LIMITS, Reason.UNTRACKABLE)


def _strict(parts: Parts, config: RefinementConfig) -> ValidatorConfig:
    """The last look's settings, for plans of which the optimiser has seen single instants only."""
    return dataclasses.replace(parts.config.validator, most_excess=config.most_excess)


def _against(faults: Fault) -> Reason:
    """What the last look has found, as reasons against a plan."""
    unable = Fault.THRUST | Fault.ROTORS | Fault.SPEED | Fault.FALLING
    body = Reason.LIMITS if faults & unable else Reason(0)
    place = Reason.CLEARANCE if faults & Fault.CLEARANCE else Reason(0)
    shape = Reason.NONFINITE if faults & (Fault.NONFINITE | Fault.STARTS_ELSEWHERE | Fault.NOT_SMOOTH) else Reason(0)
    return body | place | shape


def _expected(candidates: Candidates, until: float) -> Expected | None:
    """From the candidates' mean, at least ``until`` so long [s]; None from fewer than two instants.

    Before the first of them the target comes as fast as it goes on, behind the last one it waits.
    """
    instants, means, spread = mean_motion(candidates)
    if len(instants) < 2 or instants[-1] <= 0.0:
        return None
    horizon = float(instants[-1])
    interval = max(horizon, until) / (ROWS - 1)
    times = interval * np.arange(ROWS)
    position = np.stack([np.interp(times, instants, means[:, axis]) for axis in range(3)], axis=1)
    early = np.minimum(times - instants[0], 0.0)[:, None]
    position += early * (means[1] - means[0]) / (instants[1] - instants[0])
    return Expected(interval, position, np.interp(times, instants, spread), horizon)


def _limits(parts: Parts, state: FlatState, radius: float, config: RefinementConfig, caution: float) -> Limits:
    """What one plan keeps to: the planner's distances and some more, or what it has where it begins.

    The body must be able to fly it ``caution`` times as fast as usually.
    """
    keep = parts.keep
    speed = float(np.linalg.norm(np.asarray(state.vel)))
    own = float(parts.room.free_distance(np.asarray(state.pos)[None])[0])
    spare = min(config.spare, own - float(keep.at(np.array([speed]))[0]) - START_SPARE)
    numbers = {
        "clearance": keep.least + spare,
        "slow": keep.slow,
        "per_speed": keep.per_speed,
        "most": keep.most - keep.least,
        "meet_radius": radius,
        "dilation": config.dilation * caution,
    }
    return Limits(**{name: np.full(1, number) for name, number in numbers.items()})
