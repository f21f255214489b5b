"""What InterceptConfig refuses."""

import inspect
import math
import re
from typing import Any

import pytest

from jaxplan.config import InterceptConfig
from jaxplan.errors import InputError
from jaxplan.world.load import _READERS

BAD: list[dict[str, Any]] = [
    {"speed": 0.0},
    {"speed": -1.0},
    {"speed": math.nan},
    {"speed": math.inf},
    {"speed": 51.0},
    {"speed": True},
    {"speed": "fast"},
    {"resolution": 0.0},
    {"resolution": 2.0},
    {"departure": math.nan},
    {"departure": -0.1},
    {"departure": 1e9},
    {"start": (1.0, 2.0)},
    {"start": (1.0, 2.0, math.nan)},
    {"start": "here"},
    {"seed": -1},
    {"seed": 2**32},
    {"seed": 1.5},
    {"seed": True},
    {"world": ""},
    {"world": "a\0b"},
    {"target": " "},
    {"out": ""},
    {"predictor": "oracle"},
    {"planner": "policy"},
    {"meet": "crash"},
    {"heading": "down"},
    {"allocate": "network"},
    {"refine": "often"},
    {"place": "some"},
    {"place": "all"},
]


@pytest.mark.parametrize("fields", BAD, ids=str)
def test_bad_values_are_named_with_what_is_wanted(fields: dict[str, Any]) -> None:
    (name,) = fields
    with pytest.raises(InputError, match=rf"^--{name}: have .*, want ") as caught:
        InterceptConfig(**fields)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("fields", [{"meet": "rest"}, {"meet": "match"}, {"heading": "path"}], ids=str)
def test_only_what_passes_with_its_heading_held_is_refined(fields: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"^--refine: have .*, want ") as caught:
        InterceptConfig(refine=True, **fields)
    assert "\n" not in str(caught.value)

    assert not InterceptConfig(**fields).refines
    assert InterceptConfig().refines
    assert not InterceptConfig(refine=False).refines


def test_defaults_and_good_values_pass() -> None:
    InterceptConfig().validate()
    InterceptConfig(speed=5.5, departure=0, start=(1, 2.0, 0.5), seed=7, target="a file.csv").validate()


def test_the_help_of_world_names_every_kind_of_map() -> None:
    """``jaxplan intercept --help`` shows the docstring of the field."""
    field = inspect.getsource(InterceptConfig).split("world: str", 1)[1].split("target: str", 1)[0]
    named = set(re.findall(r"\.[a-z]+\b", field)) - {".md"}
    assert named == set(_READERS)
