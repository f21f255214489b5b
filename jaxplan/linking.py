"""How numba compiles what only compiled code calls: once, where it is used (``jaxplan.native``).

Numba makes machine code of every function on its own, and links it into its callers, each of which is optimised with
all that it calls, at every level of a tree of calls. Here a function is a part: it is typed and lowered, then waits.
The function that Python calls takes in its parts, and theirs, each once; all of it is optimised and made machine code
once. What the optimiser may put into its callers stays the same.

This builds on how numba's compiler is put together, so it is used with versions that it was tried with only; others
compile as ever, for longer.
"""

import contextlib
from collections.abc import Iterator
from typing import Any

import numba
from numba.core import typed_passes, types, untyped_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.postproc import PostProcessor

TRIED = ("0.68",)
"""Versions of numba."""
_USED = (
    untyped_passes.TranslateByteCode,
    untyped_passes.FixupArgs,
    untyped_passes.IRProcessing,
    untyped_passes.GenericRewrites,
    untyped_passes.InlineInlinables,
    untyped_passes.ReconstructSSA,
    typed_passes.NopythonTypeInference,
    typed_passes.PreLowerStripPhis,
    typed_passes.IRLegalization,
    typed_passes.NativeLowering,
    typed_passes.NoPythonBackend,
)
"""Passes that loops over arrays need; not those for closures, array expressions, ``with``, literals or branches on
types, which take a tenth of the time and find nothing."""


class _Part(JITCodeLibrary):
    """Code that is taken in by what calls it, and never made machine code on its own."""

    def finalize(self) -> None:
        self._raise_if_finalized()
        self._finalized = True


class _Whole(JITCodeLibrary):
    """What Python calls, with all parts that it calls and that these call, each once."""

    def finalize(self) -> None:
        found: dict[Any, None] = dict.fromkeys(self._linking_libraries)
        waiting: list[Any] = list(found)
        while waiting:
            library = waiting.pop()
            fresh = [other for other in library._linking_libraries if other not in found]
            if isinstance(library, _Part):
                found.update(dict.fromkeys(fresh))
                waiting.extend(fresh)
        self._linking_libraries: list[Any] = list(found)
        super().finalize()


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerPart(typed_passes.NativeLowering):
    """Lowers a part, and tells numba about it without machine code."""

    _name = "lower_part"

    def run_pass(self, state: Any) -> bool:
        _library_for(state, _Part)
        state.flags.no_compile = True
        super().run_pass(state)
        entry = [state.library].count  # in numba's tables it stands for the part; nobody calls it
        state.targetctx.insert_user_function(entry, state["cr"].fndesc, [state.library])
        state["cr"] = state["cr"]._replace(cfunc=entry)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerWhole(typed_passes.NativeLowering):
    """Lowers what Python calls."""

    _name = "lower_whole"

    def run_pass(self, state: Any) -> bool:
        _library_for(state, _Whole)
        return bool(super().run_pass(state))


def _library_for(state: Any, kind: type) -> None:
    state.library = kind(state.targetctx.codegen(), state.func_id.func_qualname)
    state.library.enable_object_caching()


class _Flags(Flags):
    """Numba's, compared quickly: they are part of the key by which each operator is looked up."""

    def __hash__(self) -> int:
        return _HASH

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Flags) and (self._values == other._values or super().__eq__(other)))


_HASH = hash(Flags())
"""Of all of them: numba hashes their names."""


class _Passes(PassManager):
    """Runs passes without a description of each, and analyses a function anew where something was put into it only."""

    def _runPass(self, index: int, step: Any, state: Any) -> None:
        step.analysis = self._analysis
        step.run_initialization(state)
        if step.run_pass(state) and isinstance(step, untyped_passes.InlineInlinables):
            PostProcessor(state.func_ir).run()
        step.run_finalizer(state)


_signatures: dict[tuple, Any] = {}
"""Of numba's own functions and operators, by function, context and types of what it is called with."""


@contextlib.contextmanager
def _looked_up_once() -> Iterator[None]:
    """Numba tries all that an operator may stand for wherever one occurs, when typing and when lowering it.

    Here that is done once for all that have operands of the same types. To be used under numba's lock on its compiler.
    """
    functions: Any = types.Function
    if "get_call_type" in vars(functions):  # a part of what is compiled already
        yield
        return
    functions.get_call_type = _signature
    try:
        yield
    finally:
        del functions.get_call_type


def _signature(function: Any, context: Any, args: Any, named: Any) -> Any:
    key = (function, context, tuple(args), *named.items())
    if key not in _signatures:
        _signatures[key] = types.BaseFunction.get_call_type(function, context, args, named)
    return _signatures[key]


class _Compiler(CompilerBase):
    def __init__(self, typingctx: Any, targetctx: Any, library: Any, args: Any, restype: Any, flags: Any, locals: Any):
        super().__init__(typingctx, targetctx, library, args, restype, _Flags(flags), locals)

    def compile_extra(self, func: Any) -> Any:
        with _looked_up_once():
            return super().compile_extra(func)

    def _passes(self, used: tuple | None, lower: type) -> list[PassManager]:
        """Numba's passes, those ``used`` or all, with another one for lowering."""
        passes = _Passes("jaxplan")
        for step, said in DefaultPassBuilder.define_nopython_pipeline(self.state).passes:
            if used is None or step in used:
                passes.add_pass(lower if step is typed_passes.NativeLowering else step, said)
        passes.finalize()
        return [passes]


class _PartCompiler(_Compiler):
    def define_pipelines(self) -> list[PassManager]:
        return self._passes(_USED, _LowerPart)


class _WholeCompiler(_Compiler):
    def define_pipelines(self) -> list[PassManager]:
        return self._passes(None, _LowerWhole)


_tried = numba.__version__.startswith(TRIED)
PART: dict[str, Any] = {"pipeline_class": _PartCompiler} if _tried else {}
"""Options of ``numba.njit`` for functions that only other compiled functions call; they make no arrays."""
WHOLE: dict[str, Any] = {"pipeline_class": _WholeCompiler} if _tried else {}
"""For those that Python calls."""
