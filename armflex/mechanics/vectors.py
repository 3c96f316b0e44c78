"""Vectors in compiled code: three numbers, each of them a double or a pack of doubles that the processor takes at once.

LLVM widens no loop over so few columns as a frame's six motions; a `Pack` is of a type of its own instead. Where a
processor has shorter registers it takes two of them.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba import extending, types
from numba.extending import models, overload, register_model

LOOSE = {"contract", "reassoc", "nsz", "arcp"}
inner = numba.njit(nogil=True, forceinline=True, error_model="numpy", fastmath=LOOSE)
called = numba.njit(nogil=True, error_model="numpy", fastmath=LOOSE)
bare = numba.njit(nogil=True, error_model="numpy", fastmath=LOOSE, _nrt=False)  # pyright: ignore[reportCallIssue]
"""For what makes no array: it need not count who holds one, which at every view costs as much as a few products."""
in_order = numba.njit(nogil=True, error_model="numpy", fastmath={"contract"})
"""For sums whose order matters."""

intrinsic: Any = extending.intrinsic  # whose first argument is numba's own

WIDE = 4
"""Doubles of a pack: more take longer to be loaded than they save."""
VECTOR = ir.VectorType(ir.DoubleType(), WIDE)
NUMBER = ir.IntType(32)


class _Pack(types.Type):
    def __init__(self) -> None:
        super().__init__("Pack")


Pack = _Pack()


@register_model(_Pack)
class _Model(models.PrimitiveModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, VECTOR)


def _place(context, builder, sig, args):
    start = context.make_array(sig.args[0])(context, builder, args[0]).data
    return builder.bitcast(builder.gep(start, [args[1]]), VECTOR.as_pointer())


@intrinsic
def pack(typing, array, start):
    """Return a pack of a contiguous array, whose numbers are counted through."""
    return Pack(array, types.intp), lambda *given: given[1].load(_place(*given), align=8)


@intrinsic
def put_pack(typing, array, start, value):
    """Put a pack into a contiguous array."""

    def made(context, builder, sig, args):
        builder.store(args[2], _place(context, builder, sig, args), align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, Pack), made


def _declare(sign: Callable, name: str) -> None:
    """Let packs be added to, subtracted from and multiplied with each other and numbers, which are for all of one."""

    @intrinsic
    def found(typing, a, b):
        def made(context, builder, sig, args):
            nothing, both = ir.Constant(VECTOR, ir.Undefined), []
            for kind, value in zip(sig.args, args, strict=True):
                if kind != Pack:
                    first = builder.insert_element(nothing, value, NUMBER(0))
                    value = builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(NUMBER, WIDE), [0] * WIDE))
                both.append(value)
            return getattr(builder, name)(*both, flags=sorted(LOOSE))

        return Pack(a, b), made

    @overload(sign)
    def declared(a, b):
        if Pack in (a, b) and {a, b} <= {Pack, types.float64}:
            return lambda a, b: found(a, b)
        return None


for _sign, _name in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul")):
    _declare(_sign, _name)


@inner
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inner
def plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inner
def minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inner
def times(share, a):
    return share * a[0], share * a[1], share * a[2]


@inner
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner
def three(array, start):
    """Return three numbers of an array."""
    return array[start], array[start + 1], array[start + 2]


@inner
def put(array, start, vector):
    array[start], array[start + 1], array[start + 2] = vector


@inner
def turned(turn, vector):
    """Return a (3, 3) rotation of a vector."""
    return dot(turn[0], vector), dot(turn[1], vector), dot(turn[2], vector)


@inner
def turned_back(turn, vector):
    """Return what a (3, 3) rotation makes this vector of."""
    return plus(times(vector[0], turn[0]), plus(times(vector[1], turn[1]), times(vector[2], turn[2])))


@inner
def columns(array, start, width):
    """Return a vector of packs: from three of an array's rows of a width."""
    return pack(array, start), pack(array, start + width), pack(array, start + 2 * width)


@inner
def add_columns(array, start, width, vector):
    """Add a vector of packs to three of an array's rows of a width."""
    for a in range(3):
        put_pack(array, start + a * width, pack(array, start + a * width) + vector[a])
