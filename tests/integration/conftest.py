"""What several tests of the planner begin with; tests of other rooms have fixtures of their own."""

import pytest

from jaxplan.world.load import load_world
from oracles.planner_cases import in_flight


@pytest.fixture(scope="module")
def world():
    """Environment 1."""
    return load_world("env1")


@pytest.fixture(scope="module")
def moving():
    """A state in full flight there."""
    return in_flight()
