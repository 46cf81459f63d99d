"""The header of C code: the call convention, and what is declared."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from ...groups import Euclidean
from ..scalar.in_c import CType
from . import version
from .c_names import comment
from .functions import ExportedFunction, Exporter, Port

__all__ = ["MARK", "declaration", "defaults", "header"]

#: How every file begins, by which files that may be replaced are known.
MARK = "/* Written by twistax"


def header(
    name: str, exporter: Exporter, functions: Sequence[ExportedFunction], names: Mapping[Port, str], real: CType
) -> str:
    """The text of the header."""
    prototypes = "\n".join(f"{declaration(name, f, exporter.arguments, names, real)};\n" for f in functions)
    constants = "".join(
        f"extern const {real.name} {name}_default_{names[port]}[{port.size}];\n" for port, _ in defaults(exporter)
    )
    guard = f"{name}_H"  # as written: in C, names that differ in case differ
    return f"""{MARK} {version()}. Do not edit: write it anew with to_c.
 *
 * x' = f(t, x, u, p) with numbers of type {real.name}: C99, no allocation, no state, nothing but libm.
 *
 * Call convention
 *   Every array is a pointer to its entries, read row by row; a scalar is an array of one entry, the time a value.
 *   Arguments come first and are only read; results follow and are written whole, zeros too. A result must not
 *   overlap an argument or another result. All functions take the same arguments; what one does not read is ignored.
 *   Units are those of the arguments: nothing is converted.
 *   Compile without -ffast-math where infinities or NaN may occur.
 *
 * Arguments, in this order
{_listed(exporter, exporter.arguments, names)}
{_results(exporter, functions, names)} */
#ifndef {guard}
#define {guard}

#ifdef __cplusplus
extern "C" {{
#endif

{_own_values(constants)}{prototypes}
#ifdef __cplusplus
}}
#endif

#endif
"""


def declaration(
    name: str, function: ExportedFunction, arguments: Sequence[Port], names: Mapping[Port, str], real: CType
) -> str:
    """The head of a function, without what follows it."""
    listed = [f"{real.name} t" if port.kind == "t" else f"const {real.name} *{names[port]}" for port in arguments]
    listed += [f"{real.name} *{names[port]}" for port in function.results]
    return f"void {name}_{function.name}(\n    " + ",\n    ".join(listed) + ")"


def defaults(exporter: Exporter) -> list[tuple[Port, list[float]]]:
    """The parameters that have values of their own, and these, row by row."""
    values = {p.name: p.value for p in exporter.dynamics.parameters if p.value is not None}
    return [
        (port, [float(v) for v in values[port.name].reshape(-1)])
        for port in exporter.arguments
        if port.kind == "p" and port.name in values and port.size
    ]


def _own_values(constants: str) -> str:
    return f"/* The parameters' own values, to pass where no others are wanted. */\n{constants}\n" if constants else ""


def _listed(exporter: Exporter, ports: Sequence[Port], names: Mapping[Port, str]) -> str:
    width = max(len(names[port]) for port in ports)
    shapes = [_shape(port.shape) for port in ports]
    room = max(map(len, shapes))
    return "\n".join(
        f" *   {names[port]:<{width}}  {shape:<{room}}  {_meaning(exporter, port)}".rstrip()
        for port, shape in zip(ports, shapes, strict=True)
    )


def _shape(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape)) if shape else "1"


def _meaning(exporter: Exporter, port: Port) -> str:
    name = comment(port.name)
    if port.kind == "x":
        group = next(s.group for s in exporter.dynamics.states if s.name == port.name)
        return f"state {name}" + ("" if isinstance(group, Euclidean) else f", an element of {comment(group.name)}")
    if port.kind == "rate":
        group = next(s.group for s in exporter.dynamics.states if s.name == port.name)
        return f"rate of {name}" + ("" if isinstance(group, Euclidean) else ", a body velocity")
    return {
        "t": "time",
        "u": f"control {name}",
        "p": f"parameter {name}",
        "output": f"output {name}",
        "constraint": {"inequality": "what must be <= 0", "equality": "what must be = 0"}.get(port.name, ""),
        "jacobian": f"by {_COLUMNS.get(port.name, '')}",
    }[port.kind]


_COLUMNS = {
    "x": "right perturbations of the states, x (+) d = x Exp(d)",
    "u": "entries of the controls",
    "params": "entries of the parameters",
}


def _results(exporter: Exporter, functions: Sequence[ExportedFunction], names: Mapping[Port, str]) -> str:
    parts = []
    for function in functions:
        parts.append(
            f" *\n * Results of {function.name}, in this order\n{_listed(exporter, function.results, names)}\n"
        )
        if function.name == "jacobian":
            rows = ", ".join(comment(state.name) for state in exporter.dynamics.states)
            places = sum(math.prod(port.shape) for port in function.results)
            written = sum(int((nodes != function.program.graph.zero).sum()) for nodes in function.program.outputs)
            parts.append(
                f" *   Rows: the rates of {rows}, one after the other, entries row by row; columns likewise, in the\n"
                f" *   order of the arguments. {written} of {places} entries may differ from zero.\n"
            )
    return "".join(parts)
