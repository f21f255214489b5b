"""Minimum-snap solves and gradients, against SciPy's banded solver and two packages, in the same run.

    jaxplan bench minsnap [--json FILE]

"solve" gives coefficients and cost, "cost" the cost alone, "cost_and_gradient" its gradient by durations and waypoints
too, all inside jit; "numpy" is the whole public call on NumPy arrays, residual and status included. float32 rows take
and return float32 and solve in float64. SciPy's baseline is banded Cholesky (LAPACK pbsv) of the same degree-9 problem,
one call per problem, without assembling the matrix.
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import solveh_banded

from jaxplan.minsnap.many import minimum_snap_batch
from jaxplan.precision import in_float64

from . import _harness


def problems(waypoints, batch, dtype):
    """Random problems in a 10 x 10 x 2 m room."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (waypoints, 3, batch)) * np.array([10.0, 10, 2])[:, None]
    return jnp.asarray(points, dtype), jnp.asarray(rng.uniform(0.3, 2.0, (waypoints - 1, batch)), dtype)


def solve(points, durations):
    """Coefficients and cost."""
    solved = minimum_snap_batch(points, durations)
    return solved.splines.position, solved.cost


def cost(points, durations):
    """The cost alone."""
    return minimum_snap_batch(points, durations).cost


def cost_and_gradient(points, durations):
    """The cost and its gradient by waypoints and durations."""
    value, pullback = jax.vjp(cost, points, durations)
    return value, pullback(jnp.ones_like(value))


def scipy_banded(waypoints, repeats):
    """Milliseconds per problem of the bare banded solve: 4 unknowns per interior knot, 3 axes."""
    size = 4 * (waypoints - 2)
    if size == 0:
        return None
    band = np.full((8, size), 0.1)
    band[0] = 4.0
    right = np.ones((size, 3))
    return _harness.timed(lambda: solveh_banded(band, right, lower=True), repeats=repeats)["min_ms"]


def peers(waypoints, repeats):
    """Milliseconds per problem of each installed package."""
    points, durations = (np.asarray(a[..., 0]) for a in problems(waypoints, 1, jnp.float64))
    times = np.concatenate([[0.0], np.cumsum(durations)])
    found = {}
    try:
        import minsnap_trajectories as peer

        still = np.zeros(3)
        ends = {0, waypoints - 1}
        references = [
            peer.Waypoint(t, p, still, still, still) if i in ends else peer.Waypoint(t, p)
            for i, (t, p) in enumerate(zip(times, points, strict=True))
        ]
        run = lambda: peer.generate_trajectory(references, 9, idx_minimized_orders=4, num_continuous_orders=5)  # noqa: E731
        found["minsnap-trajectories"] = _harness.timed(run, repeats=repeats)["min_ms"]
    except ImportError:
        print("minsnap-trajectories is not installed: pip install 'jaxplan[peers]'")
    try:
        from rotorpy.trajectories.minsnap import MinSnap

        found["rotorpy"] = _harness.timed(lambda: MinSnap(points, v_avg=3.0, verbose=False), repeats=repeats)["min_ms"]
    except ImportError:
        print("rotorpy is not installed: pip install 'jaxplan[peers]'")
    except TypeError as error:  # what it raises where its QP solver finds no solution
        print(f"rotorpy did not solve {waypoints} waypoints: {error}")
    return found


@in_float64
def measure(sizes, batches, repeats):
    """One row for each method, number of waypoints, batch and precision."""
    rows = []
    for waypoints in sizes:
        baselines = {"scipy banded": scipy_banded(waypoints, repeats), **peers(waypoints, max(repeats // 4, 1))}
        for name, each in baselines.items():
            if each is not None:
                rows.append({"method": name, "waypoints": waypoints, "ms_per_problem": each})
        for batch in batches:
            for dtype in (jnp.float64, jnp.float32):
                arrays = problems(waypoints, batch, dtype)
                for function in (solve, cost, cost_and_gradient):
                    row = _harness.timed(jax.jit(function), *arrays, repeats=repeats)
                    each = row["min_ms"] / batch
                    head = {"method": function.__name__, "waypoints": waypoints, "batch": batch}
                    ratios = {f"times faster than {n}": t / each for n, t in baselines.items() if t is not None}
                    rows.append({**head, "dtype": jnp.dtype(dtype).name, **row, "ms_per_problem": each, **ratios})
            arrays = [np.asarray(a) for a in problems(waypoints, batch, jnp.float64)]
            row = _harness.timed(minimum_snap_batch, *arrays, repeats=repeats)
            head = {"method": "numpy", "waypoints": waypoints, "batch": batch, "dtype": "float64"}
            rows.append({**head, **row, "ms_per_problem": row["min_ms"] / batch})
    return rows


def draw(rows, path):
    """Time per problem against the waypoints and against the batch."""
    from ._figure import draw_costs

    ours = [row for row in rows if row["method"] == "solve" and row["dtype"] == "float64"]
    draw_costs(ours, [row for row in rows if "batch" not in row], path)


def main(argv=None):
    """Measure, print and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--waypoints", type=int, nargs="+", default=[2, 6, 14])
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 400, 4096])
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args(argv)
    rows = measure(options.waypoints, options.batches, options.repeats)
    _harness.show(rows)
    if options.json:
        _harness.write(options.json, rows)
    if options.picture:
        draw(rows, options.picture)
    return rows


if __name__ == "__main__":
    main()
