"""A vehicle's fingerprint: the same for the same numbers, another for any other number, and stable over releases."""

import dataclasses
import hashlib
import struct

import numpy as np
import pytest

from jaxplan.records import replace
from jaxplan.vehicle.fingerprint import fingerprint
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle

NUMBERS = [field.name for field in dataclasses.fields(Vehicle) if field.name not in ("name", "indi", "se3")]
GAINS = [("indi", field.name) for field in dataclasses.fields(load_vehicle().indi)] + [
    ("se3", field.name) for field in dataclasses.fields(load_vehicle().se3)
]


def changed(value: object) -> object:
    """The value with its last number the next larger one; the rotors' spins with all signs turned."""
    numbers = np.array(value, dtype=np.float64)
    if numbers.shape == (4,):
        return -numbers
    numbers.flat[-1] = np.nextafter(numbers.flat[-1], np.inf)
    return tuple(numbers.tolist()) if isinstance(value, tuple) else numbers if numbers.shape else float(numbers)


def test_it_is_the_hash_of_names_and_bytes() -> None:
    vehicle = load_vehicle()
    pairs = {name: getattr(vehicle, name) for name in NUMBERS}
    pairs |= {f"{table}.{name}": getattr(getattr(vehicle, table), name) for table, name in GAINS}
    message = b""
    for name in sorted(pairs):
        numbers = [float(number) for number in np.ravel(pairs[name])]
        message += name.encode() + b"\0" + struct.pack(f"<{len(numbers)}d", *numbers)
    assert fingerprint(vehicle) == hashlib.sha256(message).hexdigest()[:16]


def test_loading_twice_another_name_and_other_types_change_nothing() -> None:
    vehicle = load_vehicle()
    assert fingerprint(load_vehicle()) == fingerprint(vehicle)
    assert fingerprint(replace(vehicle, name="another")) == fingerprint(vehicle)
    same = {name: np.asarray(getattr(vehicle, name)) for name in NUMBERS}
    assert fingerprint(replace(vehicle, **same)) == fingerprint(vehicle)
    assert fingerprint(load_vehicle("flightgoggles")) != fingerprint(vehicle)


@pytest.mark.parametrize("name", NUMBERS)
def test_every_physical_number_counts(name: str) -> None:
    vehicle = replace(load_vehicle(), rotor_speed_min=100.0)
    other = replace(vehicle, **{name: changed(getattr(vehicle, name))})
    assert fingerprint(other) != fingerprint(vehicle)


@pytest.mark.parametrize(("table", "name"), GAINS)
def test_every_gain_counts(table: str, name: str) -> None:
    vehicle = load_vehicle()
    gains = getattr(vehicle, table)
    other = replace(vehicle, **{table: dataclasses.replace(gains, **{name: changed(getattr(gains, name))})})
    assert fingerprint(other) != fingerprint(vehicle)
