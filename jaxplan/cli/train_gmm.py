"""``jaxplan train gmm``: fit a mixture of target motions for ``--predictor gmm``."""

import dataclasses
import hashlib
import os
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from jaxplan.cli.parameters import command_line, option_values, with_options
from jaxplan.errors import InputError
from jaxplan.prediction.gmm import FitConfig, fit_mixture
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.scores import observe_windows, score
from jaxplan.prediction.target_model import TargetModel, save_model, window_coordinates
from jaxplan.prediction.waypoints import ChainConfig, WaypointSource, chains, walks
from jaxplan.prediction.windows import OPEN_SPACE, WindowConfig, draw_windows
from jaxplan.training.tours import tours
from jaxplan.versions import require_supported_jax
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World

Flights = Literal["tours", "chains", "walks"]

_HELD_OUT = 0.2
"""Held-out windows, as a share of those that are fitted."""
_SCORED = 1000
"""Held-out windows on which the errors of the card are measured."""


@with_options(FitConfig)
def gmm(
    *,
    world: str | None = None,
    out: Path,
    flights: Flights | None = None,
    dt: float | None = None,
    windows: int = 20000,
    config: FitConfig,
    debug: bool = False,
) -> int:
    """Fit a Gaussian mixture to windows of random minimum-snap flights, for --predictor gmm.

    Parameters
    ----------
    world
        A stored world's name or a map's file. Default: open space, for any world.
    out
        Where the mixture is saved (.npy); its card, with command, seed, data hash and scores, goes beside it (.json).
    flights
        tours: over far places along searched routes; chains: between free places in sight of each other; walks: in
        open space. Default: tours in a world, walks without.
    dt
        Seconds between two positions. Default: 0.1, and 0.2 in rooms with a diagonal above 20 m.
    windows
        How many windows are fitted.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    if out.suffix != ".npy" or not os.path.isdir(out.parent) or windows < 1:
        have = f"--out {out} and --windows {windows}"
        raise InputError(f"train gmm: have {have}, want a .npy file in a folder that exists and at least 1; correct it")
    room = None if world is None else load_world(world)
    if dt is None:
        dt = (PredictionConfig() if room is None else PredictionConfig.for_world(room)).dt
    flights = flights or ("walks" if room is None else "tours")
    source, cuts = _flights(flights, room, dt)
    rng = np.random.default_rng(config.seed)
    fitted = draw_windows([source], room, windows, rng, cuts)
    held_out = draw_windows([source], room, max(1, int(_HELD_OUT * windows)), rng, cuts)
    training, test = (window_coordinates(w, cuts.observations, room is not None) for w in (fitted, held_out))
    fit, likelihoods = fit_mixture(training, test, config)
    name, bounds = ("generic", None) if room is None else (room.name, np.asarray(room.bounds, dtype=float))
    model = TargetModel(name, cuts.observations, cuts.steps, dt, bounds, fit.weights, fit.means, fit.factors)
    options = {"world": world, "out": out.name, "flights": flights, "dt": dt, "windows": windows}
    origin = {
        "command": command_line("train gmm", options, option_values(config)),
        "seed": config.seed,
        "data_sha256": hashlib.sha256(fitted.astype("<f8").tobytes()).hexdigest(),
        "held_out_log_likelihood": {str(count): round(value, 3) for count, value in likelihoods.items()},
        "held_out_scores": _scores(model, held_out[:_SCORED], room),
        "versions": {package: metadata.version(package) for package in ("jaxplan", "numpy", "scikit-learn")},
    }
    save_model(model, out, origin)
    for count, value in likelihoods.items():
        print(f"{count:>3} components: mean log-likelihood of held-out windows {value:.2f}")
    print(f"{out}: {len(fit.weights)} components, {out.stat().st_size / 1e6:.2f} MB")
    return 0


def _flights(kind: Flights, room: World | None, dt: float) -> tuple[WaypointSource, WindowConfig]:
    """Where waypoints come from, and how flights are cut."""
    if (room is None) != (kind == "walks"):
        raise InputError(f"--flights: have {kind!r}, want walks without --world and tours or chains with it")
    if room is None:
        return walks(), dataclasses.replace(OPEN_SPACE, dt=dt)
    config = WindowConfig(dt=dt)
    source = tours(room, config.margin) if kind == "tours" else chains(room, ChainConfig(margin=config.margin))
    return source, config


def _scores(model: TargetModel, windows: Float[np.ndarray, "k length 3"], room: World | None) -> dict[str, Any]:
    """Errors, likelihood and coverage of the mixture, and the errors of constant velocity, on the same windows."""
    config = PredictionConfig(steps=model.steps, dt=model.dt, observations=model.observations)

    seen, futures = observe_windows(windows, model.observations, model.dt)
    found: dict[str, Any] = {"windows": len(windows)}
    for name in ("gmm", "constant-velocity"):
        predictor = build_predictor(name, config, model=model, world=room)
        summary = score([predictor.predict(observations) for observations in seen], futures).summary()
        found[name] = {key: None if value is None else round(value, 4) for key, value in summary.items()}
    return found
