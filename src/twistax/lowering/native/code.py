"""Text of LLVM's intermediate language: instructions on vectors, one after the other."""

from __future__ import annotations

import itertools
import re
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from .processor import Processor

__all__ = ["Code", "Module", "NotNative", "addressed"]


class NotNative(Exception):
    """A program has no native form; the message says why."""


#: LLVM's names of vectors in the names of functions on them.
_SUFFIXES = {"double": "f64", "float": "f32"}


class Module:
    """What is compiled together: functions and what they declare."""

    def __init__(self, processor: Processor) -> None:
        self.processor = processor
        self.declarations: set[str] = set()
        self.functions: dict[str, str] = {}
        #: Functions of the C library that are called.
        self.library: set[str] = set()

    def text(self) -> str:
        bits = self.processor.bits
        vectors = f'"prefer-vector-width"="{bits}" "min-legal-vector-width"="{bits}"'
        attributes = [f"attributes #0 = {{ noinline nounwind {vectors} }}", "attributes #1 = { cold }"]
        attributes.append('!0 = !{!"branch_weights", i32 1, i32 2000}')
        return "\n".join([*sorted(self.declarations), *self.functions.values(), *attributes, ""])


class Code:
    """The instructions of one function, all vectors with the same number of lanes.

    Values are LLVM's names or constants, types are LLVM's names of the type of one lane.
    """

    def __init__(self, module: Module, lanes: int) -> None:
        self.module = module
        self.lanes = lanes
        self.lines: list[str] = []
        #: Angles of which sine and cosine are there.
        self.turned: dict[str, tuple[str, ...]] = {}
        self._count = 0

    def emit(self, instruction: str) -> str:
        """The value of an instruction."""
        name = self.name()
        self.lines.append(f"{name} = {instruction}")
        return name

    def name(self) -> str:
        """A name not used before."""
        self._count += 1
        return f"%v{self._count}"

    def label(self) -> str:
        """The name of a block that is yet to come."""
        return f"b{self.name()[1:]}"

    def vector(self, kind: str) -> str:
        """The type of a vector."""
        return f"<{self.lanes} x {kind}>"

    def constant(self, kind: str, value: Any) -> str:
        """A number in all lanes."""
        return f"splat ({kind} {_number(kind, value)})"

    # ---- instructions --------------------------------------------------------------------------------------------

    def binary(self, name: str, kind: str, a: str, b: str) -> str:
        return self.emit(f"{name} {self.vector(kind)} {a}, {b}")

    def call(self, name: str, kind: str, *arguments: str) -> str:
        """One of LLVM's own functions of vectors."""
        own = self.vector(kind)
        suffix = f"v{self.lanes}{_SUFFIXES.get(kind, kind)}"
        self.module.declarations.add(f"declare {own} @llvm.{name}.{suffix}({', '.join([own] * len(arguments))})")
        return self.emit(f"call {own} @llvm.{name}.{suffix}({', '.join(f'{own} {a}' for a in arguments)})")

    def convert(self, name: str, source: str, target: str, value: str) -> str:
        return self.emit(f"{name} {self.vector(source)} {value} to {self.vector(target)}")

    def select(self, kind: str, condition: str, a: str, b: str) -> str:
        own = self.vector(kind)
        return self.emit(f"select {self.vector('i1')} {condition}, {own} {a}, {own} {b}")

    def multiply_add(self, kind: str, a: str, b: str, c: str) -> str:
        """a b + c, with one rounding where the processor can."""
        if self.module.processor.fma:
            return self.call("fma", kind, a, b, c)
        return self.binary("fadd", kind, self.binary("fmul", kind, a, b), c)

    def polynomial(self, kind: str, x: str, coefficients: Sequence[float]) -> str:
        """c0 + c1 x + c2 x^2 + ..., by Horner's rule."""
        *rest, last = coefficients
        value = self.constant(kind, last)
        for c in reversed(rest):
            value = self.multiply_add(kind, value, x, self.constant(kind, c))
        return value

    def library(self, function: str, kind: str, *arguments: str) -> str:
        """A function of the C library, lane by lane."""
        name = f"lanes_{function}"
        if name not in self.module.functions:
            names = [f"%a{k}" for k in range(len(arguments))]
            inner = Code(self.module, self.lanes)
            result = inner.lane_by_lane(function, kind, names)
            own = self.vector(kind)
            self.module.functions[name] = inner.function(
                f"internal {own} @{name}({', '.join(f'{own} {a}' for a in names)})", f"ret {own} {result}"
            )
        own = self.vector(kind)
        return self.emit(f"call {own} @{name}({', '.join(f'{own} {a}' for a in arguments)})")

    def lane_by_lane(self, function: str, kind: str, arguments: Sequence[str]) -> str:
        """The calls that `library` is made of."""
        symbol = function if kind == "double" else f"{function}f"
        self.module.library.add(symbol)
        self.module.declarations.add(f"declare {kind} @{symbol}({', '.join([kind] * len(arguments))})")
        result, own = "poison", self.vector(kind)
        for lane in range(self.lanes):
            given = [self.emit(f"extractelement {own} {a}, i32 {lane}") for a in arguments]
            value = self.emit(f"call {kind} @{symbol}({', '.join(f'{kind} {a}' for a in given)})")
            result = self.emit(f"insertelement {own} {result}, {kind} {value}, i32 {lane}")
        return result

    def function(self, head: str, end: str = "ret void", attributes: str = "#0") -> str:
        """The instructions so far as a function."""
        return "\n".join([f"define {head} {attributes} {{", *self.lines, end, "}"])


def _number(kind: str, value: Any) -> str:
    if kind == "i1":
        return "true" if value else "false"
    if kind in ("i32", "i64"):
        return str(int(value))
    # LLVM writes both types as the bits of a double.
    with np.errstate(over="ignore"):
        exact = float(np.float32(value)) if kind == "float" else float(value)
    return f"0x{struct.unpack('<Q', struct.pack('<d', exact))[0]:016X}"


def addressed(text: str) -> str:
    """Text in which loads and stores have an offset in bytes, `ptr %a + 8`, as LLVM reads it."""
    count = itertools.count()

    def split(match: re.Match[str]) -> str:
        instruction, base, offset = match.groups()
        place = f"%place.{next(count)}"
        return f"{place} = getelementptr i8, ptr {base}, i64 {offset}\n{instruction}, ptr {place}"

    return re.sub(r"^(.*), ptr (%[\w.]+) \+ (\d+)$", split, text, flags=re.MULTILINE)
