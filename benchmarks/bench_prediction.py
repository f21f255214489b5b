"""Condition, draw and score 400 candidates of a Gaussian mixture, against NumPy and SciPy on the same mixture.

python -m benchmarks.bench_prediction [--world env1] [--repeats 500] [--json FILE]

The interception paper reports 18.7 ms for its prediction (mean, on a Titan Xp). ``compiled`` is the one program that
conditions, draws and scores; ``predictor`` the whole call from observations to candidates, with random numbers;
``particles``, ``imm``, ``fused``, ``mdn`` and ``ensemble`` whole calls of the predictors of these names, which know the
room.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from jaxplan.compilation import compilations
from jaxplan.io.targets import load_target
from jaxplan.precision import in_float64
from jaxplan.prediction.mixture_predictor import conditional_draw
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.target_model import TargetModel, shipped_model, window_coordinates
from jaxplan.world.load import ENVIRONMENTS, load_world

from . import _harness


def milliseconds(function: Callable[[int], object], repeats: int) -> list[float]:
    """Of each call, after a first one that is not counted."""
    function(0)
    spent = []
    for index in range(repeats):
        began = time.perf_counter()
        function(index)
        spent.append(1e3 * (time.perf_counter() - began))
    return spent


def scipy_candidates(
    model: TargetModel,
    observed: Float[np.ndarray, "q"],
    newest: Float[np.ndarray, "3"],
    config: PredictionConfig,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "s b 3"], Float[np.ndarray, "s b"]]:
    """The same with covariances, solves and SciPy's densities, for one observation."""
    q = len(observed)
    weights, parts = [], []
    for weight, mean, factor in zip(model.weights, model.means, model.factors, strict=True):
        covariance = factor @ factor.T
        head = cho_factor(covariance[:q, :q])
        gain = cho_solve(head, covariance[:q, q:]).T
        weights.append(np.log(weight) + multivariate_normal.logpdf(observed, mean[:q], covariance[:q, :q]))
        parts.append((mean[q:] + gain @ (observed - mean[:q]), covariance[q:, q:] - gain @ covariance[:q, q:]))
    logs = np.array(weights) - logsumexp(weights)
    chosen = rng.choice(len(logs), (config.steps, config.batch), p=np.exp(logs))
    goals = np.empty((config.steps, config.batch, 3))
    density = np.empty((config.steps, config.batch))
    for step in range(config.steps):
        at = slice(3 * step, 3 * step + 3)
        for draw, component in enumerate(chosen[step]):
            mean, covariance = parts[component]
            goals[step, draw] = rng.multivariate_normal(mean[at], covariance[at, at])
        each = [multivariate_normal.logpdf(goals[step], mean[at], covariance[at, at]) for mean, covariance in parts]
        density[step] = logsumexp(logs[:, None] + np.array(each), axis=0)
    return goals + newest, density


@in_float64
def measure(world: str, repeats: int) -> list[dict[str, Any]]:
    """One row for each way of doing it."""
    room = load_world(world)
    config = PredictionConfig.for_world(room)
    model = shipped_model(world, config.dt)
    target = load_target(None, world=world, speed=2.0)
    times = 2.0 + config.dt * np.arange(config.observations)
    seen = Observations(times=times, positions=target.position(times))
    predictor = build_predictor("gmm", config, target.position, model=model)
    names = ("particles", "imm", "fused", "mdn", "ensemble")
    whole = {name: build_predictor(name, config, model=model, world=room) for name in names}
    prepared = jax.device_put(model.conditional())
    observed, newest = (
        window_coordinates(seen.positions, config.observations, model.bounds is not None),
        seen.positions[-1],
    )
    rng = np.random.default_rng(0)
    randoms = rng.random((config.steps, config.batch, 4))
    ways = {
        "compiled": (
            lambda index: jax.block_until_ready(conditional_draw(prepared, np.append(newest, observed), randoms)),
            repeats,
        ),
        "predictor": (lambda index: predictor(seen, index), repeats),
        **{name: ((lambda index, one=one: one(seen, index)), repeats) for name, one in whole.items()},
        "scipy": (lambda index: scipy_candidates(model, observed, newest, config, rng), max(3, repeats // 100)),
    }
    rows = []
    for way, (function, count) in ways.items():
        function(0)
        before = compilations()
        spent = milliseconds(function, count)
        rows.append(
            {
                "world": world,
                "components": len(model.weights),
                "way": way,
                "median_ms": float(np.median(spent)),
                "p99_ms": float(np.percentile(spent, 99)),
                "compilations": compilations() - before,
            }
        )
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the rows; write them where ``--json`` says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--world", choices=ENVIRONMENTS, default="env1")
    parser.add_argument("--repeats", type=int, default=500)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    rows = measure(options.world, options.repeats)
    _harness.show(rows)
    if options.json:
        _harness.write(options.json, rows)


if __name__ == "__main__":
    main()
