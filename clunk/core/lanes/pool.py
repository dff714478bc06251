"""Items that wait in queues, and are taken from them as many at a time as there are lanes.

An item is a number: the row of an array that holds the item's own numbers. Those of the items that are taken are
gathered, and transposed: a row of `work` then holds one number of each of them.
"""

from typing import NamedTuple

import numpy as np

from clunk.core.arrays import FloatArray, IntArray
from clunk.core.jit import part
from clunk.core.lanes import vectors
from clunk.core.lanes.vectors import ROW, WIDTH


class Pool(NamedTuple):
    """Queues of items, and the items that have been taken; W lanes."""

    waiting: IntArray  # (queues, items + 1 or more)  with room for one that is not pushed
    length: IntArray  # (queues,)  how many wait
    work: FloatArray  # (numbers, W)  of the items taken
    items: IntArray  # (W,)  the items taken; the last row of their array in lanes that have none
    places: IntArray  # (W,)  where the numbers of each begin in their array


def whole(count: int) -> int:
    """`count`, filled up to a multiple of what `gather` takes at a time."""
    return -(-count // ROW) * ROW


def aligned(count: int, columns: int = WIDTH) -> FloatArray:
    """Zeros that begin where a register's worth of memory does."""
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
    """Append those of the items taken whose lanes are in a mask."""
    end = pool.length[queue]
    for lane in range(WIDTH):  # nothing branches on the mask, which no processor could predict
        pool.waiting[queue, end] = pool.items[lane]
        end += mask >> lane & 1
    pool.length[queue] = end


@part
def take(pool: Pool, queue: int, array: FloatArray) -> int:
    """Take as many items from a queue as there are lanes, or as wait, the last ones first; return how many.

    array : (items + 1, numbers) float64
        Whose rows are gathered, numbers being a multiple of ROW; the last one is scratch for unused lanes.
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
    """Write the first `count` rows of lanes to those of the items taken whose lanes are in a mask."""
    unused, length = array.shape
    for lane in range(WIDTH):
        pool.places[lane] = (pool.items[lane] if mask >> lane & 1 else unused - 1) * length
    for row in range(0, count, ROW):
        vectors.scatter(array, pool.places, row, rows, row)
