"""SHA-256 of a file's bytes, written behind them, so that HDF5 only reads bytes that were written.

HDF5 does not come back from every damaged file: a changed bit can send it around in a circle. It does not look behind
the end that its superblock names, and cuts the file there when it changes it. So the checksum stands behind that end:
a file that another program has changed has none any more, and one that was damaged has a wrong one.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator
from typing import BinaryIO

_MARK = b"clunk-sha256:"
_LENGTH = len(_MARK) + 64 + 1  # `head -c -78 FILE | sha256sum` gives the same digits
_END_AT = {0: 40, 1: 44, 2: 28, 3: 28}  # superblock version -> where it has the address of the end of the file
_BLOCK = 1 << 20


def trailer(content: Iterable[bytes | memoryview]) -> bytes:
    """Compute the checksum that follows the content of a file, which comes block by block."""
    sha = hashlib.sha256()
    for block in content:
        sha.update(block)
    return _MARK + sha.hexdigest().encode() + b"\n"


def blocks(file: BinaryIO, size: int) -> Iterator[bytes]:
    """Read the first `size` bytes of a file, block by block."""
    file.seek(0)
    while size and (block := file.read(min(_BLOCK, size))):
        size -= len(block)
        yield block


def matches_checksum(file: BinaryIO) -> bool:
    """Whether an HDF5 file has a checksum, which its bytes match; False where it has none.

    Raises ValueError where the bytes do not match, or where something else follows the end of the HDF5.
    """
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - _LENGTH))
    tail = file.read()
    if tail.startswith(_MARK):
        if tail != trailer(blocks(file, size - _LENGTH)):
            raise ValueError("its bytes do not match its checksum")
        return True
    file.seek(0)
    head = file.read(64)
    at = _END_AT.get(head[8]) if len(head) == 64 else None
    if at is not None and size > int.from_bytes(head[at : at + 8], "little"):
        raise ValueError("its end is not whole")
    return False
