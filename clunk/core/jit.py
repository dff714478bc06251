"""How functions are compiled, and where compiled kernels are kept between processes.

numba's own cache notices a change only in the file that defines a function, not in the helpers it calls, and would run
stale machine code after such an edit. So the directory is named by a digest of every source file of the core. A
compiled function elsewhere may use nothing of yet another file.
"""

import contextlib
import gc
import hashlib
import importlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import FunctionCache
from numba.core.registry import CPUDispatcher

from clunk.core.partial import Part, PartCompiler

_KEPT_DAYS = 30  # for which kernels are kept that nothing uses

Function = TypeVar("Function", bound=Callable[..., Any])


def _configure() -> None:
    """Point numba's cache at this core's own directory; a user's `NUMBA_CACHE_DIR` is respected."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return
    directory = _user_cache() / "clunk" / f"kernels-{_digest()}"
    numba.config.CACHE_DIR = str(_writable(directory))  # type: ignore[attr-defined]  # numba makes it at run time
    with contextlib.suppress(OSError):
        os.utime(directory)
        _remove_unused(directory)


def _remove_unused(used: Path) -> None:
    """Remove the kernels of other digests that were last used `_KEPT_DAYS` ago."""
    for directory in used.parent.glob("kernels-*"):
        if directory != used and time.time() - directory.stat().st_mtime > _KEPT_DAYS * 86400:
            shutil.rmtree(directory, ignore_errors=True)


def is_cold(method: str) -> bool:
    """Whether the kernels of a method, "rk4" or "exact", are yet to be compiled and kept."""
    directory = Path(numba.config.CACHE_DIR)  # type: ignore[attr-defined]
    return not any(directory.glob(f"**/tile.by_{method}-*.nbi"))


def _digest() -> str:
    core = Path(__file__).parent
    sources = sorted(core.rglob("*.py"))
    joined = b"\0".join(str(source.relative_to(core)).encode() + b"\0" + source.read_bytes() for source in sources)
    return hashlib.sha256(joined).hexdigest()[:16]


def _user_cache() -> Path:
    root = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    try:
        return Path(root) if root else Path.home() / ".cache"
    except RuntimeError:  # no home directory
        return Path(tempfile.gettempdir())


def _writable(directory: Path) -> Path:
    """`directory` if a file can be written there, else a fresh one that costs each process a compilation."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            return directory
    except OSError:
        return Path(tempfile.mkdtemp(prefix="clunk-kernels-"))


def _import_without_blas() -> None:
    """Import numba's array functions, which ask for scipy's BLAS: a third of what a kernel takes to load; none uses it.

    Whoever else in the process does has it imported then.
    """
    linear: Any = importlib.import_module("numba.np.linalg")
    ensure = getattr(linear, "ensure_blas", None)
    if ensure is None or "numba.np.arraymath" in sys.modules:
        return
    linear.ensure_blas = lambda: None
    try:
        arraymath: Any = importlib.import_module("numba.np.arraymath")
        arraymath.ensure_blas = ensure
    finally:
        linear.ensure_blas = ensure


class _Cache(FunctionCache):
    """numba's cache of one function; where it is damaged or cannot be written, that costs a compilation and no more."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # whatever it is that reading half a file, or something else in its place, raises
            with contextlib.suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]


def _uncached(**options: Any) -> Callable[[Function], Function]:
    """numba's njit with the options that all kernels share."""
    return cast(Callable[[Function], Function], numba.njit(nogil=True, error_model="numpy", **options))


class _Kernel(CPUDispatcher):
    """A function that Python calls. While it is compiled, no garbage is collected: that would take an eighth longer."""

    def compile(self, signature: Any) -> Any:
        collects = gc.isenabled()
        gc.disable()
        try:
            return super().compile(signature)
        finally:
            if collects:
                gc.enable()


def _kept(**options: Any) -> Callable[[Function], Function]:
    """`_uncached` with a cache: what cache=True does, with a class of ours."""

    def decorate(function: Function) -> Function:
        dispatcher: Any = _uncached(**options)(function)
        dispatcher.__class__ = _Kernel
        dispatcher._cache = _Cache(function)  # type: ignore[no-untyped-call]
        return cast(Function, dispatcher)

    return decorate


def _part(**options: bool) -> Callable[[Function], Function]:
    """Numba's njit for parts; an option that is not given would be that of the function that calls it."""

    def decorate(function: Function) -> Function:
        wrappers = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        dispatcher: Any = _uncached(pipeline_class=PartCompiler, **wrappers, **options)(function)
        dispatcher.__class__ = Part
        return cast(Function, dispatcher)

    return decorate


_configure()  # before the first function is decorated
_import_without_blas()
# No fastmath: the same input gives the same bits, on any number of threads. Division by zero gives an infinity and no
# exception: kernels never raise.
compiled = _kept()
# Without reference counts, each change of which is an atomic operation: for what allocates nothing, and is called so
# often that they would take longer than its work.
unowned = _kept(_nrt=False)
# The same for what only compiled functions call. It is optimised and made machine code with its callers, and once only:
# numba would do so with each function and all that it calls, for functions of functions again and again (exact takes
# 70 s of processor time so, and 26 s with parts). Which of them are inlined is LLVM's choice.
part = _part(_nrt=False, forceinline=False)
# The same for what allocates.
allocating_part = _part(_nrt=True, forceinline=False)
# And always in the machine code of their callers: rk4 takes a third longer without, and exact runs no faster with it,
# but takes a fifth longer to compile.
inlined_part = _part(_nrt=False, forceinline=True)
