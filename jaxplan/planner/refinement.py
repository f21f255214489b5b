"""A chosen plan made sooner: waypoints, durations, meeting point and stop point optimised together (host).

The policy allots times to all candidates at once, on waypoints of shortest paths. For the one that is chosen there is
time for more: a few steps of ``jaxplan.optimizer``, from that plan or from what the placing policy makes of it. The
result is checked like any plan, and only taken where it is sooner.
"""

import dataclasses

import numpy as np

from jaxplan.optimizer.interior_point import DescentConfig
from jaxplan.optimizer.problem import Limits, TargetTable, flatten
from jaxplan.planner.border import usual_candidates, usual_state
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
VIOLATION = 0.02
"""A margin of the optimiser below 0 by less counts as kept: the last look decides (arbitrary)."""
START_SPARE = 5e-3
"""m; a plan that begins closer to an obstacle than it should keeps so much less than it has there (arbitrary)."""
STILL = 1e-6
"""rad/s; a plan that begins with a turning heading is not refined: the heading of refined ones is held."""


def refine(
    parts: Parts, state: FlatState, candidates: Candidates, seed: Seed, iterations: int | None = None
) -> Refined | None:
    """A plan that is sooner than ``seed`` where there is one, checked."""
    config, expected = parts.config.refinement, None
    state, candidates = usual_state(state), usual_candidates(candidates)
    if config is not None and config.soonest <= seed.meeting and abs(float(state.yaw[1])) < STILL:
        expected = _expected(candidates)
    if config is None or parts.descend is None or expected is None:
        return None
    offset = np.asarray(seed.goal) - expected.at(seed.meeting)
    target = TargetTable(
        interval=np.asarray(expected.interval),
        position=expected.position,
        velocity=np.gradient(expected.position, expected.interval, axis=0),
        offset=offset[:, None],
    )
    radius = expected.meet_radius(seed.meeting, config)
    starts = [seed_start(seed, expected.at(seed.meeting) + offset, radius, config.segments)]
    if parts.placing is not None:
        starts.append(placed_start(*parts.placing, parts.room, state, seed, expected, offset, radius))
    descent = replace(DESCENT, iterations=config.iterations if iterations is None else iterations)
    limits = _limits(parts, state, radius, config)
    begin = np.concatenate([flatten(start).T for start in starts])
    time, least, spline = parts.descend(parts.room, state, target, limits, begin, descent)
    verdict = validate(spline, parts.room, parts.vehicle, parts.keep, _strict(parts, config), start=state)
    late = Reason.ALPHA_LT_1 if time > expected.horizon else Reason(0)
    unkept = Reason(0) if least >= -VIOLATION else Reason.LIMITS
    return Refined(
        spline=spline,
        goal=expected.at(time) + offset,
        arrival_time=time,
        score=parts.config.likelihood_weight * seed.likelihood - time,
        reasons=late | unkept | _against(verdict.faults),
        clearance=verdict.clearance,
    )


def _strict(parts: Parts, config: RefinementConfig) -> ValidatorConfig:
    """The last look's settings, for plans of which the optimiser has seen single instants only."""
    return dataclasses.replace(parts.config.validator, most_excess=config.most_excess)


def _against(faults: Fault) -> Reason:
    """What the last look has found, as reasons against a plan."""
    body = Reason.LIMITS if faults & (Fault.THRUST | Fault.ROTORS | Fault.SPEED) else Reason(0)
    place = Reason.CLEARANCE if faults & Fault.CLEARANCE else Reason(0)
    shape = Reason.NONFINITE if faults & (Fault.NONFINITE | Fault.STARTS_ELSEWHERE | Fault.NOT_SMOOTH) else Reason(0)
    return body | place | shape


def _expected(candidates: Candidates) -> Expected | None:
    """From the candidates' mean; before the first of them the target comes as fast as it goes on.

    None from fewer than two instants.
    """
    instants, means, spread = mean_motion(candidates)
    if len(instants) < 2 or instants[-1] <= 0.0:
        return None
    interval = float(instants[-1]) / (ROWS - 1)
    times = interval * np.arange(ROWS)
    position = np.stack([np.interp(times, instants, means[:, axis]) for axis in range(3)], axis=1)
    early = np.minimum(times - instants[0], 0.0)[:, None]
    position += early * (means[1] - means[0]) / (instants[1] - instants[0])
    return Expected(interval, position, np.interp(times, instants, spread))


def _limits(parts: Parts, state: FlatState, radius: float, config: RefinementConfig) -> Limits:
    """What one plan keeps to: the planner's distances and some more, or what it has where it begins."""
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
        "dilation": config.dilation,
    }
    return Limits(**{name: np.full(1, number) for name, number in numbers.items()})
