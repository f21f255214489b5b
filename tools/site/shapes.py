"""An extension of griffe, which reads the sources for mkdocstrings: jaxtyping's shapes are strings and stay strings.

Else griffe takes the string in ``Float[Array, "3"]`` for a forward reference: ``"k"`` becomes a name, ``"3"`` a number.
"""

import ast
from typing import Any

import griffe


def _as_written(annotation: ast.expr, scope: griffe.Class | griffe.Module) -> griffe.Expr | str | None:
    """An annotation with its strings, but for one that is a string as a whole: a forward reference."""
    whole = isinstance(annotation, ast.Constant)
    return griffe.safe_get_expression(annotation, parent=scope, parse_strings=whole)


class Shapes(griffe.Extension):
    """Reads annotations again, with their strings."""

    def on_attribute_instance(self, *, node: Any, attr: griffe.Attribute, **kwargs: Any) -> None:
        """Fields of classes and constants of modules."""
        if isinstance(node, ast.AnnAssign):
            attr.annotation = _as_written(node.annotation, attr.parent)

    def on_function_instance(self, *, node: Any, func: griffe.Function, **kwargs: Any) -> None:
        """Arguments and results of functions."""
        if not isinstance(node, ast.FunctionDef):
            return
        given = node.args
        extra = [argument for argument in (given.vararg, given.kwarg) if argument]
        for argument in (*given.posonlyargs, *given.args, *given.kwonlyargs, *extra):
            if argument.annotation is not None:
                func.parameters[argument.arg].annotation = _as_written(argument.annotation, func.parent)
        if node.returns is not None:
            func.returns = _as_written(node.returns, func.parent)
