"""The real firmware, built from source: what it flies, how it fails, and that it does so twice alike."""

import os
from pathlib import Path

import jax
import numpy as np
import pytest

from experiments import firmware
from experiments.betaflight import build, plant, process, settings
from experiments.betaflight.plant import FirmwarePlant
from jaxplan import cli
from jaxplan.errors import InputError, ResourceError
from jaxplan.spline import FlatState
from jaxplan.tracking.rollout import FlightLog
from jaxplan.vehicle.load import load_vehicle

pytestmark = [pytest.mark.slow, pytest.mark.firmware]
GENTLE = 0.03
"""m, largest root mean square of a gentle reference's error."""


@pytest.fixture(scope="module")
def flyer() -> FirmwarePlant:
    try:
        build.require_buildable()
    except ResourceError as error:
        pytest.skip(str(error))
    return FirmwarePlant(load_vehicle())


def first_of(references: FlatState) -> FlatState:
    return jax.tree.map(lambda rows: rows[0], references)


def followed(flyer: FirmwarePlant, speed: float) -> FlightLog:
    references = firmware.references_of(speed)
    with flyer as flown:
        return flown.fly(flown.reset(first_of(references), jax.random.key(0)), references)[1]


def rms(log: FlightLog) -> float:
    return float(np.sqrt((np.asarray(log.position_error, dtype=float) ** 2).mean()))


def test_it_hovers_on_the_vehicles_weight(flyer: FirmwarePlant) -> None:
    log, vehicle = followed(flyer, 0.0), load_vehicle()
    assert rms(log) < GENTLE
    lift = float(vehicle.thrust_coefficient) * (np.asarray(log.rotor_speeds, dtype=float) ** 2).sum(axis=1).mean()
    assert lift == pytest.approx(0.771 * 9.81, rel=0.01)  # the noise's force is not zero in the mean


@pytest.mark.parametrize("speed", [3.5, 5.0])
def test_gentle_references_are_followed_and_two_runs_are_the_same(flyer: FirmwarePlant, speed: float) -> None:
    log = followed(flyer, speed)
    assert rms(log) < GENTLE
    assert np.degrees(np.asarray(log.twist_error)).max() < 10.0
    again = followed(flyer, speed)
    for one, other in zip(jax.tree.leaves(log), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, other)


def test_with_two_motors_exchanged_it_is_lost(flyer: FirmwarePlant, monkeypatch: pytest.MonkeyPatch) -> None:
    """So what holds it in the other tests is the firmware."""
    monkeypatch.setattr(flyer, "_motors", flyer._motors[[1, 0, 2, 3]])
    references = jax.tree.map(lambda rows: rows[:401], firmware.references_of(0.0))
    with flyer as flown:
        _, log = flown.fly(flown.reset(first_of(references), jax.random.key(0)), references)
    assert not np.asarray(log.position_error)[-1] < 1.0


def test_how_a_flight_is_cut_into_calls_does_not_matter(flyer: FirmwarePlant) -> None:
    references = jax.tree.map(lambda rows: rows[:201], firmware.references_of(5.0))
    with flyer as flown:
        state = flown.reset(first_of(references), jax.random.key(3))
        _, whole = flown.fly(state, references)
        state, pieces = flown.reset(first_of(references), jax.random.key(3)), []
        for begin in range(0, 200, 20):
            part = jax.tree.map(lambda rows, begin=begin: rows[begin : begin + 21], references)
            state, log = flown.fly(state, part)
            pieces.append(np.asarray(log.pos))
    np.testing.assert_array_equal(np.concatenate(pieces), whole.pos)


def test_without_a_network_of_its_own_it_flies_the_same(flyer: FirmwarePlant, monkeypatch: pytest.MonkeyPatch) -> None:
    if not process.has_own_network():
        pytest.skip("this system gives a process no network of its own")
    references, flown = jax.tree.map(lambda rows: rows[:101], firmware.references_of(5.0)), []
    for alone in (True, False):
        monkeypatch.setattr(process, "has_own_network", lambda alone=alone: alone)
        with flyer as either:
            state = either.reset(first_of(references), jax.random.key(1))
            flown.append(either.fly(state, references)[1].pos)
    np.testing.assert_array_equal(*flown)


def test_a_flight_does_not_go_back(flyer: FirmwarePlant) -> None:
    references = jax.tree.map(lambda rows: rows[:21], firmware.references_of(0.0))
    with flyer as flown:
        state = flown.reset(first_of(references), jax.random.key(0))
        flown.fly(state, references)
        with pytest.raises(InputError, match="a flight from step 0, but it is at step 20"):
            flown.fly(state, references)
    with pytest.raises(InputError, match="reset the plant first"):
        flyer.fly(state, references)


def test_a_firmware_that_dies_in_flight_is_one_line(flyer: FirmwarePlant, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plant.Link.__init__, "__defaults__", (0.5,))
    references = jax.tree.map(lambda rows: rows[:21], firmware.references_of(0.0))
    with flyer as flown:
        state = flown.reset(first_of(references), jax.random.key(0))
        flyer._link._firmware.process.kill()
        with pytest.raises(ResourceError, match=r"within 0\.5 s at 11\.0025 s of its clock; the process ended"):
            flown.fly(state, references)


def test_a_firmware_that_does_not_arm_is_one_line(flyer: FirmwarePlant, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plant, "ARMED_AT", 6.6)  # with the throttle up already
    with pytest.raises(ResourceError, match=r"its motors are at \[0\.0, 0\.0, 0\.0, 0\.0\], want 0\.\d+ each"):
        followed(flyer, 0.0)


def test_a_refused_setting_is_one_line(flyer: FirmwarePlant) -> None:
    folder = flyer._firmware.program.parent
    before = sorted(folder.iterdir())
    with pytest.raises(ResourceError, match="its command line refuses 'set nonsense = 1'"):
        settings.settings_file(flyer._firmware, ("set small_angle = 180", "set nonsense = 1"))
    assert sorted(folder.iterdir()) == before


def test_it_listens_to_this_machine_alone(flyer: FirmwarePlant) -> None:
    references = firmware.references_of(0.0)
    with flyer as flown:
        flown.reset(first_of(references), jax.random.key(0))
        number = flyer._link._firmware.process.pid
        inodes = {os.readlink(path) for path in Path(f"/proc/{number}/fd").iterdir()}
        heard = []
        for table in ("udp", "udp6", "tcp", "tcp6"):
            for line in Path(f"/proc/{number}/net/{table}").read_text().splitlines()[1:]:
                words = line.split()
                if f"socket:[{words[9]}]" in inodes and not words[1].endswith(":0000"):
                    heard.append(words[1].split(":"))
    assert {port for _, port in heard} >= {"1681", "232B", "232C"}  # 5761, 9003, 9004
    loopback = ("0100007F", "0000000000000000FFFF00000100007F")
    assert all(address in loopback for address, port in heard if port in ("1681", "232B", "232C"))


def test_an_interception_is_replanned_and_met(flyer: FirmwarePlant, tmp_path: Path) -> None:
    """The whole experiment at its smallest."""
    del flyer
    line = ["experiment", "firmware", "--preset", "smoke", "--speeds", "0", "--out", str(tmp_path), "--workers", "0"]
    assert cli.run(line) == 0
    said = (tmp_path / "report.md").read_text()
    assert "1 of 1 met" in said
    assert "every bit the same: 2 of 2" in said
