"""The checks that configurations share."""

import dataclasses
import math

import pytest

from jaxplan.errors import InputError
from jaxplan.validation import require_at_least, require_between, require_positive, require_within


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
