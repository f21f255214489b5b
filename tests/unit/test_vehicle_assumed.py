"""A vehicle in three lines: what a file may leave out, what is assumed then, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from jaxplan import cli
from jaxplan.errors import FileError
from jaxplan.records import replace
from jaxplan.tracking.trial import circle, eight, trial_flights, turning_acceleration
from jaxplan.vehicle import toml
from jaxplan.vehicle.assumed import completed
from jaxplan.vehicle.gains import IndiGains, gains_for, slowness
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.reach import MOST_SIDEWAYS, sideways_acceleration
from jaxplan.vehicle.report import angular_accelerations, thrust_to_weight, vehicle_warnings
from jaxplan.vehicle.toml import list_presets, read_vehicle
from tolerances import relative, tolerance

SHORT = "mass = 0.8\narm = 0.12\nthrust_to_weight = 4.0\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(text)
    return path


def test_mass_arm_and_thrust_are_enough(tmp_path: Path) -> None:
    vehicle, assumed = read_vehicle(written(tmp_path, SHORT))
    assert thrust_to_weight(vehicle) == pytest.approx(4.0, **relative("exact"))
    np.testing.assert_allclose(np.linalg.norm(vehicle.rotor_positions, axis=1), 0.12, **tolerance("exact"))
    assert set(assumed) >= {
        "inertia",
        "rotor_positions",
        "thrust_coefficient",
        "rotor_speed_max",
        "radius",
        "drag_coefficient",
    }
    assert "mass" not in assumed
    assert trial_flights(vehicle)[0].held


def test_what_is_given_is_not_assumed_and_either_half_of_the_thrust_will_do(tmp_path: Path) -> None:
    fast = read_vehicle(written(tmp_path, SHORT + "rotor_speed_max = 1500.0\nradius = 0.3\n"))
    assert fast.vehicle.rotor_speed_max == 1500.0
    assert fast.vehicle.radius == 0.3
    assert not {"rotor_speed_max", "radius"} & set(fast.assumed)
    strong = read_vehicle(written(tmp_path, SHORT + "thrust_coefficient = 1e-5\n")).vehicle
    for vehicle in (fast.vehicle, strong):
        assert thrust_to_weight(vehicle) == pytest.approx(4.0, **relative("exact"))


@pytest.mark.parametrize("name", ["cf21", "flightgoggles", "mfrl", "racer5", "x500"])
def test_presets_assume_nothing_but_gains(name: str) -> None:
    vehicle, assumed = read_vehicle(Path(toml.__file__).parent / "presets" / f"{name}.toml")
    assert set(assumed) <= {"indi, se3"}
    assert vehicle_warnings(vehicle) == [] or name == "cf21"
    assert name in list_presets()


@pytest.mark.parametrize("name", ["cf21", "mfrl", "racer5", "x500"])
def test_the_rules_are_about_right_for_the_presets(name: str) -> None:
    """Within a factor of two and a half of what was identified."""
    vehicle = load_vehicle(name)
    table, _ = completed(
        {"mass": vehicle.mass, "rotor_positions": vehicle.rotor_positions.tolist(), "thrust_coefficient": 1e-6}
    )
    for known, assumed in ((vehicle.inertia, table["inertia"]), (vehicle.radius, table["radius"])):
        ratio = np.asarray(assumed) / np.asarray(known)
        assert ((ratio > 0.4) & (ratio < 2.5)).all(), (known, assumed)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("drag = 0.1\n", "lacks 'mass', 'rotor_positions', .*'thrust_coefficient' and has the unknown 'drag'"),
        (SHORT.replace("0.8", "800"), "are these grams"),
        (SHORT.replace("0.12", "4.7"), "inches or mm"),
        (SHORT.replace("thrust_to_weight = 4.0", "thrust_coefficient = 1.6e-6\nrotor_speed_max = 21000"), "rev/min"),
        (SHORT.replace("4.0", "0.9"), "hovering takes"),
        ("mass = 0.8\nrotor_positions = [[1, 0, 0], [0, 1, 0]]\nthrust_to_weight = 4.0\n", "rotor_positions"),
        (SHORT.replace("0.8", '"heavy"'), "'mass'"),
    ],
)
def test_mistakes_are_named_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(FileError, match=said) as caught:
        read_vehicle(written(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_gains_slow_down_with_the_motors_and_hold() -> None:
    fast, slow = gains_for(0.01)["indi"], gains_for(0.08)["indi"]
    assert fast == IndiGains()
    np.testing.assert_allclose(slow.attitude, 0.25 * np.array(IndiGains().attitude), **tolerance("exact"))
    np.testing.assert_allclose(slow.velocity, 0.5 * np.array(IndiGains().velocity), **tolerance("exact"))
    sluggish = load_vehicle("cf21")
    assert all(flight.held for flight in trial_flights(sluggish)[:2])
    assert not trial_flights(replace(sluggish, indi=IndiGains()))[0].held, "those for fast motors do not"


def test_trial_references_are_what_they_say() -> None:
    for reference, most in ((eight(4.0, 1.0), 4.0), (circle(6.0, 2.0), 6.0)):
        acceleration = np.linalg.norm(reference.acc, axis=1)
        assert 0.6 * most < acceleration.max() <= 1.2 * most
        numeric = np.gradient(reference.pos, 0.005, axis=0)[1:-1]
        np.testing.assert_allclose(numeric, reference.vel[1:-1], atol=2e-3)
    assert not eight(0.0, 1.0).derivatives.any()
    assert turning_acceleration(load_vehicle()) == pytest.approx(np.sqrt(3.0) * 9.81, **relative("formula"))


def test_what_a_plan_may_ask_for_grows_with_the_thrust(tmp_path: Path) -> None:
    asked = []
    for ratio in (1.3, 2.0, 3.0, 6.0):
        vehicle: Vehicle = read_vehicle(written(tmp_path, SHORT.replace("4.0", str(ratio)))).vehicle
        asked.append(sideways_acceleration(vehicle))
    assert asked == sorted(asked)
    assert asked[-1] == pytest.approx(MOST_SIDEWAYS * slowness(vehicle.motor_time_constant) ** 2, **relative("exact"))
    assert sideways_acceleration(load_vehicle()) == MOST_SIDEWAYS, "what it was tuned with"
    assert vehicle_warnings(read_vehicle(written(tmp_path, SHORT.replace("4.0", "1.15"))).vehicle)


def test_angular_accelerations_are_those_of_the_rotors() -> None:
    vehicle = load_vehicle()
    lift, hover, fastest = vehicle.thrust_coefficient, 1080.0, vehicle.rotor_speed_max
    spare = min(fastest**2 - hover**2, hover**2)
    assert angular_accelerations(vehicle)[0] == pytest.approx(4 * 0.08 * lift * spare / 0.004, rel=1e-2)


def test_the_command_says_it_all(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["vehicle"]) == 0
    assert capsys.readouterr().out.split() == list_presets()
    assert cli.run(["vehicle", str(written(tmp_path, SHORT))]) == 0
    said = capsys.readouterr().out
    for text in ("thrust to weight", "4.00", "assumed: inertia", "hover  held", "turn   held"):
        assert text in said
    assert cli.run(["vehicle", "spaceship"]) == 10
    assert cli.run(["vehicle", "absent.toml"]) == 11
