"""The checks that configurations share: one line in ``__post_init__`` for each kind of number.

Every message says whose value it is, what was found and what is wanted. NaN never passes. NumPy is imported by those
that look at arrays: the command line checks its options before anything slow is there.
"""

import dataclasses
import math
import numbers
import operator
import os
from typing import Any, TypeVar, get_args, no_type_check

from jaxplan.errors import InputError

T = TypeVar("T")


@no_type_check
def as_numbers(name: str, values: Any, dtype: type = float) -> Any:
    """The values as a NumPy array of this type. Raises ``InputError`` where they are no numbers, or complex ones."""
    import numpy as np

    try:
        array = np.asarray(values)
        if array.dtype.kind in "fiub":
            return array.astype(dtype, copy=False)
        if array.dtype.kind in "SUcMm":
            raise TypeError(f"of {array.dtype}")
        return np.asarray(values, dtype=dtype)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: have {type(values).__name__} that is no array of numbers ({error})") from error


@no_type_check
def as_shaped(name: str, values: Any, shape: tuple[int | None, ...], dtype: type = float) -> Any:
    """The values as a NumPy array of this type and shape, None for any length. Raises ``InputError`` otherwise."""
    array = as_numbers(name, values, dtype)
    wanted = ", ".join("K" if length is None else str(length) for length in shape)
    fits = len(array.shape) == len(shape) and all(b is None or a == b for a, b in zip(array.shape, shape, strict=True))
    if not fits:
        raise InputError(f"{name}: have shape {array.shape}, want ({wanted}{',' if len(shape) == 1 else ''})")
    return array


@no_type_check
def as_finite(name: str, values: Any, shape: tuple[int | None, ...]) -> Any:
    """The same of float64, all of them finite."""
    import numpy as np

    array = as_shaped(name, values, shape)
    if not np.isfinite(array).all():
        raise InputError(f"{name}: have {array[~np.isfinite(array)][0]}, want finite numbers")
    return array


@no_type_check
def as_number(name: str, value: Any) -> float:
    """One number, which may be infinite or NaN. Raises ``InputError`` otherwise."""
    return float(as_shaped(name, value, ()))


@no_type_check
def require_path(owner: str, value: Any) -> None:
    """Raise ``InputError`` unless the value is a name or a path."""
    if not isinstance(value, str | os.PathLike):
        raise InputError(f"{owner}: have {value!r}, want a name or a path")


@no_type_check
def require_made_by(owner: str, value: Any, kind: type, maker: str) -> None:
    """Raise ``InputError`` unless the value is of a kind, which ``maker`` makes."""
    if not isinstance(value, kind):
        raise InputError(f"{owner}: have {value!r:.80}, want a {kind.__name__} ({maker})")


@no_type_check
def as_order(name: str, value: Any) -> int:
    """Which derivative, 0 for none. Raises ``InputError`` otherwise."""
    try:
        order = operator.index(value)
    except TypeError:
        order = -1
    if order < 0:
        raise InputError(f"{name}: have {value!r:.80}, want a whole number from 0 on")
    return order


def require_kinds(owner: str, config: object) -> None:
    """Raise ``InputError`` where a field is a configuration or a switch by default and something else here."""
    for field in dataclasses.fields(config):  # type: ignore[arg-type]
        value, usual = getattr(config, field.name), field.default
        kind, may_lack = type(usual), type(None) in get_args(field.type)
        if value is None and may_lack:
            continue
        if (kind is bool or dataclasses.is_dataclass(kind)) and not isinstance(value, kind):
            raise InputError(f"{owner}: {field.name} is {value!r}, want a {kind.__name__}")


def checks_itself(cls: type[T]) -> type[T]:
    """Say of a dataclass that its ``__post_init__`` refuses wrong types too: no run-time type checker goes first."""
    no_type_check(cls.__init__)
    return cls


def require_positive(owner: str, config: object, *names: str) -> None:
    """Raise ``InputError`` unless the named fields are finite numbers above 0."""
    for name in names:
        value = _number(owner, config, name)
        if not 0.0 < value < math.inf:
            raise InputError(f"{owner}: {name} is {value}, want a positive number")


def require_at_least(owner: str, config: object, least: float, *names: str) -> None:
    """Raise ``InputError`` unless the named fields are finite numbers not below ``least``."""
    for name in names:
        value = _number(owner, config, name)
        if not least <= value < math.inf:
            raise InputError(f"{owner}: {name} is {value}, want {least:g} or more")


def require_within(owner: str, config: object, low: float, high: float, *names: str) -> None:
    """Raise ``InputError`` unless the named fields are numbers from ``low`` to ``high``, both included."""
    for name in names:
        value = _number(owner, config, name)
        if not low <= value <= high:
            raise InputError(f"{owner}: {name} is {value}, want {low:g} to {high:g}")


def require_one_of(owner: str, config: object, choices: tuple[str, ...], *names: str) -> None:
    """Raise ``InputError`` unless the named fields are among the ``choices``."""
    for name in names:
        value = getattr(config, name)
        if not isinstance(value, str) or value not in choices:
            raise InputError(f"{owner}: {name} is {value!r}, want one of {', '.join(choices)}")


def require_range(owner: str, config: object, *names: str) -> None:
    """Raise ``InputError`` unless the named fields are pairs of finite numbers above 0, the lesser first."""
    for name in names:
        low, high = as_shaped(f"{owner}: {name}", getattr(config, name), (2,)).tolist()
        if not 0.0 < low <= high < math.inf:
            raise InputError(f"{owner}: {name} is {(low, high)}, want two positive numbers, the lesser first")


def require_between(owner: str, config: object, low: float, high: float, *names: str) -> None:
    """Raise ``InputError`` unless the named fields are numbers between ``low`` and ``high``, both excluded."""
    for name in names:
        value = _number(owner, config, name)
        if not low < value < high:
            raise InputError(f"{owner}: {name} is {value}, want a number between {low:g} and {high:g}")


def _number(owner: str, config: object, name: str) -> Any:
    """The value of a field that is to be a number."""
    value = getattr(config, name)
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        raise InputError(f"{owner}: {name} is {value!r}, want a number")
    return value
