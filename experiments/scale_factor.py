"""Tracking error against scale factor: the vehicle on random minimum-snap trajectories, slowed from their limit.

    python -m experiments.scale_factor --count 64 --out out/scale_factor

Each trajectory (rest to rest through random waypoints, durations proportional to distance) is brought to its
feasibility boundary: the fastest dilation whose rotor speeds, by flatness, stay within limits. It is then slowed by
alpha from 0.7 (faster than the boundary) to 2.0 and flown with noise. The picture shows mean and standard deviation of
the largest position and yaw error of a flight; flights 5 m off or not finite are counted beside it, not averaged.
"""

import json
from pathlib import Path

import cyclopts
import numpy as np

from jaxplan.minsnap.problem import minimum_snap
from jaxplan.tracking.fidelity import build_labeller
from jaxplan.tracking.result import TRAINING
from jaxplan.tracking.track import TrackConfig, track
from jaxplan.viz.scale_factor import draw_scale_factor

ALPHAS = np.round(np.arange(0.7, 2.01, 0.1), 2)
BISECTIONS = 12
"""Halvings of log alpha over a range of 100: the boundary is found to 0.1 %."""


def random_trajectories(count, waypoints, rng):
    """Rest to rest through ``waypoints`` points with steps of up to 3 m an axis, yaw along with chance."""
    chains = np.cumsum(rng.uniform(-3.0, 3.0, (count, waypoints, 3)), axis=1)
    headings = np.cumsum(rng.uniform(-0.5, 0.5, (count, waypoints)), axis=1)
    steps = np.linalg.norm(np.diff(chains, axis=1), axis=2)
    return [minimum_snap(c, step, yaw=yaw) for c, step, yaw in zip(chains, steps, headings, strict=True)]


def at_the_boundary(splines):
    """Each spline at the fastest dilation that the rotors allow; feasible stays feasible when slowed, nearly always."""
    within = build_labeller("rotor-limits")
    low, high = np.full(len(splines), -np.log(10.0)), np.full(len(splines), np.log(10.0))
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        feasible = within([s.dilate(a) for s, a in zip(splines, np.exp(middle), strict=True)]).feasible
        low, high = np.where(feasible, low, middle), np.where(feasible, middle, high)
    return [spline.dilate(alpha) for spline, alpha in zip(splines, np.exp(high), strict=True)]


def statistics(result):
    """Mean and standard deviation over the flights that stayed finite, and how many did."""
    flown = np.isfinite(result.max_position_error) & np.isfinite(result.max_yaw_error)
    flown &= result.max_position_error < 5.0  # lost: its error says only how far it fell
    position, yaw = result.max_position_error[flown], np.degrees(result.max_yaw_error[flown])
    return {
        "position_mean_m": position.mean(),
        "position_std_m": position.std(),
        "yaw_mean_deg": yaw.mean(),
        "yaw_std_deg": yaw.std(),
        "feasible_share": result.feasible.mean(),
        "lost_share": 1.0 - flown.mean(),
    }


app = cyclopts.App(name="scale_factor", help=__doc__)


@app.default
def main(
    *,
    count: int = 64,
    waypoints: int = 5,
    controller: str = "indi",
    seed: int = 0,
    out: Path = Path("out/scale_factor"),
) -> None:
    """Fly ``count`` trajectories at each alpha; write ``scale_factor.json`` and ``scale_factor.png``."""
    splines = at_the_boundary(random_trajectories(count, waypoints, np.random.default_rng(seed)))
    config = TrackConfig(controller=controller, seed=seed)
    result = track([spline.dilate(alpha) for alpha in ALPHAS for spline in splines], config=config)
    rows = []
    for index, alpha in enumerate(ALPHAS):
        part = slice(index * count, (index + 1) * count)
        rows.append({"alpha": float(alpha), **statistics(_part(result, part))})
        print("  ".join(f"{key} {float(value):.3f}" for key, value in rows[-1].items()))
    out.mkdir(parents=True, exist_ok=True)
    command = f"python -m experiments.scale_factor --count {count} --waypoints {waypoints} --seed {seed}"
    command += f" --controller {controller}"
    report = {"command": command, "rows": rows}
    (out / "scale_factor.json").write_text(json.dumps(report, indent=1, default=float) + "\n", encoding="utf-8")
    draw_scale_factor(rows, out / "scale_factor.png", position=TRAINING.position, yaw=np.degrees(TRAINING.yaw))
    print(f"{len(ALPHAS) * count} flights; picture in {out / 'scale_factor.png'}")


def _part(result, part):
    return type(result)(**{name: values[part] for name, values in vars(result).items()})


if __name__ == "__main__":
    app()
