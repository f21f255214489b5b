"""Bytes, sockets and frames of the MAVLink streamer, against the protocol's specification."""

import math
import socket
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jaxplan.errors import InputError, ResourceError
from jaxplan.mavlink.autopilot import Autopilot, TargetVehicle
from jaxplan.mavlink.codec import Codec
from jaxplan.mavlink.endpoint import Endpoint
from jaxplan.mavlink.flights import PlannedFlight
from jaxplan.mavlink.frames import NedSetpoint, Reference, rotated, to_ned
from jaxplan.mavlink.streamer import Streamer
from jaxplan.runtime import Setpoint
from oracles import mavlink_wire as wire
from oracles.mavlink_cases import free_port, straight
from oracles.mavlink_wire import encode
from tolerances import relative, tolerance

pytest.importorskip("pymavlink")
EVERY_FLOAT = st.floats(-1e6, 1e6, width=32)


def codec() -> Codec:
    return Codec(245, 191)


def test_the_oracle_knows_the_published_checksum_bytes() -> None:
    """As MAVLink's own generated headers list them."""
    known = {"HEARTBEAT": 50, "LOCAL_POSITION_NED": 185, "GLOBAL_POSITION_INT": 104, "GPS_GLOBAL_ORIGIN": 39}
    known |= {"COMMAND_LONG": 152, "COMMAND_ACK": 143, "SET_POSITION_TARGET_LOCAL_NED": 143, "ODOMETRY": 91}
    assert {name: wire.extra(name) for name in wire.DEFINITIONS} == known


@given(values=st.lists(EVERY_FLOAT, min_size=11, max_size=11), seconds=st.floats(0.0, 4e6))
def test_a_setpoint_by_value_in_single_precision(values: list[float], seconds: float) -> None:
    rows = np.array(values[:9]).reshape(3, 3)
    message = wire.decode(codec().setpoint(seconds, 7, 1, NedSetpoint(*rows, values[9], values[10])))
    assert (message.name, message.system, message.component) == ("SET_POSITION_TARGET_LOCAL_NED", 245, 191)
    names = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
    assert [message.fields[name] for name in names] == values
    assert message.fields["type_mask"] == 0
    assert message.fields["coordinate_frame"] == 1
    assert (message.fields["target_system"], message.fields["target_component"]) == (7, 1)
    assert message.fields["time_boot_ms"] == int(1e3 * seconds) % 2**32


def test_heartbeats_and_commands() -> None:
    both = codec()
    beat, ask = wire.decode(both.heartbeat()), wire.decode(both.command(1, 1, 176, 1, 6, 0))
    assert (beat.name, beat.fields["type"], beat.fields["autopilot"], beat.fields["mavlink_version"]) == (
        "HEARTBEAT",
        18,
        8,
        3,
    )
    assert [ask.fields[f"param{number}"] for number in range(1, 8)] == [1, 6, 0, 0, 0, 0, 0]
    assert (beat.sequence, ask.sequence) == (0, 1)


def test_several_frames_in_a_datagram_and_damaged_ones() -> None:
    good = encode("HEARTBEAT", 1, 1, 0, autopilot=12)
    unknown = bytearray(good)
    unknown[7:10] = b"\xff\xff\x00"
    reader = codec()
    assert [m.get_type() for m in reader.decode(good + good)] == ["HEARTBEAT", "HEARTBEAT"]
    assert reader.damaged == 0
    damaged = bytearray(good)
    damaged[-1] ^= 1
    assert [m.get_type() for m in reader.decode(bytes(damaged) + good)] == ["HEARTBEAT"]
    assert reader.damaged == 1
    assert not [m for m in reader.decode(bytes(unknown)) if m.get_type() == "HEARTBEAT"]
    for content in (b"", b"x", b"\xfd" * 3, good[:-1], b"GET / HTTP/1.1\r\n", b"\xfd\xff" + bytes(20)):
        assert reader.decode(content) == []


@given(st.binary(max_size=300))
def test_no_datagram_is_trouble(content: bytes) -> None:
    codec().decode(content)


def setpoint(**values: object) -> Setpoint:
    derivatives, yaw = np.zeros((5, 3)), np.zeros(3)
    derivatives[:3] = [values.get(name, np.zeros(3)) for name in ("position", "velocity", "acceleration")]
    yaw[:2] = values.get("yaw", 0.0), values.get("yaw_rate", 0.0)
    return Setpoint(0.0, derivatives, yaw)


def test_north_east_down_by_value() -> None:
    """1 m east, 2 m north, 3 m up of an origin at (10, 20, 0.5), looking east and turning left."""
    given = setpoint(
        position=np.array([11.0, 22.0, 3.5]),
        velocity=np.array([4.0, 5.0, 6.0]),
        acceleration=np.array([7.0, 8.0, 9.0]),
        yaw=0.0,
        yaw_rate=0.3,
    )
    found = to_ned(given, np.array([10.0, 20.0, 0.5]))
    assert found.position.tolist() == [2.0, 1.0, -3.0]
    assert found.velocity.tolist() == [5.0, 4.0, -6.0]
    assert found.acceleration.tolist() == [8.0, 7.0, -9.0]
    assert (found.yaw, found.yaw_rate) == (0.5 * np.pi, -0.3)


