"""The machine and the versions that results come from: cores, memory, processor, and versions that decide the bits."""

import contextlib
import functools
import hashlib
import math
import os
import platform
import shutil
import time
from concurrent.futures import Executor
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numba
from llvmlite.binding import get_host_cpu_name

import clunk

_CONTAINER = Path("/sys/fs/cgroup")  # where a container finds its own limits (cgroups, version 2)
# Packages whose sources decide the bits of a cell; an edit elsewhere, of a picture or a table, discards no cells.
_DECISIVE = ("core", "study", "simulation", "sweeping")
_KEPT_DAYS = 30  # for which the kernels of another version are kept after their last use
_version = functools.cache(version)


# --- cores and memory that this process may use: the machine's, or fewer where a container (cgroup) limits them


def available_cores() -> int:
    """Number of cores, 1 or more."""
    try:
        cores = len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS and Windows
        cores = os.cpu_count() or 1
    time, period = _limit("cpu.max", 2)
    return max(1, min(cores, math.ceil(time / period) if time < math.inf else cores))


def available_memory() -> float:
    """Memory in bytes; infinite where that is unknown."""
    memory = math.inf
    with contextlib.suppress(AttributeError, ValueError, OSError):
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min(memory, *_limit("memory.max", 1))


def _limit(name: str, count: int) -> list[float]:
    """The `count` numbers of a container's limit; infinite where there is no limit ("max", or no such file)."""
    with contextlib.suppress(OSError, ValueError):
        numbers = [math.inf if word == "max" else float(word) for word in (_CONTAINER / name).read_text().split()]
        if len(numbers) == count and min(numbers) > 0.0:
            return numbers
    return [math.inf] * count


# --- provenance


@functools.cache
def versions(package: Path = Path(clunk.__file__).parent) -> dict[str, str]:
    """Versions of all that could change a bit of a cell's results: Python, numpy, scipy, numba, and clunk's sources.

    The version of the sources is their SHA-256.

    package : directory of clunk's sources
    """
    sources = hashlib.sha256()
    for path in sorted(path for room in _DECISIVE for path in (package / room).rglob("*.py")):
        sources.update(str(path.relative_to(package)).encode() + b"\0" + path.read_bytes() + b"\0")
    packages = {name: _version(name) for name in ("numpy", "scipy", "numba")}
    return {"python": platform.python_version(), **packages, "sources of clunk": sources.hexdigest()}


def provenance(engine: Executor | None) -> dict[str, str]:
    """Versions, date and processors, under the names of the results file's attributes."""
    return {
        "clunk_version": clunk.__version__,
        "python_version": platform.python_version(),
        **{f"{name}_version": _version(name) for name in ("numpy", "numba", "h5py")},
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "cpu": str(getattr(engine, "processors", get_host_cpu_name)()),
    }


def remove_old_kernels() -> None:
    """Remove the compiled kernels of other versions that nothing has used for `_KEPT_DAYS`."""
    caches = Path(numba.config.CACHE_DIR).parent  # type: ignore[attr-defined]  # numba sets it at run time
    with contextlib.suppress(OSError):
        for kept in caches.glob("kernels-*") if caches.name == "clunk" else ():
            if time.time() - kept.stat().st_mtime > _KEPT_DAYS * 86400:
                shutil.rmtree(kept, ignore_errors=True)
