"""Goals and stops of corrections: those of array arithmetic over all of them, in every kind of room."""

import numpy as np
import pytest

from jaxplan.planner import corrections
from jaxplan.planner.kernels.ways import Trial, find_ways
from jaxplan.planner.validator import Room
from jaxplan.search.kernels.solids import solids_of
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World
from oracles.correction_ways import ways
from oracles.solid_rooms import room_of_all_kinds, room_of_grids
from tolerances import assert_close

WANTED = 0.35
TRIAL = Trial(
    WANTED,
    corrections.NEAR_COST,
    corrections.LOOKED_AT,
    corrections.SLOW,
    corrections.REACTION,
    corrections.SHORTEST_STOP,
    corrections.STOP_REACH,
)


def rooms() -> dict[str, World]:
    return {
        "kinds": room_of_all_kinds(),
        "grids": room_of_grids(),
        **{name: load_world(name) for name in ("env1", "env3")},
    }


@pytest.mark.parametrize("name", rooms())
@pytest.mark.parametrize("fastest", [0.3, 6.0])
def test_goals_and_stops_are_those_of_all_that_there_are(name: str, fastest: float) -> None:
    world, rng = rooms()[name], np.random.default_rng(3)
    bounds = np.asarray(world.bounds, float)
    room = Room(tuple(solids_of(world)), bounds)
    for _ in range(25):
        start = np.stack([rng.uniform(*bounds), fastest * rng.normal(size=3) / np.sqrt(3.0)])
        goals = start[0] + rng.normal(scale=0.3 * fastest + 0.2, size=(24, 3))  # some outside of the room
        times = rng.uniform(0.2, 1.9, 24)
        found = find_ways(
            room.solids,
            bounds,
            start,
            goals,
            times,
            corrections._stops(),
            TRIAL,
            (corrections.GOALS, corrections.STOPS),
        )
        for mine, theirs in zip(found, ways(room, start, goals, times, WANTED), strict=True):
            assert_close(mine, theirs, "exact")
