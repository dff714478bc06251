"""Named tuples by reference, in compiled functions.

numba passes a named tuple by value: each number and each field of each array in it is an argument, some 600 for a
workspace, in every call. A reference to the tuple is a single argument, and has the tuple's attributes; an attribute
that is a named tuple is a reference too. Results are the same, and the exact method has a sixth of the code to compile
(23 instead of 142 MB of LLVM code).
"""

from collections.abc import Callable
from typing import TypeVar, cast

import numpy as np
from llvmlite import ir
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import intrinsic, lower_getattr_generic, models, register_model, types

from clunk.core.arrays import IntArray

Tuple = TypeVar("Tuple")


class Reference(types.Type):
    """The type of a reference to a named tuple."""

    def __init__(self, of) -> None:
        self.of = of
        super().__init__(name=f"Reference({of})")

    def field(self, name: str):
        """The position and the type of one of the tuple's fields."""
        index = self.of.fields.index(name)
        return index, tuple(self.of)[index]


@register_model(Reference)
class _Model(models.PrimitiveModel):
    def __init__(self, manager, reference: Reference) -> None:
        super().__init__(manager, reference, cgutils.voidptr_t)


@infer_getattr
class _Attributes(AttributeTemplate):
    key = Reference

    def generic_resolve(self, reference: Reference, name: str):
        if name not in reference.of.fields:
            return None
        _, field = reference.field(name)
        return Reference(field) if isinstance(field, types.BaseNamedTuple) else field


@lower_getattr_generic(Reference)
def _attribute(context, builder: ir.IRBuilder, reference: Reference, pointer, name: str):
    index, field = reference.field(name)
    values = builder.bitcast(pointer, context.get_value_type(reference.of).as_pointer())
    at = cgutils.gep_inbounds(builder, values, 0, index)
    if isinstance(field, types.BaseNamedTuple):
        return builder.bitcast(at, cgutils.voidptr_t)
    return impl_ret_borrowed(context, builder, field, _load(builder, at))


def _load(builder: ir.IRBuilder, at):
    """Load a value part by part, each marked as never changing, so that it stays in its register across stores."""
    pointee = at.type.pointee
    if isinstance(pointee, (ir.LiteralStructType, ir.ArrayType)):
        value = ir.Constant(pointee, ir.Undefined)
        for k in range(len(pointee)):
            value = builder.insert_value(value, _load(builder, cgutils.gep_inbounds(builder, at, 0, k)), k)
        return value
    value = builder.load(at)
    value.set_metadata("invariant.load", builder.module.add_metadata([]))
    return value


def _refer(context, builder: ir.IRBuilder, signature, arguments):
    at = builder.bitcast(cgutils.alloca_once_value(builder, arguments[0]), cgutils.voidptr_t)
    # LLVM knows nothing of the pointer that this empty code returns, so it moves no load ahead of the values' stores.
    opaque = ir.FunctionType(cgutils.voidptr_t, [cgutils.voidptr_t])
    return builder.asm(opaque, "", "=r,0,~{memory}", [at], side_effect=True)


@intrinsic
def _reference(_, values):
    if isinstance(values, Reference):
        return values(values), lambda context, builder, signature, arguments: arguments[0]
    return Reference(values)(values), _refer


@intrinsic
def _reference_at(_, rows, k, like):
    def emit(context, builder: ir.IRBuilder, signature, arguments):
        array, first = context.make_array(rows)(context, builder, arguments[0]), context.get_constant(types.intp, 0)
        at = cgutils.get_item_pointer(context, builder, rows, array, [arguments[1], first])
        return builder.bitcast(at, cgutils.voidptr_t)

    return like(rows, types.intp, like), emit


def rows_of(values, each) -> IntArray:
    """D named tuples of numbers and arrays, one a row, as machine words in the layout of compiled functions.

    The tuples differ in the arrays to which `each`, a tuple of the same type, gives one more axis, of D, in front: row
    k has `each.NAME[k]`. All else is as in `values`, the tuple of row 0. Rows hold bare pointers, so that the arrays
    have to outlive them.

    Returns (D, words) int64.
    """
    words: list[int] = []
    places, strides = [], []  # places of the pointers that differ from row to row, and the differences in bytes
    for field, array in zip(values, each, strict=True):
        if isinstance(field, np.ndarray):  # as numba lays out an array; the first two words, its owner, are null
            if array.ndim > field.ndim:
                places.append(len(words) + 4)
                strides.append(array.strides[0])
            words += [0, 0, field.size, field.itemsize, field.ctypes.data, *field.shape, *field.strides]
        else:
            words.append(field)
    rows = np.tile(np.array(words), (len(each[0]), 1))
    rows[:, places] += np.outer(np.arange(len(rows)), strides)
    return rows


# A reference to a named tuple, valid in the compiled function to which the tuple was passed.
refer = cast(Callable[[Tuple], Tuple], _reference)
# A reference to the tuple in row k of `rows_of`, of the same type as another reference.
reference_at = cast(Callable[[IntArray, int, Tuple], Tuple], _reference_at)
