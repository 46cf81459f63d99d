"""C99 files of a compiled system: header and source by `c_code.py`, and a test program with reference values."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...checks import number, path_of
from ...errors import InputError, ModelError
from ...progress import watching
from ...scalar.targets.c import CType, c_type
from ..functions import Functions
from . import CFiles
from .c_code import MARK, CCode, filled, identifiers, mark, numbers
from .programs import ExportedFunction, Exporter

#: One array for each argument.
Point = list[NDArray[Any]]

#: Of references at which the test main gives up, relative to the largest one of a function.
_TOLERANCES = {"float64": 1e-10, "float32": 1e-4}

#: Headers of C99, which a header of that name would hide.
_STANDARD = (
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdarg stdbool stddef "
    "stdint stdio stdlib string tgmath time wchar wctype"
)


@watching("export")
def write_c(
    dynamics: Functions,
    directory: str | Path,
    *,
    name: str,
    dtype: Any,
    jacobian: Sequence[str],
    step: Callable[..., Mapping[str, Any]] | None,
    checked: bool,
    points: Sequence[Sequence[Any]] | None,
    tolerance: float | None,
) -> CFiles:
    """Implements `Dynamics.to_c`, which documents the arguments."""
    check_name(name)
    exporter = Exporter(dynamics, real_type(dtype).dtype, checked, loops=True)
    functions = _functions(exporter, jacobian, step)
    return write_functions(exporter, functions, directory, name=name, points=points, tolerance=tolerance)


def write_functions(
    exporter: Exporter,
    functions: Sequence[ExportedFunction],
    directory: str | Path,
    *,
    name: str,
    points: Sequence[Sequence[Any]] | None,
    tolerance: float | None,
) -> CFiles:
    """Write the files of functions. Arguments are those of `write_c`."""
    check_name(name)
    real = real_type(exporter.dtype)
    of_functions = dict.fromkeys(port for f in functions for port in (*f.extra, *f.results))
    names = identifiers([*exporter.arguments, *of_functions])
    chosen_points = _drawn_points(exporter) if points is None else [_point(exporter, point) for point in points]
    if not chosen_points:
        raise InputError("points expects at least one (t, x, u, params).\n  fix: leave points out for random ones")
    allowed = _TOLERANCES[real.dtype.name] if tolerance is None else tolerance
    number("tolerance", allowed, "a finite number that is not negative", lambda size: 0.0 <= size < np.inf)
    folder, code = path_of("directory", directory), CCode(name, exporter, functions, names, real)
    files = CFiles(folder / f"{name}.h", folder / f"{name}.c", folder / f"{name}_test.c")
    test = _test_main(code, chosen_points, allowed)
    texts = {files.header: code.header(), files.source: code.source(), files.test: test}
    write_files(folder, texts)
    return files


def check_name(name: str) -> None:
    """Raise InputError for a name that C files cannot have."""
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise InputError(f"name expects a letter, then letters, digits and underscores, got {name!r}")
    if name.lower() in _STANDARD.split():
        raise InputError(f"name expects a name that no C header has, got {name!r}: {name.lower()}.h is a header of C")


def real_type(dtype: Any) -> CType:
    """The type in C of a user's dtype.

    Raises:
        InputError: neither double nor single precision.
    """
    try:
        numpy_type = np.dtype(dtype)
    except TypeError:
        raise InputError(f"dtype expects float64 or float32, got {dtype!r}") from None
    if numpy_type.name not in _TOLERANCES:
        raise InputError(f"dtype expects float64 or float32, got {numpy_type.name}")
    return c_type(numpy_type)


def _functions(exporter: Exporter, jacobian: Sequence[str], step: Any) -> list[ExportedFunction]:
    functions = [exporter.family(family) for family, exprs in exporter.dynamics.families.items() if any(exprs.values())]
    if jacobian:
        if isinstance(jacobian, str):
            raise InputError(f"jacobian expects a sequence like ('x', 'u'), got {jacobian!r}")
        functions.append(exporter.jacobian(jacobian))
    if step is not None:
        functions.append(exporter.step(step))
    functions = [function for function in functions if function.results]
    if not functions:
        raise ModelError("there is nothing to write: no result has an entry")
    return functions


def write_files(folder: Path, texts: dict[Path, str]) -> None:
    """Write the files. Files of an earlier call are replaced; other files raise an error."""
    try:
        for path in texts:
            if path.exists() and not path.read_text(errors="replace").startswith(MARK):
                raise InputError(
                    f"{str(path)!r} exists and was not written by twistax.\n  fix: move it, or pass another name="
                )
        folder.mkdir(parents=True, exist_ok=True)
        for path, text in texts.items():
            path.write_text(text, encoding="ascii")
    except OSError as error:
        raise InputError(f"cannot write C code to {str(folder)!r}: {error}.\n  fix: pass a writable folder") from None


# ---- the test main ---------------------------------------------------------------------------------------------------


def _point(exporter: Exporter, point: Sequence[Any]) -> Point:
    """(t, x, u, params) as arrays in the order of the arguments; parameters may be left out."""
    if not isinstance(point, Sequence) or not 2 <= len(point) <= 4:
        raise InputError(f"points expects tuples (t, x, u, params), of which the last two are optional, got {point!r}")
    t, x, u, params = [*point, None, None][:4]
    inputs = exporter.dynamics.prepare(t, x, u, params, reads=("rates", "outputs", "constraints"))
    # As they were given where they were: prepared ones may be of single precision.
    values = {"x": {**inputs.x, **x}, "u": {**inputs.u, **(u or {})}, "params": {**inputs.params, **(params or {})}}
    return [
        np.asarray(t, np.float64),
        *(
            np.asarray(values[port.kind].get(port.name, np.zeros(port.shape)), np.float64).reshape(port.shape)
            for port in exporter.arguments[1:]
        ),
    ]


def _drawn_points(exporter: Exporter, count: int = 3) -> list[Point]:
    """Random arguments: Exp of a normal tangent, normal entries, defaults of parameters."""
    rng = np.random.default_rng(0)
    groups = {state.name: state.group for state in exporter.dynamics.states}
    defaults = {p.name: p.value for p in exporter.dynamics.parameters}
    points = []
    with jax.enable_x64(True):
        for _ in range(count):
            point: Point = []
            for port in exporter.arguments:
                drawn = rng.normal(size=port.shape)
                group = groups.get(port.name) if port.kind == "x" else None
                if port.kind == "params" and defaults[port.name] is not None:
                    drawn = np.asarray(defaults[port.name], np.float64)
                elif group is not None and not group.flat:
                    drawn = np.asarray(group.exp(jnp.asarray(0.5 * rng.normal(size=group.dimension))))
                point.append(drawn)
            points.append(point)
    return points


def _test_main(code: CCode, points: Sequence[Point], tolerance: float) -> str:
    """The text of a program that ends with 0 where all functions agree with their references."""
    real, names = code.real, code.names
    points = [[_cast(v, real) for v in point] for point in points]
    data: list[str] = []
    steps: list[str] = []
    inputs = []
    for k, point in enumerate(points):
        arrays = {f"point_{k}_{names[port]}": v for port, v in zip(code.exporter.arguments[1:], point[1:], strict=True)}
        data += [numbers(name, values, real) for name, values in arrays.items()]
        inputs.append([real.literal(point[0][()]), *arrays])
    for function in code.functions:
        # Brought to the code's numbers first: what is beyond their range is infinite there, and no measure.
        references = [[_cast(r, real) for r in reference] for reference in _references(function, points)]
        finite = np.concatenate([np.abs(r[np.isfinite(r)]) for reference in references for r in reference])
        allowed = real.literal(_cast(tolerance * float(finite.max(initial=0.0)), real)[()])
        results = [f"found[{j}]" for j in range(len(function.results))]
        trials = []
        for port, value in zip(function.extra, function.trial, strict=True):
            array = f"trial_{function.name}_{names[port]}"
            trials.append(real.literal(_cast(value, real)[()]) if port.by_value else array)
            data += [] if port.by_value else [numbers(array, _cast(value, real), real)]
        for k, arguments in enumerate(inputs):
            steps.append(f"{code.name}_{function.name}({', '.join([*arguments, *trials, *results])});")
            for result, port, reference in zip(results, function.results, references[k], strict=True):
                array = f"expected_{k}_{function.name}_{names[port]}"
                data.append(numbers(array, reference, real))
                label = f"{function.name} {names[port]}, point {k + 1}"
                steps.append(f'failed += compare("{label}", {result}, {array}, {port.size}, {allowed});')
    widest = max(len(function.results) for function in code.functions)
    longest = max(port.size for function in code.functions for port in function.results)
    return filled(
        "test_main.c.in",
        mark=mark(),
        tolerance=f"{tolerance:.0e}",
        name=code.name,
        real=real.name,
        data="".join(data),
        widest=widest,
        longest=longest,
        zero=real.literal(0.0),
        fabs=f"fabs{real.suffix}",
        steps="\n    ".join(steps),
    )


def _references(function: ExportedFunction, points: Sequence[Point]) -> list[list[NDArray[Any]]]:
    """The results at every point, in double precision."""
    with jax.enable_x64(True):
        stacked: list[Any] = [
            jnp.stack([jnp.asarray(v, np.float64) for v in values]) for values in zip(*points, strict=True)
        ]
        repeated = [jnp.asarray(value, np.float64) for value in function.trial]
        stacked += [jnp.broadcast_to(value, (len(points), *value.shape)) for value in repeated]
        # Compiled once, for a few points: the compiler's optimisations would take longer than they save.
        run = jax.jit(jax.vmap(function.arrays), compiler_options={"xla_backend_optimization_level": 0})
        results = [np.asarray(r) for r in run(*stacked)]
    return [[np.asarray(result[k]) for result in results] for k in range(len(points))]


def _cast(values: Any, real: CType) -> NDArray[Any]:
    with np.errstate(over="ignore"):
        return np.asarray(values).astype(real.dtype)
