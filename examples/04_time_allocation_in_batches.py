"""Time allocation, a hundred sequences at once.

Three ways to spend time between the same waypoints: in proportion to the distances, as smooth as the same total time
allows, and as fast as the rotors' limits allow. `margin` may be any function of flat states that is positive where a
limit is kept.
"""

import functools

import numpy as np

import jaxplan

SEQUENCES, WAYPOINTS = 100, 6


def main() -> None:
    """Compare the three on random sequences."""
    rng = np.random.default_rng(1)
    steps = rng.normal(0.0, 1.0, (WAYPOINTS, 3, SEQUENCES)) * np.array([2.0, 2.0, 0.4])[:, None]
    waypoints = np.cumsum(steps, axis=0) + np.array([0.0, 0.0, 1.5])[:, None]  # m

    lengths = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    proportional = lengths / 1.5  # s, at 1.5 m/s
    total = proportional.sum(axis=0)
    smooth = jaxplan.time_allocation(waypoints, total_time=total)
    margin = functools.partial(jaxplan.rotor_limit_margin, jaxplan.load_vehicle("mfrl"))
    fastest = jaxplan.time_allocation(waypoints, margin=margin)

    before = jaxplan.minimum_snap_batch(waypoints, proportional).cost
    print(f"snap at the same total time, smooth over proportional: {np.median(smooth.cost / before):.4f} in the median")
    ratio = fastest.durations.sum(axis=0) / total
    print(
        f"least time over that of 1.5 m/s: {np.median(ratio):.3f} in the median, {ratio.min():.3f} to {ratio.max():.3f}"
    )
    shares = fastest.durations / fastest.durations.sum(axis=0)
    print("mean share of each segment's time:", np.array2string(shares.mean(axis=1), precision=3))
    print(f"all solved: {bool((fastest.status == 0).all() and (smooth.status == 0).all())}")


if __name__ == "__main__":
    main()
