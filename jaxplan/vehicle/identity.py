"""Which vehicle something was learned for, and the refusal of another one.

A policy's durations and a classifier's probabilities hold for one vehicle with its gains. For another one they are
wrong without looking wrong: plans that it cannot follow come with a probability near 1. So both carry a ``VehicleId``,
in memory and in their files, and whoever brings them together with a vehicle calls ``require_same_vehicle``.
"""

import dataclasses
from typing import Any

import jax

from jaxplan.errors import InputError
from jaxplan.vehicle.fingerprint import fingerprint
from jaxplan.vehicle.params import Vehicle


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class VehicleId:
    """Who a vehicle is. Static in JAX: part of the structure of what holds it."""

    name: str
    """For messages; two vehicles of one name may differ."""
    fingerprint: str
    """Of its numbers (``jaxplan.vehicle.fingerprint``): what decides."""

    def __str__(self) -> str:
        """Name and fingerprint, for messages."""
        return f"{self.name!r} ({self.fingerprint})"


UNSTATED = VehicleId("mfrl", "5b2e9036461ad816")
"""For whom files without a vehicle in their header were made: until headers had one, weights were shipped for the
preset ``mfrl`` alone."""


def identify(vehicle: Vehicle) -> VehicleId:
    """Name and fingerprint of a vehicle (host)."""
    return VehicleId(vehicle.name, fingerprint(vehicle))


def to_header(vehicle: Vehicle | VehicleId) -> dict[str, str]:
    """The vehicle as it stands in the header of a file."""
    return dataclasses.asdict(vehicle if isinstance(vehicle, VehicleId) else identify(vehicle))


def from_header(header: dict[str, Any]) -> VehicleId:
    """For whom the file with this ``header`` was made; ``UNSTATED`` where it does not say so.

    Raises:
        ValueError: the entry is there, but is no name and fingerprint.
    """
    if "vehicle" not in header:
        return UNSTATED
    stated = header["vehicle"]
    known = {field.name for field in dataclasses.fields(VehicleId)}
    if not isinstance(stated, dict) or set(stated) != known or not all(isinstance(v, str) for v in stated.values()):
        raise ValueError(f"vehicle is {stated!r}")
    return VehicleId(**stated)


def require_same_vehicle(what: str, made_for: VehicleId | None, vehicle: Vehicle) -> None:
    """Raise ``InputError`` where ``what`` was made for another vehicle than the one it is to serve (host).

    Args:
        what: names it in the message, for instance "policy 'mfrl'".
        made_for: None serves every vehicle.
        vehicle: compared by its numbers; its name does not matter.
    """
    if made_for is None:
        return
    given = identify(vehicle)
    if made_for.fingerprint != given.fingerprint:
        raise InputError(
            f"{what}: was made for vehicle {made_for}, have vehicle {given}; train one for it (jaxplan train dataset "
            "--vehicle FILE, then pretrain and mfrl), or plan without: no-policy, no classifier"
        )
