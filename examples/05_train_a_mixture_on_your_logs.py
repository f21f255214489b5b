"""Train a target model on your own logs.

`jaxplan train gmm` learns from random flights in a room. Where you have recordings of the targets that you expect, cut
windows of 10 seen and 20 future positions out of those instead: `fit_mixture` takes any windows, and `--target-model`
the file that `save_model` writes.

The logs here are flights around a figure eight, each at a speed of its own and never twice on the same line. The last
one is held out.
"""

from pathlib import Path

import numpy as np

import jaxplan
from jaxplan.prediction.gmm import FitConfig, fit_mixture
from jaxplan.prediction.scores import observe_windows, score
from jaxplan.prediction.target_model import TargetModel, load_model, save_model, window_coordinates

OUT = Path("out/examples/logs")
SEEN, AHEAD, DT = 10, 20, 0.1  # positions, positions, s


def write_logs(count: int) -> list[Path]:
    """Recordings as `t,x,y,z`; replace them by yours (other headers, units and frames are read as well)."""
    rng = np.random.default_rng(2)
    paths = []
    for number in range(count):
        times = np.arange(0.0, 40.0, 0.05)
        lap = (0.9 + 0.1 * number / count) * times + 0.2 * np.sin(0.3 * times + number)
        wide = 1.0 + 0.05 * np.sin(0.7 * times + rng.uniform(0.0, 6.0))
        track = [4.0 * wide * np.cos(lap), 2.0 * wide * np.sin(2.0 * lap), 1.5 + 0.3 * np.sin(lap)]
        paths.append(OUT / f"flight{number}.csv")
        np.savetxt(paths[-1], np.stack([times, *track], axis=1), delimiter=",", header="t,x,y,z", comments="")
    return paths


def windows_of(path: Path) -> np.ndarray:
    """Windows of a recording, each 0.1 s after the other: (n, 30, 3) m."""
    target = jaxplan.load_target(str(path), world="")
    starts = np.arange(0.0, target.duration - (SEEN + AHEAD) * DT, 0.1)
    times = starts[:, None] + DT * np.arange(SEEN + AHEAD)
    return target.position(times.ravel()).reshape(*times.shape, 3)


def main() -> None:
    """Fit, save, load, and compare with constant velocity on the flight that was held out."""
    OUT.mkdir(parents=True, exist_ok=True)
    *training, held_out = [windows_of(path) for path in write_logs(6)]
    fitted, checked = (window_coordinates(w, SEEN, False) for w in (np.concatenate(training), held_out))
    fit, likelihoods = fit_mixture(fitted, checked, FitConfig(components=(2, 4)))
    print("held-out log-likelihood:", {count: round(value, 1) for count, value in likelihoods.items()})

    model = TargetModel("generic", SEEN, AHEAD, DT, None, fit.weights, fit.means, fit.factors)
    save_model(model, OUT / "track.npy", {"command": "examples/05_train_a_mixture_on_your_logs.py", "seed": 0})
    config = jaxplan.PredictionConfig(dt=DT)
    seen, futures = observe_windows(held_out[::5], SEEN, DT)
    for name, own in (("gmm", load_model(OUT / "track.npy")), ("gmm", None), ("constant-velocity", None)):
        predictor = jaxplan.build_predictor(name, config, model=own)
        found = score([predictor.predict(one) for one in seen], futures).summary()
        which = "yours" if own is not None else "the shipped one" if name == "gmm" else "none"
        print(
            f"{name:17}, mixture {which:15}: {found['ade_m']:.2f} m off in the mean, {found['fde_m']:.2f} m after 2 s"
        )


if __name__ == "__main__":
    main()
