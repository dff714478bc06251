"""Vectors of WIDTH floats in a processor's wide registers, one lane each for as many runs side by side.

Operators act lane by lane on two vectors, or on a vector and a number, which stands for the same number in all lanes. A
comparison gives an int, in which the bits of those lanes are set where it holds. Each operation rounds as its scalar
counterpart does, and no sum is reordered: a run has the same bits on every processor, in any lane, beside any others.

Vectors are loaded from, and stored to, rows of a contiguous array.
"""

import operator
from collections.abc import Callable
from typing import Any, NamedTuple

from llvmlite import ir
from llvmlite.binding import get_host_cpu_features
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, lower_builtin, models, overload, register_model, type_callable

from clunk.core.arrays import FloatArray
from clunk.core.jit import inlined_part


def _has_wide_registers() -> bool:
    """Whether this processor's registers hold eight floats, and not four or two."""
    try:
        return bool(get_host_cpu_features().get("avx512f"))
    except RuntimeError:  # of a processor that LLVM cannot ask
        return False


# Two of the widest registers: while one waits for its result, the other works. More of narrower registers would take
# longer where few runs share a driveline (measured: 1.75 times with one run a driveline), and no less time where many
# do.
WIDTH = 16 if _has_wide_registers() else 8
ROW = 8  # numbers of a run that `gather` and `scatter` take at a time
Vector = Any  # for mypy


class OfLanes(NamedTuple):
    """A table whose numbers differ from lane to lane."""

    rows: FloatArray  # (numbers, W)


Table = FloatArray | OfLanes  # whose numbers are in C order

_VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)
_ANY = ir.Constant(_VECTOR, ir.Undefined)
_EIGHT = ir.VectorType(ir.DoubleType(), ROW)
_INT = ir.IntType(64)


class LanesType(types.Type):
    """numba's type of lanes."""


_LANES = LanesType("Vector")
register_model(LanesType)(lambda manager, of: models.PrimitiveModel(manager, of, _VECTOR))


_operation: Any = intrinsic  # for mypy: its first argument is not the caller's


def _index(*lanes: int) -> ir.Constant:
    return ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), list(lanes))


def _splat(builder, x):
    return builder.shuffle_vector(builder.insert_element(_ANY, x, ir.IntType(32)(0)), _ANY, _index(*[0] * WIDTH))


def _at(context, builder, array, value, first, shape=_VECTOR):
    """A pointer to as many numbers of an array as a vector of type `shape` has, from number `first` on."""
    data = context.make_array(array)(context, builder, value).data
    return builder.bitcast(builder.gep(data, [first]), shape.as_pointer())


def _loaded(builder, pointer):
    lanes = builder.load(pointer)
    lanes.align = 8
    return lanes


@_operation
def load(typing, array, row):
    """A row of an array."""

    def emit(context, builder, signature, values):
        first = builder.mul(values[1], _INT(WIDTH))
        return _loaded(builder, _at(context, builder, signature.args[0], values[0], first))

    return _LANES(array, types.intp), emit


@_operation
def number(typing, table, k):
    """Element k of a table, k not negative: a float if the table is an array, lanes if it is `OfLanes`."""

    has_lanes = isinstance(table, types.BaseNamedTuple)

    def emit(context, builder, signature, values):
        if has_lanes:
            first, rows = builder.mul(values[1], _INT(WIDTH)), builder.extract_value(values[0], 0)
            return _loaded(builder, _at(context, builder, table[0], rows, first))
        return builder.load(_at(context, builder, table, values[0], values[1], ir.DoubleType()))

    return (_LANES if has_lanes else types.float64)(table, types.intp), emit


@_operation
def store(typing, array, row, lanes):
    """Write a row of an array, or several lanes to as many rows from that one on."""

    def emit(context, builder, signature, values):
        first = builder.mul(values[1], _INT(WIDTH))
        of_rows = [values[2]] if lanes == _LANES else cgutils.unpack_tuple(builder, values[2])
        for k, of_row in enumerate(of_rows):
            at = builder.add(first, _INT(k * WIDTH))
            builder.store(of_row, _at(context, builder, signature.args[0], values[0], at)).align = 8
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes), emit


@_operation
def splat(typing, x):
    """The same number in all lanes."""
    return _LANES(types.float64), lambda context, builder, signature, values: _splat(builder, values[0])


def _by_llvm(name: str, sides: tuple[Any, ...]):
    """An operation on lanes that is an intrinsic of LLVM; a number stands for the same number in all lanes."""

    def emit(context, builder, signature, values):
        lanes = _as_lanes(builder, signature.args, values)
        signature_of, full = ir.FunctionType(_VECTOR, [_VECTOR] * len(lanes)), f"llvm.{name}.v{WIDTH}f64"
        return builder.call(cgutils.get_or_insert_function(builder.module, signature_of, full), lanes)

    return _LANES(*sides), emit


@_operation
def fused(typing, a, b, c):
    """a b + c, rounded once."""
    return _by_llvm("fma", (a, b, c))


@_operation
def root(typing, a):
    """Square roots."""
    return _by_llvm("sqrt", (a,))


