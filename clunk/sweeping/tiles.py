"""Tiles: results of cells that were run together, and the bytes in which they are kept on the disk.

A tile has a row for each lash of each cell, a cell's rows behind one another: one record and any number of details, of
a regime map its CELL and its impacts, of a tolerance map its TOLERANCE_CELL and its OUTCOMEs.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clunk.study.arrays import Array, Cells, Records

_ARRAYS = ("cells", "records", "details")
_DIGEST = 32  # bytes of SHA-256


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


def to_bytes(tiles: Sequence[Tile], origin: bytes) -> bytes:
    """Bytes of tiles: a SHA-256, then all tiles' cells, their records, and their details, each as a file of NumPy's.

    origin : identifies the study and the versions of the tiles
    """
    arrays = io.BytesIO()
    for name in _ARRAYS:
        np.save(arrays, np.concatenate([getattr(tile, name) for tile in tiles]))
    return hashlib.sha256(origin + arrays.getbuffer()).digest() + arrays.getbuffer()


def from_bytes(raw: bytes, origin: bytes) -> Tile:
    """Read the bytes that `to_bytes` made, as a single tile. Raises ValueError where a bit or the origin differs."""
    if hashlib.sha256(origin + raw[_DIGEST:]).digest() != raw[:_DIGEST]:
        raise ValueError("damaged, or of another study or version")
    arrays = io.BytesIO(raw[_DIGEST:])
    return Tile(*(np.load(arrays) for _ in _ARRAYS))
