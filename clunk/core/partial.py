"""How numba compiles kernels and their parts: all that reaches into numba's inner parts.

numba optimises each function with all that it calls, and makes machine code of that: what is called by a function that
is called by another one is worked on three times. Here that is left to the outermost one, the kernel.

Importing this raises ImportError where those inner parts are not as expected; `jit` does without it then.
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
    """numba's cache of one function; where it is damaged or cannot be written, that costs a compilation and no more."""

    def load_overload(self, sig, target_context):
        try:
            # without preparing for compiling, as `load_overload` does: that takes half a second
            return self._load_overload(sig, target_context)
        except Exception:  # whatever it is that reading half a file, or something else in its place, raises
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig, data) -> None:
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)


def kernel(dispatcher):
    """Make a function of `numba.njit` one that is kept between processes, as cache=True does."""
    dispatcher._cache = _Cache(dispatcher.py_func)
    return dispatcher


class _Pass(AnalysisPass):
    def __init__(self) -> None:  # abstract in what it extends
        super().__init__()


@register_pass(mutates_CFG=False, analysis_only=True)
class _BeginPart(_Pass):
    """Before a part is lowered: into a library of its own kind, and not prepared for execution."""

    _name = "clunk_begin_part"

    def run_pass(self, state) -> bool:
        codegen = state.targetctx.codegen()
        state.library = _PartLibrary(codegen, state.func_id.func_qualname)
        state.flags.no_compile = True
        return False


@register_pass(mutates_CFG=False, analysis_only=True)
class _EndPart(_Pass):
    """After it: name it to its callers, which numba does together with the preparation for execution."""

    _name = "clunk_end_part"

    def run_pass(self, state) -> bool:
        lowered = state["cr"]
        entry = _dynfunc.make_function(lowered.fndesc.lookup_module(), "part", "", 0, lowered.env, (state.library,))
        state.targetctx.insert_user_function(entry, lowered.fndesc, [state.library])
        state["cr"] = lowered._replace(cfunc=entry)
        return False


class _PartLibrary(JITCodeLibrary):
    """The code of a part: neither optimised nor made machine code before it is in that of a whole."""

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
        """Call the function as Python has it: there is no other code for Python to call."""
        return self.py_func(*arguments)


class PartCompiler(CompilerBase):
    """numba's compiler, for functions that only compiled functions call."""

    def define_pipelines(self):
        """Numba's own passes, and ours before and after that to machine code."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_BeginPart, AnnotateTypes)
        passes.add_pass_after(_EndPart, NativeLowering)
        passes.finalize()
        return [passes]


def with_callers(dispatcher):
    """Make a function of `numba.njit` with `PartCompiler` one that is compiled with its callers alone."""
    dispatcher.__class__ = _Part
    return dispatcher
