"""The firmware's packets decoded by hand, its sticks and frames by value, and what is said where it cannot be flown.

Nothing here needs the firmware: its side is real sockets and real processes of other programs.
"""

import dataclasses
import os
import shutil
import socket
import struct
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments import firmware
from experiments.betaflight import build, outer_loop, process
from experiments.betaflight.link import Link, Sensors, Sticks, radio_packet, state_packet
from experiments.betaflight.plant import motor_of_rotor
from experiments.betaflight.process import Running, Sockets
from jaxplan import cli
from jaxplan.errors import FileError, InputError, ResourceError
from jaxplan.runner.definition import Results
from jaxplan.spline import hover
from jaxplan.tracking.plant import state_on_reference
from jaxplan.vehicle.flatness import differential_flatness
from jaxplan.vehicle.load import load_vehicle
from tolerances import tolerance

TURNED = np.diag([1.0, -1.0, -1.0])
"""From FLU to FRD, and from a world with y left and z up to one with y right and z down."""
CENTRED = Sticks(1500, 1500, 1000, 1500, armed=False)
START, DEMAND = jax.jit(state_on_reference), jax.jit(differential_flatness)
COMMANDS = jax.jit(outer_loop.commands)
REST = Sensors(np.zeros(3), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.0, 0.0, 9.81]))


def test_the_state_packet_has_the_firmwares_axes() -> None:
    turn = Rotation.from_euler("xyz", [0.3, -0.5, 1.1])
    x, y, z, w = turn.as_quat()
    sensors = Sensors(
        pos=np.array([100.0, -200.0, 3.0]),
        vel=np.array([1.0, 2.0, 3.0]),
        quat_wxyz=np.array([w, x, y, z]),
        body_rates=np.array([0.1, 0.2, 0.3]),
        specific_force=np.array([1.0, 2.0, 9.0]),
    )
    packet = state_packet(12.5, sensors)
    assert len(packet) == 144
    values = np.array(struct.unpack("<18d", packet))
    exact = tolerance("exact")
    assert values[0] == 12.5
    np.testing.assert_allclose(values[1:4], TURNED @ sensors.body_rates, **exact)
    np.testing.assert_allclose(values[4:7], [-1.0, -2.0, -9.0], **exact)
    theirs = Rotation.from_quat(values[[8, 9, 10, 7]]).as_matrix()
    np.testing.assert_allclose(theirs, TURNED @ turn.as_matrix() @ TURNED, **tolerance("formula"))
    np.testing.assert_allclose(values[11:14], [1.0, 2.0, 3.0], **exact)
    # 40 000 km round the equator: 100 m are 0.9 thousandths of a degree, to 0.2 %
    np.testing.assert_allclose(values[14:16], [9.0e-4, -18.0e-4], rtol=2e-3)
    np.testing.assert_allclose(values[16:], [3.0, 101325.0], **exact)


def test_the_radio_packet_is_aetr_then_the_arming_switch() -> None:
    packet = radio_packet(7.25, Sticks(roll=1234.6, pitch=900.0, throttle=2345.0, yaw=1500.2, armed=True))
    assert len(packet) == 40
    time, *channels = struct.unpack("<d16H", packet)
    assert (time, channels) == (7.25, [1235, 1000, 2000, 1500, 2000] + 11 * [1000])
    assert struct.unpack("<d16H", radio_packet(0.0, CENTRED))[5] == 1000


def test_sticks_are_rates_of_670_degrees_with_yaw_reversed_and_a_throttle_from_idle() -> None:
    full = np.radians(670.0)
    assert outer_loop.sticks(0.055, np.zeros(3)) == Sticks(1500, 1500, 1050, 1500, armed=True)
    found = outer_loop.sticks(1.0, np.array([full, -full / 2.0, full]))
    np.testing.assert_allclose(found[:4], [2000, 1250, 2000, 1000], **tolerance("formula"))


