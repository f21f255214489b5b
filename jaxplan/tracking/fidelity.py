"""One signature for feasibility at two fidelities: ``label(splines) -> Labels``.

Low: what the trajectory itself demands of the rotors, by flatness on dense samples; no drag, no lag, no controller.
High: a flight in closed loop. MFRL learns from many of the first and few of the second.
"""

from typing import Literal, Protocol, get_args, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, UInt32

from jaxplan.arrays import AnyArray
from jaxplan.batching import at_fixed_width
from jaxplan.errors import InputError
from jaxplan.precision import in_float64
from jaxplan.records import record
from jaxplan.spline import PiecewisePolynomial
from jaxplan.tracking.references import PaddedSplines, Splines, as_sequence, duration_of_each, padded
from jaxplan.tracking.result import Flaw
from jaxplan.tracking.track import LONGEST_FLIGHT, TrackConfig, track
from jaxplan.vehicle.limits import Feasibility, rotor_limit_margin
from jaxplan.vehicle.limits import feasibility as rotor_feasibility
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle

Fidelity = Literal["rotor-limits", "rollout"]

SAMPLES = 256
"""Instants of a flight at which the low fidelity looks, equally far apart, ends included (arbitrary)."""
PIECES = 64
"""Parts of a segment over which the rotors' demand is bounded (as ``vehicle.limits``)."""
_FLIGHTS_AT_ONCE = 256
"""Arbitrary."""


@record
class Labels:
    """One entry a trajectory, in the order given; NumPy arrays."""

    feasible: Bool[np.ndarray, "k"]
    """No reason against it."""
    reasons: UInt32[np.ndarray, "k"]
    """Bits of ``Flaw``."""
    margin: Float[np.ndarray, "k"]
    """Share of what is allowed that is left, negative where infeasible; -inf where it is not known.

    Low fidelity: of the range of rotor speeds, for the worst rotor. High: of the nearer of the two error thresholds.
    """
    decided: Bool[np.ndarray, "k"]
    """False where the low fidelity saw no violation but its bounds between the samples do not rule one out."""


@runtime_checkable
class Labeller(Protocol):
    """Labels trajectories at one fidelity."""

    def __call__(self, splines: Splines) -> Labels:
        """One entry a trajectory, in the order given."""


@runtime_checkable
class _Margins(Protocol):
    def __call__(self, splines: PaddedSplines) -> tuple[Float[AnyArray, "b"], Int[AnyArray, "b"]]:
        """The least distance [rad/s] of each flight from a rotor limit, and its ``Feasibility``."""


def build_labeller(
    fidelity: Fidelity | str, *, vehicle: Vehicle | None = None, config: TrackConfig | None = None
) -> Labeller:
    """The function that labels trajectories at one fidelity (host).

    ``config`` is for the rollout; the low fidelity has no thresholds, no noise and no controller.
    """
    if fidelity not in get_args(Fidelity):
        raise InputError(f"build_labeller: fidelity is {fidelity!r}, want one of {', '.join(get_args(Fidelity))}")
    flyer = load_vehicle() if vehicle is None else vehicle
    if fidelity == "rollout":
        chosen = TrackConfig() if config is None else config
        return lambda splines: _from_flights(splines, flyer, chosen)

    def margin(flight: PaddedSplines) -> tuple[Float[AnyArray, ""], Int[AnyArray, ""]]:
        spline = PiecewisePolynomial(**flight._asdict())
        return _rotor_margin(flyer, spline), rotor_feasibility(flyer, spline, PIECES)

    margins = jax.jit(jax.vmap(margin))
    return lambda splines: _from_demands(splines, flyer, margins)


def _from_flights(splines: Splines, vehicle: Vehicle, config: TrackConfig) -> Labels:
    result = track(splines, vehicle=vehicle, config=config)
    used = np.maximum(
        result.max_position_error / config.thresholds.position, result.max_yaw_error / config.thresholds.yaw
    )
    return Labels(feasible=result.feasible, reasons=result.reasons, margin=1.0 - used, decided=used >= 0.0)


@in_float64
def _from_demands(splines: Splines, vehicle: Vehicle, margins: _Margins) -> Labels:
    flights = as_sequence(splines)
    durations = duration_of_each(flights)
    finite = np.isfinite(durations)
    in_time = finite & (durations > 0.0) & (durations <= LONGEST_FLIGHT)
    margin, decided = np.full(len(durations), -np.inf), np.ones(len(durations), bool)
    members = np.flatnonzero(in_time)
    if len(members):
        margin[members], known = at_fixed_width(lambda some: margins(padded(flights, some)), members, _FLIGHTS_AT_ONCE)
        decided[members] = (known != Feasibility.UNDECIDED) | ~(margin[members] >= 0.0)
    reasons = (
        np.where(finite, 0, int(Flaw.NONFINITE))
        | np.where(finite & ~in_time, int(Flaw.DURATION), 0)
        | np.where(in_time & ~(margin >= 0.0), int(Flaw.ROTORS), 0)
    ).astype(np.uint32)
    scale = float(vehicle.rotor_speed_max) - float(vehicle.rotor_speed_min)
    return Labels(feasible=reasons == 0, reasons=reasons, margin=margin / scale, decided=decided)


def _rotor_margin(vehicle: Vehicle, spline: PiecewisePolynomial) -> Float[AnyArray, ""]:
    """The least distance [rad/s] from a rotor limit over ``SAMPLES`` instants; -inf where a state is not finite."""
    states = spline.state(jnp.linspace(0.0, 1.0, SAMPLES) * spline.duration)
    return jnp.min(jax.vmap(lambda state: rotor_limit_margin(vehicle, state))(states))
