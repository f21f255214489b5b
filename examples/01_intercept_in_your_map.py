"""Intercept in your own map.

A hall of boxes and a recorded flight, as files like those that you have: the map is rotorpy's JSON (meshes, point
clouds, occupancy grids, OctoMaps and MJCF are read as well), the flight is `t,x,y,z` a line. The whole loop is flown
in simulation; `jaxplan intercept --world hall.json --target flight.csv` does the same from a shell.

Change the boxes, the flight, or `predictor`: with "ground-truth" the target's future is known, with "none" it is not.
"""

import json
from pathlib import Path

import numpy as np

import jaxplan
from jaxplan.metrics import episode_metrics
from jaxplan.viz.episode import draw_episode

OUT = Path("out/examples")

ROOM = [-6.0, 6.0, -4.0, 4.0, 0.0, 3.0]  # x, y, z from and to [m]; z is up
BOXES = [
    [-2.5, -1.5, -1.5, 4.0, 0.0, 3.0],  # a wall with a way around its end
    [1.5, 2.5, -4.0, 0.5, 0.0, 3.0],
    [-4.5, -3.5, -2.5, -1.5, 0.0, 1.8],  # a crate; there is room above it
]


def write_map(path: Path) -> None:
    """The hall as rotorpy's worlds are written."""
    blocks = [{"extents": box} for box in BOXES]
    path.write_text(json.dumps({"bounds": {"extents": ROOM}, "blocks": blocks}))


def write_flight(path: Path) -> None:
    """A target that flies back and forth behind the second wall, 20 positions a second."""
    times = np.arange(0.0, 12.0, 0.05)
    x, y, z = 4.4 + 0.6 * np.sin(1.1 * times), 2.2 * np.sin(0.6 * times), 1.4 + 0.3 * np.cos(0.9 * times)
    np.savetxt(path, np.stack([times, x, y, z], axis=1), delimiter=",", header="t,x,y,z", comments="")


def main() -> None:
    """Write both files, fly, and say how it went."""
    OUT.mkdir(parents=True, exist_ok=True)
    write_map(OUT / "hall.json")
    write_flight(OUT / "flight.csv")
    config = jaxplan.InterceptConfig(
        world=str(OUT / "hall.json"), target=str(OUT / "flight.csv"), start=(-5.0, 2.5, 1.0), predictor="gmm"
    )
    episode = jaxplan.run(config)
    metrics = episode_metrics(episode)
    print(f"{metrics['outcome']} {metrics['time_to_intercept_s']:.2f} s after the departure")
    print(f"fastest {metrics['max_speed_m_s']:.1f} m/s, nearest obstacle {metrics['min_clearance_m']:.2f} m away")
    print(f"tracking error at most {metrics['max_position_error_m']:.2f} m")
    draw_episode(episode, metrics, OUT / "01_intercept_in_your_map.png")


if __name__ == "__main__":
    main()