def test_motors_are_those_at_the_vehicles_corners() -> None:
    """The packet is front right, rear left, front left, rear right; mfrl counts from the front left, clockwise."""
    vehicle = load_vehicle()
    assert motor_of_rotor(vehicle).tolist() == [2, 0, 3, 1]
    with pytest.raises(InputError, match="the other way round"):
        motor_of_rotor(dataclasses.replace(vehicle, rotor_spin=-np.asarray(vehicle.rotor_spin)))
    plus = np.array([[0.1, 0.0, 0.0], [0.0, -0.1, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    with pytest.raises(InputError, match="not one at each of front right"):
        motor_of_rotor(dataclasses.replace(vehicle, rotor_positions=plus))


def asked(moved: dict[str, np.ndarray]) -> np.ndarray:
    """What the outer loop commands of a vehicle that hovers, but for what is moved."""
    vehicle = load_vehicle().astype(np.float32)
    still = jax.tree.map(lambda leaf: jnp.asarray(leaf, np.float32), hover([0.0, 0.0, 1.0]))
    state = dataclasses.replace(START(vehicle, still, jax.random.key(0)), **moved)
    return np.asarray(COMMANDS(vehicle, state, still, DEMAND(vehicle, still)))


def test_the_outer_loop_hovers_on_its_weight_and_turns_back_to_where_it_should_be() -> None:
    vehicle, still = load_vehicle(), asked({})
    thrust = 4.0 * float(vehicle.thrust_coefficient) * (still[0] * float(vehicle.rotor_speed_max)) ** 2
    assert thrust == pytest.approx(0.771 * 9.81, rel=1e-5)  # single precision
    np.testing.assert_allclose(still[1:], 0.0, **tolerance("formula", np.float32))
    behind = asked({"pos": np.float32([-0.1, 0.0, 1.0])})
    assert behind[2] > 0.1  # nose down, about body y to the left
    assert asked({"pos": np.float32([0.0, 0.1, 1.0])})[1] > 0.1  # too far left: right side down
    assert asked({"pos": np.float32([0.0, 0.0, 0.9])})[0] > still[0]
    turned = np.float32([np.cos(0.1), 0.0, 0.0, np.sin(0.1)])
    # 0.2 rad to the left: back at k_R / k_W = 20 / 8 a second
    assert asked({"quat_wxyz": turned})[3] == pytest.approx(-0.2 * 2.5, rel=1e-3)


class Peer:
    """Both ends of a link over real sockets on ports that are free; the process is one that only waits."""

    def __init__(self, folder: Path, waiting: subprocess.Popen) -> None:
        kinds = (socket.SOCK_DGRAM, socket.SOCK_DGRAM, socket.SOCK_STREAM)
        self.sockets = Sockets(*(socket.socket(socket.AF_INET, kind) for kind in kinds))
        self.sockets.inbound.bind(("127.0.0.1", 0))
        self.firmware = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.running = Running(self.sockets, waiting, folder)
        (folder / process.LOG).write_text("first\nlast words\n\n")

    def motors(self, packet: bytes) -> None:
        self.firmware.sendto(packet, self.sockets.inbound.getsockname())

    def close(self) -> None:
        for opened in (*self.sockets, self.firmware):
            opened.close()


@pytest.fixture
def peer(tmp_path: Path) -> Iterator[Peer]:
    waiting = subprocess.Popen(["sleep", "60"])
    made = Peer(tmp_path, waiting)
    yield made
    made.close()
    waiting.kill()
    waiting.wait()


def test_a_silent_peer_is_one_line(peer: Peer) -> None:
    with pytest.raises(ResourceError) as caught:
        Link(peer.running, timeout=0.05)
    said = str(caught.value)
    assert "no motor packet on UDP port 9002 within 0.05 s" in said
    assert said.endswith("the process runs; it said last: last words")
    peer.motors(struct.pack("<4f", 0.0, 0.0, 0.0, 0.0))
    link = Link(peer.running, timeout=0.05)
    peer.running.process.kill()
    peer.running.process.wait()
    with pytest.raises(ResourceError, match=r"at 3\.25 s of its clock; the process ended with code -9"):
        link.step(3.25, REST, CENTRED)
    peer.motors(b"12345")
    with pytest.raises(ResourceError, match="a motor packet of 5 bytes"):
        link.step(3.5, REST, CENTRED)


def test_one_exchange_is_two_packets_out_and_one_in(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a firmware hears of a step, over real sockets, and that its answer comes back in its own order."""
    ears = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    heard: list[bytes] = []

    def answer() -> None:
        heard.extend(ear.recv(256) for ear in ears)
        peer.motors(struct.pack("<4f", 0.125, 0.25, 0.5, 1.0))

    for ear, name in zip(ears, ("RADIO_PORT", "STATE_PORT"), strict=True):
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(5.0)
        monkeypatch.setattr(f"experiments.betaflight.link.{name}", ear.getsockname()[1])
    peer.motors(struct.pack("<4f", 0.0, 0.0, 0.0, 0.0))
    link, listening = Link(peer.running, timeout=5.0), threading.Thread(target=answer)
    listening.start()
    assert link.step(3.0025, REST, CENTRED).tolist() == [0.125, 0.25, 0.5, 1.0]
    listening.join()
    for ear in ears:
        ear.close()
    assert heard == [radio_packet(3.0025, CENTRED), state_packet(3.0025, REST)]


@pytest.fixture
def sleeper(tmp_path: Path) -> build.Firmware:
    """Another program in the place of the firmware, with an empty library before it."""
    program = tmp_path / "sleeper"
    program.write_text("#!/bin/sh\necho here\nexec sleep 60\n")
    program.chmod(0o755)
    return build.Firmware(program, Path(""))


@pytest.mark.parametrize(("port", "kind"), [(9002, "DGRAM"), (9003, "DGRAM"), (9004, "DGRAM"), (5761, "STREAM")])
def test_a_port_in_use_is_one_line(port: int, kind: str, sleeper: build.Firmware, tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, getattr(socket, f"SOCK_{kind}")) as mine:
        mine.bind(("127.0.0.1", port))
        if kind == "STREAM":
            mine.listen()
        with (
            pytest.raises(
                ResourceError, match=rf"port {port} of 127\.0\.0\.1 cannot be used \(Address already in use\)"
            ),
            process.running(sleeper, tmp_path, None, own_network=False),
        ):
            pass
        if not process.has_own_network():
            pytest.skip("this system gives a process no network of its own")
        with process.running(sleeper, tmp_path, None, own_network=True) as there:
            assert there.sockets.inbound.getsockname() == ("127.0.0.1", 9002)


def test_the_process_ends_with_its_block(sleeper: build.Firmware, tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), process.running(sleeper, tmp_path, None) as there:
        assert there.process.poll() is None
        raise ZeroDivisionError
    assert there.process.returncode == -9
    assert all(made.fileno() == -1 for made in there.sockets)


def test_a_program_that_cannot_be_started_is_one_line(tmp_path: Path) -> None:
    absent = build.Firmware(tmp_path / "absent", Path(""))
    with process.running(absent, tmp_path, None) as there:
        there.process.wait(20.0)
        assert "ended with code 1; it said last: FileNotFoundError" in there.condition()


def test_without_a_compiler_nothing_is_flown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bin").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setenv("JAXPLAN_CACHE_DIR", str(tmp_path / "cache"))  # where nothing is built
    out = tmp_path / "out"
    assert cli.run(["experiment", "firmware", "--out", str(out), "--workers", "0"]) == 12
    (said,) = capsys.readouterr().err.strip().splitlines()
    assert "firmware: gcc is not on the path" in said
    assert not out.exists()
    (tmp_path / "bin" / "gcc").symlink_to("/bin/true")
    with pytest.raises(ResourceError, match="make is not on the path"):
        build.require_tools()


def test_another_archive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "other.tar.gz").write_bytes(b"other")
    with pytest.raises(
        FileError, match="its SHA-256 is d9298a10d1b0735837dc4bd85dac641b0f3cef27a47e5d53a54f2f3f5b2fcffa"
    ):
        build.check_archive(tmp_path / "other.tar.gz")


def test_nothing_is_built_where_nothing_may_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JAXPLAN_CACHE_DIR", "")
    with pytest.raises(ResourceError, match="set JAXPLAN_CACHE_DIR to a folder"):
        build.build()
    (tmp_path / "file").touch()
    monkeypatch.setenv("JAXPLAN_CACHE_DIR", str(tmp_path / "file"))
    with pytest.raises(ResourceError, match="cannot make .*Not a directory"):
        build.build()


@pytest.mark.parametrize(
    "wrong", [{"episodes": 0}, {"seed": -1}, {"speeds": (-1.0,)}, {"speeds": (1.0, 1.0)}, {"worlds": ("env9",)}]
)
def test_flags_that_mean_nothing_are_refused(wrong: dict) -> None:
    with pytest.raises(InputError):
        firmware.Config(**wrong)


def test_references_go_from_rest_to_rest_at_their_speed() -> None:
    eight = firmware.references_of(3.5)
    assert np.linalg.norm(eight.vel, axis=1).max() == pytest.approx(3.5, rel=1e-3)  # between the instants
    np.testing.assert_allclose(eight.derivatives[0, 1:4], 0.0, **tolerance("solve"))
    assert firmware.references_of(0.0).vel.max() == 0.0


@pytest.mark.skipif(any(shutil.which(tool) is None for tool in build.NEEDED), reason="needs gcc and make")
def test_the_report_of_made_up_flights(tmp_path: Path) -> None:
    config = firmware.Config(episodes=2, worlds=("env1",), speeds=(0.0, 5.0))
    trace = {"error": [0.01, 0.02], "rotors": [[0.5, 0.5, 0.5, 0.5]] * 2}
    row = {"rms": 0.0123, "worst": 0.02, "twist_deg": 1.0, "saturated": 0.0, "identical": True, "digest": "0"}
    row |= {"own_rms": 0.01, "own_worst": 0.02, "own_network": False, "trace": trace, "speed": 5.0}
    met = {"kind": "interception", "outcome": "intercepted", "time_to_intercept_s": 1.0, "thrust_g": 2.0, "plans": 2}
    met |= {"min_distance_m": 0.3, "min_clearance_m": 0.5, "replans": 9, "wall_s": 1.0, "own_outcome": "intercepted"}
    reference = {**row, "kind": "reference", "acceleration": 9.0}
    hit = {**row, **met, "outcome": "collision", "time_to_intercept_s": None, "identical": False}
    items, rows = firmware.items(config), [{**reference, "speed": 0.0}, reference, {**row, **met}, hit]
    found = firmware.EXPERIMENT.report(Results(config, items, rows, [1.0] * 4, [False] * 4, {}, {}))
    assert "1 of 2 met" in found.summary
    assert "1 collisions; largest rms of the references up to 5 m/s: 12.3 mm" in found.markdown
    assert "every bit the same: 3 of 4. The firmware had the fixed ports" in found.markdown
    found.figures["firmware.png"](tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000
    assert "trace" not in found.table[0]
    assert os.fspath(tmp_path) not in found.markdown
