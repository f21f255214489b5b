"""A sweep on a cluster.

Which speed can which vehicle follow? Every point of the grid is a function call, and dask brings the calls to
processes: two of this machine, or those of a scheduler whose address you give. Results come in the order of the grid,
and do not depend on how many workers there are: the noise of a flight comes from the seed and its place in the batch.
It needs `pip install 'jaxplan[cluster]'`.

    python examples/10_sweep_on_a_cluster.py                     # two processes here
    python examples/10_sweep_on_a_cluster.py tcp://host:8786     # a cluster of yours

A sweep that takes hours wants shards, resuming and a report: `jaxplan experiment my_package.my_experiment` gives all
three to a module with an `EXPERIMENT`.
"""

import logging
import sys

from dask.distributed import Client, LocalCluster

VEHICLES = ("mfrl", "x500")
SPEEDS = (1.0, 2.0, 3.0, 4.0, 6.0)  # m/s, in the mean
FLIGHTS = 60


def tracked_share(vehicle_name: str, speed: float) -> float:
    """Of random flights through five waypoints, that stay within 0.2 m and 15 degrees."""
    import numpy as np

    import jaxplan

    rng = np.random.default_rng(0)
    steps = rng.normal(0.0, 2.0, (5, 3, FLIGHTS)) * np.array([1.0, 1.0, 0.2])[:, None]  # m
    lengths = np.linalg.norm(steps[1:], axis=1)
    solved = jaxplan.minimum_snap_batch(np.cumsum(steps, axis=0), lengths / speed)
    return float(jaxplan.track(solved.splines, vehicle=jaxplan.load_vehicle(vehicle_name)).feasible.mean())


def main() -> None:
    """Send the grid to the workers and print it as a table."""
    here = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": logging.ERROR}
    cluster = sys.argv[1] if len(sys.argv) > 1 else LocalCluster(**here)
    with Client(cluster) as client:
        calls = {name: client.map(tracked_share, [name] * len(SPEEDS), SPEEDS) for name in VEHICLES}
        print(f"{'m/s':8}" + "".join(f"{speed:>8}" for speed in SPEEDS))
        for name, futures in calls.items():
            print(f"{name:8}" + "".join(f"{share:8.2f}" for share in client.gather(futures)))


if __name__ == "__main__":
    main()
