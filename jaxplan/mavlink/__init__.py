"""Streaming plans to an autopilot that speaks MAVLink: PX4 in OFFBOARD, ArduCopter in GUIDED.

``streamer`` sends setpoints at an even rate and goes from phase to phase (``records``); ``flights`` are what it sends.
``autopilot`` is what is heard, ``frames`` where the axes point, ``codec`` and ``endpoint`` the bytes and the sockets.
"""

from jaxplan.mavlink.autopilot import TargetVehicle
from jaxplan.mavlink.endpoint import Endpoint
from jaxplan.mavlink.flights import Flight, LiveFlight, PlannedFlight, saved_flight
from jaxplan.mavlink.records import Phase, StreamConfig, StreamReport
from jaxplan.mavlink.streamer import Streamer, stated

__all__ = [
    "Endpoint",
    "Flight",
    "LiveFlight",
    "Phase",
    "PlannedFlight",
    "StreamConfig",
    "StreamReport",
    "Streamer",
    "TargetVehicle",
    "saved_flight",
    "stated",
]
