"""Tiles: results of cells that were run together, and the bytes in which they are kept on the disk.

A tile has a row for each lash of each cell, a cell's rows behind one another: one record and any number of details, of
a regime map its CELL and its impacts, of a tolerance map its TOLERANCE_CELL and its OUTCOMEs.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clunk.study.arrays import Array, Cells, Records

_MAGIC = b"clunk tiles 2\n\0\0"
_HEADER = struct.Struct("<16sQQ32s32s")  # magic, cells, details, origin, SHA-256 of all other bytes


@dataclass(frozen=True)
class Layout:
    """Types of a tile's arrays.

    record, detail : dtype
    counted_by : field of a record with the number of its details
    lashes : number of rows of each cell
    """

    record: np.dtype[np.void]
    detail: np.dtype[np.void]
    counted_by: str
    lashes: int = 1

    def rows(self, cells: Array) -> Array:
        """Numbers of the rows of some cells, in their order, from the cells' numbers."""
        return cells if self.lashes == 1 else (cells[:, None] * self.lashes + np.arange(self.lashes)).ravel()


@dataclass(frozen=True, eq=False)
class Tile:
    """Results of some cells.

    cells : (n,) int64, numbers in C order of the design; in any order, consecutive or not
    records : (n lashes,) of the layout's record type
    details : (N,) of its detail type, those of each row behind those of the row before it
    """

    cells: Cells
    records: Records
    details: Records


def to_pieces(tiles: Sequence[Tile], origin: bytes) -> list[bytes | memoryview]:
    """Bytes of tiles, to be written one piece after the other; nothing is copied.

    They are a header with a checksum, all tiles' cells, their records, and their details, as they are in memory.

    origin : 32 bytes that identify the study and the versions of the tiles
    """
    counts = sum(tile.cells.size for tile in tiles), sum(tile.details.size for tile in tiles)
    arrays = [getattr(tile, name) for name in ("cells", "records", "details") for tile in tiles]
    body = [np.ascontiguousarray(array).view(np.uint8).data for array in arrays if array.size]
    return [_HEADER.pack(_MAGIC, *counts, origin, _checksum(*counts, origin, *body)), *body]


def from_bytes(raw: bytes, origin: bytes, layout: Layout) -> Tile:
    """Read the bytes that `to_pieces` made, as a single tile. Raises ValueError where a bit or the origin differs."""
    if len(raw) < _HEADER.size:
        raise ValueError("truncated")
    magic, cells, details, written_origin, checksum = _HEADER.unpack_from(raw)
    if magic != _MAGIC or written_origin != origin:
        raise ValueError("of another study or version")
    body = memoryview(raw)[_HEADER.size :]
    width = 8 + layout.lashes * layout.record.itemsize
    size = width * cells + layout.detail.itemsize * details
    if len(body) != size or _checksum(cells, details, origin, body) != checksum:
        raise ValueError("damaged")
    return Tile(
        np.frombuffer(body[: 8 * cells], np.int64).copy(),  # reductions keep the cells; a view would keep all the bytes
        np.frombuffer(body[8 * cells : width * cells], layout.record),
        np.frombuffer(body[width * cells :], layout.detail),
    )


def _checksum(cells: int, details: int, origin: bytes, *body: memoryview) -> bytes:
    sha = hashlib.sha256(struct.pack("<QQ", cells, details) + origin)
    for piece in body:
        sha.update(piece)
    return sha.digest()
