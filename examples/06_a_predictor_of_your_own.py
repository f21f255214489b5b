"""A predictor of your own, in thirty lines.

A predictor is a function of the observations and the cycle's number that proposes goals: where the target may be, when,
and how likely that is. This one expects the target to go on turning as it does: the turn of its last three positions,
about the vertical, goes on at the same rate. It stands beside constant velocity on a target that circles, first in
what it predicts and then in flight.
"""

import dataclasses
from pathlib import Path

import numpy as np

import jaxplan
from jaxplan.interception import fly, warm_up
from jaxplan.prediction.observations import Observations
from jaxplan.scenario import build_scenario

OUT = Path("out/examples")
STEPS, DT = 20, 0.1  # positions ahead, s


def turning(observations: Observations, cycle: int) -> jaxplan.Candidates:
    """One goal for each of the next steps, on the circle through the newest three positions."""
    seen = observations.positions[-3:]
    offsets = DT * np.arange(1, STEPS + 1)  # s after the newest observation
    if len(seen) < 3:
        return jaxplan.candidates_from(seen[-1], np.repeat(seen[-1:], STEPS, axis=0), offsets, np.zeros(STEPS))
    interval = observations.times[-1] - observations.times[-2]
    before, after = np.diff(seen, axis=0)[:, :2] @ [1.0, 1.0j] / interval  # horizontal velocities, complex
    rate = np.angle(after / before) / interval if abs(before) > 1e-6 else 0.0  # rad/s
    now = after * np.exp(0.5j * rate * interval)
    flown = offsets if abs(rate) < 1e-6 else (np.exp(1j * rate * offsets) - 1.0) / (1j * rate)
    climb = (seen[2, 2] - seen[1, 2]) / interval
    way = np.stack([(now * flown).real, (now * flown).imag, climb * offsets], axis=1)
    certainty = -0.5 * offsets  # the farther ahead, the less likely; to within a constant
    return jaxplan.candidates_from(seen[-1], seen[-1] + way, offsets - observations.age, certainty)


def circle(times: np.ndarray) -> np.ndarray:
    """The target's flight: 1 m in radius, about 2 m/s, in front of the wall of environment 1."""
    return np.stack([-3.4 + np.cos(2.0 * times), -3.0 + np.sin(2.0 * times), np.full_like(times, 1.0)], axis=-1)


def main() -> None:
    """Compare what both predict, then fly each against the circling target."""
    OUT.mkdir(parents=True, exist_ok=True)
    times = DT * np.arange(10)
    observations = Observations(times=times, positions=circle(times))
    straight = jaxplan.build_predictor("constant-velocity", jaxplan.PredictionConfig(dt=DT, steps=STEPS))
    predictors = {"constant velocity": straight, "turning": turning}
    for name, predictor in predictors.items():
        goals = predictor(observations, 0).goals
        off = np.linalg.norm(goals - circle(times[-1] + DT * np.arange(1, STEPS + 1)), axis=1)
        print(f"{name:17}: {off[9]:.2f} m off after 1 s, {off[-1]:.2f} m after 2 s")

    sampled = np.arange(0.0, 12.0, 0.05)
    flight = np.column_stack([sampled, circle(sampled)])
    np.savetxt(OUT / "circle.csv", flight, delimiter=",", header="t,x,y,z", comments="")
    scenario = build_scenario(jaxplan.InterceptConfig(world="env1", target=str(OUT / "circle.csv")))
    warm_up(scenario)
    for name, predictor in predictors.items():
        episode = fly(dataclasses.replace(scenario, predictor=predictor))
        spent = episode.flight.times[-1] - scenario.departure
        print(f"{name:17}: {episode.outcome} after {spent:.2f} s, {len(episode.plans)} plans")


if __name__ == "__main__":
    main()
