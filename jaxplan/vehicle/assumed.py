"""What a vehicle file may leave out, and what is assumed then, each by a stated rule.

Only what identifies a vehicle is mandatory: its mass, where its rotors are, and what they push. The rules are about the
middle of the presets; none is exact for any of them.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

REFERENCE = {"mass": 0.771, "inertia": 0.004, "force_noise_psd": 5.0e-4, "moment_noise_psd": 1.25e-7}
"""Of the preset mfrl, whose noise is scaled."""

STANDING_IN = ("arm", "thrust_to_weight")
"""Keys that stand for others."""


class Rule(NamedTuple):
    """A value for a key that was left out."""

    value: Any
    reason: str


def completed(table: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """A vehicle's table with every key that can be derived, and for each of these keys the rule.

    ``arm`` [m] stands for ``rotor_positions`` of an X layout, ``thrust_to_weight`` for one of ``thrust_coefficient``
    and ``rotor_speed_max``, or for both. What is no number stays as it is: whoever reads the table says what is wrong.
    """
    found, rules = dict(table), {}

    def assume(key: str, rule: Rule | None) -> None:
        if key not in found and rule is not None:
            found[key] = rule.value
            rules[key] = rule.reason

    arm = found.pop("arm", None)
    if _positive(arm):
        side = arm / math.sqrt(2.0)
        corners = [[side, side, 0.0], [side, -side, 0.0], [-side, -side, 0.0], [-side, side, 0.0]]
        assume("rotor_positions", Rule(corners, "an X layout, front left first"))
    assume("gravity", Rule(9.81, "standard"))
    _thrust(found, found.pop("thrust_to_weight", None), assume)
    for key, rule in _rules(found).items():
        assume(key, rule)
    _noise(found, assume)
    return found, rules


def _thrust(table: dict[str, Any], ratio: Any, assume: Any) -> None:
    """What is missing of the thrust."""
    if not (_positive(ratio) and _positive(table.get("mass")) and _positive(table.get("gravity"))):
        return
    if "thrust_coefficient" not in table:
        assume("rotor_speed_max", Rule(2000.0, "any number will do, where the thrust is given by thrust_to_weight"))
    full = ratio * table["mass"] * table["gravity"] / 4.0
    if _positive(table.get("rotor_speed_max")):
        assume("thrust_coefficient", Rule(full / table["rotor_speed_max"] ** 2, "thrust_to_weight"))
    elif _positive(table.get("thrust_coefficient")):
        assume("rotor_speed_max", Rule(math.sqrt(full / table["thrust_coefficient"]), "thrust_to_weight"))


def _rules(table: Mapping[str, Any]) -> dict[str, Rule | None]:
    """By size and mass; None where these are not known."""
    arm, mass, lift = _arm(table), table.get("mass", 0.0), table.get("thrust_coefficient", 0.0)
    sized = arm is not None and _positive(mass)
    share = mass * (arm or 0.0) ** 2 if sized else 0.0
    return {
        "rotor_spin": Rule([1.0, -1.0, 1.0, -1.0], "neighbours turn against each other"),
        "inertia": Rule([0.25 * share, 0.25 * share, 0.45 * share], "0.25, 0.25, 0.45 mass arm^2") if sized else None,
        "torque_coefficient": Rule(0.016 * lift, "0.016 m times the thrust") if _positive(lift) else None,
        "rotor_inertia": Rule(0.0, "neglected"),
        "motor_time_constant": Rule(0.03, "0.03 s"),
        "rotor_speed_min": Rule(0.0, "rotors may stand still"),
        "drag_coefficient": Rule(5.0 * arm**2, "5 N/(m/s)^2 times arm^2") if arm is not None else None,
        "aero_moment_coefficient": Rule(0.0, "neglected"),
        "accelerometer_variance": Rule(0.005, "as mfrl"),
        "gyroscope_variance": Rule(0.003, "as mfrl"),
        "radius": Rule(1.55 * arm, "1.55 times the arm") if arm is not None else None,
    }


def _noise(table: dict[str, Any], assume: Any) -> None:
    """White force and moment: those of mfrl, by mass and inertia squared."""
    for key, by in (("force_noise_psd", "mass"), ("moment_noise_psd", "inertia")):
        try:
            size = float(np.max(np.asarray(table.get(by), dtype=float)))
        except (TypeError, ValueError):
            continue
        if _positive(size):
            assume(key, Rule(REFERENCE[key] * (size / REFERENCE[by]) ** 2, f"as mfrl, by {by} squared"))


def _arm(table: Mapping[str, Any]) -> float | None:
    """Mean distance of the rotors [m]; None where it is not known."""
    try:
        positions = np.asarray(table.get("rotor_positions"), dtype=float)
        return float(np.linalg.norm(positions, axis=1).mean()) if positions.shape == (4, 3) else None
    except (TypeError, ValueError):
        return None


def _positive(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0.0 < value < math.inf
