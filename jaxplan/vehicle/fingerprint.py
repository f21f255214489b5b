"""Who a vehicle is, by its numbers: what was learned or compiled for one vehicle can refuse another."""

import dataclasses
import hashlib
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from jaxplan.vehicle.params import Vehicle

_DIGITS = 16
"""Hexadecimal, 64 bits: among a million vehicles two are alike by chance with probability 3e-8."""


def fingerprint(vehicle: Vehicle) -> str:
    """Sixteen hexadecimal digits over all numbers of ``vehicle``, the same for equal vehicles of any name (host).

    SHA-256 over each number's name and its float64 bytes, little-endian, in alphabetical order. The controllers' gains
    count: whether a trajectory is followed, hence the labels of a classifier and the durations of a policy that was
    reinforced by one, depends on them as much as on the rotors. A float32 copy is another vehicle.
    """
    digest = hashlib.sha256()
    for name, numbers in sorted(_numbers(vehicle), key=lambda pair: pair[0]):
        digest.update(name.encode("ascii") + b"\0" + numbers.astype("<f8").tobytes())
    return digest.hexdigest()[:_DIGITS]


def _numbers(part: object, prefix: str = "") -> Iterator[tuple[str, Float[np.ndarray, "..."]]]:
    """Name and value of every number, gains as ``indi.position``; 0 has one sign."""
    for field in dataclasses.fields(part):  # type: ignore[arg-type]
        value = getattr(part, field.name)
        if dataclasses.is_dataclass(value):
            yield from _numbers(value, f"{prefix}{field.name}.")
        elif not isinstance(value, str):
            yield prefix + field.name, np.asarray(value, np.float64) + 0.0
