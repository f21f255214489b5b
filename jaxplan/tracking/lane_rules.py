"""The rules of ``lanes``: what each primitive does to arrays whose entries are constants or vectors over the lanes."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

Entries = np.ndarray
"""Object array of the small shape; entries are NumPy scalars (constants) or vectors over the lanes."""

_COMPARISONS = frozenset({"eq", "ge", "gt", "is_finite", "le", "lt", "ne", "and", "not", "or", "xor"})
_ARITHMETIC = frozenset(
    {"abs", "add", "div", "integer_pow", "mul", "neg", "pow", "rem", "sqrt", "rsqrt", "square", "sub"}
)
_FUNCTIONS = frozenset({"atan2", "ceil", "cos", "exp", "floor", "log", "round", "sign", "sin", "tan", "tanh"})
ELEMENTWISE = (
    _COMPARISONS | _ARITHMETIC | _FUNCTIONS | {"clamp", "convert_element_type", "copy", "max", "min", "select_n"}
)
_VIEWS = frozenset({"broadcast_in_dim", "expand_dims", "reshape", "rev", "slice", "squeeze", "transpose"})
MOVES = _VIEWS | {"concatenate", "gather", "pad", "scatter", "tile"}
"""Primitives whose every output entry is an input entry."""
_DATA = {"gather": (0,), "scatter": (0, 2)}
"""Which operands of a move are data; all, where not named."""
LINEAR = {"scatter-add": 2, "cumsum": 0}
"""Primitives that add multiples of this operand's entries to the first operand (or to 0)."""
REDUCTIONS = {
    "reduce_sum": lax.add,
    "reduce_prod": lax.mul,
    "reduce_max": lax.max,
    "reduce_min": lax.min,
    "reduce_and": lax.bitwise_and,
    "reduce_or": lax.bitwise_or,
}
_NUMPY: dict[str, Callable[..., Any]] = {
    "abs": np.abs,
    "add": np.add,
    "and": np.bitwise_and,
    "convert_element_type": np.asarray,
    "copy": np.asarray,
    "div": lambda x, y: np.trunc(np.divide(x, y)) if x.dtype.kind in "iu" else np.divide(x, y),
    "eq": np.equal,
    "ge": np.greater_equal,
    "gt": np.greater,
    "floor": np.floor,
    "is_finite": np.isfinite,
    "le": np.less_equal,
    "lt": np.less,
    "max": np.maximum,
    "min": np.minimum,
    "mul": np.multiply,
    "ne": np.not_equal,
    "neg": np.negative,
    "or": np.bitwise_or,
    "rem": np.fmod,
    "select_n": lambda which, *cases: np.choose(which.astype(np.int32), cases),
    "sign": np.sign,
    "sqrt": np.sqrt,
    "sub": np.subtract,
}
"""Constant folding without a compilation; what is not here is evaluated by JAX."""


def entries_of(array: Any, shape: tuple[int, ...]) -> Entries:
    """The entries ``array[index]`` for all indices of ``shape``."""
    found = np.empty(shape, object)
    for index in np.ndindex(shape):
        found[index] = array[index]
    return found


def constants(array: Any) -> Entries:
    """The entries of an array known now."""
    return entries_of(np.asarray(array), np.shape(array))


def _is_constant(entry: Any) -> bool:
    return isinstance(entry, np.generic)


def all_constant(entries: Entries) -> bool:
    """Whether no entry depends on the lanes."""
    return all(_is_constant(entry) for entry in entries.flat)


def _array(entries: Entries, dtype: Any) -> np.ndarray:
    """The NumPy array of constant entries."""
    return np.array(list(entries.flat), dtype).reshape(entries.shape)


def vector(entry: Any, dtype: Any, lanes: int) -> Any:
    """The entry as a vector over the lanes."""
    return lax.broadcast(np.asarray(entry, dtype), (lanes,)) if _is_constant(entry) else entry


def filled(shape: tuple[int, ...], entry: Callable[[tuple[int, ...]], Any]) -> Entries:
    """The entries ``entry(index)`` for all indices of ``shape``."""
    found = np.empty(shape, object)
    for index in np.ndindex(shape):
        found[index] = entry(index)
    return found


def folded(equation: Any, inputs: list[Entries]) -> list[Entries]:
    """An equation of constants, evaluated now."""
    arrays = [_array(entries, v.aval.dtype) for entries, v in zip(inputs, equation.invars, strict=True)]
    if equation.primitive.multiple_results and len(equation.outvars) > 1:
        with jax.ensure_compile_time_eval():
            results = equation.primitive.bind(*map(jnp.asarray, arrays), **equation.params)
        return [constants(result) for result in results]
    quick = None if equation.primitive.name in _NUMPY else _moved_by_numpy(equation, arrays)
    return [constants(_evaluated(equation, arrays) if quick is None else quick)]


