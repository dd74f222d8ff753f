"""Vectors of bytes for numba: the few operations that explicit kernels need, as LLVM vector instructions.

Loops over few lanes are vectorised badly or not at all, so `compiled.cells` says which lanes go together. A `Lanes(n)`
is LLVM's ``<n x i8>``; LLVM splits it into registers of whatever the processor has (AVX-512, AVX2, SSE, NEON), so the
results are the same everywhere, to the bit. All lanes are unsigned.

A register in memory is an item of an array whose items are n bytes (`in_registers`), so that n is part of the array's
type. `load` and `store` do not check bounds.

Beware: numba's cache on disk notices changes of the file that holds a kernel, not of this one. After editing this file,
touch the kernels' file (installers write all files of a new version, so users need nothing).
"""

import operator
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.extending import register_model
from numba.np.arrayobj import make_array
from numpy.typing import NDArray

BYTE = ir.IntType(8)
WORD = ir.IntType(32)
SMALLEST = 16
"""Bytes of the smallest vector register of any processor that has them."""
intrinsic: Any = extending.intrinsic


class Lanes(types.Type):
    """Numba's type of n unsigned bytes in a register."""

    def __init__(self, n: int) -> None:
        self.n = n
        super().__init__(f"Lanes({n})")


@register_model(Lanes)
class LanesModel(models.PrimitiveModel):
    """A `Lanes` is an LLVM vector, in registers and in memory."""

    def __init__(self, dmm: Any, fe_type: Lanes) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(BYTE, fe_type.n))


def in_registers(lanes: NDArray[np.uint8]) -> NDArray[np.void]:
    """Return (..., n) bytes as (...) items of n bytes, without a copy, for `load` and `store`."""
    return lanes.view(_register(lanes.shape[-1]))[..., 0]


@cache
def _register(n: int) -> np.dtype[np.void]:
    """Return one record type per size: numba knows those again that it has seen, and no other items of n bytes."""
    return np.dtype([("lanes", np.uint8, (n,))])


def _constant(n: int, values: Any) -> ir.Constant:
    return ir.Constant(ir.VectorType(BYTE, n), [int(v) for v in values])


def _splat(builder: ir.IRBuilder, value: ir.Value, n: int) -> ir.Value:
    """Return a register with a value in each of its n lanes, whatever its kind."""
    vector = ir.VectorType(value.type, n)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, WORD(0))
    return builder.shuffle_vector(
        first, ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(WORD, n), [0] * n)
    )


def _halves(builder: ir.IRBuilder, lanes: ir.Value, n: int) -> list[ir.Value]:
    """Return the first n lanes of a register, and the n after them."""
    places = [ir.Constant(ir.VectorType(WORD, n), list(range(i, i + n))) for i in (0, n)]
    return [builder.shuffle_vector(lanes, lanes, place) for place in places]


def _call_llvm(builder: ir.IRBuilder, name: str, n: int, *args: ir.Value, result: Any = None) -> ir.Value:
    """Return LLVM's intrinsic function `name` of registers of n lanes; `result` is a register too unless given."""
    vector = ir.VectorType(BYTE, n)
    kind = ir.FunctionType(result or vector, [vector] * len(args))
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{n}i8"), args)


def _address(context: Any, builder: ir.IRBuilder, signature: Any, args: Any, n: int) -> ir.Value:
    """Return the address of item (i, j) of a two-dimensional C array as a pointer to n lanes."""
    array = make_array(signature.args[0])(context, builder, args[0])
    i, j = (
        context.cast(builder, value, kind, types.intp)
        for value, kind in zip(args[1:3], signature.args[1:3], strict=True)
    )
    row_bytes = cgutils.unpack_tuple(builder, array.strides, 2)[0]
    offset = builder.add(builder.mul(i, row_bytes), builder.mul(j, array.itemsize))
    start = builder.gep(builder.bitcast(array.data, BYTE.as_pointer()), [offset])
    return builder.bitcast(start, ir.VectorType(BYTE, n).as_pointer())


