"""Every scalar operation in C, on special values too, against its meaning in NumPy and JAX."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from export_systems import Library, needs_compiler

from twistax.scalar.graph import ScalarGraph
from twistax.scalar.primitives.entry import convert
from twistax.scalar.primitives.table import OPERATIONS
from twistax.scalar.program import ScalarProgram
from twistax.scalar.targets.c import c_type
from twistax.system.export.c_code import body
from twistax.system.export.programs import ExportedFunction, Port

SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, 2.0, -2.5, 7.0, -7.0, 1e-9, 300.7, -1e10, 1e30, np.inf, -np.inf, np.nan]
GRID = np.array(list(itertools.product(SPECIAL, SPECIAL)))
THIRD = np.resize([0.7, -3.0, np.nan, 5.0, np.inf], len(GRID))
COLUMNS = [GRID[:, 0], GRID[:, 1], THIRD]

#: On real numbers, on integers, on truth values.
BITS = ("and", "or", "xor", "not")
COMPARISONS = ("eq", "ne", "lt", "le", "gt", "ge")
WHOLE = ("add", "sub", "mul", "div", "neg", "abs", "sign", "rem", "max", "min", "clamp", *BITS, *COMPARISONS)
INTEGERS = [np.dtype(name) for name in ("int8", "uint8", "int32", "uint32", "int64", "uint64")]


class Sheet:
    """A C function of three real numbers that works many operations out, and what each should give."""

    def __init__(self, dtype: Any) -> None:
        self.dtype = np.dtype(dtype)
        self.g = ScalarGraph(dtype, checked=True)
        self.inputs = tuple(np.array([self.g.input(k, 0, self.dtype)]).reshape(()) for k in range(4))
        self.real = [int(self.inputs[k]) for k in (1, 2, 3)]
        self.rows: dict[str, int] = {}
        self.expected: dict[str, np.ndarray] = {}
        with np.errstate(all="ignore"):
            self.values = [c.astype(self.dtype) for c in COLUMNS]

    def add(self, name: str, node: int, expected: Any) -> None:
        self.rows[name] = node
        with np.errstate(all="ignore"):
            self.expected[name] = np.asarray(expected).astype(self.dtype)

    def found(self, folder: Path) -> dict[str, np.ndarray]:
        """All of them by C, a row for each point of the grid."""
        ports = [Port("t", "", ()), *(Port("x", name, ()) for name in "abc")]
        names = {ports[0]: "t", ports[1]: "x_a", ports[2]: "x_b", ports[3]: "x_c"}
        result = Port("rate", "all", (len(self.rows),))
        outputs = (np.array(list(self.rows.values())),)
        program = ScalarProgram(self.g, self.inputs, outputs, (self.dtype,))
        text = body(ExportedFunction("all", (result,), program, lambda *a: []), ports, {**names, result: "r"})
        real = c_type(self.dtype).name
        head = f"void all({real} t, const {real} *x_a, const {real} *x_b, const {real} *x_c, {real} *r)"
        source = folder / f"all_{self.dtype.name}.c"
        includes = "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n"
        source.write_text(f"{includes}{head};\n{head}\n{{\n{text}}}\n")
        library = Library(source, self.dtype)
        table = np.array(
            [library.call("all", [0.0, *row], [result.shape])[0] for row in zip(*self.values, strict=True)]
        )
        return dict(zip(self.rows, table.T, strict=True))


def compare(sheet: Sheet, folder: Path, rtol: float) -> None:
    for name, own in sheet.found(folder).items():
        at = ", ".join(f"{a}" for a in np.flatnonzero(~np.isclose(own, sheet.expected[name], rtol, 0.0, True))[:5])
        np.testing.assert_allclose(own, sheet.expected[name], rtol=rtol, atol=0.0, err_msg=f"{name} at {at}")


def test_every_operation_has_a_form() -> None:
    """On real numbers, or on truth values; `test_integers_and_conversions` names those of integers."""
    for operation in OPERATIONS.values():
        assert operation.c.boolean if operation.name in BITS else operation.c.real, operation


@needs_compiler
@pytest.mark.parametrize(("dtype", "rtol"), [(np.float64, 4e-15), (np.float32, 2e-6)])
def test_real_numbers(dtype: Any, rtol: float, tmp_path: Path) -> None:
    sheet = Sheet(dtype)
    g, (a, b, c), values = sheet.g, sheet.real, sheet.values
    less, more = g.node(OPERATIONS["lt"], a, b), g.node(OPERATIONS["ge"], b, c)
    truths = [values[0] < values[1], values[1] >= values[2]]
    with np.errstate(all="ignore"):
        for operation in OPERATIONS.values():
            if operation.name in BITS:
                pair = [less, more][: operation.arity]
                sheet.add(operation.name, g.node(operation, *pair), operation.number(*truths[: len(pair)]))
            elif operation.name == "select":
                sheet.add("select", g.node(operation, less, b, c), operation.number(truths[0], *values[1:]))
            else:
                n = operation.arity
                sheet.add(operation.name, g.node(operation, *(a, b, c)[:n]), operation.number(*values[:n]))
                if n == 2:
                    sheet.add(f"{operation.name} back", g.node(operation, c, a), operation.number(values[2], values[0]))
    compare(sheet, tmp_path, rtol)


@needs_compiler
def test_numbers_read_back_to_the_last_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    special = [0.1, -0.5, 1e-320, 1.7976931348623157e308, 5e-324, 3.0, 1 / 3, 123456.0, np.inf, -np.inf, np.nan]
    numbers = [*special, *rng.normal(size=50) * 10.0 ** rng.integers(-300, 300, 50)]
    for dtype in (np.float64, np.float32):
        sheet = Sheet(dtype)
        with np.errstate(all="ignore"):
            for k, number in enumerate(np.asarray(numbers).astype(dtype)):
                sheet.add(str(k), sheet.g.constant(number), np.full(len(GRID), number))
        compare(sheet, tmp_path, 0.0)


@needs_compiler
def test_integers_and_conversions(tmp_path: Path) -> None:
    """As XLA: whole parts kept in range, arithmetic that wraps around, no division by zero."""
    sheet = Sheet(np.float64)
    g, to_bool, to_int16 = sheet.g, convert(np.dtype(bool)), convert(np.dtype("int16"))
    cases = [
        (own, OPERATIONS[name])
        for own in INTEGERS
        for name in WHOLE
        if not (own.kind == "u" and name in ("neg", "abs"))
    ]

    def by_jax(*values: jax.Array) -> dict[str, jax.Array]:
        whole = {own: [convert(own).array(v) for v in values] for own in INTEGERS}
        found = {f"{own} {o.name}": o.array(*whole[own][: o.arity]) for own, o in cases}
        for own in INTEGERS:
            found |= {f"{own} {k}": whole[own][k] for k in range(3)}
            found |= {f"{own} to {o.name}": o.array(whole[own][0]) for o in (to_bool, to_int16)}
        return found

    expected = jax.jit(by_jax, compiler_options={"xla_backend_optimization_level": 0})(*sheet.values)
    for own in INTEGERS:
        nodes = [g.node(convert(own), x) for x in sheet.real]
        rows = {f"{own} {o.name}": g.node(o, *nodes[: o.arity]) for kind, o in cases if kind == own}
        rows |= {f"{own} {k}": node for k, node in enumerate(nodes)}
        rows |= {f"{own} to {o.name}": g.node(o, nodes[0]) for o in (to_bool, to_int16)}
        for name, node in rows.items():
            sheet.add(name, node, expected[name])
    compare(sheet, tmp_path, 0.0)
