"""A tile: cells of the grid that were run together, what came of them, and the bytes in which that is kept.

Of a regime map, a cell has a CELL and its impacts; of a tolerance map, a TOLERANCE_CELL and its OUTCOMEs.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

_MAGIC = b"clunk tiles 2\n\0\0"
_HEADER = struct.Struct("<16sQQ32s32s")  # magic, cells, impacts, origin, SHA-256 of all other bytes


@dataclass(frozen=True, eq=False)
class Tile:
    """The runs of some cells.

    cells : (n,) int64, each one's number in C order of the grid; in any order, consecutive or not
    records : (n,) CELL or TOLERANCE_CELL
    impacts : (N,) IMPACT or OUTCOME, those of each cell behind those of the cell before it: as many of them as
        `records["primary_impacts"]` or `records["outcomes"]` says
    """

    cells: npt.NDArray[np.int64]
    records: npt.NDArray[np.void]
    impacts: npt.NDArray[np.void]


def to_pieces(tiles: Sequence[Tile], origin: bytes) -> list[bytes | memoryview]:
    """All tiles' cells, then their records, then their impacts, as they are in memory, behind a checksum.

    The pieces are to be written one after the other; nothing is copied.

    origin : 32 bytes that tell which study and which versions the tiles are of
    """
    counts = sum(tile.cells.size for tile in tiles), sum(tile.impacts.size for tile in tiles)
    arrays = [getattr(tile, name) for name in ("cells", "records", "impacts") for tile in tiles]
    body = [np.ascontiguousarray(array).view(np.uint8).data for array in arrays if array.size]
    return [_HEADER.pack(_MAGIC, *counts, origin, _checksum(*counts, origin, *body)), *body]


def from_bytes(raw: bytes, origin: bytes, record: np.dtype[np.void], impact: np.dtype[np.void]) -> Tile:
    """What `to_pieces` made, put together, as one tile. Raises ValueError where a bit of it differs, or its origin."""
    if len(raw) < _HEADER.size:
        raise ValueError("truncated")
    magic, cells, impacts, its_origin, checksum = _HEADER.unpack_from(raw)
    if magic != _MAGIC or its_origin != origin:
        raise ValueError("of another study or version")
    body = memoryview(raw)[_HEADER.size :]
    width = 8 + record.itemsize
    if len(body) != width * cells + impact.itemsize * impacts:
        raise ValueError("damaged")
    if _checksum(cells, impacts, origin, body) != checksum:
        raise ValueError("damaged")
    return Tile(
        np.frombuffer(body[: 8 * cells], np.int64).copy(),  # of the cells alone; a view would keep all the bytes
        np.frombuffer(body[8 * cells : width * cells], record),
        np.frombuffer(body[width * cells :], impact),
    )


def _checksum(cells: int, impacts: int, origin: bytes, *body: memoryview) -> bytes:
    sha = hashlib.sha256(struct.pack("<QQ", cells, impacts) + origin)
    for piece in body:
        sha.update(piece)
    return sha.digest()
