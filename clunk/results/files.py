"""Writing files whole or not at all: a reader gets the old content or the new, never half of it."""

import os
import secrets
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from clunk.study.document import READ, FilePath
from clunk.study.errors import ClunkError


def write_whole(path: FilePath, write: Callable[[BinaryIO], object], scratch: Path | None = None) -> None:
    """Write a file so that at every moment `path` is either the old file or the complete new one.

    The content is written under a temporary name to `scratch`, a directory of the same file system (by default the one
    of `path`), flushed to the disk, and the file is then renamed. Raises OSError; the temporary file is then removed,
    as it is on an interrupt.
    """
    path = Path(os.path.realpath(path))  # through a symbolic link: replace the file, not the link
    temporary = (scratch or path.parent) / f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp"
    try:
        with temporary.open("x+b") as target:
            write(target)
            target.flush()
            os.fsync(target.fileno())
        temporary.replace(path)
    finally:
        with suppress(OSError):  # the directory itself may be missing
            temporary.unlink(missing_ok=True)


@contextmanager
def writing(path: FilePath) -> Iterator[Path]:
    """Context for writing a file: make its directory, and turn an OSError into a ClunkError for the user."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield path
    except OSError as problem:
        raise ClunkError(f"{path} cannot be written: {reason(problem)}.") from problem


def write_text(path: FilePath, text: str) -> None:
    """Write a text file whole or not at all, in UTF-8. Raises ClunkError."""
    with writing(path) as target:
        write_whole(target, lambda file: file.write(text.encode()))


def reason(error: BaseException) -> str:
    """Text of an error as a phrase within a sentence: on one line, with a small first letter, without a full stop."""
    if isinstance(error, OSError) and error.strerror:
        words = error.strerror
    else:
        words = str(error.args[0]) if error.args else type(error).__name__
    words = " ".join(words.split()).rstrip(".")
    return words[:1].lower() + words[1:]


# --- Files that a command is to write --------------------------------------------------------------------------------


PICTURES = (".png", ".svg", ".pdf")
RESULTS = (".h5",)


def check(target: Path | None, suffixes: Sequence[str], *, reads: Path | None = None) -> None:
    """Check, before a command runs, that it can write to a file; make missing parent directories.

    Raises ClunkError where the target is a directory, a device or a pipe, has another suffix, is the file that the
    command reads or a text file that this process has read, such as the trace of the load, or where no file can be
    created in its directory.

    target : None where no file is to be written
    suffixes : allowed suffixes, in lower case
    reads : results file that the command reads
    """
    if target is None:
        return
    if target.exists() and not target.is_file():
        what = "directory; name a file in it" if target.is_dir() else "device or a pipe; name a file"
        raise ClunkError(f"{target} is a {what}.")
    if target.suffix.lower() not in suffixes:
        raise ClunkError(f"{target} cannot be written: its name must end in {', '.join(suffixes)}.")
    if Path(os.path.realpath(target)) in (READ if reads is None else {*READ, reads.resolve()}):
        raise ClunkError(f"{target} is what the command reads; write to another file.")
    with writing(target), tempfile.TemporaryFile(dir=target.parent):
        pass
