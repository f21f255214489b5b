"""The planner in the loop of an autopilot and a target that are heard over UDP."""

import subprocess
import sys
import time

import numpy as np
import pytest

from jaxplan import cli
from jaxplan.config import InterceptConfig
from jaxplan.errors import InputError, ResourceError
from jaxplan.mavlink import LiveFlight
from jaxplan.mavlink.autopilot import Seen
from jaxplan.runtime import Runtime, from_observed
from jaxplan.scenario import start_of
from jaxplan.spline import hover
from oracles import runtime_builds
from oracles.fake_autopilot import FakeAutopilot, Running
from oracles.mavlink_cases import free_port
from oracles.planner_cases import START
from tolerances import assert_close

pytest.importorskip("pymavlink")


def test_a_live_flight_waits_in_a_hover_until_the_planner_is_ready() -> None:
    seen = Seen(1.0, START + 0.1, np.zeros(3))
    with Runtime(runtime_builds.refusing, hover(START)) as runtime:
        flight = LiveFlight(runtime)
        assert_close(flight.setpoint(0.0).position, START, "exact")
        flight.tell(1.0, seen, None)
        flight.tell(1.0, None, Seen(1.0, START + 0.2, np.zeros(3)))
        assert not flight.over(1.0), "before it begins nothing is met"
        flight.begin(1.1)
        flight.tell(1.2, None, Seen(1.2, START + 2.0, np.zeros(3)))
        assert not flight.over(1.2)
        flight.tell(1.3, None, Seen(1.3, START + 0.3, np.zeros(3)))
        assert flight.over(1.3)
        assert flight.closest == pytest.approx(np.sqrt(3.0) * 0.2)
        with pytest.raises(ResourceError, match=r"planner: .*nowhere\.stl"):
            for _ in range(600):
                flight.is_ready()
                time.sleep(0.1)


def test_where_a_pursuit_starts(tmp_path) -> None:
    assert_close(start_of(InterceptConfig(predictor="gmm")).pos, START, "exact")
    assert_close(start_of(InterceptConfig(predictor="none", start=(0.0, 0.0, 1.0))).pos, [0.0, 0.0, 1.0], "exact")
    room = tmp_path / "room.json"
    room.write_text('{"bounds": {"extents": [0, 5, 0, 5, 0, 3]}, "blocks": []}')
    for config, said in (
        (InterceptConfig(predictor="ground-truth"), "knows the truth"),
        (InterceptConfig(predictor="none", world=str(room)), "give --start"),
        (InterceptConfig(predictor="none", start=(50.0, 0.0, 1.0)), "clearance"),
    ):
        with pytest.raises(InputError, match=said):
            start_of(config)


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ([], 10, "--target-system: have none"),
        (["--target-system", "2", "--predictor", "ground-truth"], 10, "knows the truth"),
        (["--target-system", "2", "--world", "absent.stl"], 11, "absent.stl"),
        (["--target-link", "udp:x"], 10, "want udpin:HOST:PORT"),
        (["--target-system", "2", "--target", "env1-01"], 2, "--target"),
    ],
)
def test_bad_arguments_end_in_one_line(
    capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, said: str
) -> None:
    assert cli.run(["stream", "live", "--to", f"udpin:127.0.0.1:{free_port()}", *arguments]) == code
    printed = capsys.readouterr()
    assert said in printed.err
    assert printed.err.count("\n") == 1


@pytest.mark.slow
def test_a_pursuit_over_udp() -> None:
    """The command itself: it compiles, engages, climbs, plans against a target that passes, meets it, comes to rest."""
    to, at = free_port(), free_port()
    own, target = FakeAutopilot(to), FakeAutopilot(at, system=2)
    own.position = np.array([START[1], START[0], -0.3])
    command = [sys.executable, "-m", "jaxplan.cli", "stream", "live", "--to", f"udpin:127.0.0.1:{to}", "--engage"]
    command += ["--target-link", f"udpin:127.0.0.1:{at}", "--target-origin", "0", "0", "0", "--planner", "no-policy"]
    command += ["--refine=no", "--allocate", "policy", "--hold", "3", "--patience", "120"]
    with Running(own), Running(target):
        run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        began = time.monotonic()
        while run.poll() is None and time.monotonic() < began + 500.0:
            since = time.monotonic() - began
            target.position = np.array([-1.0 + 0.3 * np.sin(0.2 * since), -4.0, -1.0])
            time.sleep(0.02)
        run.terminate()
        out, err = run.communicate(timeout=60.0)
        assert run.returncode == 0, out + err
    assert [word for word in ("ready", "approaching", "flying", "holding", "done") if f"  {word}\n" not in out] == []
    assert float(out.splitlines()[-1].split()[-2]) <= 0.4
    assert own.undecoded == 0
    last = own.setpoints[-1][1]
    assert [last[name] for name in ("vx", "vy", "vz")] == [0.0, 0.0, 0.0]


def test_the_build_can_be_sent() -> None:
    """To another process: it is pickled by the runtime."""
    assert from_observed(InterceptConfig(predictor="none")).func.__module__ == "jaxplan.runtime.build"
