"""The numbers of an episode, as they stand in ``metrics.json``."""

from typing import Any

import numpy as np

from jaxplan.interception import Episode, RealTime
from jaxplan.status import Note, PlanStatus
from jaxplan.vehicle.report import vehicle_warnings
from jaxplan.versions import installed_versions


def episode_metrics(episode: Episode) -> dict[str, Any]:
    """Outcome, errors, margins, times of the replans and what became of the candidates; plain JSON types."""
    flight, scenario = episode.flight, episode.scenario
    apart = np.linalg.norm(flight.position - flight.target, axis=1)
    end = float(flight.times[-1])
    return {
        "success": episode.success,
        "outcome": episode.outcome,
        "time_to_intercept_s": end - scenario.departure if episode.success else None,
        "end_time_s": end,
        "departure_s": scenario.departure,
        "min_distance_m": float(apart.min()),
        "meeting": _meeting(episode) if episode.success else None,
        "max_position_error_m": float(flight.position_error.max()),
        "max_yaw_error_deg": float(np.degrees(flight.yaw_error.max())),
        "max_twist_error_deg": float(np.degrees(flight.twist_error.max())),
        "min_clearance_m": float(flight.clearance.min()),
        "max_speed_m_s": float(np.linalg.norm(flight.velocity, axis=1).max()),
        "target": {
            "name": scenario.target.name,
            "read_as": scenario.target.read_as or None,
            "max_speed_m_s": scenario.target.max_speed,
            "warnings": list(scenario.target.warnings),
        },
        "replans": episode.replans,
        "replan_status": _statuses(episode),
        "predictor_fallbacks": sum(bool(cycle.note & Note.PREDICTOR_FALLBACK) for cycle in episode.cycles),
        "replan_ms": _times(episode),
        "late_replans": sum(sum(c.stage_ms.values()) > 1e3 * scenario.replanning.latency for c in episode.cycles),
        "compile_s": episode.warmup_s,
        "compilations_after_warmup": episode.compilations_after_warmup,
        "wall_s": episode.wall_s,
        "wall_over_simulated": episode.wall_s / end,
        "switch_jump": _jumps(episode),
        "candidates": _candidates(episode),
        "real_time": None if episode.real_time is None else _real_time(episode.real_time),
        "vehicle": {"name": scenario.vehicle.name, "warnings": vehicle_warnings(scenario.vehicle)},
        "seed": scenario.seed,
        "versions": installed_versions(),
    }


def _meeting(episode: Episode) -> dict[str, float]:
    """How fast the defender and the target are at the end, and how fast they close in."""
    own, other = episode.flight.velocity[-1], episode.flight.target_velocity[-1]
    return {
        "speed_m_s": float(np.linalg.norm(own)),
        "target_speed_m_s": float(np.linalg.norm(other)),
        "relative_speed_m_s": float(np.linalg.norm(own - other)),
    }


def _statuses(episode: Episode) -> dict[str, int]:
    """Cycles by what they came to."""
    values = [cycle.status for cycle in episode.cycles]
    return {status.name.lower(): values.count(status) for status in PlanStatus if status in values}


def _times(episode: Episode) -> dict[str, dict[str, float]]:
    """Wall time of the replans [ms], in total and per station; cycles without a station count 0 for it."""
    rows = [cycle.stage_ms for cycle in episode.cycles]
    if not rows:
        return {}
    stages = list(dict.fromkeys(stage for row in rows for stage in row))
    columns = {"total": [sum(row.values()) for row in rows]}
    columns |= {stage: [row.get(stage, 0.0) for row in rows] for stage in stages}
    return {
        name: {"p50": float(np.percentile(ms, 50)), "p99": float(np.percentile(ms, 99)), "max": float(np.max(ms))}
        for name, ms in columns.items()
    }


def _jumps(episode: Episode) -> dict[str, float]:
    """Largest discontinuity of the commanded trajectory over all switches: SI, and snap relative to its size."""
    jumps = [cycle.jump for cycle in episode.cycles if cycle.jump is not None]
    worst = np.max(jumps, axis=0) if jumps else np.zeros(5)
    names = ("position_m", "velocity_m_s", "acceleration_m_s2", "jerk_m_s3", "snap_relative")
    return dict(zip(names, (float(value) for value in worst), strict=True))


def _real_time(kept: RealTime) -> dict[str, Any]:
    """How long setpoints took, how late they were asked for, and how the planner's process did."""
    status = kept.status
    rows = {"setpoint_us": kept.setpoint_us, "behind_ms": kept.behind_ms}
    return {
        **{name: {f"p{q}": float(np.percentile(row, q)) for q in (50, 99, 100)} for name, row in rows.items()},
        "late_plans": status.late,
        "refused_plans": status.refused,
        "restarts": status.restarts,
        "planner_memory_mb": status.memory_mb,
    }


def _candidates(episode: Episode) -> dict[str, Any]:
    """Candidates generated over all cycles, and how many of them carry each reason."""
    rejected: dict[str, int] = {}
    for cycle in episode.cycles:
        for reason, count in cycle.rejected.items():
            rejected[reason] = rejected.get(reason, 0) + count
    return {"generated": sum(cycle.generated for cycle in episode.cycles), "rejected": rejected}
