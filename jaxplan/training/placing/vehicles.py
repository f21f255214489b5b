"""Vehicles of all sizes, and what the placing policy and its loss need to know of each."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.policy.placing import vehicle_numbers
from jaxplan.records import replace
from jaxplan.vehicle.assumed import completed
from jaxplan.vehicle.gains import gains_for
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.report import LAGS, MASSES, RATIOS, usual_arm

ARMS = (0.8, 1.25)
"""By which arms differ from the usual one."""


class Fleet(NamedTuple):
    """v vehicles, with a leading axis (``of``: chosen ones, batch axis last where there is more than one number)."""

    vehicles: Vehicle
    numbers: Float[AnyArray, "v 6"]

    def of(self, members: Int[AnyArray, "k"]) -> "Fleet":
        """Some of them, by their index; a vehicle may be chosen more than once."""
        return jax.tree.map(lambda leaf: leaf[members], self)


def random_vehicle(rng: np.random.Generator) -> Vehicle:
    """One that is given by mass, arm, thrust and lag alone, evenly spread on a logarithmic scale."""
    mass, ratio, lag, arm = (float(np.exp(rng.uniform(*np.log(span)))) for span in (MASSES, RATIOS, LAGS, ARMS))
    table = {"mass": mass, "arm": arm * usual_arm(mass)}
    table |= {"thrust_to_weight": ratio, "motor_time_constant": lag}
    values, _ = completed(table)
    numbers = {key: np.asarray(value, float) if isinstance(value, list) else value for key, value in values.items()}
    given: dict[str, Any] = numbers | gains_for(lag)
    return Vehicle(name="random", **given)


def fleet(vehicles: list[Vehicle]) -> Fleet:
    """All of them, in float32; their names and gains, which nothing here depends on, are the first one's."""
    kept = {"name": "", "indi": vehicles[0].indi, "se3": vehicles[0].se3}
    nameless = [replace(vehicle, **kept) for vehicle in vehicles]
    stacked = jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf, np.float32) for leaf in leaves]), *nameless)
    return Fleet(stacked, np.stack([vehicle_numbers(vehicle) for vehicle in vehicles]).astype(np.float32))
