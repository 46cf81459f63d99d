"""The test main of C code: reference values by JAX, on arrays, and their comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...groups import Euclidean
from ..scalar.in_c import CType
from . import version
from .c_header import MARK
from .functions import ExportedFunction, Exporter, Port

__all__ = ["drawn_points", "test_main"]

#: One array for each argument.
Point = list[NDArray[Any]]


def drawn_points(exporter: Exporter, count: int = 3) -> list[Point]:
    """Arguments drawn at random: Exp of a normal tangent, normal entries, of parameters their own values."""
    rng = np.random.default_rng(0)
    groups = {state.name: state.group for state in exporter.dynamics.states}
    own = {p.name: p.value for p in exporter.dynamics.parameters}
    points = []
    with jax.enable_x64(True):
        for _ in range(count):
            point: Point = []
            for port in exporter.arguments:
                drawn = rng.normal(size=port.shape)
                group = groups.get(port.name) if port.kind == "x" else None
                if port.kind == "p" and own[port.name] is not None:
                    drawn = np.asarray(own[port.name], np.float64)
                elif group is not None and not isinstance(group, Euclidean):
                    drawn = np.asarray(group.exp(jnp.asarray(0.5 * rng.normal(size=group.dimension))))
                point.append(drawn)
            points.append(point)
    return points


def test_main(
    name: str,
    exporter: Exporter,
    functions: Sequence[ExportedFunction],
    names: Mapping[Port, str],
    real: CType,
    points: Sequence[Point],
    tolerance: float,
) -> str:
    """The text of a program that ends with 0 where all functions agree with their references."""
    points = [[_cast(v, real) for v in point] for point in points]
    data: list[str] = []
    steps: list[str] = []
    sizes = [port.size for function in functions for port in function.results]
    for function in functions:
        references = _references(function, points)
        # Brought to the code's numbers first: what is beyond their range is infinite there, and no measure.
        references = [[_cast(r, real) for r in result] for result in references]
        finite = np.concatenate([np.abs(r[np.isfinite(r)]) for result in references for r in result])
        allowed = real.literal(_cast(tolerance * float(finite.max(initial=0.0)), real)[()])
        for k, point in enumerate(points):
            given = []
            for port, value in zip(exporter.arguments, point, strict=True):
                if port.kind == "t":
                    given.append(real.literal(value[()]))
                    continue
                array = f"point_{k}_{names[port]}"
                if function is functions[0]:
                    data.append(_array(array, value, real))
                given.append(array)
            results = [f"found[{j}]" for j in range(len(function.results))]
            steps.append(f"{name}_{function.name}({', '.join([*given, *results])});")
            for j, (port, result) in enumerate(zip(function.results, references[k], strict=True)):
                array = f"expected_{k}_{function.name}_{names[port]}"
                data.append(_array(array, result, real))
                label = f"{function.name} {names[port]}, point {k + 1}"
                steps.append(f'failed += compare("{label}", found[{j}], {array}, {port.size}, {allowed});')
    widest = max(len(function.results) for function in functions)
    return f"""{MARK} {version()}: compares with values by JAX in double precision, on arrays.
 * Allowed is {tolerance:.0e} times the largest reference of the function. Ends with 0 where all agree.
 */
#include <math.h>
#include <stdio.h>

#include "{name}.h"

{"".join(data)}
static {real.name} found[{widest}][{max(sizes)}];

static int compare(const char *name, const {real.name} *own, const {real.name} *other, int n, {real.name} allowed)
{{
    {real.name} worst = {real.literal(0.0)};
    int bad = 0, k;
    for (k = 0; k < n; k++) {{
        if (isnan(other[k])) {{
            bad += !isnan(own[k]);
        }} else if (isinf(other[k])) {{
            bad += !isinf(own[k]) || (own[k] > {real.literal(0.0)}) != (other[k] > {real.literal(0.0)});
        }} else {{
            const {real.name} apart = fabs{real.suffix}(own[k] - other[k]);
            bad += !(apart <= allowed);
            worst = apart > worst ? apart : worst;
        }}
    }}
    printf("%-40s apart %.1e, allowed %.1e%s\\n", name, (double)worst, (double)allowed, bad ? "  WRONG" : "");
    return bad;
}}

int main(void)
{{
    int failed = 0;
    {"".join(f"{step}{chr(10)}    " for step in steps).rstrip()}
    printf(failed ? "%d entries are WRONG\\n" : "all agree\\n", failed);
    return failed ? 1 : 0;
}}
"""


def _references(function: ExportedFunction, points: Sequence[Point]) -> list[list[NDArray[Any]]]:
    """The results at every point, in double precision."""
    with jax.enable_x64(True):
        stacked = [jnp.stack([jnp.asarray(p[k], np.float64) for p in points]) for k in range(len(points[0]))]
        # Compiled once, for a few points: the compiler's optimisations would take longer than they save.
        run = jax.jit(jax.vmap(function.arrays), compiler_options={"xla_backend_optimization_level": 0})
        found = [np.asarray(r) for r in run(*stacked)]
    return [[np.asarray(result[k]) for result in found] for k in range(len(points))]


def _cast(values: Any, real: CType) -> NDArray[Any]:
    """As numbers of the code."""
    with np.errstate(over="ignore"):
        return np.asarray(values).astype(real.dtype)


def _array(name: str, values: NDArray[Any], real: CType) -> str:
    entries = [real.literal(v) for v in values.reshape(-1)]
    lines = [", ".join(entries[k : k + 6]) for k in range(0, len(entries), 6)]
    return f"static const {real.name} {name}[{len(entries)}] = {{\n    " + ",\n    ".join(lines) + "\n};\n"
