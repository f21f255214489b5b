"""The policy's parts: encoder, one decoder pass, the arrival matching, and the classifier of its flights.

    jaxplan bench policy [--json FILE]

Random sequences of 2 to 14 waypoints from random states in flight; arrival times 1 to 3 times the least.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplan.arrival import Arrival, ArrivalConfig, match_arrival
from jaxplan.feasibility.checkpoint import load_classifier
from jaxplan.feasibility.classifier import Classifier
from jaxplan.minsnap.spline_batch import fit_each
from jaxplan.policy.checkpoint import load_policy
from jaxplan.policy.protocol import Policy
from jaxplan.spline import FlatState
from jaxplan.vehicle.identity import require_same_vehicle
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle

from . import _harness


def sequences(
    lanes: int, waypoints: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "n 3 k"], Int[np.ndarray, "k"]]:
    """Random paths with steps of metres, the goal repeated behind the last waypoint."""
    count = rng.integers(2, waypoints + 1, lanes)
    points = np.cumsum(rng.normal(size=(waypoints, 3, lanes)) * [[2.0], [2.0], [0.3]], axis=0)
    for lane, used in enumerate(count):
        points[used:, :, lane] = points[used - 1, :, lane]
    return points - points[:1], count


def measure(
    policy: Policy, classifier: Classifier, vehicle: Vehicle, lanes: int, waypoints: int, repeats: int
) -> Iterator[dict[str, Any]]:
    """One row for each part, over ``lanes`` candidates of up to ``waypoints`` waypoints."""
    rng = np.random.default_rng(0)
    points, count = sequences(lanes, waypoints, rng)
    derivatives = rng.normal(size=(5, 3)) * np.array([[0.0], [2.0], [3.0], [5.0], [10.0]])
    state = FlatState(derivatives=derivatives, yaw=np.zeros(3))
    states = state.repeated(lanes)
    encode, decode = jax.jit(policy.encode), jax.jit(policy.decode)
    context = encode(points, count)
    least = np.asarray(decode(context, states)).sum(axis=0)
    times = least * rng.uniform(1.0, 3.0, lanes)

    @jax.jit
    def match(context: Any, times: Float[Array, "k"]) -> Arrival:
        return match_arrival(lambda s: policy.decode(context, s), state, times, ArrivalConfig())

    calls = np.asarray(match(context, times).calls)
    shape = {"candidates": lanes, "waypoints": waypoints}
    yield {"part": "encode", **shape, **_harness.timed(encode, points, count, repeats=repeats)}
    yield {"part": "decode", **shape, **_harness.timed(decode, context, states, repeats=repeats)}
    matched = _harness.timed(match, context, times, repeats=repeats)
    passes = {"median_passes": float(np.median(calls)), "most_passes": int(calls.max())}
    yield {"part": "match arrival", **shape, **matched, **passes}
    splines = jax.jit(fit_each, static_argnums=3)(states, points, decode(context, states), 1.5)
    classify = jax.jit(lambda splines: classifier.predict(splines, vehicle))  # one vehicle, as in a planner
    yield {"part": "classify", **shape, **_harness.timed(classify, splines, repeats=repeats)}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the rows; write them where ``--json`` says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="save the rows, with hardware, versions and commit")
    parser.add_argument("--policy", default="mfrl")
    parser.add_argument("--classifier", default="mfrl")
    parser.add_argument("--candidates", type=int, nargs="+", default=[36, 400, 2048])
    parser.add_argument("--waypoints", type=int, nargs="+", default=[7, 14])
    parser.add_argument("--repeats", type=int, default=50)
    chosen = parser.parse_args(arguments)
    rows: list[dict[str, Any]] = []
    with jax.enable_x64(True):
        policy, classifier, vehicle = load_policy(chosen.policy), load_classifier(chosen.classifier), load_vehicle()
        require_same_vehicle("classifier", classifier.vehicle, vehicle)
        for lanes in chosen.candidates:
            for waypoints in chosen.waypoints:
                rows += measure(policy, classifier, vehicle, lanes, waypoints, chosen.repeats)
    _harness.show(rows)
    if chosen.json:
        _harness.write(chosen.json, rows)


if __name__ == "__main__":
    main()
