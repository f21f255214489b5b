"""What is kept from obstacles beyond the vehicle's radius is what tracking errors need, at every speed."""

import dataclasses
import itertools

import numpy as np
import pytest

from experiments import closed_loop, table1
from jaxplan import interception
from jaxplan.selection import CheckConfig
from jaxplan.world.load import ENVIRONMENTS

EDGES = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 30.0)
"""m/s"""


def errors(world: str) -> np.ndarray:
    """Speed of the reference [m/s], and the distance of the vehicle beside it [m]; a row for each control step."""
    rows = []
    for episode in table1.chosen(table1.Config(worlds=(world,), episodes=100))[::10]:
        own = dataclasses.replace(episode, planner="mfrl", predictor="ground-truth")
        flight = interception.fly(closed_loop.scenario_of(own)).flight
        velocity = np.gradient(flight.reference, flight.times, axis=0)
        speed = np.linalg.norm(velocity, axis=1)
        off = flight.position - flight.reference
        along = (off * velocity).sum(axis=1) / np.maximum(speed, 1e-3)
        rows.append(np.stack([speed, np.sqrt(np.maximum((off**2).sum(axis=1) - along**2, 0.0))], axis=1))
    return np.concatenate(rows)


@pytest.mark.slow
def test_999_of_1000_instants_of_flight_need_no_more_than_is_kept() -> None:
    rows = np.concatenate([errors(world) for world in ENVIRONMENTS])
    checks = CheckConfig()
    for low, high in itertools.pairwise(EDGES):
        there = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
        kept = float(checks.margin_at(np.array([0.5 * (low + min(high, 20.0))]))[0])
        assert len(there) > 100
        assert np.quantile(there[:, 1], 0.99) <= kept + 0.02, f"{low} to {high} m/s"
        assert np.quantile(there[:, 1], 0.999) <= kept + 0.05, f"{low} to {high} m/s"
