"""Compiling functions that only compiled functions call.

numba optimises each function with all that it calls, and makes machine code of that: what is called by a function that
is called by another one is worked on three times. Here that is left to the outermost one.
"""

from typing import Any

from numba import _dynfunc, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import AnalysisPass, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import AnnotateTypes, NativeLowering


@register_pass(mutates_CFG=False, analysis_only=True)
class _BeginPart(AnalysisPass):
    """Before a part is lowered: into a library of its own kind, and not prepared for execution."""

    _name = "clunk_begin_part"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        codegen = state.targetctx.codegen()
        state.library = _Part(codegen, state.func_id.func_qualname)
        state.flags.no_compile = True
        return False


@register_pass(mutates_CFG=False, analysis_only=True)
class _EndPart(AnalysisPass):
    """After it: name it to its callers, which numba does together with the preparation for execution."""

    _name = "clunk_end_part"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        lowered = state["cr"]
        entry = _dynfunc.make_function(lowered.fndesc.lookup_module(), "part", "", 0, lowered.env, (state.library,))
        state.targetctx.insert_user_function(entry, lowered.fndesc, [state.library])
        state["cr"] = lowered._replace(cfunc=entry)
        return False


class _Part(JITCodeLibrary):
    """The code of a part: neither optimised nor made machine code before it is in that of a whole."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class Part(CPUDispatcher):
    """A function that only compiled functions call."""

    def compile(self, signature: Any) -> Any:
        """Compile once for all ints, not again for each constant in a call: that would take an eighth longer."""
        return super().compile(tuple(map(types.unliteral, signature)))

    def __call__(self, *_: Any) -> Any:
        """Raise TypeError: there is no code for Python to call."""
        raise TypeError(f"{self.__name__} is called by compiled functions only")


class PartCompiler(CompilerBase):
    """numba's compiler, for functions that only compiled functions call."""

    def define_pipelines(self) -> list[Any]:
        """Numba's own passes, and ours before and after that to machine code."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_BeginPart, AnnotateTypes)
        passes.add_pass_after(_EndPart, NativeLowering)
        passes.finalize()
        return [passes]
