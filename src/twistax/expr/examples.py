"""Examples of node classes as expressions with values, for the conformance test suite."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from .operators import NODES, Operators

#: Values of the fields by name, where arrays and numbers of operands stand for states, and a node that takes any number
#: of operands has a list of them; or a function of the class and of states that gives the expression, and their values.
Case: TypeAlias = Mapping[str, Any] | tuple[Callable[..., Any], Mapping[str, Any]]


class Example(NamedTuple):
    """One example for the conformance tests: an expression, values of its leaves, and whether it is smooth there."""

    expr: Any
    values: Mapping[str, Any]
    smooth: bool = True


def example_of(cls: Any, case: Case, smooth: bool) -> Example:
    """An example of a class from one of its declared cases."""
    values: dict[str, np.ndarray] = {}

    def leaf(name: str, value: Any) -> Any:
        if isinstance(value, Operators):
            return value
        values[name] = np.asarray(value, float)
        return NODES["State"](name, shape=values[name].shape)

    if isinstance(case, tuple):
        build, operands = case
        return Example(build(cls, **{name: leaf(name, value) for name, value in operands.items()}), values, smooth)
    several: list[Any] = []
    named = dict(case)
    for field in cls._fields:
        if field.variadic:
            several = [leaf(f"{field.name}{i}", value) for i, value in enumerate(named.pop(field.name))]
        elif field.operand:
            named[field.name] = leaf(field.name, named[field.name])
    return Example(cls(*several, **named), values, smooth)
