"""Sine and cosine of vectors.

x = k pi/2 + r with |r| <= pi/4 (W. J. Cody and W. Waite, Software Manual for the Elementary Functions, 1980): products
of k with pieces of pi/2 are subtracted one after the other, so that what cancels is exact. Polynomials in r as in
FDLIBM (Sun Microsystems, 1993; k_sin.c, k_cos.c), of single precision as in Cephes (S. L. Moshier, 1989; sinf.c).
Below 2 units in the last place up to the largest angle; beyond, and for what is not finite, the C library is called.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from fractions import Fraction

from .code import Code
from .elementary import DOUBLE, SINGLE, Precision, computed_in

#: In radians.
LARGEST = 1e9
#: The same where k has few bits.
_LARGEST_SINGLE = 1e5

_SINE = {
    "double": (
        -1.66666666666666324348e-01,
        8.33333333332248946124e-03,
        -1.98412698298579493134e-04,
        2.75573137070700676789e-06,
        -2.50507602534068634195e-08,
        1.58969099521155010221e-10,
    ),
    "float": (-1.6666654611e-01, 8.3321608736e-03, -1.9515295891e-04),
}
_COSINE = {
    "double": (
        4.16666666666666019037e-02,
        -1.38888888888741095749e-03,
        2.48015872894767294178e-05,
        -2.75573143513906633035e-07,
        2.08757232129817482790e-09,
        -1.13596475577881948265e-11,
    ),
    "float": (4.166664568298827e-02, -1.388731625493765e-03, 2.443315711809948e-05),
}

#: pi / 2, 188 bits behind the point.
_QUARTER_TURN = Fraction(0x1921FB54442D18469898CC51701B839A252049C1114CF98E, 2**188)


def _pieces(count: int, bits: int) -> list[float]:
    """Numbers of so many bits whose sum is pi / 2. None is negative, or sin(-0.0) would lose its sign."""
    rest, pieces = _QUARTER_TURN, []
    for _ in range(count):
        unit = Fraction(2) ** (math.frexp(float(rest))[1] - bits)
        pieces.append(float(rest // unit * unit))
        rest -= Fraction(pieces[-1])
    return pieces


#: With one rounding in a b + c, k times a piece need not be exact.
_FUSED = {"double": _pieces(3, 53), "float": _pieces(3, 24)}
#: Without, k of up to 30 bits times a piece of 23 is.
_EXACT = _pieces(6, 23)


def sines_and_cosines(code: Code, kind: str, angles: Sequence[str]) -> list[tuple[str, ...]]:
    """The values of sin x and cos x of several angles."""
    return [_called(code, kind, x) for x in angles] if code.module.calls else _written(code, kind, angles)


def _called(code: Code, kind: str, x: str) -> tuple[str, ...]:
    """By a function of one angle."""
    vector, name = code.vector(kind), f"turned.{code.suffix(kind)}"
    pair = f"{{ {vector}, {vector} }}"
    if name not in code.module.functions:
        inner = Code(code.module, code.lanes)
        ((sine, cosine),) = _written(inner, kind, ["%x"])
        one = inner.emit(f"insertvalue {pair} poison, {vector} {sine}, 0")
        both = inner.emit(f"insertvalue {pair} {one}, {vector} {cosine}, 1")
        head = f"internal {pair} @{name}({vector} %x)"
        code.module.functions[name] = inner.function(head, f"ret {pair} {both}")
    turned = code.emit(f"call {pair} @{name}({vector} {x})")
    return tuple(code.emit(f"extractvalue {pair} {turned}, {k}") for k in range(2))


def _written(code: Code, kind: str, angles: Sequence[str]) -> list[tuple[str, ...]]:
    """One branch for all, in case that one of them is far."""
    precision, vector_type = computed_in(code, kind), code.vector(kind)
    largest = code.constant(kind, LARGEST if precision is DOUBLE else _LARGEST_SINGLE)
    near: list[tuple[str, ...]] = []
    far: list[str] = []
    for x in angles:
        # Not "greater": so that NaN is among them.
        size = code.intrinsic("fabs", kind, x)
        far.append(code.emit(f"fcmp ugt {vector_type} {size}, {largest}"))
        pair = _near(code, precision, x if kind == precision.kind else code.convert("fpext", kind, precision.kind, x))
        if kind != precision.kind:
            pair = tuple(code.convert("fptrunc", precision.kind, kind, value) for value in pair)
        near.append(pair)
    return _with_far(code, kind, angles, near, far)


def _near(code: Code, precision: Precision, x: str) -> tuple[str, ...]:
    d, rounding = precision.kind, code.constant(precision.kind, precision.rounding)
    shifted = code.multiply_add(d, x, code.constant(d, 2.0 / math.pi), rounding)
    k = code.instruction("fsub", d, shifted, rounding)
    quadrant = code.convert("bitcast", d, precision.integer, shifted)
    r = x
    for piece in _FUSED[d] if precision is SINGLE or code.module.processor.fma else _EXACT:
        r = code.multiply_add(d, k, code.constant(d, -piece), r)
    square = code.instruction("fmul", d, r, r)
    cube = code.instruction("fmul", d, r, square)
    sine = code.multiply_add(d, cube, code.polynomial(d, square, _SINE[d]), r)
    sine = code.intrinsic("copysign", d, sine, r)  # of zero
    # 1 - r^2 / 2 with what its rounding leaves.
    one, minus_half = code.constant(d, 1.0), code.constant(d, -0.5)
    high = code.multiply_add(d, square, minus_half, one)
    low = code.multiply_add(d, square, minus_half, code.instruction("fsub", d, one, high))
    fourth = code.instruction("fmul", d, square, square)
    low = code.multiply_add(d, fourth, code.polynomial(d, square, _COSINE[d]), low)
    cosine = code.instruction("fadd", d, high, low)
    one_bit = code.constant(precision.integer, 1)
    lowest = code.instruction("and", precision.integer, quadrant, one_bit)
    odd = code.emit(f"icmp ne {code.vector(precision.integer)} {lowest}, zeroinitializer")
    return (
        _signed(code, precision, code.select(d, odd, cosine, sine), quadrant),
        _signed(
            code,
            precision,
            code.select(d, odd, sine, cosine),
            code.instruction("add", precision.integer, quadrant, one_bit),
        ),
    )


def _signed(code: Code, precision: Precision, value: str, quadrant: str) -> str:
    """The opposite in quadrants 2 and 3."""
    bits = 63 if precision is DOUBLE else 31
    sign = code.instruction("and", precision.integer, quadrant, code.constant(precision.integer, 2))
    sign = code.instruction("shl", precision.integer, sign, code.constant(precision.integer, bits - 1))
    pattern = code.convert("bitcast", precision.kind, precision.integer, value)
    return code.convert(
        "bitcast", precision.integer, precision.kind, code.instruction("xor", precision.integer, pattern, sign)
    )


def _with_far(
    code: Code, kind: str, angles: Sequence[str], near: Sequence[tuple[str, ...]], far: Sequence[str]
) -> list[tuple[str, ...]]:
    """In lanes that are far the values of the C library, in a branch that is hardly ever taken."""
    taken = code.any(functools.reduce(functools.partial(code.instruction, "or", "i1"), far))
    here, beyond, after = code.label(), code.label(), code.label()
    code.lines += [f"br label %{here}", f"{here}:", f"br i1 {taken}, label %{beyond}, label %{after}, !prof !0"]
    code.lines.append(f"{beyond}:")
    exact = [
        [
            code.select(kind, mask, code.library(f, kind, x), value)
            for f, value in zip(("sin", "cos"), pair, strict=True)
        ]
        for x, pair, mask in zip(angles, near, far, strict=True)
    ]
    code.lines += [f"br label %{after}", f"{after}:"]
    vector_type = code.vector(kind)
    return [
        tuple(
            code.emit(f"phi {vector_type} [ {value}, %{here} ], [ {other}, %{beyond} ]")
            for value, other in zip(values, exact_values, strict=True)
        )
        for values, exact_values in zip(near, exact, strict=True)
    ]
