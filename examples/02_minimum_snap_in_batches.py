"""Minimum snap, thousands at a time.

Each problem has its own waypoints and durations, and may have fewer segments than the others: durations of 0 stand
behind its last one. The batch is the last axis. A problem that cannot be solved says so and changes no other.
"""

import sys
import time

import numpy as np

import jaxplan

PROBLEMS, WAYPOINTS = 5000, 7


def main() -> None:
    """Solve a batch of random problems and look at three of them."""
    rng = np.random.default_rng(0)
    waypoints = np.cumsum(rng.normal(0.0, 1.5, (WAYPOINTS, 3, PROBLEMS)), axis=0)  # m
    lengths = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    durations = np.maximum(lengths / 2.0, 0.3)  # s: 2 m/s in the mean
    durations[3:, 1] = 0.0  # problem 1 has three segments
    durations[0, 2] = np.nan  # problem 2 is broken

    jaxplan.minimum_snap_batch(waypoints, durations)  # compiles for this shape
    began = time.perf_counter()
    solved = jaxplan.minimum_snap_batch(waypoints, durations)
    spent = time.perf_counter() - began
    print(f"{1e6 * spent / PROBLEMS:.1f} us a problem", file=sys.stderr)

    print(f"{(solved.status == 0).sum()} of {PROBLEMS} solved, not problem {np.flatnonzero(solved.status)}")
    alone = jaxplan.minimum_snap(waypoints[:4, :, 1], durations[:3, 1])
    together = solved.splines.spline(1)
    apart = np.abs(together.evaluate(1.0)[:3] - alone.evaluate(1.0)[:3]).max()
    print(f"problem 1: {together.duration:.2f} s; solved alone it is the same to 1 nm: {apart < 1e-9}")
    speed = np.linalg.norm(solved.splines.spline(0).evaluate(np.linspace(0.0, 5.0, 6), derivative=1)[:, :3], axis=1)
    print("speed of problem 0 [m/s], each second:", np.array2string(speed, precision=2))


if __name__ == "__main__":
    main()
