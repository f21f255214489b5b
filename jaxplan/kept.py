"""``jax.jit`` whose traces are kept on disk, where programs are (``jaxplan.programs``).

XLA's programs are found by a hash of the whole program, which takes tracing and lowering it: most of what a start
takes that compiles nothing. So what was traced is kept too, as StableHLO (``jax.export``), under a hash of what it came
from: the function and all that it is bound to (``jaxplan.closure``), shapes and types of its arguments, JAX's settings,
and the sources and versions of everything. Where any of that cannot be told, the function is traced as ever.

The first process calls what it has kept too, so that all of them run the same program.
"""

import functools
import importlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
from jax import export
from jax.extend.core import Primitive
from jax.interpreters import mlir

from jaxplan import programs
from jaxplan.closure import KEPT, Undecided, closure_digest, source_digest
from jaxplan.versions import installed_versions

try:  # what ``Exported.call`` is lowered by; a version of JAX without it traces as ever
    from jax._src.export._export import _call_exported_lowering
except ImportError:
    _call_exported_lowering = None  # type: ignore[assignment]

R = TypeVar("R")
_ASIDE = ("compilation_cache", "persistent_cache", "dump", "log_", "logging", "traceback", "pprint")
"""Settings of JAX with these words in their names do not change what is computed."""


def kept(function: Callable[..., R], static: int = 0) -> Callable[..., R]:
    """``function``, compiled; not traced again where an earlier process has done so.

    Under ``jit``, ``vmap`` or ``grad`` it is what ``jax.jit`` would make of it.

    Args:
        function: pure; of arguments without names.
        static: how many arguments, from the first on, are hashable values and not traced.
    """
    plain = jax.jit(function, static_argnums=tuple(range(static)))
    folder = programs.folder_in_use()
    if folder is None or _call_exported_lowering is None:
        return plain

    @functools.wraps(getattr(function, "func", function))  # of a partial: jax.jit calls it by that name, too
    def traced(*args: Any) -> Any:
        fixed, leaves, tree = args[:static], *jax.tree.flatten(args[static:])
        program = _program(folder, function, fixed, leaves, tree)
        if program is None:
            return function(*args)
        return jax.tree.unflatten(program.tree, _inlined.bind(*leaves, exported=program.exported))

    stored = jax.jit(traced, static_argnums=tuple(range(static)))

    @functools.wraps(function)
    def call(*args: Any) -> Any:
        inside = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(args[static:]))
        return plain(*args) if inside else stored(*args)

    setattr(call, KEPT, True)
    return call


_inlined = Primitive("inlined")
"""What ``Exported.call`` does, but JAX ties the results of that to a device, and compiles what takes them once more."""
_inlined.multiple_results = True
_inlined.def_abstract_eval(lambda *leaves, exported: list(exported.out_avals))
if _call_exported_lowering is not None:
    mlir.register_lowering(_inlined, _call_exported_lowering)


class _Program(NamedTuple):
    """What was traced, without its trees."""

    exported: export.Exported
    tree: Any
    """Of its results."""


def _program(folder: Path, function: Callable, fixed: tuple, leaves: list[Any], tree: Any) -> _Program | None:
    """What an earlier process has traced, or else this one does now; None where it cannot be kept."""
    if jax.device_count() > 1:  # where arrays lie would count, too
        return None
    types = [jax.typeof(leaf) for leaf in leaves]
    of = [(aval.shape, str(aval.dtype), getattr(aval, "weak_type", False)) for aval in types]
    try:
        key = closure_digest(function, fixed, of, str(tree), _settings(), source_digest(), _versions())
    except Undecided:
        return None
    content = programs.read_traced(folder, key)
    found = None if content is None else _read(content)
    if found is None:
        try:
            found = _trace(function, fixed, types, tree)
            programs.write_traced(folder, key, _written(found))
        except (ImportError, NotImplementedError, TypeError, ValueError):  # nothing that can be kept
            return None
    return found


def _trace(function: Callable, fixed: tuple, types: list[Any], tree: Any) -> _Program:
    """Raises ``NotImplementedError``, ``TypeError``, ``ValueError`` for what cannot be exported or described."""
    results: list[Any] = []

    def flat(*leaves: Any) -> list[Any]:
        found, shape = jax.tree.flatten(function(*fixed, *jax.tree.unflatten(tree, leaves)))
        results.append(shape)
        return found

    wanted = [jax.ShapeDtypeStruct(a.shape, a.dtype, weak_type=getattr(a, "weak_type", False)) for a in types]
    exported = export.export(jax.jit(flat))(*wanted)
    return _Program(exported, results[-1])


def _read(content: bytes) -> _Program | None:
    """None where this version cannot read it."""
    tree, _, exported = content.partition(b"\n")
    try:
        return _Program(export.deserialize(bytearray(exported)), _built(json.loads(tree)))
    except Exception:  # whatever another version's bytes raise
        return None


def _written(program: _Program) -> bytes:
    return json.dumps(_described(program.tree)).encode() + b"\n" + bytes(program.exported.serialize())


@functools.cache
def _versions() -> str:
    return repr(sorted(installed_versions().items())) + os.environ.get("XLA_FLAGS", "")


def _settings() -> list[tuple[str, str]]:
    """JAX's settings where this is asked, scoped ones too."""
    names = [name for name in jax.config.values if not any(word in name for word in _ASIDE)]
    return [
        *((name, repr(getattr(jax.config, name, None))) for name in sorted(names)),
        ("backend", jax.default_backend()),
    ]


def _described(tree: Any) -> Any:
    """How leaves belong together, for JSON: 0 for a leaf, else a class, what else it takes, and its children."""
    node = tree.node_data()
    if node is None:
        return 0
    kind, fixed = node
    if json.loads(json.dumps(fixed)) != (list(fixed) if isinstance(fixed, tuple) else fixed):
        raise TypeError(f"{kind}: what it holds beside its leaves cannot be written down")
    return [f"{kind.__module__}:{kind.__qualname__}", fixed, [_described(child) for child in tree.children()]]


def _built(described: Any) -> Any:
    """The tree that was described."""
    if described == 0:
        return jax.tree.structure(0)
    name, fixed, children = described
    if name == "builtins:NoneType":
        return jax.tree.structure(None)
    module, _, qualified = name.partition(":")
    if module.split(".")[0] not in ("builtins", "jaxplan"):
        raise TypeError(f"{name} is none of ours")
    kind: Any = functools.reduce(getattr, qualified.split("."), importlib.import_module(module))
    if isinstance(fixed, list) and kind is not dict:
        fixed = tuple(fixed)
    node = (kind, fixed)
    return jax.tree_util.PyTreeDef.from_node_data_and_children(
        jax.tree_util.default_registry, node, [_built(child) for child in children]
    )
