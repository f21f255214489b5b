"""A stream of setpoints to an autopilot over real sockets; only the clock is stepped by hand."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from test_io_export import committed

from jaxplan import cli
from jaxplan.errors import InputError, ResourceError
from jaxplan.io.plans import write_plans
from jaxplan.mavlink import Endpoint, Phase, PlannedFlight, StreamConfig, TargetVehicle
from jaxplan.mavlink.frames import to_ned
from oracles.fake_autopilot import ARDUPILOT, GUIDED, HOLD, OFFBOARD, SET_MODE, FakeAutopilot, Running
from oracles.mavlink_cases import ORIGIN, Together, free_port, straight

pytest.importorskip("pymavlink")


@pytest.fixture
def make() -> Iterator[type]:
    made: list[Together] = []

    def build(*arguments: object, **config: object) -> Together:
        made.append(Together(*arguments, **config))
        return made[-1]

    yield build
    for each in made:
        each.close()


@pytest.mark.parametrize(("kind", "mode"), [(12, OFFBOARD), (ARDUPILOT, GUIDED)])
def test_from_hover_to_rest_when_asked_to_engage(make, kind: int, mode: int) -> None:
    both = make(kind, engage=True)
    both.until(Phase.FLYING)
    assert both.autopilot.mode == mode
    both.until(Phase.DONE)
    assert both.phases == ["ready", "approaching", "flying", "holding", "done"]
    commands = [(time, m.fields["command"]) for time, m in both.autopilot.heard if m.name == "COMMAND_LONG"]
    first = both.autopilot.setpoints[0][0]
    assert commands[0] == (pytest.approx(first + 1.5, abs=1.1), SET_MODE), "streamed before the mode is asked for"
    assert commands[0][0] > first + 1.4
    both.pass_time(0.3)
    assert both.autopilot.mode == (HOLD if kind == 12 else mode), "PX4 is left in a mode that stays where it is"


def test_every_setpoint_arrives_as_it_was_said(make) -> None:
    """All frames decode; float32 exactly; time and numbers grow; at rest at the end."""
    both = make(engage=True)
    both.until(Phase.DONE)
    both.pass_time(0.02)
    fields = [fields for _, fields in both.autopilot.setpoints]
    assert both.autopilot.undecoded == 0
    assert len(fields) == both.streamer.report().sent
    wanted = {tuple(np.float32(flat(to_ned(said, np.array(ORIGIN))))) for said in both.flight.said}
    names = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
    rows = [tuple(np.float32(row[name]) for name in names) for row in fields]
    assert set(rows) <= wanted
    assert len(set(rows)) > 70, "a second and a half at 50 a second"
    assert all(row["type_mask"] == 0 and row["coordinate_frame"] == 1 for row in fields)
    assert (np.diff([row["time_boot_ms"] for row in fields]) > 0).all()
    numbers = [m.sequence for _, m in both.autopilot.heard]
    assert set(np.diff(numbers) % 256) == {1}
    last = fields[-1]
    np.testing.assert_allclose([last["x"], last["y"], last["z"]], [0.0, 1.0, -1.5], rtol=0.0, atol=1e-6)  # float32
    assert [last[name] for name in names[3:9]] == [0.0] * 6
    assert last["yaw"] == pytest.approx(0.5 * np.pi - 0.5, abs=1e-6)  # float32


def flat(setpoint) -> list[float]:
    three = [*setpoint.position, *setpoint.velocity, *setpoint.acceleration]
    return [*three, setpoint.yaw, setpoint.yaw_rate]


def test_the_flight_is_the_plan_in_its_own_time(make) -> None:
    """Against the trajectory's closed form at the stamps, from where it began to move."""
    both = make(engage=True, rate=100.0)
    both.until(Phase.DONE)
    both.pass_time(0.02)
    (began,) = [seconds for seconds, text in both.events if text == "flying"]
    rows = [fields for _, fields in both.autopilot.setpoints if fields["time_boot_ms"] >= 1e3 * began + 5]
    share = np.clip((np.array([row["time_boot_ms"] for row in rows]) * 1e-3 - began) / 1.5, 0.0, 1.0)
    east = 35 * share**4 - 84 * share**5 + 70 * share**6 - 20 * share**7
    np.testing.assert_allclose([row["y"] for row in rows], east, rtol=0.0, atol=2e-3)  # stamps are whole ms
    speed = 140 * share**3 * (1 - share) ** 3 / 1.5
    np.testing.assert_allclose([row["vy"] for row in rows], speed, rtol=0.0, atol=1e-2)  # likewise


