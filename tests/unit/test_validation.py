"""The checks that configurations share."""

import dataclasses
import inspect
import math

import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.planner import build_planner
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.validation import (
    as_order,
    require_at_least,
    require_between,
    require_made_by,
    require_positive,
    require_within,
)
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world


@dataclasses.dataclass
class Config:
    size: float


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_what_is_not_positive_is_refused_by_name(value: float) -> None:
    with pytest.raises(InputError, match=f"^oven: size is {value}, want a positive number$"):
        require_positive("oven", Config(value), "size")


@pytest.mark.parametrize("value", [0, 0.99, math.nan, math.inf])
def test_what_is_too_small_is_refused_by_name(value: float) -> None:
    with pytest.raises(InputError, match="^oven: size is .*, want 1 or more$"):
        require_at_least("oven", Config(value), 1, "size")


@pytest.mark.parametrize("value", [1.9, 3.1, math.nan, -math.inf])
def test_what_is_outside_is_refused_by_name(value: float) -> None:
    with pytest.raises(InputError, match="^oven: size is .*, want 2 to 3$"):
        require_within("oven", Config(value), 2, 3, "size")


@pytest.mark.parametrize("value", [0.0, 1.0, math.nan, math.inf])
def test_what_is_not_between_is_refused_by_name(value: float) -> None:
    with pytest.raises(InputError, match="^oven: size is .*, want a number between 0 and 1$"):
        require_between("oven", Config(value), 0, 1, "size")


def test_what_is_allowed_passes() -> None:
    require_positive("oven", Config(1e-9), "size")
    require_at_least("oven", Config(1), 1, "size")
    require_within("oven", Config(3), 2, 3, "size")
    require_between("oven", Config(0.5), 0, 1, "size")


@pytest.mark.parametrize("value", [-1, 1.0, "one", None, math.nan])
def test_what_is_no_order_of_a_derivative_is_refused(value: object) -> None:
    with pytest.raises(InputError, match="^spline: derivative: have .*, want a whole number from 0 on$"):
        as_order("spline: derivative", value)


def test_orders_are_whole_numbers_of_any_kind() -> None:
    assert [as_order("spline: derivative", order) for order in (0, 4, np.int32(2), True)] == [0, 4, 2, 1]


def test_what_somebody_else_made_is_refused_in_one_short_line() -> None:
    require_made_by("oven", Config(1.0), Config, "bake")
    with pytest.raises(InputError, match=r"^oven: have 'xx+, want a Config \(bake\)$"):
        require_made_by("oven", "x" * 1000, Config, "bake")


@pytest.mark.parametrize(
    ("parts", "maker"),
    [({"world": "env1"}, "load_world"), ({"vehicle": "mfrl"}, "load_vehicle"), ({"policy": "mfrl"}, "load_policy")],
)
def test_a_planner_is_not_built_from_names(parts: dict[str, str], maker: str) -> None:
    whole = {"world": load_world("env1"), "vehicle": load_vehicle(), "policy": constant_speed_policy()}
    with pytest.raises(InputError, match=f"^build_planner: .*{maker}"):
        inspect.unwrap(build_planner)(**whole | parts)  # users have no run-time type checker before it
