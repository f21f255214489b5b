"""What may go wrong around a flight: wind, one gust, and rotors that pull less than they should.

The controller is not told. Wind enters through the drag alone, -c |v - u| (v - u); the gust is the "1 - cosine" of
FAR 25.341, u(t) = wind + gust (1 - cos 2 pi s) / 2 with s = (t - start) / duration in [0, 1].
"""

from typing import Annotated

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jaxplan.arrays import AnyArray
from jaxplan.errors import InputError
from jaxplan.numerics import safe_divide
from jaxplan.records import record

Numbers = ArrayLike | float | tuple[float, ...]
"""What NumPy makes an array of; a run-time check does not find floats and tuples in its ``ArrayLike``."""

SHAPES: dict[str, tuple[int, ...]] = {
    "wind": (3,),
    "gust": (3,),
    "gust_start": (),
    "gust_duration": (),
    "thrust_loss": (4,),
}
"""Of one flight."""


@record
class Disturbance:
    """Inputs of one flight, or of a batch with a leading axis. World frame z up, SI units; zeros are calm."""

    wind: Annotated[Numbers, "*batch 3"] = (0.0, 0.0, 0.0)
    """m/s, velocity of the air, constant."""
    gust: Annotated[Numbers, "*batch 3"] = (0.0, 0.0, 0.0)
    """m/s, added at the peak of the gust."""
    gust_start: Annotated[Numbers, "*batch"] = 0.0
    """s since the reset of the plant."""
    gust_duration: Annotated[Numbers, "*batch"] = 0.0
    """s; 0 means no gust."""
    thrust_loss: Annotated[Numbers, "*batch 4"] = (0.0, 0.0, 0.0, 0.0)
    """Share in [0, 1] of thrust and reaction torque that each rotor lacks."""

    def __post_init__(self) -> None:
        for name, shape in SHAPES.items():
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.shape[value.ndim - len(shape) :] != shape or not np.all(np.isfinite(value)):
                raise InputError(f"disturbance: {name} is {value.tolist()}, want finite numbers of shape {shape}")
            object.__setattr__(self, name, value)
        if np.any(np.less(self.gust_duration, 0.0)):
            raise InputError("disturbance: gust_duration is negative, want s >= 0")
        if np.any(np.less(self.thrust_loss, 0.0) | np.greater(self.thrust_loss, 1.0)):
            raise InputError("disturbance: thrust_loss is outside [0, 1], want the share of thrust that is lacking")


def air_velocity(disturbance: Disturbance, time: Float[AnyArray, ""]) -> Float[AnyArray, "3"]:
    """Velocity of the air [m/s, world] at ``time`` [s] of one flight."""
    begin, duration = jnp.asarray(disturbance.gust_start), jnp.asarray(disturbance.gust_duration)
    share = safe_divide(time - begin, duration, otherwise=-1.0)
    inside = (share > 0.0) & (share < 1.0)
    strength = jnp.where(inside, 0.5 * (1.0 - jnp.cos(2.0 * jnp.pi * share)), 0.0)
    return jnp.asarray(disturbance.wind) + strength * jnp.asarray(disturbance.gust)