def test_a_person_engages_and_the_rate_is_kept(make) -> None:
    both = make(listening=False)
    both.pass_time(3.0)
    assert both.streamer.phase is Phase.READY
    assert not [m for _, m in both.autopilot.heard if m.name == "COMMAND_LONG"], "nobody was asked"
    assert both.autopilot.setpoints[-1][1]["z"] == -1.5, "the hover at the start"
    both.autopilot.engage(both.now)
    both.until(Phase.DONE)
    arrivals = [time for time, _ in both.autopilot.setpoints]
    assert np.diff(arrivals).max() < 0.026
    assert len(arrivals) == pytest.approx(50.0 * (arrivals[-1] - arrivals[0]), abs=2)
    beats = [time for time, m in both.autopilot.heard if m.name == "HEARTBEAT"]
    assert np.diff(beats).max() < 1.02
    report = both.streamer.report()
    assert report.lost == 0
    assert report.off.max() < 0.2
    assert both.autopilot.mode == OFFBOARD, "who engaged, a person, ends it"


def test_a_gap_ends_the_flight_and_nothing_brings_it_back(make) -> None:
    """The network loses everything for a little more than a second: PX4 gives up, and is not asked again."""
    both = make(engage=True)
    both.until(Phase.FLYING)
    both.autopilot.deaf = True
    both.pass_time(1.1)
    both.autopilot.deaf = False
    both.until(Phase.RELEASED, within=1.0)
    assert both.autopilot.mode == HOLD
    asked = len([m for _, m in both.autopilot.heard if m.name == "COMMAND_LONG"])
    both.pass_time(3.0)
    assert both.streamer.phase is Phase.RELEASED
    assert len([m for _, m in both.autopilot.heard if m.name == "COMMAND_LONG"]) == asked
    assert "left OFFBOARD" in both.streamer.report().reason


def test_a_short_gap_is_none(make) -> None:
    both = make(engage=True)
    both.until(Phase.FLYING)
    both.autopilot.deaf = True
    both.pass_time(0.8)
    both.autopilot.deaf = False
    both.until(Phase.DONE)


def test_this_program_stalls_and_makes_up_for_nothing(make) -> None:
    """Half a second without a step: one setpoint follows, of the time that it is, and no burst."""
    both = make(engage=True)
    both.until(Phase.FLYING)
    before = len(both.autopilot.setpoints)
    both.now += 0.5
    both.pass_time(0.1)
    assert len(both.autopilot.setpoints) - before <= 7
    assert both.streamer.report().gaps.max() == pytest.approx(0.5, abs=0.03)
    both.until(Phase.DONE)


def test_a_silent_autopilot_is_streamed_to_until_patience_ends(make) -> None:
    both = make(engage=True, hold=20.0, patience=6.0)
    both.until(Phase.HOLDING)
    both.autopilot.mute = True
    both.pass_time(4.0)
    both.autopilot.mute = False
    both.pass_time(1.0)
    assert [text for _, text in both.events][-2:] == ["the autopilot is silent", "the autopilot is heard again"]
    arrivals = [time for time, _ in both.autopilot.setpoints]
    assert np.diff(arrivals).max() < 0.026, "it was streamed to all the while"
    both.autopilot.mute = True
    with pytest.raises(ResourceError, match="silent for 6 s"):
        both.pass_time(7.0)


def test_who_takes_over_has_it(make) -> None:
    both = make(engage=True)
    both.until(Phase.FLYING)
    both.pass_time(0.5)
    both.autopilot.mode = HOLD
    both.until(Phase.RELEASED, within=1.0)
    both = make(engage=True, hold=60.0)
    both.until(Phase.HOLDING)
    both.autopilot.mode = HOLD
    both.until(Phase.DONE, within=1.0)


def test_what_cannot_begin_is_said(make) -> None:
    with pytest.raises(ResourceError, match="no autopilot was heard in 2 s"):
        silent = make(patience=2.0)
        silent.autopilot.mute = True
        silent.pass_time(3.0)
    with pytest.raises(ResourceError, match="positions in frame 20 only, want LOCAL_NED"):
        elsewhere = make(patience=2.0)
        elsewhere.autopilot.speaks_odometry = 20
        elsewhere.pass_time(3.0)
    with pytest.raises(ResourceError, match="MAV_RESULT 2 to command 176, want OFFBOARD"):
        refusing = make(engage=True, patience=2.0)
        refusing.autopilot.refuses = True
        refusing.pass_time(6.0)
    with pytest.raises(ResourceError, match="have MAV_AUTOPILOT 8"):
        make(8).pass_time(1.0)
    with pytest.raises(ResourceError, match=r"31\.5 m off; want at most 5 m"):
        far = make(engage=True)
        far.autopilot.position = np.array([0.0, 0.0, 30.0])
        far.pass_time(3.0)


def test_a_vehicle_that_does_not_come_is_given_up(make) -> None:
    both = make(patience=3.0)
    both.pass_time(2.0)
    both.autopilot.engage(both.now)
    both.autopilot._move = lambda now: None
    with pytest.raises(ResourceError, match=r"1\.5 m from the start after 3 s"):
        both.pass_time(5.0)