def _is_grid(array: Any, item: Any) -> bool:
    return isinstance(array, types.Array) and array.ndim == 2 and isinstance(array.dtype, item)


@intrinsic
def load(typing: Any, cells: Any, i: Any, j: Any) -> Any:
    """Return item (i, j) of a two-dimensional array of registers."""
    if not _is_grid(cells, types.Record):
        return None
    lanes = Lanes(cells.dtype.size)

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(_address(context, builder, signature, args, lanes.n), align=1)

    return lanes(cells, i, j), build


@intrinsic
def store(typing: Any, cells: Any, i: Any, j: Any, lanes: Any) -> Any:
    """Write item (i, j) of a two-dimensional array of registers, or n bytes from (i, j) on of one of bytes."""
    if not (_is_grid(cells, types.Record) or _is_grid(cells, types.Integer)) or not isinstance(lanes, Lanes):
        return None

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.store(args[3], _address(context, builder, signature, args, lanes.n), align=1)
        return context.get_dummy_value()

    return types.void(cells, i, j, lanes), build


@intrinsic
def load_bytes(typing: Any, image: Any, i: Any, j: Any, like: Any) -> Any:
    """Return as many bytes as `like` has lanes, from (i, j) on, of a two-dimensional array of bytes."""
    if not _is_grid(image, types.Integer) or not isinstance(like, Lanes):
        return None

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(_address(context, builder, signature, args, like.n), align=1)

    return like(image, i, j, like), build


@intrinsic(prefer_literal=True)
def zeros(typing: Any, n: Any) -> Any:
    """Return n lanes of 0; n is a literal number."""
    if not isinstance(n, types.IntegerLiteral):
        return None
    lanes = Lanes(n.literal_value)

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _constant(lanes.n, [0] * lanes.n)

    return lanes(n), build


@intrinsic
def splat(typing: Any, byte: Any, like: Any) -> Any:
    """Return a register like `like` with `byte` in every lane."""
    if not isinstance(byte, types.Integer) or not isinstance(like, Lanes):
        return None

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _splat(builder, context.cast(builder, args[0], signature.args[0], types.uint8), like.n)

    return like(byte, like), build


@intrinsic
def lane_numbers(typing: Any, like: Any) -> Any:
    """Return 0, 1, 2 ... in a register like `like`."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _constant(like.n, range(like.n))

    return like(like), build


def _call(name: str) -> Any:
    """Return an intrinsic of two registers that is LLVM's function `name`."""

    def operation(typing: Any, a: Any, b: Any) -> Any:
        def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return _call_llvm(builder, name, a.n, *args)

        return (a(a, b), build) if isinstance(a, Lanes) and a == b else None

    operation.__name__ = operation.__qualname__ = name.replace(".", "_")
    return intrinsic(operation)


minimum = _call("umin")
maximum = _call("umax")
add = _call("uadd.sat")
"""a + b, at most 255."""
subtract = _call("usub.sat")
"""a - b, at least 0."""


def _instruction(name: str) -> Any:
    """Return an intrinsic of two registers that is an instruction of LLVM."""

    def operation(typing: Any, a: Any, b: Any) -> Any:
        def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return getattr(builder, name)(*args)

        return (a(a, b), build) if isinstance(a, Lanes) and a == b else None

    operation.__name__ = operation.__qualname__ = name
    return intrinsic(operation)


both = _instruction("and_")
either = _instruction("or_")
differing = _instruction("xor")
wrapping_subtract = _instruction("sub")
"""a - b modulo 256."""


@intrinsic
def equal(typing: Any, a: Any, b: Any) -> Any:
    """Return 255 where both are equal, and 0 elsewhere."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.sext(builder.icmp_unsigned("==", *args), args[0].type)

    return (a(a, b), build) if isinstance(a, Lanes) and a == b else None


@intrinsic
def select(typing: Any, mask: Any, a: Any, b: Any) -> Any:
    """Return a where the mask is not 0, and b elsewhere."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        chosen = builder.icmp_unsigned("!=", args[0], ir.Constant(args[0].type, [0] * mask.n))
        return builder.select(chosen, args[1], args[2])

    return (a(mask, a, b), build) if isinstance(a, Lanes) and mask == a == b else None


