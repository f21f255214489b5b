"""Batched time allocation, against SciPy's L-BFGS-B on one problem at a time with the same cost and gradient.

jaxplan bench time-allocation [--json FILE]
"""

import argparse
import functools
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import OptimizeResult, minimize

from jaxplan.minsnap.many import minimum_snap_batch
from jaxplan.minsnap.time_allocation import TimeAllocationConfig, time_allocation
from jaxplan.precision import in_float64
from jaxplan.vehicle.limits import rotor_limit_margin
from jaxplan.vehicle.load import load_vehicle

from . import _harness

TIME_WEIGHT = 1000.0
"""rho [m^2/s^8] (arbitrary: mean speeds of a few m/s)."""


def waypoints(count: int, batch: int) -> Float[np.ndarray, "n 3 b"]:
    """Random waypoints in a 10 x 10 x 2 m room."""
    return np.random.default_rng(0).uniform(0, 1, (count, 3, batch)) * np.array([10.0, 10, 2])[:, None]


@in_float64
def scipy_each(points: Float[np.ndarray, "n 3 b"], repeats: int) -> float:
    """Milliseconds per problem."""

    def log_cost(logs: Float[Array, "m"], points: Float[Array, "n 3"]) -> Float[Array, ""]:
        times = jnp.exp(logs)
        return jnp.log(minimum_snap_batch(points[..., None], times[:, None]).cost[0] + TIME_WEIGHT * jnp.sum(times))

    both = jax.jit(jax.value_and_grad(log_cost))

    def one(lane: int) -> OptimizeResult:
        run = lambda logs: tuple(np.asarray(v) for v in both(logs, points[..., lane]))  # noqa: E731
        return minimize(run, np.zeros(len(points) - 1), jac=True, method="L-BFGS-B", options={"ftol": 1e-6})

    one(0)
    calls = itertools.count()
    return _harness.timed(lambda: one(next(calls) % points.shape[-1]).fun, repeats=repeats)["median_ms"]


def measure(sizes: Sequence[int], batches: Sequence[int], repeats: int) -> list[dict[str, Any]]:
    """One row for each way of allocating, size and batch."""
    rows = []
    margin = functools.partial(rotor_limit_margin, load_vehicle())
    tight = TimeAllocationConfig(tolerance=1e-12, max_evaluations=300)
    for count in sizes:
        baseline = scipy_each(waypoints(count, 8), repeats)
        rows.append({"method": "scipy L-BFGS-B, our gradient", "waypoints": count, "ms_per_problem": baseline})
        for batch in batches:
            points = waypoints(count, batch)
            best = time_allocation(points, time_weight=TIME_WEIGHT, config=tight).cost
            kinds: dict[str, dict[str, Any]] = {
                "weighted": {"time_weight": TIME_WEIGHT},
                "fixed": {"total_time": 5.0},
                "fastest": {"margin": margin},
            }
            for name, options in kinds.items():
                row = _harness.timed(functools.partial(time_allocation, points, **options), repeats=repeats)
                found = time_allocation(points, **options)
                each = row["min_ms"] / batch
                extra = {"evaluations": int(found.evaluations.max()), "solved": float(np.mean(found.status == 0))}
                if name == "weighted":
                    extra["worst_excess"] = float(np.max(found.cost / best - 1.0))
                    extra["times faster than scipy"] = baseline / each
                head = {"method": name, "waypoints": count, "batch": batch}
                rows.append({**head, **row, "ms_per_problem": each, "per_second": 1e3 / each, **extra})
    return rows


def main(argv: Sequence[str] | None = None) -> list[dict[str, Any]]:
    """Print the rows and return them; write them where ``--json`` says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--waypoints", type=int, nargs="+", default=[6, 14])
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 400])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(argv)
    rows = measure(options.waypoints, options.batches, options.repeats)
    _harness.show(rows)
    if options.json:
        _harness.write(options.json, rows)
    return rows


if __name__ == "__main__":
    main()
