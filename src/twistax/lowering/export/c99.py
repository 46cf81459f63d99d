"""C99 code of a compiled system: header, source, and a test main."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, ModelError
from ..functions import Functions
from ..scalar.entry import Operation
from ..scalar.in_c import CType, c_type, expression
from . import CFiles, version
from .c_header import MARK, declaration, defaults, header
from .c_names import checked_name, identifiers
from .c_test import Point, drawn_points, test_main
from .functions import ExportedFunction, Exporter, Port

__all__ = ["body", "write_c"]

#: Of references at which the test main gives up, relative to the largest one of a function.
_TOLERANCES = {"float64": 1e-10, "float32": 1e-4}


def write_c(
    dynamics: Functions,
    directory: str | Path,
    *,
    name: str,
    dtype: Any,
    jacobian: Sequence[str],
    checked: bool,
    points: Sequence[Sequence[Any]] | None,
    tolerance: float | None,
) -> CFiles:
    """What `Dynamics.to_c` does; it says what the arguments are."""
    name, real = checked_name(name), _real(dtype)
    exporter = Exporter(dynamics, real.dtype, checked)
    functions = _functions(exporter, jacobian)
    names = identifiers([*exporter.arguments, *dict.fromkeys(port for f in functions for port in f.results)])
    given = drawn_points(exporter) if points is None else [_point(exporter, each) for each in points]
    if not given:
        raise InputError("points expects at least one (t, x, u, params); left out, some are drawn")
    allowed = _TOLERANCES[real.dtype.name] if tolerance is None else tolerance
    if not 0.0 <= allowed < np.inf:
        raise InputError(f"tolerance expects a number that is not negative, got {allowed}")
    folder = Path(directory)
    files = CFiles(folder / f"{name}.h", folder / f"{name}.c", folder / f"{name}_test.c")
    texts = {
        files.header: header(name, exporter, functions, names, real),
        files.source: _source(name, exporter, functions, names, real),
        files.test: test_main(name, exporter, functions, names, real, given, allowed),
    }
    _write(folder, texts)
    return files


def _real(dtype: Any) -> CType:
    try:
        found = np.dtype(dtype)
    except TypeError:
        raise InputError(f"dtype expects float64 or float32, got {dtype!r}") from None
    if found.name not in _TOLERANCES:
        raise InputError(f"dtype expects float64 or float32, got {found.name}")
    return c_type(found)


def _functions(exporter: Exporter, jacobian: Sequence[str]) -> list[ExportedFunction]:
    wanted = [family for family, own in exporter.dynamics.families.items() if any(own.values())]
    found = [exporter.family(family) for family in wanted]
    if jacobian:
        if isinstance(jacobian, str):
            raise InputError(f"jacobian expects a sequence like ('x', 'u'), got {jacobian!r}")
        found.append(exporter.jacobian(jacobian))
    found = [function for function in found if function.results]
    if not found:
        raise ModelError("there is nothing to write: no result has an entry")
    return found


def _point(exporter: Exporter, point: Sequence[Any]) -> Point:
    """(t, x, u, params) as arrays in the order of the arguments; parameters may be left out."""
    if not isinstance(point, Sequence) or not 2 <= len(point) <= 4:
        raise InputError(f"points expects (t, x, u, params) each, the last two may be left out, got {point!r}")
    given: list[Any] = [*point, *([{}] * (4 - len(point)))]
    t, x, u, params = given
    inputs = exporter.dynamics.prepare(t, x, u, params, reads=("rates", "outputs", "constraints"))
    values = {"x": inputs.x, "u": inputs.u, "p": inputs.params}
    raw = {"x": x, "u": u or {}, "p": params or {}}
    found = [np.asarray(t, np.float64)]
    for port in exporter.arguments[1:]:
        value = raw[port.kind].get(port.name, values[port.kind].get(port.name))
        found.append(np.zeros(port.shape) if value is None else np.asarray(value, np.float64).reshape(port.shape))
    return found


def _source(
    name: str, exporter: Exporter, functions: Sequence[ExportedFunction], names: dict[Port, str], real: CType
) -> str:
    bodies = []
    for function in functions:
        head = declaration(name, function, exporter.arguments, names, real)
        bodies.append(f"{head}\n{{\n{body(function, exporter.arguments, names)}}}\n")
    constants = []
    for port, values in defaults(exporter):
        entries = ", ".join(real.literal(real.dtype.type(v)) for v in values)
        constants.append(f"const {real.name} {name}_default_{names[port]}[{port.size}] = {{{entries}}};\n")
    parts = [
        f'{MARK} {version()}. The call convention stands in {name}.h. */\n#include "{name}.h"\n\n'
        "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n",
        "".join(constants),
        *bodies,
    ]
    return "\n".join(part for part in parts if part)


def body(function: ExportedFunction, arguments: Sequence[Port], names: Mapping[Port, str]) -> str:
    """The lines of a function.

    Raises:
        ModelError: a type that C has not, or has no such operation of.
    """
    program, g = function.program, function.program.graph
    lines: list[str] = []
    used: set[int] = set()

    def entry(argument: int, place: int) -> str:
        used.add(argument)
        port = arguments[argument]
        return names[port] if port.kind == "t" else f"{names[port]}[{place}]"

    def computed(operation: Operation, node: int, *values: str) -> str:
        own, argument = c_type(g.dtypes[node]), c_type(g.dtypes[g.arguments(node)[-1]])
        lines.append(f"const {own.name} v{len(lines)} = {expression(operation, argument, own, values)};")
        return f"v{len(lines) - 1}"

    values = program.computed(entry, lambda value, dtype: c_type(dtype).literal(value), computed)
    unused = [f"(void){names[port]};" for k, port in enumerate(arguments) if k not in used]
    results = []
    real = c_type(g.dtype)
    for port, nodes in zip(function.results, program.outputs, strict=True):
        for k, i in enumerate(nodes.reshape(-1).tolist()):
            cast = "" if g.dtypes[i] == g.dtype else f"({real.name})"
            results.append(f"{names[port]}[{k}] = {cast}{values[i]};")
    return "".join(f"    {line}\n" for line in (*unused, *lines, *results))


def _write(folder: Path, texts: dict[Path, str]) -> None:
    """Files of an earlier call are replaced; others are left alone, and told."""
    try:
        for path in texts:
            if path.exists() and not path.read_text(errors="replace").startswith(MARK):
                raise InputError(
                    f"{str(path)!r} exists and was not written by twistax.\n  fix: move it, or give another name="
                )
        folder.mkdir(parents=True, exist_ok=True)
        for path, text in texts.items():
            path.write_text(text, encoding="ascii")
    except OSError as error:
        raise InputError(f"cannot write C code to {str(folder)!r}: {error}") from None
