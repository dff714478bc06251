"""Compilation of kernels together with their parts, by changes to private parts of numba.

numba optimises each function together with all that it calls, and makes machine code of both: a function that is called
by one that another function calls is compiled three times. Here only the outermost function, the kernel, is optimised
and made machine code, with its parts.

Importing this module raises ImportError where numba's private parts are not as expected; `jit` then does without it.
"""

import contextlib

from numba import _dynfunc, types
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags
from numba.core.compiler_machinery import AnalysisPass, PassManager, register_pass
from numba.core.cpu import CPUContext
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import AnnotateTypes, NativeLowering

for _owner, _names in (
    (_dynfunc, "make_function"),
    (CPUContext, "insert_user_function"),
    (CPUDispatcher, "compile"),
    (DefaultPassBuilder, "define_nopython_pipeline"),
    (Flags, "no_compile nrt"),
    (FunctionCache, "flush load_overload _load_overload save_overload"),
    (JITCodeLibrary, "_finalize_dynamic_globals _finalize_final_module _optimize_final_module"),
    (PassManager, "add_pass_after"),
):
    for _name in _names.split():
        if not hasattr(_owner, _name):
            raise ImportError(f"numba's {_owner.__name__} has no {_name}")


class _Cache(FunctionCache):
    """numba's cache of one function; a cache that is damaged or cannot be written costs a compilation and no more."""

    def load_overload(self, sig, target_context):
        try:
            # without preparing for compiling, as `load_overload` does: that takes half a second
            return self._load_overload(sig, target_context)
        except Exception:  # reading half a file, or something else in its place, may raise anything
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig, data) -> None:
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)


def kernel(dispatcher):
    """Keep the machine code of a function of `numba.njit` between processes, as cache=True does."""
    dispatcher._cache = _Cache(dispatcher.py_func)
    return dispatcher


class _Pass(AnalysisPass):
    def __init__(self) -> None:  # abstract in AnalysisPass
        super().__init__()


@register_pass(mutates_CFG=False, analysis_only=True)
class _BeginPart(_Pass):
    """Pass before a part is lowered: its code goes to a `_PartLibrary`, and is not prepared for execution."""

    _name = "clunk_begin_part"

    def run_pass(self, state) -> bool:
        codegen = state.targetctx.codegen()
        state.library = _PartLibrary(codegen, state.func_id.func_qualname)
        state.flags.no_compile = True
        return False


@register_pass(mutates_CFG=False, analysis_only=True)
class _EndPart(_Pass):
    """Pass after a part is lowered: make it known to its callers, which numba does as it prepares for execution."""

    _name = "clunk_end_part"

    def run_pass(self, state) -> bool:
        lowered = state["cr"]
        entry = _dynfunc.make_function(lowered.fndesc.lookup_module(), "part", "", 0, lowered.env, (state.library,))
        state.targetctx.insert_user_function(entry, lowered.fndesc, [state.library])
        state["cr"] = lowered._replace(cfunc=entry)
        return False


class _PartLibrary(JITCodeLibrary):
    """The code of a part, which is optimised and made machine code only within the code of a kernel."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _Part(CPUDispatcher):
    """A function that only compiled functions call."""

    def compile(self, signature):
        """Compile once for all ints, not again for each constant in a call: that would take an eighth longer."""
        return super().compile(tuple(map(types.unliteral, signature)))

    def __call__(self, *arguments):
        """Call the uncompiled function: a part has no machine code that Python could call."""
        return self.py_func(*arguments)


class PartCompiler(CompilerBase):
    """numba's compiler, for functions that only compiled functions call."""

    def define_pipelines(self):
        """Numba's own passes, with `_BeginPart` and `_EndPart` before and after the one that lowers to LLVM's code."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_BeginPart, AnnotateTypes)
        passes.add_pass_after(_EndPart, NativeLowering)
        passes.finalize()
        return [passes]


def with_callers(dispatcher):
    """Make a function of `numba.njit` with `PartCompiler` a part, which is compiled only with its callers."""
    dispatcher.__class__ = _Part
    return dispatcher