def _evaluated(equation: Any, arrays: list[np.ndarray]) -> np.ndarray:
    """A primitive of constants, by NumPy where it has a name there, else by JAX."""
    name = equation.primitive.name
    if name in _NUMPY:
        return np.asarray(_NUMPY[name](*arrays), equation.outvars[0].aval.dtype)
    with jax.ensure_compile_time_eval():
        result = equation.primitive.bind(*map(jnp.asarray, arrays), **equation.params)
    return np.asarray(result[0] if equation.primitive.multiple_results else result)


def elementwise(equation: Any, entries: list[Any], lanes: int) -> Any:
    """One entry of an elementwise primitive."""
    name = equation.primitive.name
    if all(map(_is_constant, entries)):
        return _evaluated(equation, [np.asarray(entry) for entry in entries])[()]
    if name == "select_n" and _is_constant(entries[0]):
        return entries[1 + int(entries[0])]
    if name == "copy":
        return entries[0]
    short = _simplified(name, entries)
    if short is not None:
        return short
    pairs = zip(entries, equation.invars, strict=True)
    return equation.primitive.bind(*[vector(e, v.aval.dtype, lanes) for e, v in pairs], **equation.params)


def _simplified(name: str, entries: list[Any]) -> Any:
    """The entry itself, or a constant, where one operand is 0, 1, True or False; None where nothing is to be had."""
    if len(entries) != 2:
        return None
    left, right = entries
    for constant, other, second in ((left, right, False), (right, left, True)):
        if not _is_constant(constant):
            continue
        zero, one = bool(constant == 0), bool(constant == 1)
        if (name in ("add", "or") and zero) or (name == "sub" and zero and second):
            return other
        if (name == "mul" and zero) or (name == "div" and zero and not second) or (name == "and" and zero):
            return constant
        if (name == "mul" and one) or (name == "div" and one and second):
            return other
        if constant.dtype == bool and one and name in ("and", "or"):
            return other if name == "and" else constant
    return None


def _combined(primitive: Callable[..., Any], left: Any, right: Any, dtype: Any, lanes: int) -> Any:
    """``primitive`` of two entries, which is one of those of ``REDUCTIONS``."""
    name = primitive.__name__.removeprefix("bitwise_")
    if _is_constant(left) and _is_constant(right):
        return np.asarray(_NUMPY[name](left, right), dtype)[()]
    short = _simplified(name, [left, right])
    return primitive(vector(left, dtype, lanes), vector(right, dtype, lanes)) if short is None else short


def moved(equation: Any, inputs: list[Entries]) -> Entries:
    """Run the primitive on the numbers of the entries instead of the entries."""
    name = equation.primitive.name
    data = _DATA.get(name, tuple(range(len(inputs))))
    pool: list[Any] = []
    arrays = []
    for place, entries in enumerate(inputs):
        if place in data:
            arrays.append(np.arange(len(pool), len(pool) + entries.size, dtype=np.int32).reshape(entries.shape))
            pool += entries.flat
        elif all_constant(entries):
            arrays.append(_array(entries, equation.invars[place].aval.dtype))
        else:
            raise NotImplementedError(f"over_lanes: the indices of {name} must be constant")
    numbers = _moved_by_numpy(equation, arrays)
    if numbers is None:
        params = equation.params | ({"fill_value": -1} if name == "gather" else {})
        with jax.ensure_compile_time_eval():
            numbers = np.asarray(equation.primitive.bind(*map(jnp.asarray, arrays), **params))
    if np.any(numbers < 0):
        raise NotImplementedError(f"over_lanes: an index of {name} is out of range")
    return filled(numbers.shape, lambda at: pool[numbers[at]])


def _moved_by_numpy(equation: Any, arrays: list[np.ndarray]) -> np.ndarray | None:
    """What a move makes of ``arrays``, for the moves that NumPy has too."""
    name, params, shape = equation.primitive.name, equation.params, equation.outvars[0].aval.shape
    if name in ("squeeze", "reshape", "expand_dims"):
        return arrays[0].reshape(shape)
    if name == "transpose":
        return arrays[0].transpose(params["permutation"])
    if name == "concatenate":
        return np.concatenate(arrays, params["dimension"])
    if name == "slice":
        steps = params["strides"] or (1,) * arrays[0].ndim
        return arrays[0][tuple(map(slice, params["start_indices"], params["limit_indices"], steps))]
    if name == "broadcast_in_dim":
        spread = [1] * len(shape)
        for axis, size in zip(params["broadcast_dimensions"], arrays[0].shape, strict=True):
            spread[axis] = size
        return np.broadcast_to(arrays[0].reshape(spread), shape)
    if name == "iota":
        axis = params["dimension"]
        return np.moveaxis(
            np.broadcast_to(np.arange(shape[axis]), (*shape[:axis], *shape[axis + 1 :], shape[axis])), -1, axis
        )
    return _gathered(params, arrays[0], arrays[1], shape) if name == "gather" else None


