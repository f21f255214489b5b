"""``jaxplan stream``: a flight to an autopilot that speaks MAVLink, planned before or in the loop."""

import contextlib
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts import App

from jaxplan.cli.cache import use_cache
from jaxplan.cli.parameters import DEFAULT_PARAMETER, with_options
from jaxplan.config import InterceptConfig, Predictor
from jaxplan.names import require_vehicle, require_world
from jaxplan.versions import require_supported_jax

if TYPE_CHECKING:
    from jaxplan.mavlink import Endpoint, Flight, StreamConfig, TargetVehicle

FIXED = ("target", "time_unit", "frame", "columns", "speed", "departure", "out")
"""Options of an interception that mean nothing where the target is a real one."""

stream = App(
    name="stream",
    help="Stream a flight to an autopilot that speaks MAVLink: PX4 in OFFBOARD, ArduCopter in GUIDED.",
    default_parameter=DEFAULT_PARAMETER,
    help_flags=["--help", "-h"],
    version_flags=[],
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class LiveConfig(InterceptConfig):
    """A pursuit of a real target."""

    predictor: Predictor = "constant-velocity"
    """How the target's future is predicted: none, constant-velocity, constant-acceleration, gmm or particles."""


@stream.default
def saved(
    source: Path,
    *,
    to: str,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    engage: bool = False,
    rate: float = 50.0,
    hold: float = 10.0,
    patience: float = 30.0,
    debug: bool = False,
) -> int:
    """Stream what was commanded in a flight of jaxplan intercept: hover at its start, the flight, rest at its end.

    Parameters
    ----------
    source
        The folder of an interception, or its plans.npz.
    to
        The autopilot: udpin:HOST:PORT to listen, udpout:HOST:PORT to speak first. PX4's simulation speaks to
        udpin:127.0.0.1:14540.
    origin
        Where the origin of the autopilot's local frame stands in the world, X Y Z [m].
    engage
        Ask for OFFBOARD (GUIDED) and arm, once the stream is heard. Otherwise a person does.
    rate
        Setpoints a second.
    hold
        Seconds for which the end is held.
    patience
        Seconds of silence, or on the way to the start, after which it is given up.
    debug
        Show the traceback of an error.
    """
    from jaxplan.mavlink import Endpoint, StreamConfig, saved_flight

    config = StreamConfig(rate=rate, origin=origin, engage=engage, hold=hold, patience=patience)
    flight = saved_flight(source)
    with Endpoint(to) as link:
        return _run(link, flight, config)


@stream.command
@with_options(LiveConfig, fixed=FIXED)
def live(
    *,
    config: LiveConfig,
    to: str,
    target_link: str | None = None,
    target_system: int | None = None,
    target_origin: tuple[float, float, float] | None = None,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    engage: bool = False,
    rate: float = 50.0,
    hold: float = 10.0,
    patience: float = 30.0,
    debug: bool = False,
) -> int:
    """Plan in the loop: pursue another vehicle that says where it is, until it is met.

    Parameters
    ----------
    to
        The autopilot: udpin:HOST:PORT to listen, udpout:HOST:PORT to speak first. PX4's simulation speaks to
        udpin:127.0.0.1:14540.
    target_link
        Where the target is heard, likewise. Default: on the same link.
    target_system
        The target's MAVLink system; needed where it is on the same link.
    target_origin
        Where the origin of its local frame stands in the world, X Y Z [m]: its LOCAL_POSITION_NED counts then.
        Default: its GLOBAL_POSITION_INT counts.
    origin
        Where the origin of the autopilot's local frame stands in the world, X Y Z [m].
    engage
        Ask for OFFBOARD (GUIDED) and arm, once the planner is ready. Otherwise a person does.
    rate
        Setpoints a second.
    hold
        Seconds for which the end is held.
    patience
        Seconds of silence, or on the way to the start, after which it is given up.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    require_world(config.world)
    require_vehicle(config.vehicle)
    use_cache()
    import numpy as np

    from jaxplan.errors import InputError
    from jaxplan.mavlink import Endpoint, LiveFlight, StreamConfig, TargetVehicle
    from jaxplan.runtime import Runtime, from_observed, settle
    from jaxplan.scenario import start_of

    if target_link is None and target_system is None:
        raise InputError("--target-system: have none, want the target's, or --target-link where it is heard")
    streaming = StreamConfig(rate=rate, origin=origin, engage=engage, hold=hold, patience=patience)
    target = TargetVehicle(target_system, None if target_origin is None else np.array(target_origin))
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(Endpoint(to))
        other = None if target_link is None else stack.enter_context(Endpoint(target_link))
        runtime = stack.enter_context(Runtime(from_observed(config), start_of(config)))
        flight = LiveFlight(runtime)
        settle()
        code = _run(link, flight, streaming, target, other)
        print(f"closest to the target: {flight.closest:.2f} m")
        return code


def _run(
    link: "Endpoint",
    flight: "Flight",
    config: "StreamConfig",
    target: "TargetVehicle | None" = None,
    target_link: "Endpoint | None" = None,
) -> int:
    """Stream until it is over, and say what came of it. ``ResourceError`` where the autopilot was taken away."""
    from jaxplan.errors import ResourceError
    from jaxplan.mavlink import Phase, Streamer, stated

    streamer = Streamer(link, flight, config, target=target, target_link=target_link, tell=_say)
    report = streamer.run()
    print("  ".join(f"{name} {value:.4g}" for name, value in stated(report).items()))
    if report.phase is Phase.RELEASED:
        raise ResourceError(f"stream: {report.reason}; the flight is not finished")
    return 0


def _say(seconds: float, text: str) -> None:
    print(f"{seconds:8.2f} s  {text}", flush=True)