@_operation
def magnitude(typing, a):
    """Absolute values."""
    return _by_llvm("fabs", (a,))


def _as_lanes(builder, of, values):
    return [value if type_ == _LANES else _splat(builder, value) for type_, value in zip(of, values, strict=True)]


def _binary(operations: tuple[Any, ...], result, emit: Callable[..., Any]) -> None:
    """Define a binary operation on lanes for some of Python's operators, such as + and +=."""

    def typed(context):
        def types_of(a, b):
            return result if _LANES in (a, b) and {a, b} <= {_LANES, types.float64} else None

        return types_of

    def lower(context, builder, signature, values):
        return emit(builder, *_as_lanes(builder, signature.args, values))

    for operation in operations:
        type_callable(operation)(typed)
        for pair in ((_LANES, _LANES), (_LANES, types.float64), (types.float64, _LANES)):
            lower_builtin(operation, *pair)(lower)


def _comparison(sign: str) -> Callable[..., Any]:
    bits = ir.IntType(WIDTH)
    return lambda builder, a, b: builder.zext(builder.bitcast(builder.fcmp_ordered(sign, a, b), bits), _INT)


_binary((operator.add, operator.iadd), _LANES, ir.IRBuilder.fadd)
_binary((operator.sub, operator.isub), _LANES, ir.IRBuilder.fsub)
_binary((operator.mul, operator.imul), _LANES, ir.IRBuilder.fmul)
_binary((operator.truediv,), _LANES, ir.IRBuilder.fdiv)
for _sign, _operator in (
    (">", operator.gt),
    (">=", operator.ge),
    ("<", operator.lt),
    ("<=", operator.le),
    ("==", operator.eq),
):
    _binary((_operator,), types.int64, _comparison(_sign))


@overload(operator.neg)
def _negated(a):
    return (lambda a: a * -1.0) if a == _LANES else None


@_operation
def choose(typing, bits, a, b):
    """Vector of the lanes of a where bits are set, and of b elsewhere; both may be numbers."""

    def emit(context, builder, signature, values):
        mask = builder.bitcast(builder.trunc(values[0], ir.IntType(WIDTH)), ir.VectorType(ir.IntType(1), WIDTH))
        return builder.select(mask, *_as_lanes(builder, signature.args[1:], values[1:]))

    return _LANES(types.int64, a, b), emit


@_operation
def first_of(typing, bits):
    """Index of the lowest bit that is set; 64 for none."""
    return types.int64(types.int64), lambda context, builder, signature, values: builder.cttz(
        values[0], ir.IntType(1)(0)
    )


@inlined_part
def larger(a: Vector, b: Vector) -> Vector:
    """The larger of two, lane by lane; b where either is NaN."""
    return choose(a > b, a, b)


@inlined_part
def smaller(a: Vector, b: Vector) -> Vector:
    """The smaller of two, lane by lane; b where either is NaN."""
    return choose(a < b, a, b)


def _transposed(builder, rows: list[Any]) -> list[Any]:
    """The columns of ROW rows of ROW: swapped within pairs, then between pairs, then between fours."""
    for step in (1, 2, 4):
        mixed = list(rows)
        for k in range(ROW):
            if k & step:
                continue
            a, b = rows[k], rows[k + step]
            low = [lane if not lane & step else lane - step + ROW for lane in range(ROW)]
            high = [lane + step if not lane & step else lane + ROW for lane in range(ROW)]
            mixed[k] = builder.shuffle_vector(a, b, _index(*low))
            mixed[k + step] = builder.shuffle_vector(a, b, _index(*high))
        rows = mixed
    return rows


def _transfer(gathers: bool):
    """Make `gather`, which copies numbers of runs into the lanes of rows, or `scatter`, which copies them back."""

    def operation(typing, array, offsets, first, rows, row):
        def emit(context, builder, signature, values):
            integers = context.make_array(offsets)(context, builder, values[1]).data
            for begin in range(0, WIDTH, ROW):
                places, lanes = [], []
                for k in range(ROW):
                    offset = builder.load(builder.gep(integers, [_INT(begin + k)]))
                    places.append(_at(context, builder, array, values[0], builder.add(offset, values[2]), _EIGHT))
                    of_row = builder.mul(builder.add(values[4], _INT(k)), _INT(WIDTH))
                    lanes.append(_at(context, builder, rows, values[3], builder.add(of_row, _INT(begin)), _EIGHT))
                of, to = (places, lanes) if gathers else (lanes, places)
                columns = _transposed(builder, [_loaded(builder, at) for at in of])
                for column, at in zip(columns, to, strict=True):
                    builder.store(column, at).align = 8
            return context.get_dummy_value()

        return types.void(array, offsets, types.intp, rows, types.intp), emit

    return intrinsic(operation)


# gather(array, offsets, first, rows, row): for each lane k, copy ROW numbers of an array, from place offsets[k] + first
# on, into that lane of ROW rows, from `row` on. With numbers copied one by one, a run would take a quarter longer.
gather = _transfer(gathers=True)
# scatter(array, offsets, first, rows, row): copy from the lanes of rows to the places of the array.
scatter = _transfer(gathers=False)