def _gathered(
    params: dict[str, Any], table: np.ndarray, starts: np.ndarray, shape: tuple[int, ...]
) -> np.ndarray | None:
    """``gather`` inside the table and without batching axes; None otherwise."""
    numbers, sizes = params["dimension_numbers"], params["slice_sizes"]
    begins = np.zeros((*starts.shape[:-1], table.ndim), np.int64)
    begins[..., list(numbers.start_index_map)] = starts
    if numbers.operand_batching_dims or np.any(begins < 0) or np.any(begins + sizes > table.shape):
        return None
    windows = np.lib.stride_tricks.sliding_window_view(table, sizes) if table.ndim else table
    found = windows[tuple(np.moveaxis(begins, -1, 0))]
    batch = starts.ndim - 1
    found = found.reshape([n for axis, n in enumerate(found.shape) if axis - batch not in numbers.collapsed_slice_dims])
    return np.moveaxis(found, range(batch, found.ndim), numbers.offset_dims).reshape(shape)


def reduced(primitive: Callable[..., Any], entries: Entries, axes: Any, dtype: Any, lanes: int) -> Entries:
    """A reduction along ``axes``, from left to right."""
    kept = [axis for axis in range(entries.ndim) if axis not in axes]
    rows = entries.transpose([*kept, *axes]).reshape(*(entries.shape[axis] for axis in kept), -1)
    step = functools.partial(_combined, primitive, dtype=dtype, lanes=lanes)
    return filled(rows.shape[:-1], lambda at: functools.reduce(step, rows[at]))


def product(inputs: list[Entries], numbers: Any, dtype: Any, lanes: int) -> Entries:
    """``dot_general``: sums of products, without the products with constant 0."""
    (left_sum, right_sum), (left_batch, right_batch) = numbers
    tables, free_shapes = [], []
    for entries, summed, batch in zip(inputs, (left_sum, right_sum), (left_batch, right_batch), strict=True):
        free = [axis for axis in range(entries.ndim) if axis not in (*summed, *batch)]
        sizes = [[entries.shape[axis] for axis in axes] for axes in (batch, free, summed)]
        tables.append(entries.transpose([*batch, *free, *summed]).reshape([int(np.prod(size)) for size in sizes]))
        free_shapes.append(sizes[1])
    left, right = tables
    add = functools.partial(_combined, lax.add, dtype=dtype, lanes=lanes)
    multiply = functools.partial(_combined, lax.mul, dtype=dtype, lanes=lanes)
    zero = np.zeros((), dtype)[()]

    def entry(at: tuple[int, ...]) -> Any:
        b, i, j = at
        return functools.reduce(add, map(multiply, left[b, i], right[b, j]), zero)

    found = filled((left.shape[0], left.shape[1], right.shape[1]), entry)
    return found.reshape([*(inputs[0].shape[axis] for axis in left_batch), *free_shapes[0], *free_shapes[1]])


def linear(equation: Any, inputs: list[Entries], lanes: int) -> Entries:
    """``out = base + W x`` with W from the primitive's answers to unit vectors x."""
    place, aval = LINEAR[equation.primitive.name], equation.outvars[0].aval
    x = inputs[place]
    found = inputs[0].copy() if place else constants(np.zeros(aval.shape, aval.dtype))
    for number, entry in enumerate(x.flat):
        unit = np.zeros(x.size, aval.dtype)
        unit[number] = 1
        arrays = [unit.reshape(x.shape)]
        if place:
            arrays = [np.zeros(aval.shape, aval.dtype), _array(inputs[1], equation.invars[1].aval.dtype), *arrays]
        with jax.ensure_compile_time_eval():
            weights = np.asarray(equation.primitive.bind(*map(jnp.asarray, arrays), **equation.params))
        for at in zip(*np.nonzero(weights), strict=True):
            found[at] = _combined(
                lax.add, found[at], _combined(lax.mul, entry, weights[at], aval.dtype, lanes), aval.dtype, lanes
            )
    return found