@intrinsic
def count_bits(typing: Any, a: Any) -> Any:
    """Return how many bits of each lane are set."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _call_llvm(builder, "ctpop", a.n, *args)

    return (a(a), build) if isinstance(a, Lanes) else None


@intrinsic
def least(typing: Any, a: Any) -> Any:
    """Return the least of all lanes, a byte."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lanes, n = args[0], a.n
        while n > SMALLEST and n % 2 == 0:
            n //= 2
            lanes = _call_llvm(builder, "umin", n, *_halves(builder, lanes, n))
        if n == SMALLEST and "+sse4.1" in context.codegen().magic_tuple()[2].split(","):
            return _least_by_phminposuw(builder, lanes)
        return _call_llvm(builder, "vector.reduce.umin", n, lanes, result=BYTE)

    return (types.uint8(a), build) if isinstance(a, Lanes) else None


def _least_by_phminposuw(builder: ir.IRBuilder, lanes: ir.Value) -> ir.Value:
    """Return the least of 16 bytes by the one instruction that x86 has for it, which LLVM finds only at times."""
    pairs = ir.VectorType(ir.IntType(16), 8)
    words = builder.bitcast(lanes, pairs)
    # The upper byte's partner is 0, so words hold the lesser of their two bytes.
    high = builder.bitcast(builder.lshr(words, ir.Constant(pairs, [8] * 8)), lanes.type)
    bytes_ = builder.bitcast(_call_llvm(builder, "umin", SMALLEST, lanes, high), pairs)
    kind = ir.FunctionType(pairs, [pairs])
    function = cgutils.get_or_insert_function(builder.module, kind, "llvm.x86.sse41.phminposuw")
    return builder.trunc(builder.extract_element(builder.call(function, [bytes_]), WORD(0)), BYTE)


@intrinsic
def first_equal(typing: Any, a: Any, b: Any) -> Any:
    """Return the first lane in which both are equal, or the number of lanes if none is."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        mask = builder.bitcast(builder.icmp_unsigned("==", *args), ir.IntType(a.n))
        lane = builder.cttz(mask, ir.Constant(ir.IntType(1), 0))
        wide = ir.IntType(64)
        if a.n < 64:
            return builder.zext(lane, wide)
        return builder.trunc(lane, wide) if a.n > 64 else lane

    return (types.int64(a, b), build) if isinstance(a, Lanes) and a == b else None


@intrinsic(prefer_literal=True)
def shift_up(typing: Any, a: Any, by: Any) -> Any:
    """Move every lane up by a literal number of lanes; 255 comes in below."""
    return _shift(a, by, 1)


@intrinsic(prefer_literal=True)
def shift_down(typing: Any, a: Any, by: Any) -> Any:
    """Move every lane down by a literal number of lanes; 255 comes in above."""
    return _shift(a, by, -1)


@intrinsic
def reverse(typing: Any, a: Any) -> Any:
    """Return the lanes in reverse order."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        mask = ir.Constant(ir.VectorType(WORD, a.n), list(range(a.n))[::-1])
        return builder.shuffle_vector(args[0], args[0], mask)

    return (a(a), build) if isinstance(a, Lanes) else None


def _shift(a: Any, by: Any, sign: int) -> Any:
    if not isinstance(a, Lanes) or not isinstance(by, types.IntegerLiteral):
        return None
    n, lanes = a.n, np.arange(a.n)
    sources = lanes - sign * by.literal_value
    # What comes in keeps its place within 16 lanes, so that one instruction can move it together with its neighbours.
    sources = np.where((sources < 0) | (sources >= n), n + sources % SMALLEST, sources)

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        mask = ir.Constant(ir.VectorType(WORD, a.n), [int(s) for s in sources])
        return builder.shuffle_vector(args[0], _constant(a.n, [255] * a.n), mask)

    return a(a, by), build


