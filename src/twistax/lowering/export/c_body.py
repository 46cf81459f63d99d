"""A scalar program as the body of a C function."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .c_forms import written
from .c_types import c_type
from .functions import ExportedFunction, Port

__all__ = ["body"]


def body(
    function: ExportedFunction, arguments: Sequence[Port], names: Mapping[Port, str]
) -> tuple[str, dict[str, str]]:
    """The lines of a function, and the helpers that they call, by name.

    Raises:
        ModelError: a type that C has not.
    """
    program, g = function.program, function.program.graph
    values: dict[int, str] = {}
    lines: list[str] = []
    helpers: dict[str, str] = {}
    used: set[int] = set()
    for i in program.live:
        place, operation, own = g.input_of(i), g.operation(i), c_type(g.dtypes[i])
        if place is not None:
            used.add(place[0])
            port = arguments[place[0]]
            values[i] = names[port] if port.kind == "t" else f"{names[port]}[{place[1]}]"
        elif operation is None:
            values[i] = own.literal(g.numbers[i])
        else:
            read = g.arguments(i)
            form = written(operation, own, [c_type(g.dtypes[a]) for a in read], [values[a] for a in read])
            helpers.update(form.helpers)
            values[i] = f"v{len(lines)}"
            lines.append(f"const {own.name} {values[i]} = {form.text};")
    unused = [f"(void){names[port]};" for k, port in enumerate(arguments) if k not in used]
    results = []
    real = c_type(g.dtype)
    for port, nodes in zip(function.results, program.outputs, strict=True):
        for k, i in enumerate(nodes.reshape(-1).tolist()):
            cast = "" if g.dtypes[i] == g.dtype else f"({real.name})"
            results.append(f"{names[port]}[{k}] = {cast}{values[i]};")
    return "".join(f"    {line}\n" for line in (*unused, *lines, *results)), helpers