@given(st.floats(-100.0, 100.0))
def test_yaw_is_wrapped_and_points_the_same_way(yaw: float) -> None:
    """As seen from above: east is sin in one convention, cos in the other."""
    found = to_ned(setpoint(yaw=yaw), np.zeros(3)).yaw
    assert -math.pi < found <= math.pi
    np.testing.assert_allclose([np.sin(found), np.cos(found)], [np.cos(yaw), np.sin(yaw)], **tolerance("formula"))


def test_places_on_the_globe_against_spherical_trigonometry() -> None:
    """Distance by haversines, direction by the bearing's own formula; over a room exact to the millimetre."""
    rng = np.random.default_rng(0)
    reference = Reference(math.radians(47.4), math.radians(8.5), 400.0)
    for scale in (1e-7, 1e-5, 1e-3):
        latitude, longitude = math.radians(47.4) + scale * rng.normal(), math.radians(8.5) + scale * rng.normal()
        north, east, down = reference.north_east_down(latitude, longitude, 410.0)
        half = np.sin((latitude - reference.latitude) / 2.0) ** 2
        half += np.cos(latitude) * np.cos(reference.latitude) * np.sin((longitude - reference.longitude) / 2.0) ** 2
        apart = 2.0 * 6_371_000.0 * np.arcsin(np.sqrt(half))
        assert math.hypot(north, east) == pytest.approx(apart, **relative("solve"))
        across = np.cos(reference.latitude) * np.sin(latitude)
        across -= np.sin(reference.latitude) * np.cos(latitude) * np.cos(longitude - reference.longitude)
        bearing = math.atan2(np.sin(longitude - reference.longitude) * np.cos(latitude), across)
        assert math.atan2(east, north) == pytest.approx(bearing, **relative("solve"))
        assert down == -10.0
    assert reference.north_east_down(reference.latitude, reference.longitude, 400.0).tolist() == [0.0, 0.0, 0.0]


def test_vectors_are_turned_as_quaternions_say() -> None:
    quat, vector = np.array([0.5, -0.1, 0.7, 0.5]), np.array([1.0, 2.0, 3.0])
    quat = quat / np.linalg.norm(quat)
    wanted = Rotation.from_quat(quat, scalar_first=True).apply(vector)
    np.testing.assert_allclose(rotated(quat, vector), wanted, **tolerance("formula"))


def hear(
    listener: Autopilot, name: str, now: float = 1.0, system: int = 1, component: int = 1, **fields: object
) -> None:
    for message in codec().decode(encode(name, system, component, 0, **fields)):
        listener.hear(message, 1.0)


def px4(origin: list[float], other: int | None = None) -> Autopilot:
    listener = Autopilot(np.array(origin), other)
    hear(listener, "HEARTBEAT", autopilot=12, base_mode=128, custom_mode=6 << 16)
    return listener


def test_what_an_autopilot_says() -> None:
    listener = px4([10.0, 20.0, 0.0])
    assert listener.engaged
    hear(listener, "LOCAL_POSITION_NED", x=2.0, y=1.0, z=-3.0, vx=5.0, vy=4.0, vz=-6.0)
    assert listener.vehicle.position.tolist() == [11.0, 22.0, 3.0]
    assert listener.vehicle.velocity.tolist() == [4.0, 5.0, 6.0]
    hear(listener, "LOCAL_POSITION_NED", x=math.nan)
    hear(listener, "LOCAL_POSITION_NED", system=2)
    hear(listener, "LOCAL_POSITION_NED", component=100)
    assert listener.vehicle.position.tolist() == [11.0, 22.0, 3.0]
    for mode, armed in ((4 << 16, 128), (6 << 16, 0)):
        hear(listener, "HEARTBEAT", autopilot=12, base_mode=armed, custom_mode=mode)
        assert not listener.engaged


def test_odometry_has_its_velocity_in_the_body_or_not() -> None:
    """Looking east (yaw 90 degrees from north) and flying 2 m/s ahead is flying east."""
    half = math.sqrt(0.5)
    for child, velocity in ((12, {"vx": 2.0}), (1, {"vy": 2.0})):
        listener = px4([0.0, 0.0, 0.0])
        fields = {"frame_id": 1, "child_frame_id": child, "q": [half, 0.0, 0.0, half], "x": 1.0}
        hear(listener, "ODOMETRY", **fields, **velocity)
        np.testing.assert_allclose(listener.vehicle.velocity, [2.0, 0.0, 0.0], **tolerance("formula", np.float32))
        assert listener.vehicle.position.tolist() == [0.0, 1.0, 0.0]
    listener = px4([0.0, 0.0, 0.0])
    hear(listener, "ODOMETRY", frame_id=20, child_frame_id=12, q=[1.0, 0.0, 0.0, 0.0])
    hear(listener, "ODOMETRY", frame_id=1, child_frame_id=99, q=[1.0, 0.0, 0.0, 0.0])
    assert listener.vehicle is None
    assert listener.other_frames == {20, 99}


