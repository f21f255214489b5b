"""A function of small arrays, evaluated for many lanes at once, each entry of each array a vector over the lanes.

``vmap`` keeps a vector of 3 as the minor axis of (b, 3): XLA's CPU loops then run over 3 elements, and a physics step
is some hundred kernels over tiny rows. Here the program of one flight is traced (``make_jaxpr``, so it is MJX's own
step that is evaluated, not a copy of it) and interpreted entry by entry. Slices, gathers and products with constants
0 and 1 vanish while tracing; what is left is arithmetic on vectors over the lanes, which XLA vectorises.

Exact up to the order of rounding, with one difference: 0 times a value that is not finite is 0. Indices must be
constants and loops bounded; anything else raises ``NotImplementedError`` while tracing. ``vmap`` is the independent
twin in the tests.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

from jaxplan.tracking import lane_rules
from jaxplan.tracking.lane_rules import Entries, all_constant, constants, entries_of, filled, vector

_CALLS = ("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call")


@jax.tree_util.register_pytree_node_class
class Split:
    """A small array as one vector over the lanes for each entry: nothing for XLA to stack and to take apart again."""

    def __init__(self, shape: tuple[int, ...], vectors: Sequence[Any]) -> None:
        self.shape, self.vectors = shape, tuple(vectors)

    def tree_flatten(self) -> tuple[tuple[Any, ...], tuple[int, ...]]:
        return self.vectors, self.shape

    @classmethod
    def tree_unflatten(cls, shape: tuple[int, ...], vectors: Sequence[Any]) -> "Split":
        return cls(shape, vectors)


def split(tree: Any) -> Any:
    """Every leaf (..., b) as a ``Split``."""

    return jax.tree.map(_parts, tree)


def _parts(leaf: Any) -> Split:
    return Split(leaf.shape[:-1], [leaf[index] for index in np.ndindex(leaf.shape[:-1])])


def joined(tree: Any) -> Any:
    """The inverse of ``split``; axes that a ``scan`` has put in front of the vectors stay in front."""

    def whole(leaf: Split) -> Any:
        first = leaf.vectors[0]
        if not leaf.shape:
            return first
        return jnp.stack(leaf.vectors, axis=-2).reshape(*first.shape[:-1], *leaf.shape, first.shape[-1])

    return jax.tree.map(whole, tree, is_leaf=_is_split)


def _is_split(leaf: Any) -> bool:
    return isinstance(leaf, Split)


def over_lanes(function: Callable[..., Any]) -> Callable[..., Any]:
    """``function`` of pytrees of small arrays, for many lanes; call it inside ``jit``.

    Leaves of the arguments are arrays (..., b) or ``Split``; those of the results are ``Split``.
    """

    @functools.wraps(function)
    def wrapped(*args: Any) -> Any:
        leaves, tree = jax.tree.flatten(args, is_leaf=_is_split)
        leaves = [leaf if _is_split(leaf) else _parts(leaf) for leaf in leaves]
        lanes = leaves[0].vectors[0].shape[-1]
        small = [jax.ShapeDtypeStruct(leaf.shape, leaf.vectors[0].dtype) for leaf in leaves]
        program, shapes = jax.make_jaxpr(function, return_shape=True)(*jax.tree.unflatten(tree, small))
        entries = [_rebuilt(leaf) for leaf in leaves]
        outputs = _evaluate(program.jaxpr, program.consts, entries, lanes)
        variables = program.jaxpr.outvars
        results = [
            Split(out.shape, [vector(entry, v.aval.dtype, lanes) for entry in out.flat])
            for out, v in zip(outputs, variables, strict=True)
        ]
        return jax.tree.unflatten(jax.tree.structure(shapes), results)

    return wrapped


def _rebuilt(leaf: Split) -> Entries:
    found = np.empty(leaf.shape, object)
    for index, entry in zip(np.ndindex(leaf.shape), leaf.vectors, strict=True):
        found[index] = entry
    return found


def _evaluate(jaxpr: Any, consts: Sequence[Any], args: Sequence[Entries], lanes: int) -> list[Entries]:
    """The outputs of a program for ``args``, entry by entry."""
    known: dict[Any, Entries] = dict(zip(jaxpr.constvars, map(constants, consts), strict=True))
    known.update(zip(jaxpr.invars, args, strict=True))

    def read(variable: Any) -> Entries:
        return constants(variable.val) if isinstance(variable, core.Literal) else known[variable]

    for equation in jaxpr.eqns:
        outputs = _apply(equation, [read(variable) for variable in equation.invars], lanes)
        known.update(zip(equation.outvars, outputs, strict=True))
    return [read(variable) for variable in jaxpr.outvars]


def _apply(equation: Any, inputs: list[Entries], lanes: int) -> list[Entries]:
    """The outputs of one equation."""
    name = equation.primitive.name
    if name in _CALLS:
        inner = equation.params["jaxpr"] if "jaxpr" in equation.params else equation.params["call_jaxpr"]
        return _evaluate(inner.jaxpr, inner.consts, inputs, lanes)
    if name == "scan":
        return _unrolled(equation.params, inputs, lanes)
    shape, dtype = equation.outvars[0].aval.shape, equation.outvars[0].aval.dtype
    if 0 in shape:
        return [np.empty(shape, object)]
    if name in lane_rules.REDUCTIONS and inputs[0].size:
        return [lane_rules.reduced(lane_rules.REDUCTIONS[name], inputs[0], equation.params["axes"], dtype, lanes)]
    if name == "dot_general":
        return [lane_rules.product(inputs, equation.params["dimension_numbers"], dtype, lanes)]
    if all(map(all_constant, inputs)):
        return lane_rules.folded(equation, inputs)
    if name in lane_rules.ELEMENTWISE:
        rows = [np.broadcast_to(entries, shape) for entries in inputs]
        return [filled(shape, lambda at: lane_rules.elementwise(equation, [row[at] for row in rows], lanes))]
    if name in lane_rules.MOVES:
        return [lane_rules.moved(equation, inputs)]
    if name in lane_rules.LINEAR:
        return [lane_rules.linear(equation, inputs, lanes)]
    raise NotImplementedError(f"over_lanes has no rule for {name} of inputs that are not constant")


def _unrolled(params: dict[str, Any], inputs: list[Entries], lanes: int) -> list[Entries]:
    """A ``scan``, step by step."""
    program, first, last = params["jaxpr"], params["num_consts"], params["num_consts"] + params["num_carry"]
    consts, carry, rows = inputs[:first], inputs[first:last], inputs[last:]
    order = range(params["length"])
    outputs = []
    for step in reversed(order) if params["reverse"] else order:
        row = [
            entries_of(entries[step], entries.shape[1:]) if entries.ndim > 1 else entries[step, ...] for entries in rows
        ]
        results = _evaluate(program.jaxpr, program.consts, [*consts, *carry, *row], lanes)
        carry = results[: params["num_carry"]]
        outputs.append(results[params["num_carry"] :])
    if params["reverse"]:
        outputs.reverse()
    return [*carry, *(np.stack(column) for column in zip(*outputs, strict=True))]