def test_an_autopilot_that_obeys_already_and_says_later_where_it_is(make) -> None:
    both = make()
    both.autopilot.mode, both.autopilot.armed = OFFBOARD, True
    both.autopilot.send("HEARTBEAT", autopilot=12, base_mode=129, custom_mode=OFFBOARD)
    for _ in range(100):
        both.now += 0.005
        both.streamer.step()
    assert both.streamer.phase is Phase.READY
    both.until(Phase.DONE)


def test_an_old_position_is_none(make) -> None:
    """Its estimator is lost while a person engages: it is not called anywhere, and given up in the end."""
    both = make(patience=3.0)
    both.autopilot._move = lambda now: None
    both.pass_time(2.0)
    both.autopilot.lost = True
    both.pass_time(1.1)
    both.autopilot.engage(both.now)
    both.pass_time(1.0)
    assert both.streamer.phase is Phase.READY
    both.autopilot.lost = False
    both.until(Phase.APPROACHING)
    both.autopilot.lost = True
    with pytest.raises(ResourceError, match="at an unknown place after 3 s"):
        both.pass_time(4.0)


def test_the_last_wish_is_said_again_until_it_is_heard(make) -> None:
    """The first requests to hold are lost: the stream goes on until PX4 has left OFFBOARD, and no longer than that."""
    both = make(engage=True)
    both.until(Phase.HOLDING)
    both.autopilot.refuses = True
    both.pass_time(3.5)
    assert both.streamer.phase is Phase.HOLDING
    both.autopilot.refuses = False
    both.until(Phase.DONE, within=1.5)
    assert both.autopilot.mode == HOLD
    gaps = np.diff([time for time, _ in both.autopilot.setpoints])
    assert gaps.max() < 0.026


def test_odometry_in_the_local_frame_will_do(make) -> None:
    both = make(engage=True)
    both.autopilot.speaks_odometry = 1
    both.until(Phase.DONE)


def test_a_target_on_the_globe_is_told_of(make) -> None:
    """The autopilot is asked where it counts from; a second vehicle speaks on a link of its own."""
    both = make()
    both.autopilot.origin = {"latitude": 474_000_000, "longitude": 85_000_000, "altitude": 400_000}
    target_link = Endpoint(f"udpin:127.0.0.1:{free_port()}")
    target = FakeAutopilot(target_link.port, system=2)
    both.streamer = both.streaming(target=TargetVehicle(None, None), target_link=target_link)
    both.pass_time(1.5)
    target.send("GLOBAL_POSITION_INT", lat=474_000_000, lon=85_000_000, alt=403_000, vx=100)
    both.pass_time(0.1)
    (seen,) = [target for _, _, target in both.flight.told if target is not None]
    np.testing.assert_allclose(seen.position, [1.0, 2.0, 3.0], rtol=0.0, atol=1e-6)  # 1e-7 degrees, exactly there
    assert seen.velocity.tolist() == [0.0, 1.0, 0.0]
    assert len({vehicle.time for _, vehicle, _ in both.flight.told if vehicle is not None}) > 50
    target_link.close()
    target.close()


def test_values_that_are_none() -> None:
    for bad in ({"rate": 1.0}, {"origin": (0.0, np.nan, 0.0)}, {"hold": 0.0}, {"patience": -1.0}, {"system": 0}):
        with pytest.raises(InputError):
            StreamConfig(**bad)
    moving = straight().split(0.7)[1]
    with pytest.raises(InputError, match="want one that begins at rest"):
        PlannedFlight(moving)


def test_from_the_command_line_in_real_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_plans(tmp_path / "plans.npz", [committed(2.0, straight())])
    port = free_port()
    arguments = ["stream", str(tmp_path), "--to", f"udpin:127.0.0.1:{port}", "--origin", *map(str, ORIGIN)]
    with Running(FakeAutopilot(port)) as autopilot:
        autopilot.position = np.array([0.0, 0.0, -1.4])
        assert cli.run([*arguments, "--engage", "--hold", "0.2"]) == 0
        printed = capsys.readouterr()
        assert [line.split()[-1] for line in printed.out.splitlines()[1:6]] == [
            "ready",
            "approaching",
            "flying",
            "holding",
            "done",
        ]
        assert "gap_p99_ms" in printed.out
        assert autopilot.undecoded == 0
    for change, code, said in (
        (["--hold", "0"], 10, "hold is 0.0, want a positive number"),
        (["--patience", "0.2"], 12, "no autopilot was heard"),
        (["--rate", "1"], 10, "--rate"),
    ):
        assert cli.run([*arguments, *change]) == code
        printed = capsys.readouterr()
        assert said in printed.err
        assert printed.err.count("\n") == 1
    assert cli.run(["stream", str(tmp_path), "--to", "udp:127.0.0.1:1"]) == 10
    assert "want udpin:HOST:PORT" in capsys.readouterr().err
