"""Cores and memory that this process may use: the machine's, or fewer where a container (cgroup) limits them."""

from __future__ import annotations

import contextlib
import math
import os
from pathlib import Path

_CONTAINER = Path("/sys/fs/cgroup")  # as a container sees its own limits, of cgroups of version 2


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
        memory = float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    return min(memory, *_limit("memory.max", 1))


def _limit(name: str, count: int) -> list[float]:
    """The numbers of a limit; infinite where there is none ("max")."""
    with contextlib.suppress(OSError, ValueError):
        numbers = [math.inf if word == "max" else float(word) for word in (_CONTAINER / name).read_text().split()]
        if len(numbers) == count and min(numbers) > 0.0:
            return numbers
    return [math.inf] * count
