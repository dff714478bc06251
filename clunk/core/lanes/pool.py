"""Queues of items, from which as many items are taken at a time as there are lanes.

An item is the index of a row in an array that holds the item's numbers. The rows of the items taken are gathered and
transposed: each row of `work` then holds one number of every item.
"""

from typing import NamedTuple

import numpy as np

from clunk.core.arrays import FloatArray, IntArray
from clunk.core.jit import part
from clunk.core.lanes import vectors
from clunk.core.lanes.vectors import ROW, WIDTH


class Pool(NamedTuple):
    """Queues of items, and the items that have been taken; W lanes."""

    waiting: IntArray  # (queues, items + 1 or more)  items of each queue; `push_all` writes to the place behind, too
    length: IntArray  # (queues,)  how many items wait in each queue
    work: FloatArray  # (numbers, W)  numbers of the items taken
    items: IntArray  # (W,)  the items taken; in unused lanes the last row of the items' array
    places: IntArray  # (W,)  where the numbers of each item begin in the items' array, taken as flat


def whole(count: int) -> int:
    """`count`, rounded up to a multiple of ROW, as many numbers as `gather` takes at a time."""
    return -(-count // ROW) * ROW


def aligned(count: int, columns: int = WIDTH) -> FloatArray:
    """Zeros, (count, columns), that begin at a multiple of 64 bytes in memory, ROW floats."""
    flat = np.zeros(count * columns + ROW)
    first = -(flat.ctypes.data >> 3) % ROW
    return flat[first : first + count * columns].reshape(count, columns)


@part
def push(pool: Pool, queue: int, item: int) -> None:
    """Append an item to a queue."""
    length = pool.length[queue]
    pool.waiting[queue, length] = item
    pool.length[queue] = length + 1


@part
def push_all(pool: Pool, queue: int, mask: int) -> None:
    """Append to a queue those of the items taken whose lanes are in a mask."""
    end = pool.length[queue]
    for lane in range(WIDTH):  # nothing branches on the mask, which no processor could predict
        pool.waiting[queue, end] = pool.items[lane]
        end += mask >> lane & 1
    pool.length[queue] = end


@part
def take(pool: Pool, queue: int, array: FloatArray) -> int:
    """Take as many items from the end of a queue as there are lanes, or as wait; gather their rows; return how many.

    array : (items + 1, numbers) float64
        The items' rows, numbers being a multiple of ROW; the last row is scratch for unused lanes.
    """
    count, length, unused = min(pool.length[queue], WIDTH), array.shape[1], array.shape[0] - 1
    first = pool.length[queue] - count
    pool.length[queue] = first
    for k in range(WIDTH):
        item = pool.waiting[queue, first + k] if k < count else unused
        pool.places[k], pool.items[k] = item * length, item
    for row in range(0, length, ROW):
        vectors.gather(array, pool.places, row, pool.work, row)
    return count


@part
def put_back(pool: Pool, rows: FloatArray, array: FloatArray, count: int, mask: int) -> None:
    """Write the first `count` rows of lanes, in whole ROWs, back to those items taken whose lanes are in a mask."""
    unused, length = array.shape
    for lane in range(WIDTH):
        pool.places[lane] = (pool.items[lane] if mask >> lane & 1 else unused - 1) * length
    for row in range(0, count, ROW):
        vectors.scatter(array, pool.places, row, rows, row)
