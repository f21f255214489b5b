"""Vehicles from TOML: one parameter a line, with unit and source. The presets beside this module are such files."""

import dataclasses
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError, InputError
from jaxplan.names import list_presets as list_presets
from jaxplan.names import require_vehicle
from jaxplan.vehicle.assumed import STANDING_IN, completed
from jaxplan.vehicle.gains import IndiGains, Se3Gains, gains_for
from jaxplan.vehicle.params import SHAPES, Vehicle, suspicions

_PRESETS = Path(__file__).parent / "presets"
_GAINS = {"indi": IndiGains, "se3": Se3Gains}
"""Optional tables of a vehicle file."""
_FIELDS = {field.name for field in dataclasses.fields(Vehicle)} - {"name", *_GAINS}
_MANDATORY = {"mass", "rotor_positions", "thrust_coefficient", "rotor_speed_max"}
"""Without these nothing else can be assumed."""


def preset(name: str) -> Vehicle:
    """One of ``list_presets``. Raises InputError for another name."""
    require_vehicle(name)
    return vehicle_from_toml(_PRESETS / f"{name}.toml")


class VehicleFile(NamedTuple):
    """A vehicle, and what its file has left to rules."""

    vehicle: Vehicle
    assumed: dict[str, str]
    """The keys that the file does not have, and the rule for each."""


def vehicle_from_toml(path: Path) -> Vehicle:
    """As ``read_vehicle``, the vehicle alone."""
    return read_vehicle(path).vehicle


def read_vehicle(path: Path) -> VehicleFile:
    """The vehicle of a TOML file with keys as in the presets, and what was assumed (``jaxplan.vehicle.assumed``).

    Gains that it does not give follow the lag of its motors (``gains_for``).

    Raises FileError for a file that cannot be read, is no quadrotor, or has numbers of other units than these.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(
            f"Cannot read the vehicle file {path} ({error}): give the path of a readable UTF-8 .toml file."
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise FileError(f"The vehicle file {path} is not TOML ({error}): start from one of the presets.") from error
    gains: dict[str, Any] = {key: _gains(path, key, table.pop(key)) for key in _GAINS if key in table}
    for key in set(table) & (_FIELDS | set(STANDING_IN)):
        _number(path, key, table[key])
    table, assumed = completed(table)
    _check_keys(path, set(table))
    values: dict[str, Any] = {key: _number(path, key, value) for key, value in table.items()}
    for suspicion in suspicions(values):
        raise FileError(f"The vehicle file {path} cannot be used: {suspicion}")
    if not gains:
        gains = gains_for(float(values["motor_time_constant"]))
        assumed["indi, se3"] = "the gains of mfrl, slowed down by the lag of the motors"
    try:
        return VehicleFile(Vehicle(name=path.stem, **(values | gains)), assumed)
    except InputError as error:
        raise FileError(f"The vehicle file {path} cannot be used: {error}") from error


def _check_keys(path: Path, have: set[str]) -> None:
    """Names all keys that are missing or not known, at once."""
    missing, unknown = sorted(_MANDATORY - have), sorted(have - _FIELDS)
    parts = [f"lacks {', '.join(map(repr, missing))}"] * bool(missing)
    parts += [f"has the unknown {', '.join(map(repr, unknown))}"] * bool(unknown)
    if parts:
        raise FileError(
            f"The vehicle file {path} {' and '.join(parts)}: want at least mass, rotor_positions or arm, and two of "
            "thrust_coefficient, rotor_speed_max, thrust_to_weight; start from one of the presets."
        )


def _gains(path: Path, key: str, table: Any) -> IndiGains | Se3Gains:
    """One table of gains; keys left out keep their defaults."""
    known = {field.name for field in dataclasses.fields(_GAINS[key])}
    if not isinstance(table, dict) or not set(table) <= known:
        raise FileError(f"The table [{key}] in the vehicle file {path} is {table!r}: its keys are {sorted(known)}.")
    try:
        return _GAINS[key](**{name: _gain(path, f"{key}.{name}", value) for name, value in table.items()})
    except InputError as error:
        raise FileError(f"The vehicle file {path} cannot be used: {error}") from error


def _gain(path: Path, key: str, value: Any) -> float | tuple[float, ...]:
    """``value`` as a float, or as a tuple of them."""
    numbers = value if isinstance(value, list) else [value]
    if not all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers):
        raise FileError(
            f"The key {key!r} in the vehicle file {path} is {value!r}: want a number, or one for each axis."
        )
    return tuple(map(float, numbers)) if isinstance(value, list) else float(value)


def _number(path: Path, key: str, value: Any) -> float | Float[np.ndarray, "..."]:
    """``value`` as a float, or as a float64 array of the shape that ``key`` has."""
    shape = SHAPES.get(key, ())
    try:
        array = np.array(value)
    except ValueError:
        array = np.array(None)
    if array.dtype.kind not in "if" or array.shape != shape:
        want = f"an array of shape {shape}" if shape else "a number"
        raise FileError(f"The key {key!r} in the vehicle file {path} is {value!r}: want {want} in SI units.")
    return array.astype(np.float64) if shape else float(array)
