"""Checks of the files that a command is to write, before its work and not after it."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from clunk.results.files import writing
from clunk.study.errors import ClunkError

PICTURES = (".png", ".svg", ".pdf")
RESULTS = (".h5",)


def check(target: Path, suffixes: Sequence[str], *, reads: Path | None = None) -> None:
    """Refuse a file name of another suffix, a file that is being read, a directory, and a place that takes no files.

    Missing parent directories are made. Raises ClunkError.
    """
    if target.is_dir():
        raise ClunkError(f"{target} is a directory; name a file in it.")
    if target.suffix.lower() not in suffixes:
        raise ClunkError(f"{target} cannot be written: its name must end in {', '.join(suffixes)}.")
    if reads is not None and target.resolve() == reads.resolve():
        raise ClunkError(f"{target} is what the command reads; -o must name another file.")
    with writing(target), tempfile.TemporaryFile(dir=target.parent):
        pass
