"""Code in LLVM's intermediate language: instructions on vectors."""

from __future__ import annotations

import copy
import hashlib
import itertools
import re
import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...primitives.table_load import Table
from .elementary import exponential, exponential_less_one, hyperbolic_tangent, in_precision
from .machine_code import APART, Processor


class NotNative(Exception):
    """A program has no native form; the message says why."""


#: LLVM's names of the types that numbers may have.
NAMES: dict[np.dtype[Any], str] = {
    np.dtype(np.float64): "double",
    np.dtype(np.float32): "float",
    np.dtype(np.int64): "i64",
    np.dtype(np.int32): "i32",
    np.dtype(bool): "i1",
}

#: LLVM's names of vectors in the names of functions on them.
_SUFFIXES = {"double": "f64", "float": "f32"}


#: Pieces that are compiled together. Each group has memory of its own, and a process has only so many maps of memory.
_TOGETHER = 4


class Module:
    """A unit of compilation: functions and their declarations."""

    def __init__(self, processor: Processor) -> None:
        self.processor = processor
        self.declarations: set[str] = set()
        self.functions: dict[str, str] = {}
        #: Functions that the others call and that call none of them but helpers, by name: declarations, and texts.
        self.pieces: dict[str, tuple[str, str]] = {}
        #: Whether arrays are stored by columns: the first entries of all rows, then the second ones.
        self.by_columns = False
        #: Tables of numbers, by name.
        self.tables: dict[str, str] = {}
        #: Whether it is a long straight program, or writes much: higher levels of LLVM take time and gain nothing.
        self.long = False
        #: Whether exponentials, sines and the like are functions that are called: written at each place they take LLVM
        #: most of its time where there are many.
        self.calls = False
        #: Bits of vectors for equal operations within one member; 0: LLVM does not search for them.
        self.packed = 0
        #: Functions of the C library that are called.
        self.library: set[str] = set()
        #: The names of the functions of repeated programs.
        self.repeats: dict[Any, str] = {}
        #: The addresses of functions of other modules, and the code that they belong to.
        self.addresses: dict[str, int] = {}
        self.called: list[Any] = []

    def numbers(self, array: np.ndarray[Any, Any]) -> str:
        """The pointer to the numbers of an array, one after the other."""
        raw = np.ascontiguousarray(array).tobytes()
        name = f"@numbers.{hashlib.sha256(raw).hexdigest()[:24]}"
        if name not in self.tables:
            self.tables[name] = _constant(name, raw, 64)
        return name

    def text(self) -> str:
        """The text for `compiled`; groups of pieces stand apart, so that LLVM has one of them in memory at a time."""
        declarations, pieces = sorted(self.declarations), [text for _, text in self.pieces.values()]
        if not self.groups:
            return self._joined([*self.tables.values(), *declarations, *pieces, *self.functions.values()])
        called = [declaration for declaration, _ in self.pieces.values()]
        main = self._joined([*self.tables.values(), *declarations, *called, *self.functions.values()])
        groups = ([self.pieces[name][1] for name in names] for names in self.groups)
        return APART.join([main, *(self._joined([*self._helpers(g), *declarations, *g]) for g in groups)])

    @property
    def groups(self) -> list[list[str]]:
        """The names of pieces that are compiled together; none where one function of all is made."""
        names = [] if self.processor.triple else list(self.pieces)
        return [names[k : k + _TOGETHER] for k in range(0, len(names), _TOGETHER)]

    def _helpers(self, texts: Sequence[str]) -> list[str]:
        """The tables and functions that texts name, and those that these name."""
        known = self.tables | {f"@{name}": helper for name, helper in self.functions.items()}
        helpers: list[str] = []
        for part in itertools.chain(texts, helpers):
            named = [name for name in known if re.search(re.escape(name) + r"\b(?!\.)", part)]
            helpers += [known.pop(name) for name in named]
        return helpers

    def _joined(self, texts: Sequence[str]) -> str:
        bits = min(self.processor.bits, self.packed or self.processor.bits)
        vectors = (
            f' "prefer-vector-width"="{bits}" "min-legal-vector-width"="{bits}"' if not self.processor.triple else ""
        )
        attributes = [f'attributes #0 = {{ noinline nounwind "no-builtins"{vectors} }}']
        attributes.append('!0 = !{!"branch_weights", i32 1, i32 2000}')
        return "\n".join([*texts, *attributes, ""])


