"""How functions are compiled, and where compiled kernels are kept between processes.

numba's own cache notices a change only in the file that defines a function, not in the helpers it calls, and would run
stale machine code after such an edit. So the directory is named by a digest of every source file of the core. A
compiled function outside the core may therefore call functions of the core and of its own file only.
"""

import contextlib
import hashlib
import importlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def _configure() -> None:
    """Point numba's cache at this core's own directory; a user's `NUMBA_CACHE_DIR` is respected."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return
    directory = _user_cache() / "clunk" / f"kernels-{_digest()}{'' if partial else '-plain'}"
    numba.config.CACHE_DIR = str(_writable(directory))  # type: ignore[attr-defined]  # numba makes it at run time
    with contextlib.suppress(OSError):
        os.utime(directory)  # see `sweeping.machine.remove_old_kernels`


def _digest() -> str:
    joined = b"\0".join(
        str(source).encode() + b"\0" + source.read_bytes() for source in sorted(Path(__file__).parent.rglob("*.py"))
    )
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


def _uncached(**options: Any) -> Callable[[Function], Function]:
    """numba's njit with the options that all functions share.

    No fastmath: the same input gives the same bits, on any number of threads. Division by zero gives an infinity and no
    exception: kernels never raise.
    """
    return cast(Callable[[Function], Function], numba.njit(nogil=True, error_model="numpy", **options))


def compiled(function: Function) -> Function:
    """Compile a kernel: a function that Python calls, whose machine code is kept between processes."""
    if partial is None:
        return _uncached(cache=True)(function)
    # Without reference counts, each change of which is an atomic operation: compiled functions allocate nothing.
    return cast(Function, partial.kernel(_uncached(_nrt=False)(function)))


def part(function: Function, forceinline: bool = False) -> Function:
    """Compile a part: a function that only compiled functions call.

    A part is optimised and made machine code together with the kernel that calls it, and only then. numba would do so
    with each function and all that it calls, and again for each function that calls that one (the exact method takes
    70 s of processor time to compile in this way, and 26 s with parts). Which parts are inlined is LLVM's choice.

    All options are set here: one left out would be taken from the function that calls the part.
    """
    if partial is None:
        return _uncached(forceinline=forceinline)(function)
    wrappers = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False, "forceinline": forceinline}
    return cast(Function, partial.with_callers(_uncached(pipeline_class=partial.PartCompiler, **wrappers)(function)))


def inlined_part(function: Function) -> Function:
    """Compile a part that is always inlined into its callers.

    Were these plain parts, runs would take a third longer by rk4, and an eighth longer by exact, whose compilation
    would take an eighth less.
    """
    return part(function, forceinline=True)


try:
    partial: Any = importlib.import_module("clunk.core.partial")
except (ImportError, AttributeError):  # numba's private parts are not as expected: slower to compile, the same bits
    partial = None
_configure()  # before the first function is decorated