@intrinsic(prefer_literal=True)
def last(typing: Any, a: Any, n: Any) -> Any:
    """Return the last n lanes; n is a literal number."""
    if not isinstance(a, Lanes) or not isinstance(n, types.IntegerLiteral):
        return None
    top = Lanes(n.literal_value)

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        mask = ir.Constant(ir.VectorType(WORD, top.n), list(range(a.n - top.n, a.n)))
        return builder.shuffle_vector(args[0], args[0], mask)

    return top(a, n), build


class Reals(types.Type):
    """Numba's type of n single-precision numbers in a register; `+`, `-` and `*` work lane by lane."""

    def __init__(self, n: int) -> None:
        self.n = n
        super().__init__(f"Reals({n})")


@register_model(Reals)
class RealsModel(models.PrimitiveModel):
    """`Reals` are an LLVM vector, in registers and in memory."""

    def __init__(self, dmm: Any, fe_type: Reals) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(ir.FloatType(), fe_type.n))


EIGHT = Reals(8)


@intrinsic
def load_reals(typing: Any, plane: Any, i: Any, j: Any) -> Any:
    """Return the eight numbers from (i, j) on, of a two-dimensional C array of float32."""
    if not _is_grid(plane, types.Float):
        return None

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        start = _address(context, builder, signature, args, EIGHT.n)
        return builder.load(builder.bitcast(start, context.get_value_type(EIGHT).as_pointer()), align=4)

    return EIGHT(plane, i, j), build


@intrinsic
def store_reals(typing: Any, plane: Any, i: Any, j: Any, reals: Any) -> Any:
    """Write eight numbers to (i, j) and on, of a two-dimensional C array of float32."""
    if not _is_grid(plane, types.Float) or reals != EIGHT:
        return None

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        start = _address(context, builder, signature, args, EIGHT.n)
        builder.store(args[3], builder.bitcast(start, context.get_value_type(EIGHT).as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(plane, i, j, reals), build


@intrinsic
def eight(typing: Any, number: Any) -> Any:
    """Return a register with `number` in each of its eight lanes."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        one = context.cast(builder, args[0], signature.args[0], types.float32)
        return _splat(builder, one, EIGHT.n)

    return EIGHT(number), build


@intrinsic
def reals_of(typing: Any, lanes: Any) -> Any:
    """Return eight bytes as numbers."""
    if not isinstance(lanes, Lanes) or lanes.n != EIGHT.n:
        return None

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        whole = builder.zext(args[0], ir.VectorType(WORD, EIGHT.n))
        return builder.sitofp(whole, context.get_value_type(EIGHT))

    return EIGHT(lanes), build


@intrinsic
def total(typing: Any, reals: Any) -> Any:
    """Return the sum of all lanes."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lanes, n = args[0], reals.n
        while n > 1:
            n //= 2
            lanes = builder.fadd(*_halves(builder, lanes, n))
        return builder.extract_element(lanes, WORD(0))

    return (types.float32(reals), build) if isinstance(reals, Reals) else None


@intrinsic
def lesser(typing: Any, a: Any, b: Any) -> Any:
    """Return the lesser of each two lanes."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", *args), *args)

    return (a(a, b), build) if isinstance(a, Reals) and a == b else None


def _arithmetic(operation: Any, name: str) -> None:
    """Make an operator of Python LLVM's instruction `name`, free to be contracted with others."""

    def lowered(typing: Any, a: Any, b: Any) -> Any:
        def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return getattr(builder, name)(*args, flags=("contract",))

        return (a(a, b), build) if isinstance(a, Reals) and a == b else None

    lowered.__name__ = lowered.__qualname__ = name
    instruction = intrinsic(lowered)

    @extending.overload(operation)
    def _(a, b):  # type: ignore[no-untyped-def]  # numba compares the parameters of both
        return (lambda a, b: instruction(a, b)) if isinstance(a, Reals) and a == b else None


_arithmetic(operator.add, "fadd")
_arithmetic(operator.sub, "fsub")
_arithmetic(operator.mul, "fmul")
_arithmetic(operator.truediv, "fdiv")
