"""Provenance of results: the versions that decide their bits, and the attributes of a file on how it was made."""

from __future__ import annotations

import functools
import hashlib
import platform
from concurrent.futures import Executor
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import clunk
from clunk.sweeping.engines import cpu_model

# Packages whose sources decide the bits of a cell; an edit elsewhere, of a picture or a table, discards no cells.
_DECISIVE = ("core", "study", "simulation", "sweeping")
_version = functools.cache(version)


@functools.cache
def versions(package: Path = Path(clunk.__file__).parent) -> dict[str, str]:
    """Versions of all that could change a bit of a cell's results: Python, numpy, scipy, numba, and clunk's sources.

    package : directory of clunk's sources
    """
    sources = hashlib.sha256()
    for path in sorted(path for room in _DECISIVE for path in (package / room).rglob("*.py")):
        sources.update(str(path.relative_to(package)).encode() + b"\0" + path.read_bytes() + b"\0")
    packages = {name: _version(name) for name in ("numpy", "scipy", "numba")}
    return {"python": platform.python_version(), **packages, "sources of clunk": sources.hexdigest()}


def provenance(engine: Executor | None) -> dict[str, str]:
    """Versions, date and machine, as the results file's attributes name them."""
    return {
        "clunk_version": clunk.__version__,
        "python_version": platform.python_version(),
        **{f"{name}_version": _version(name) for name in ("numpy", "numba", "h5py")},
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "cpu": str(getattr(engine, "processors", cpu_model)()),
    }