class Code:
    """The instructions of one function, all vectors with the same number of lanes.

    Values are LLVM's names or constants, types are LLVM's names of the type of one lane.
    """

    def __init__(self, module: Module, lanes: int) -> None:
        self.module = module
        self.lanes = lanes
        self.lines: list[str] = []
        #: Angles whose sine and cosine are computed.
        self.sines: dict[str, tuple[str, ...]] = {}
        self._numbers = itertools.count(1)

    def of(self, lanes: int) -> Code:
        """The same function, continued with vectors of another number of lanes."""
        code = copy.copy(self)
        code.lanes, code.sines = lanes, {}
        return code

    def emit(self, instruction: str) -> str:
        """The value of an instruction."""
        name = self.name()
        self.lines.append(f"{name} = {instruction}")
        return name

    def name(self) -> str:
        """A name not used before."""
        return f"%v{next(self._numbers)}"

    def label(self) -> str:
        """A new name of a block."""
        return f"b{self.name()[1:]}"

    def vector(self, kind: str) -> str:
        """The type of a vector; for one lane the type of a number."""
        return kind if self.lanes == 1 else f"<{self.lanes} x {kind}>"

    def suffix(self, kind: str) -> str:
        """The type in names of LLVM's functions."""
        suffix = _SUFFIXES.get(kind, kind)
        return suffix if self.lanes == 1 else f"v{self.lanes}{suffix}"

    def constant(self, kind: str, value: Any) -> str:
        """A number in all lanes."""
        number = _number(kind, value)
        return number if self.lanes == 1 else f"splat ({kind} {number})"

    def spread(self, kind: str, number: str) -> str:
        """A computed number in all lanes."""
        vector, zeros = self.vector(kind), self.vector("i32")
        first = self.emit(f"insertelement {vector} poison, {kind} {number}, i32 0")
        return self.emit(f"shufflevector {vector} {first}, {vector} poison, {zeros} zeroinitializer")

    def part(self, kind: str, vector: str, first: int, count: int) -> str:
        """Consecutive lanes of a vector; a number for one lane."""
        if count == 1:
            return self.entry(kind, vector, first)
        vector_type, order = self.vector(kind), ", ".join(f"i32 {k}" for k in range(first, first + count))
        return self.emit(f"shufflevector {vector_type} {vector}, {vector_type} poison, <{count} x i32> <{order}>")

    def entry(self, kind: str, vector: str, lane: int) -> str:
        """The number in a lane."""
        return vector if self.lanes == 1 else self.emit(f"extractelement {self.vector(kind)} {vector}, i32 {lane}")

    def put(self, kind: str, vector: str, lane: int, number: str) -> str:
        """The vector with another number in a lane."""
        vector_type = self.vector(kind)
        if self.lanes == 1:
            return number
        return self.emit(f"insertelement {vector_type} {vector}, {kind} {number}, i32 {lane}")

    # ---- instructions --------------------------------------------------------------------------------------------

    def instruction(self, name: str, kind: str, *arguments: str) -> str:
        """An instruction on one or two vectors of a type."""
        return self.emit(f"{name} {self.vector(kind)} {', '.join(arguments)}")

    def intrinsic(self, name: str, kind: str, *arguments: str) -> str:
        """An intrinsic function of LLVM, of vectors."""
        vector_type = self.vector(kind)
        return self.call(vector_type, f"llvm.{name}.{self.suffix(kind)}", *((vector_type, a) for a in arguments))

    def call(self, result: str, name: str, *arguments: tuple[str, str]) -> str:
        """A call of a function that is declared here, with values and their types."""
        self.module.declarations.add(f"declare {result} @{name}({', '.join(kind for kind, _ in arguments)})")
        text = f"call {result} @{name}({', '.join(f'{kind} {value}' for kind, value in arguments)})"
        if result != "void":
            return self.emit(text)
        self.lines.append(text)
        return ""

    def convert(self, name: str, source: str, target: str, value: str) -> str:
        return self.emit(f"{name} {self.vector(source)} {value} to {self.vector(target)}")

    def select(self, kind: str, condition: str, a: str, b: str) -> str:
        vector_type = self.vector(kind)
        return self.emit(f"select {self.vector('i1')} {condition}, {vector_type} {a}, {vector_type} {b}")

    # ---- operations on scalars, as the table names them ----------------------------------------------------------

    def turned(self, place: int, kind: str, x: str) -> str:
        """Sine (0) or cosine (1) of an angle whose sine and cosine are already computed."""
        return self.sines[x][place]

    def chosen(self, comparison: str, kind: str, a: str, b: str) -> str:
        """a where the comparison of a with b holds, else b."""
        return self.select(kind, self.instruction(comparison, kind, a, b), a, b)

    def further(self, comparison: str, kind: str, a: str, b: str) -> str:
        """The extreme of a and b; NaN where one of them is NaN."""
        first = self.chosen(comparison, kind, a, b)
        return self.select(kind, self.instruction("fcmp uno", kind, a, a), a, first)

    def sign(self, kind: str, x: str) -> str:
        """Zero, with its sign, and NaN as they are."""
        one = self.intrinsic("copysign", kind, self.constant(kind, 1.0), x)
        return self.select(kind, self.instruction("fcmp one", kind, x, self.constant(kind, 0.0)), one, x)

    def finite(self, kind: str, x: str) -> str:
        return self.instruction("fcmp olt", kind, self.intrinsic("fabs", kind, x), self.constant(kind, np.inf))

    def logistic(self, kind: str, x: str) -> str:
        one, exp = self.constant(kind, 1.0), self.exponential(kind, self.instruction("fneg", kind, x))
        return self.instruction("fdiv", kind, one, self.instruction("fadd", kind, one, exp))

    def exponential(self, kind: str, x: str) -> str:
        """e^x."""
        return self.called("exponential", kind, x, lambda code, x: in_precision(code, exponential, kind, x))

    def exponential_less_one(self, kind: str, x: str) -> str:
        """e^x - 1, also of small x."""
        return self.called("less_one", kind, x, lambda code, x: in_precision(code, exponential_less_one, kind, x))

    def hyperbolic_tangent(self, kind: str, x: str) -> str:
        """By e^(2 |x|) - 1."""
        return self.called("tangent", kind, x, lambda code, x: in_precision(code, hyperbolic_tangent, kind, x))

    def called(self, name: str, kind: str, x: str, formula: Callable[[Code, str], str]) -> str:
        """A formula of a number: written here, or once, as a function that is called here."""
        if not self.module.calls:
            return formula(self, x)
        name, vector = f"{name}.{self.suffix(kind)}", self.vector(kind)
        if name not in self.module.functions:
            inner = Code(self.module, self.lanes)
            result = formula(inner, "%x")
            text = inner.function(f"internal {vector} @{name}({vector} %x)", f"ret {vector} {result}")
            self.module.functions[name] = text
        return self.emit(f"call {vector} @{name}({vector} {x})")

    def negative(self, kind: str, x: str) -> str:
        return self.instruction("sub", kind, "zeroinitializer", x)

    def magnitude(self, kind: str, x: str) -> str:
        return self.chosen("icmp sgt", kind, x, self.negative(kind, x))

    def integer_sign(self, kind: str, x: str) -> str:
        below = self.instruction("ashr", kind, x, self.constant(kind, 31 if kind == "i32" else 63))
        above = self.instruction("icmp sgt", kind, x, "zeroinitializer")
        return self.instruction("or", kind, below, self.convert("zext", "i1", kind, above))

    def inverted(self, ones: Any, kind: str, x: str) -> str:
        """All bits the other way; `ones` is the number of which all are set."""
        return self.instruction("xor", kind, x, self.constant(kind, ones))

    def converted(self, dtype: np.dtype[Any], kind: str, x: str) -> str:
        """To a type, as JAX does: to the nearest integer that there is, and to truth where it is not zero."""
        target, real = NAMES[dtype], kind in _SUFFIXES
        if kind == target:
            return x
        if target == "i1":
            return self.instruction("fcmp une" if real else "icmp ne", kind, x, "zeroinitializer")
        if real and target not in _SUFFIXES:
            name = f"llvm.fptosi.sat.{self.suffix(target)}.{self.suffix(kind)}"
            return self.call(self.vector(target), name, (self.vector(kind), x))
        if target in _SUFFIXES:
            wider = "fpext" if target == "double" else "fptrunc"
            return self.convert(wider if real else "uitofp" if kind == "i1" else "sitofp", kind, target, x)
        return self.convert("zext" if kind == "i1" else "sext" if target == "i64" else "trunc", kind, target, x)

    def table_load(self, table: Table, offset: int, dtype: np.dtype[Any], kind: str, place: str) -> str:
        """table[place + offset], lane by lane: LLVM's gather took a third longer on the one that was measured."""
        target = NAMES[dtype]
        name = f"@{table.name}.{target}"
        if name not in self.module.tables:
            self.module.tables[name] = _constant(name, table.numbers(dtype).tobytes(), dtype.itemsize)
        values = "poison"
        for lane in range(self.lanes):
            one = self.entry(kind, place, lane)
            there = self.emit(f"getelementptr {target}, ptr {name}, {kind} {one}")
            there = self.emit(f"getelementptr {target}, ptr {there}, i64 {offset}") if offset else there
            value = self.emit(f"load {target}, ptr {there}, align {dtype.itemsize}")
            values = self.put(target, values, lane, value)
        return values

    # ---- several at once -----------------------------------------------------------------------------------------

    def multiply_add(self, kind: str, a: str, b: str, c: str) -> str:
        """a b + c, with one rounding where the processor can."""
        if self.module.processor.fma:
            return self.intrinsic("fma", kind, a, b, c)
        return self.instruction("fadd", kind, self.instruction("fmul", kind, a, b), c)

    def loop(self, carried: Sequence[tuple[str, str, str]]) -> Callable[[Sequence[str], str], None]:
        """Begin a loop that runs at least once; its values afterwards are those of the last iteration.

        Args:
            carried: names, their types, and their values the first time.
        Returns:
            what ends it, given the values of the next time and whether there is one.
        """
        before, head, latch, done = (self.label() for _ in range(4))
        self.lines += [f"br label %{before}", f"{before}:", f"br label %{head}", f"{head}:"]
        start = len(self.lines)

        def end(following: Sequence[str], more: str) -> None:
            self.lines += [f"br label %{latch}", f"{latch}:", f"br i1 {more}, label %{head}, label %{done}", f"{done}:"]
            self.lines[start:start] = [
                f"{name} = phi {kind} [ {first}, %{before} ], [ {new}, %{latch} ]"
                for (name, kind, first), new in zip(carried, following, strict=True)
            ]

        return end

    def any(self, flags: str) -> str:
        """Whether a truth value holds in any lane."""
        if self.lanes == 1:
            return flags
        return self.call("i1", f"llvm.vector.reduce.or.{self.suffix('i1')}", (self.vector("i1"), flags))

    def polynomial(self, kind: str, x: str, coefficients: Sequence[float]) -> str:
        """c0 + c1 x + c2 x^2 + ..., by Horner's rule."""
        *rest, last = coefficients
        value = self.constant(kind, last)
        for c in reversed(rest):
            value = self.multiply_add(kind, value, x, self.constant(kind, c))
        return value

    def library(self, function: str, kind: str, *arguments: str) -> str:
        """A function of the C library, lane by lane."""
        name, vector_type = f"lanes_{function}.{self.suffix(kind)}", self.vector(kind)
        if name not in self.module.functions:
            symbol = function if kind == "double" else f"{function}f"
            self.module.library.add(symbol)
            names, inner, result = [f"%a{k}" for k in range(len(arguments))], Code(self.module, self.lanes), "poison"
            for lane in range(self.lanes):
                operands = [(kind, inner.entry(kind, a, lane)) for a in names]
                value = inner.call(kind, symbol, *operands)
                result = inner.put(kind, result, lane, value)
            head = f"internal {vector_type} @{name}({', '.join(f'{vector_type} {a}' for a in names)})"
            self.module.functions[name] = inner.function(head, f"ret {vector_type} {result}")
        return self.emit(f"call {vector_type} @{name}({', '.join(f'{vector_type} {a}' for a in arguments)})")

    def function(self, head: str, end: str = "ret void") -> str:
        """The instructions so far as a function."""
        return "\n".join([f"define {head} #0 {{", *self.lines, end, "}"])


def _constant(name: str, raw: bytes, aligned: int) -> str:
    """Numbers by their bytes: LLVM reads those many times faster than numbers."""
    digits = "\\" + raw.hex("\\") if raw else ""
    return f'{name} = private unnamed_addr constant [{len(raw)} x i8] c"{digits}", align {aligned}'


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
    """LLVM code from text in which loads and stores have an offset in bytes, `ptr %a + 8`."""
    count = itertools.count()

    def split(match: re.Match[str]) -> str:
        instruction, base, offset = match.groups()
        place = f"%place.{next(count)}"
        return f"{place} = getelementptr i8, ptr {base}, i64 {offset}\n{instruction}, ptr {place}"

    return re.sub(r"^(.*), ptr (%[\w.]+) \+ (\d+)$", split, text, flags=re.MULTILINE)
