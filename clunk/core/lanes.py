"""Eight floats side by side, in one register where the processor has such: what a compiler does not find by itself.

The exact method's sums run over the few coordinates of one driveline, too short for a compiler's vector loops. No
operation here rounds otherwise than its eight scalar ones, or reorders a sum: every processor gives the same bits.

Lanes are loaded from, and stored to, rows of eight numbers of a contiguous array.
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

WIDTH = 8
Lanes = Any  # what mypy is told of them

_ROW = ir.VectorType(ir.DoubleType(), WIDTH)
_ANY = ir.Constant(_ROW, ir.Undefined)
_INT = ir.IntType(64)


class LanesType(types.Type):
    """numba's type of eight lanes."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")


@register_model(LanesType)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, of: Any) -> None:
        super().__init__(manager, of, _ROW)  # type: ignore[no-untyped-call]


_LANES = LanesType()


def _operation(code: Callable[..., Any]) -> Any:
    """What numba inserts as it stands; its first argument, the typing context, is not the caller's."""
    return intrinsic(code)


def _index(*lanes: int) -> ir.Constant:
    return ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), list(lanes))


def _splat(builder: Any, x: Any) -> Any:
    return builder.shuffle_vector(builder.insert_element(_ANY, x, ir.IntType(32)(0)), _ANY, _index(*[0] * WIDTH))


def _at(context: Any, builder: Any, array: Any, value: Any, first: Any) -> Any:
    """A pointer to eight numbers of an array."""
    data = context.make_array(array)(context, builder, value).data
    return builder.bitcast(builder.gep(data, [first]), _ROW.as_pointer())


def _loaded(builder: Any, pointer: Any) -> Any:
    lanes = builder.load(pointer)
    lanes.align = 8
    return lanes


@_operation
def load(typing: Any, array: Any, row: Any) -> Any:
    """A row of an array."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        first = builder.mul(values[1], _INT(WIDTH))
        return _loaded(builder, _at(context, builder, signature.args[0], values[0], first))

    return _LANES(array, types.intp), emit


@_operation
def load_from(typing: Any, array: Any, first: Any) -> Any:
    """Eight numbers of an array, from any one on."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return _loaded(builder, _at(context, builder, signature.args[0], *values))

    return _LANES(array, types.intp), emit


@_operation
def number(typing: Any, array: Any, k: Any) -> Any:
    """An element of an array, k not negative."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, values[0]).data
        return builder.load(builder.gep(data, [values[1]]))

    return types.float64(array, types.intp), emit


@_operation
def store(typing: Any, array: Any, row: Any, lanes: Any) -> Any:
    """Write a row of an array."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        first = builder.mul(values[1], _INT(WIDTH))
        builder.store(values[2], _at(context, builder, signature.args[0], values[0], first)).align = 8
        return context.get_dummy_value()

    return types.void(array, types.intp, _LANES), emit


@_operation
def splat(typing: Any, x: Any) -> Any:
    """The same number in all lanes."""
    return _LANES(types.float64), lambda context, builder, signature, values: _splat(builder, values[0])


@_operation
def plus(typing: Any, a: Any, b: Any) -> Any:
    """a + b."""
    return _LANES(_LANES, _LANES), lambda context, builder, signature, values: builder.fadd(*values)


@_operation
def times(typing: Any, a: Any, b: Any) -> Any:
    """a b, lane by lane."""
    return _LANES(_LANES, _LANES), lambda context, builder, signature, values: builder.fmul(*values)


@_operation
def plus_times(typing: Any, a: Any, b: Any, x: Any) -> Any:
    """a + b x with one number x."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fadd(values[0], builder.fmul(values[1], _splat(builder, values[2])))

    return _LANES(_LANES, _LANES, types.float64), emit


@_operation
def swapped(typing: Any, a: Any) -> Any:
    """The first four lanes after the last four."""
    half = [*range(WIDTH // 2, WIDTH), *range(WIDTH // 2)]
    return _LANES(_LANES), lambda context, builder, signature, values: builder.shuffle_vector(
        values[0], _ANY, _index(*half)
    )


@_operation
def root(typing: Any, a: Any) -> Any:
    """Square roots."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kind = ir.FunctionType(_ROW, [_ROW])
        name = f"llvm.sqrt.v{WIDTH}f64"
        function = cgutils.get_or_insert_function(builder.module, kind, name)  # type: ignore[no-untyped-call]
        return builder.call(function, values)

    return _LANES(_LANES), emit


@_operation
def lane(typing: Any, a: Any, k: Any) -> Any:
    """One lane."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.extract_element(*values)

    return types.float64(_LANES, types.intp), emit


@_operation
def larger(typing: Any, a: Any, b: Any) -> Any:
    """The larger of two, lane by lane; b where either is NaN."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">", *values), *values)

    return _LANES(_LANES, _LANES), emit


@_operation
def smaller(typing: Any, a: Any, b: Any) -> Any:
    """The smaller of two, lane by lane; b where either is NaN."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", *values), *values)

    return _LANES(_LANES, _LANES), emit


def _leading(builder: Any, mask: Any) -> Any:
    """How many lanes from the first on are true."""
    failing = builder.zext(builder.not_(builder.bitcast(mask, ir.IntType(WIDTH))), _INT)
    return builder.cttz(builder.or_(failing, _INT(1 << WIDTH)), ir.IntType(1)(1))


@_operation
def both_positive(typing: Any, a: Any, b: Any, h: Any, rest: Any) -> Any:
    """How many lanes from the first on have a > 0, b > 0 and h <= rest."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        zero = ir.Constant(_ROW, [0.0] * WIDTH)
        within = builder.fcmp_ordered("<=", values[2], _splat(builder, values[3]))
        first, second = (builder.fcmp_ordered(">", value, zero) for value in values[:2])
        return _leading(builder, builder.and_(builder.and_(first, second), within))

    return types.int64(_LANES, _LANES, _LANES, types.float64), emit


@_operation
def either_below(typing: Any, a: Any, b: Any) -> Any:
    """How many lanes from the first on have a <= 0 or b < 0."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        zero = ir.Constant(_ROW, [0.0] * WIDTH)
        either = (builder.fcmp_ordered(sign, value, zero) for sign, value in zip(("<=", "<"), values, strict=True))
        return _leading(builder, builder.or_(*either))

    return types.int64(_LANES, _LANES), emit
