"""``@record``: the frozen, keyword-only pytrees that carry all data of this library.

A record is a dataclass that JAX can map over. Its ``__post_init__`` checks run when a person builds
one, and never when JAX rebuilds one from traced leaves, so checks may look at concrete values. The same holds of the
fields' annotations, where jaxtyping's import hook is on (``jaxplan.arrays``): it checks the arguments of ``__init__``,
and JAX does not call ``__init__``.
"""

import dataclasses
from typing import Any, TypeVar, cast, dataclass_transform

import jax

T = TypeVar("T")


def static(**kwargs: Any) -> Any:
    """A record field that is part of the tree's structure: hashable, compared, never traced."""
    return dataclasses.field(metadata={"static": True}, **kwargs)


@dataclass_transform(
    frozen_default=True, kw_only_default=True, eq_default=False, field_specifiers=(static, dataclasses.field)
)
def record(cls: type[T]) -> type[T]:
    """Make ``cls`` a frozen keyword-only dataclass and register it as a JAX pytree."""
    cls = dataclasses.dataclass(frozen=True, kw_only=True, eq=False)(cls)
    fields = dataclasses.fields(cast(Any, cls))  # the type checker does not follow the decorator
    traced = tuple(f.name for f in fields if not f.metadata.get("static"))
    fixed = tuple(f.name for f in fields if f.metadata.get("static"))
    names = (*traced, *fixed)

    def flatten_with_keys(instance: T) -> tuple[Any, Any]:
        children = [(jax.tree_util.GetAttrKey(name), getattr(instance, name)) for name in traced]
        return children, tuple(getattr(instance, name) for name in fixed)

    def flatten(instance: T) -> tuple[Any, Any]:
        return [getattr(instance, name) for name in traced], tuple(getattr(instance, name) for name in fixed)

    def unflatten(aux: Any, children: Any) -> T:
        instance = object.__new__(cls)
        vars(instance).update(zip(names, (*children, *aux), strict=True))
        return instance

    jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)
    return cls


def replace(instance: T, **changes: Any) -> T:
    """A copy of a record with some fields changed, checked like a new one."""
    return cast(T, dataclasses.replace(cast(Any, instance), **changes))
