"""The elements of a function's parts: equations that are loops, constants, and the parts themselves."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...jax_inside import ClosedJaxpr, Literal, all_equations, closed, inner_jaxprs, part
from ..array_primitive import is_array_program
from ..backends import Emission, array_operations

#: Loops of fewer operations on scalars, all iterations together, are unrolled.
_UNROLLED = 2000
_LOOPS = ("scan", "while")
#: Constants of more entries are arguments of the parts.
_LARGEST = 1000


class Reason(NamedTuple):
    """The reason for the form in which something is executed.

    Attributes:
        text: one sentence.
        gains: whether that is faster than what JAX makes of it.
    """

    text: str
    gains: bool

    def within(self, what: str) -> Reason:
        """The same of what stands within a loop, a branch or a batch."""
        return Reason(f"{what}: {self.text}", self.gains)


def reason_of(emission: Emission) -> Reason:
    return Reason(emission.reason, emission.gains)


@dataclasses.dataclass(frozen=True)
class Part:
    """Some equations of a function, with the function that executes them.

    Attributes:
        inputs, outputs: variables of the jaxpr.
        function: from the values of these to the values of those.
        reasons: why it runs as it does.
    """

    inputs: Sequence[Any]
    outputs: Sequence[Any]
    function: Callable[..., Sequence[Any]]
    reasons: list[Reason]


def is_loop(eqn: Any) -> bool:
    """Whether an equation is a loop that is not unrolled, or has one in its branches."""
    inside = [equation for inner in inner_jaxprs(eqn) for equation in all_equations(inner.jaxpr)]
    if eqn.primitive.name == "while" or any(is_array_program(e) or e.primitive.name == "while" for e in inside):
        return eqn.primitive.name in (*_LOOPS, "cond")
    if eqn.primitive.name == "cond":
        return any(is_loop(equation) for inner in inner_jaxprs(eqn) for equation in inner.jaxpr.eqns)
    return eqn.primitive.name == "scan" and _operations(eqn) > _UNROLLED


def _operations(eqn: Any) -> int:
    return eqn.params["length"] * array_operations(closed(eqn.params["jaxpr"]).jaxpr).total()


class Constants:
    """The values that depend only on constants, as small arrays: each part computes those that it reads.

    Attributes:
        made: the equations that do.
        known: all the variables.
    """

    def __init__(self, program: ClosedJaxpr) -> None:
        self._jaxpr = program.jaxpr
        consts = zip(program.jaxpr.constvars, program.consts, strict=True)
        self._values = {v: c for v, c in consts if np.size(c) <= _LARGEST}
        self.known, self.made = dict.fromkeys(self._values), []
        for eqn in program.jaxpr.eqns:
            small = all(v.aval.size <= _LARGEST for v in eqn.outvars)
            if small and not is_loop(eqn) and all(v in self.known for v in read_by([eqn])):
                self.made.append(eqn)
                self.known.update(dict.fromkeys(eqn.outvars))

    def close(self, eqns: Sequence[Any], outputs: Sequence[Any]) -> ClosedJaxpr:
        """The jaxpr of equations, with the constants that they read; its inputs are the other variables they read."""
        wanted = read_by(eqns) | dict.fromkeys(v for v in outputs if not isinstance(v, Literal))
        before: list[Any] = []
        for eqn in reversed(self.made):
            if any(v in wanted for v in eqn.outvars):
                before.insert(0, eqn)
                wanted |= read_by([eqn])
        written = {v for eqn in (*before, *eqns) for v in eqn.outvars}
        inputs = [v for v in wanted if v not in self._values and v not in written]
        constants = {v: c for v, c in self._values.items() if v in wanted}
        return part(self._jaxpr, [*before, *eqns], inputs, outputs, constants)


def read_by(eqns: Iterable[Any]) -> dict[Any, None]:
    """The variables that equations read, in order, including those that they compute."""
    return dict.fromkeys(v for eqn in eqns for v in eqn.invars if not isinstance(v, Literal))
