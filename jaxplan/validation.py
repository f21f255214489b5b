"""The checks that configurations share: one line in ``__post_init__`` for each kind of number.

Every message says whose value it is, what was found and what is wanted. NaN never passes.
"""

import math
from typing import Any, TypeVar, no_type_check

import numpy as np

from jaxplan.errors import InputError

T = TypeVar("T")


@no_type_check
def as_numbers(name: str, values: Any, dtype: type = np.float64) -> Any:
    """The values as a NumPy array of this type. Raises ``InputError`` where they are no numbers, or complex ones."""
    try:
        array = np.asarray(values)
        if array.dtype.kind in "fiub":
            return array.astype(dtype, copy=False)
        if array.dtype.kind in "SUcMm":
            raise TypeError(f"of {array.dtype}")
        return np.asarray(values, dtype=dtype)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: have {type(values).__name__} that is no array of numbers ({error})") from error


def checks_itself(cls: type[T]) -> type[T]:
    """Say of a dataclass that its ``__post_init__`` refuses wrong types too: no run-time type checker goes first."""
    no_type_check(cls.__init__)
    return cls


def require_positive(owner: str, config: object, *names: str) -> None:
    """Raise ``InputError`` unless the named fields are finite numbers above 0."""
    for name in names:
        value = getattr(config, name)
        if not 0.0 < value < math.inf:
            raise InputError(f"{owner}: {name} is {value}, want a positive number")


def require_at_least(owner: str, config: object, least: float, *names: str) -> None:
    """Raise ``InputError`` unless the named fields are finite numbers not below ``least``."""
    for name in names:
        value = getattr(config, name)
        if not least <= value < math.inf:
            raise InputError(f"{owner}: {name} is {value}, want {least:g} or more")


def require_within(owner: str, config: object, low: float, high: float, *names: str) -> None:
    """Raise ``InputError`` unless the named fields are numbers from ``low`` to ``high``, both included."""
    for name in names:
        value = getattr(config, name)
        if not low <= value <= high:
            raise InputError(f"{owner}: {name} is {value}, want {low:g} to {high:g}")


def require_one_of(owner: str, config: object, choices: tuple[str, ...], *names: str) -> None:
    """Raise ``InputError`` unless the named fields are among the ``choices``."""
    for name in names:
        value = getattr(config, name)
        if value not in choices:
            raise InputError(f"{owner}: {name} is {value!r}, want one of {', '.join(choices)}")


def require_range(owner: str, config: object, *names: str) -> None:
    """Raise ``InputError`` unless the named fields are pairs of finite numbers above 0, the lesser first."""
    for name in names:
        low, high = getattr(config, name)
        if not 0.0 < low <= high < math.inf:
            raise InputError(f"{owner}: {name} is {(low, high)}, want two positive numbers, the lesser first")


def require_between(owner: str, config: object, low: float, high: float, *names: str) -> None:
    """Raise ``InputError`` unless the named fields are numbers between ``low`` and ``high``, both excluded."""
    for name in names:
        value = getattr(config, name)
        if not low < value < high:
            raise InputError(f"{owner}: {name} is {value}, want a number between {low:g} and {high:g}")
