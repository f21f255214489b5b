"""A digest of everything that a function computes with but its arguments: its code, and what it has been bound to.

Two functions with one digest compute the same, as long as the sources and the versions behind them are the same, which
whoever keeps digests adds. What cannot be judged has no digest: a function that is neither ours nor of a package whose
version counts, an object of an unknown kind.
"""

import dataclasses
import enum
import functools
import hashlib
import types
import typing
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np

TRUSTED = ("jaxplan", "jax", "jaxlib", "jaxtyping", "flax", "mujoco", "numpy", "builtins", "functools")
"""Packages whose sources or versions count elsewhere."""
KEPT = "kept_program"
"""Attribute of the functions that ``jaxplan.kept`` makes: they compute what the functions within compute."""
_PLAIN = (type(None), bool, int, float, complex, str, bytes, np.dtype)


class Undecided(Exception):
    """There is something of which it is not known what it computes."""


_Add = Callable[[bytes], None]
"""Takes what belongs to a digest, in order."""


def closure_digest(*values: object) -> str:
    """Of functions, configurations and arrays. Raises ``Undecided``."""
    digest = hashlib.sha256()
    _feed(digest.update, list(values), ())
    return digest.hexdigest()


@functools.cache
def source_digest() -> str:
    """Of all files of this package."""
    digest = hashlib.sha256()
    folder = Path(__file__).parent
    for path in sorted(folder.rglob("*.py")):
        digest.update(f"{path.relative_to(folder)}\0".encode() + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _feed(add: _Add, value: Any, within: tuple[int, ...]) -> None:
    """Add a value; ``within``: the objects that it is part of, for functions that refer to themselves."""
    if id(value) in within:
        add(f"again {within[::-1].index(id(value))}\0".encode())
        return
    within = (*within, id(value))
    if isinstance(value, (*_PLAIN, enum.Enum)) or typing.get_origin(value) is not None:
        add(f"{type(value).__qualname__} {value!r}\0".encode())
    elif isinstance(value, (np.ndarray, np.generic, jax.Array)):
        _feed_array(add, value)
    elif isinstance(value, (type, types.ModuleType, types.BuiltinFunctionType, np.ufunc)):
        add(f"named {_trusted(value)}\0".encode())
    elif isinstance(value, types.CodeType):
        _feed_all(add, "code", (value.co_firstlineno, value.co_code, value.co_names, value.co_varnames), within)
        _feed_all(add, "constants", value.co_consts, within)
    else:
        kind, parts = _parts(value)
        _feed_all(add, f"{kind} {_trusted(type(value))}", parts, within)


def _parts(value: Any) -> tuple[str, Iterable[object]]:
    """What a compound value is made of."""
    if isinstance(value, types.FunctionType):
        return _parts_of_function(value)
    for kind, parts in _COMPOUND.items():
        if isinstance(value, kind):
            return f"{kind} {len(value) if isinstance(value, (tuple, list)) else 0}", parts(value)
    if dataclasses.is_dataclass(value):
        return "fields", [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
    raise Undecided(f"{type(value).__module__}.{type(value).__qualname__}")


_COMPOUND: dict[Any, Callable[[Any], Iterable[object]]] = {
    functools.partial: lambda value: (value.func, value.args, value.keywords),
    types.MethodType: lambda value: (value.__func__, value.__self__),
    (dict, types.MappingProxyType): lambda value: [part for pair in value.items() for part in pair],
    (tuple, list): lambda value: value,
    (set, frozenset): lambda value: sorted(value, key=repr),
    jax.stages.Wrapped: lambda value: (value.__wrapped__,),  # of jax.jit
    (jax.custom_vjp, jax.custom_jvp): lambda value: [
        (name, part) for name, part in vars(value).items() if not name.startswith("__")
    ],
}
"""What values of these kinds are made of."""


def _parts_of_function(function: Any) -> tuple[str, Iterable[object]]:
    """Its code and what it has been bound to; names of modules' variables stand for what the sources say."""
    if hasattr(function, KEPT):
        return "kept", (function.__wrapped__,)
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    return f"function {_trusted(function)}", (function.__code__, function.__defaults__, function.__kwdefaults__, cells)


def _feed_all(add: _Add, head: str, parts: Iterable[object], within: tuple[int, ...]) -> None:
    add(f"{head} (\0".encode())
    for part in parts:
        _feed(add, part, within)
    add(b")\0")


def _feed_array(add: _Add, value: Any) -> None:
    if isinstance(value, jax.Array) and jax.dtypes.issubdtype(value.dtype, jax.dtypes.prng_key):
        value = jax.random.key_data(value)
    array = np.asarray(value)
    if array.dtype.hasobject:
        raise Undecided(f"an array of {array.dtype}")
    weak = getattr(value, "weak_type", False)
    add(f"array {array.dtype.str} {array.shape} {weak}\0".encode() + array.tobytes())


def _trusted(value: Any) -> str:
    """Name of a function or a class whose source counts elsewhere."""
    module = getattr(value, "__module__", None) or getattr(value, "__name__", "")
    name = f"{module}.{getattr(value, '__qualname__', '')}"
    if isinstance(value, np.ufunc):
        return f"numpy.{value.__name__}"
    if str(module).split(".")[0] not in TRUSTED:
        raise Undecided(name)
    return name
