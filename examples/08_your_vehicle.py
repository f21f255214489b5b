"""Your vehicle, from three lines.

Mass, arm and thrust-to-weight ratio are enough; what the file leaves out is assumed by stated rules. What the vehicle
can follow is asked twice: the rotor limits say what an eight demands of the rotors, and the simulation flies it.
"""

import functools
from pathlib import Path

import jax
import numpy as np

import jaxplan
from jaxplan.vehicle.report import vehicle_lines

OUT = Path("out/examples")
DRONE = """\
mass = 0.8              # kg
arm = 0.12              # m, from the middle to each rotor
thrust_to_weight = 3.2
"""
FASTER = (0.5, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.5)  # than the rotors allow


def main() -> None:
    """Read the vehicle, find its fastest eight by the rotor limits, and fly some around it."""
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "drone.toml").write_text(DRONE)
    vehicle = jaxplan.load_vehicle(OUT / "drone.toml")
    for line in vehicle_lines(vehicle):
        print(f"{line.name:22}{line.value:>16} {line.unit}")

    eight = np.array([[0, 0], [2, 1.2], [4, 0], [2, -1.2], [0, 0], [-2, 1.2], [-4, 0], [-2, -1.2], [0, 0]])
    waypoints = np.column_stack([eight, np.full(len(eight), 1.5)])  # m
    slow = jaxplan.minimum_snap(waypoints, np.full(len(eight) - 1, 1.5))

    margin = jax.vmap(functools.partial(jaxplan.rotor_limit_margin, vehicle))  # rad/s, for many instants

    def within_limits(rate: float) -> bool:
        """Whether the rotors can give at every instant what the eight asks for."""
        spline = slow.dilate(1.0 / rate)
        return bool((margin(spline.state(np.linspace(0.0, spline.duration, 400))) > 0.0).all())

    fastest = slow.dilate(1.0 / max(filter(within_limits, np.geomspace(0.5, 4.0, 200))))
    speed = np.linalg.norm(fastest.evaluate(np.linspace(0.0, fastest.duration, 400), 1)[:, :3], axis=1).max()
    print(f"the fastest eight within the rotors' limits takes {fastest.duration:.2f} s, at up to {speed:.1f} m/s")

    flown = jaxplan.track([fastest.dilate(1.0 / rate) for rate in FASTER], vehicle=vehicle)
    for rate, held, error in zip(FASTER, flown.feasible, flown.max_position_error, strict=True):
        print(f"  {rate:.1f} times as fast: " + (f"tracked, {error:.2f} m off at most" if held else "not tracked"))


if __name__ == "__main__":
    main()
