"""Stream a plan to a flight controller over MAVLink.

The setpoints of a trajectory, as `jaxplan export --format setpoints --frame ned` writes them, go out as
SET_POSITION_TARGET_LOCAL_NED, 50 a second. The frame is north, east, down; nothing is masked out, so position, velocity
and acceleration all count. Here the other end is this script, on the loopback interface, and says what has arrived: put
your vehicle's address into `ADDRESS` instead. It needs `pip install pymavlink`.

A real flight controller wants setpoints for a second or more before it takes OFFBOARD mode, and fails over when they
stop: arm and switch modes by your ground station, and keep a pilot at hand.
"""

import csv
import io
import threading
import time

import numpy as np
from pymavlink import mavutil
from pymavlink.dialects.v20 import common

import jaxplan
from jaxplan.io.export import ExportConfig, export_trajectory

ADDRESS = "127.0.0.1:14599"
RATE = 50.0  # setpoints a second


def plan() -> list[dict[str, float]]:
    """Rows of setpoints; read the file of `jaxplan export` instead for a flown interception."""
    spline = jaxplan.minimum_snap([[0, 0, 1], [2, 1, 1.5], [4, 0, 1]], [1.0, 1.0], yaw=[0.0, 0.3, 0.0])
    content = export_trajectory(spline, "setpoints", ExportConfig(frame="ned", rate=RATE)).content
    return [
        {name: float(value) for name, value in row.items()} for row in csv.DictReader(io.StringIO(content.decode()))
    ]


def send(rows: list[dict[str, float]]) -> None:
    """Each setpoint when it is due."""
    vehicle = mavutil.mavlink_connection(f"udpout:{ADDRESS}", source_system=255)
    began = time.monotonic()
    for row in rows:
        time.sleep(max(0.0, began + row["t"] - time.monotonic()))
        numbers = [row[name] for name in ("x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "yaw", "yaw_rate")]
        stamp = int(1e3 * row["t"])  # ms
        vehicle.mav.set_position_target_local_ned_send(stamp, 1, 1, common.MAV_FRAME_LOCAL_NED, 0, *numbers)


def main() -> None:
    """Send in one thread, listen in the other, and compare."""
    rows = plan()
    listener = mavutil.mavlink_connection(f"udpin:{ADDRESS}")
    threading.Thread(target=send, args=(rows,)).start()
    received = []
    while len(received) < len(rows):
        message = listener.recv_match(type="SET_POSITION_TARGET_LOCAL_NED", blocking=True, timeout=2.0)
        if message is None:
            break
        received.append([message.x, message.y, message.z])
    sent = np.array([[row["x"], row["y"], row["z"]] for row in rows[: len(received)]])
    print(f"{len(received)} of {len(rows)} setpoints arrived over {rows[-1]['t']:.1f} s")
    print(f"apart by less than 1 um: {bool(np.abs(np.array(received) - sent).max() < 1e-6)}")
    print(f"north {received[50][0]:.2f} m, east {received[50][1]:.2f} m, down {received[50][2]:.2f} m after 1 s")


if __name__ == "__main__":
    main()
