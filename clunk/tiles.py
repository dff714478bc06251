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

_MAGIC = b"clunk tiles 1\n\0\0"
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
    """Tiles column by column, behind a checksum: pieces to be written one after the other.

    origin : 32 bytes that tell which study and which versions the tiles are of
    """
    records, impacts = (np.concatenate([getattr(tile, name) for tile in tiles]) for name in ("records", "impacts"))
    columns = [np.concatenate([tile.cells for tile in tiles])]
    columns += [array[name] for array in (records, impacts) for name in array.dtype.names or ()]
    body = [np.ascontiguousarray(column).data.cast("B") for column in columns if column.size]
    counts = (len(records), len(impacts))
    return [_HEADER.pack(_MAGIC, *counts, origin, _checksum(*counts, origin, *body)), *body]


def from_bytes(raw: bytes, origin: bytes, record: np.dtype[np.void], impact: np.dtype[np.void]) -> Tile:
    """What `to_pieces` made, put together, as one tile. Raises ValueError where a bit of it differs, or its origin."""
    if len(raw) < _HEADER.size:
        raise ValueError("truncated")
    magic, cells, impacts, its_origin, checksum = _HEADER.unpack_from(raw)
    if magic != _MAGIC or its_origin != origin:
        raise ValueError("of another study or version")
    body = memoryview(raw)[_HEADER.size :]
    width = 8 + sum(_widths(record))
    if len(body) != width * cells + sum(_widths(impact)) * impacts:
        raise ValueError("damaged")
    if _checksum(cells, impacts, origin, body) != checksum:
        raise ValueError("damaged")
    return Tile(
        np.frombuffer(body[: 8 * cells], np.int64).copy(),  # of the cells alone; a view would keep all the bytes
        _from_columns(body[8 * cells : width * cells], record, cells),
        _from_columns(body[width * cells :], impact, impacts),
    )


def _from_columns(body: memoryview, dtype: np.dtype[np.void], count: int) -> npt.NDArray[np.void]:
    array = np.zeros(count, dtype)
    begin = 0
    for name, width in zip(dtype.names or (), _widths(dtype), strict=True):
        array[name] = np.frombuffer(body[begin : begin + width * count], dtype[name])
        begin += width * count
    return array


def _widths(dtype: np.dtype[np.void]) -> list[int]:
    """Bytes of each field, without what lies between them."""
    return [dtype[name].itemsize for name in dtype.names or ()]


def _checksum(cells: int, impacts: int, origin: bytes, *body: memoryview) -> bytes:
    sha = hashlib.sha256(struct.pack("<QQ", cells, impacts) + origin)
    for piece in body:
        sha.update(piece)
    return sha.digest()
