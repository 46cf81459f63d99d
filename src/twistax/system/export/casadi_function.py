"""A compiled system as a CasADi function."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...errors import InputError, ModelError
from ...progress import watching
from ...scalar.primitives.entry import Operation
from ..functions import Functions
from .programs import ExportedFunction, Exporter, Port


@watching("export")
def to_casadi(dynamics: Functions, families: str | Sequence[str], name: str, checked: bool) -> Any:
    """Implements `Dynamics.to_casadi`, which documents the arguments."""
    try:
        import casadi
    except ImportError as error:
        raise ModelError(f"to_casadi needs CasADi ({error}).\n  fix: pip install 'twistax[casadi]'") from None
    exporter = Exporter(dynamics, np.float64, checked)
    if not casadi.Function.check_name(name):
        raise InputError(f"name expects letters, digits and single underscores, as CasADi does, got {name!r}")
    named: list[Any] = list(families) if isinstance(families, (tuple, list)) else [families]
    for family in named:
        if family not in dynamics.families:
            raise ModelError(f"to_casadi expects families among {', '.join(dynamics.families)}, got {family!r}")
    names = [_name(port) for port in exporter.arguments]
    functions = [exporter.family(family) for family in named]
    # Scalar expressions are faster, but have no tables.
    kind: Any = casadi.MX if any(function.program.tables for function in functions) else casadi.SX
    ports = zip(names, exporter.arguments, strict=True)
    symbols: list[Any] = [kind.sym(name, *_matrix(port.shape)) for name, port in ports]
    results, result_names = [], []
    for function in functions:
        results += _results(casadi, kind, function, exporter.arguments, symbols)
        result_names += [_name(port) for port in function.results]
    everything = [*names, *result_names]
    twice = sorted({name for name in everything if everything.count(name) > 1})
    if twice:
        raise ModelError(
            "a CasADi function needs distinct names of its arguments and results, but two have the name "
            f"{twice[0]!r}.\n"
            "  fix: rename one, or request fewer families"
        )
    # CasADi takes zero for what is not given: a mass of zero would go unnoticed, NaN does not.
    scalars = {p.name: float(p.value) for p in dynamics.parameters if p.value is not None and p.shape == ()}
    defaults = [scalars.get(port.name, np.nan) if port.kind == "params" else np.nan for port in exporter.arguments]
    # A function that CasADi derives has zeros again, unless it is told; the results, which `jacobian` takes too, are
    # not read.
    derived = {"default_in": [*defaults, *(0.0 for _ in results)]}
    options: Any = {"default_in": defaults, "jacobian_options": derived}
    return casadi.Function(name, symbols, results, names, result_names, options)


def _name(port: Port) -> str:
    """The name of the leaf or the result; rates get a prefix."""
    return "t" if port.kind == "t" else f"rate_{port.name}" if port.kind == "rate" else port.name


def _matrix(shape: tuple[int, ...]) -> tuple[int, int]:
    """The rows and columns of CasADi's matrix: vectors are columns, arrays of more axes a column row by row."""
    return (shape[0], shape[1]) if len(shape) == 2 else (math.prod(shape), 1)


def _place(shape: tuple[int, ...], place: int) -> tuple[int, int]:
    """Where the entry number `place`, counted row by row, stands in that matrix."""
    return divmod(place, shape[1]) if len(shape) == 2 else (place, 0)


def _results(
    casadi: Any, kind: Any, function: ExportedFunction, arguments: Sequence[Port], symbols: Sequence[Any]
) -> list[Any]:
    """The results as matrices of expressions in the symbols."""
    g = function.program.graph
    values = function.program.computed(
        lambda argument, place: symbols[argument][_place(arguments[argument].shape, place)],
        lambda value, dtype: kind(float(value)),
        lambda operation, i, *a: expression(casadi, operation, g.dtypes[g.arguments(i)[-1]], *a),
    )
    results = []
    for port, nodes in zip(function.results, function.program.outputs, strict=True):
        result = kind(*_matrix(port.shape))  # what is structurally zero stays so
        for entry, i in enumerate(nodes.reshape(-1).tolist()):
            if i != g.zero:
                result[_place(port.shape, entry)] = values[i]
        results.append(result)
    return results


def expression(casadi: Any, operation: Operation, dtype: np.dtype[Any], *arguments: Any) -> Any:
    """An operation on arguments of a type, in CasADi.

    Raises:
        ModelError: CasADi does not have the operation.
    """
    form = operation.casadi.of(dtype)
    if form is None:
        raise ModelError(f"CasADi does not have the operation {operation.name} for {dtype.name}")
    return form(casadi, *arguments)