def test_who_is_the_autopilot() -> None:
    listener = Autopilot(np.zeros(3), other=2)
    hear(listener, "HEARTBEAT", system=2, autopilot=12)
    hear(listener, "HEARTBEAT", system=255, component=190, autopilot=8)
    assert listener.kind is None
    hear(listener, "HEARTBEAT", system=3, autopilot=3, base_mode=128, custom_mode=4)
    assert (listener.kind.name, listener.system, listener.engaged) == ("ArduPilot", 3, True)
    with pytest.raises(ResourceError, match="have MAV_AUTOPILOT 0, want PX4"):
        hear(Autopilot(np.zeros(3)), "HEARTBEAT", autopilot=0)


def test_a_target_on_the_globe_and_in_its_own_frame() -> None:
    listener, globe = px4([10.0, 20.0, 1.0]), TargetVehicle(2, None)
    own = TargetVehicle(None, np.array([1.0, 2.0, 0.0]))
    lat, lon = 474_000_000, 85_000_000

    def say(name: str, **fields: object) -> None:
        for message in codec().decode(encode(name, 2, 1, 0, **fields)):
            globe.hear(message, 1.0, listener)
            own.hear(message, 1.0, listener)

    say("GLOBAL_POSITION_INT", lat=lat, lon=lon)
    assert globe.seen is None, "where the autopilot counts from is not known yet"
    hear(listener, "GPS_GLOBAL_ORIGIN", latitude=lat, longitude=lon, altitude=400_000)
    metre = 1e7 * math.degrees(1.0 / 6_371_000.0)
    east = round(30.0 * metre / math.cos(math.radians(47.4)))
    say("GLOBAL_POSITION_INT", lat=lat + round(40.0 * metre), lon=lon + east, alt=405_000, vx=100, vy=200, vz=-300)
    np.testing.assert_allclose(globe.seen.position, [40.0, 60.0, 6.0], rtol=0.0, atol=0.02)  # 1e-7 degrees are 1 cm
    np.testing.assert_allclose(globe.seen.velocity, [2.0, 1.0, 3.0], **tolerance("exact"))
    say("LOCAL_POSITION_NED", x=5.0, y=6.0, z=-7.0, vx=1.0)
    assert own.seen.position.tolist() == [7.0, 7.0, 7.0]
    assert own.seen.velocity.tolist() == [0.0, 1.0, 0.0]
    for message in codec().decode(encode("LOCAL_POSITION_NED", 1, 1, 0)):
        own.hear(message, 2.0, listener)
    assert own.seen.time == 1.0, "the autopilot's own place is not the target's"


def test_a_listener_answers_who_spoke() -> None:
    with Endpoint(f"udpin:127.0.0.1:{free_port()}") as ours, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.settimeout(2.0)
        assert not ours.reachable
        assert not ours.send(b"nobody is there")
        assert ours.receive() == []
        other.sendto(b"hello", ("127.0.0.1", ours.port))
        assert ours.receive() == [b"hello"]
        assert ours.send(b"welcome")
        assert other.recv(100) == b"welcome"


def test_nobody_at_the_other_end_is_no_error() -> None:
    with Endpoint(f"udpout:127.0.0.1:{free_port()}") as ours:
        for _ in range(5):
            ours.send(b"anyone")
            assert ours.receive() == []


@pytest.mark.parametrize(
    "name",
    ["", "udpin", "udp:127.0.0.1:1", "udpout:127.0.0.1", "udpin:h:0", "udpin:h:70000", "serial:/dev/ttyS0:9"],
)
def test_names_that_are_none(name: str) -> None:
    with pytest.raises(InputError, match="want udpin:HOST:PORT"):
        Endpoint(name)


def test_a_port_that_is_taken_and_a_host_that_is_not_there() -> None:
    with Endpoint(f"udpin:127.0.0.1:{free_port()}") as first, pytest.raises(ResourceError, match="in use; choose"):
        Endpoint(first.name)
    with pytest.raises(ResourceError, match=r"nowhere\.invalid"):
        Endpoint("udpout:nowhere.invalid:14540")


def test_without_pymavlink_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20", None)
    with Endpoint(f"udpout:127.0.0.1:{free_port()}") as link, pytest.raises(ResourceError, match=r"jaxplan\[mavlink\]"):
        Streamer(link, PlannedFlight(straight()))
