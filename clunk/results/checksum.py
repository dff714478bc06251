"""A file's bytes and their SHA-256 behind them, so that HDF5 is only ever given what was written.

HDF5 does not come back from every damaged file: a changed bit can send it around in a circle. It does not look behind
the end that its superblock names, and cuts the file there when it changes it. So the checksum stands behind that end:
a file that another program has changed has none any more, and one that was damaged has a wrong one.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

_MARK = b"clunk-sha256:"
_LENGTH = len(_MARK) + 64 + 1  # `head -c -78 FILE | sha256sum` gives the same digits
_END_AT = {0: 40, 1: 44, 2: 28, 3: 28}  # superblock version -> where it has the address of the end of the file
_BLOCK = 1 << 20


def trailer(content: Iterable[bytes | memoryview]) -> bytes:
    """What is to follow the content of a file, which comes block by block."""
    sha = hashlib.sha256()
    for block in content:
        sha.update(block)
    return _MARK + sha.hexdigest().encode() + b"\n"


def blocks(file: BinaryIO, size: int) -> Iterator[bytes]:
    """The first `size` bytes of a file."""
    file.seek(0)
    while size and (block := file.read(min(_BLOCK, size))):
        size -= len(block)
        yield block


def verify(path: str | os.PathLike[str]) -> bool:
    """Whether an HDF5 file has a checksum that its bytes match; False where it has none.

    Raises OSError, and ValueError where the bytes do not match, or where what follows the end of the HDF5 is another.
    """
    with Path(path).open("rb") as file:
        head = file.read(64)
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _LENGTH))
        tail = file.read()
        if tail.startswith(_MARK):
            if tail != trailer(blocks(file, size - _LENGTH)):
                raise ValueError("its bytes do not match its checksum")
            return True
    at = _END_AT.get(head[8]) if len(head) == 64 else None
    if at is not None and size > int.from_bytes(head[at : at + 8], "little"):
        raise ValueError("its end is not whole")
    return False
