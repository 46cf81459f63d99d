"""The functions of a functional mock-up unit: functions of vectors of plain numbers, as scalar programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...expr import Leaf
from ...groups.ambient import ambient_numbers
from ...scalar.derivatives import tangent_program
from ...scalar.reader import scalarize
from ..export.c_code import body
from ..export.programs import ExportedFunction, Port, exported
from ..functions import Arrays, Functions
from ..inputs import Values

_TIME, _X, _U, _P = Port("t", "", ()), "x", "u", "params"


class UnitFunctions:
    """A system whose states, controls and parameters are one vector each, with states as plain numbers.

    Poses are [quaternion, position], rotations are quaternions; other values are their entries, row by row.

    Args:
        functions: the functions of the compiled system.
        advance: a function of t, x, u, params and h that returns the states after a step; None for no steps.

    Attributes:
        numbers: for each state its conversion to plain numbers.
        arguments: t and the three vectors.
    """

    def __init__(self, functions: Functions, advance: Callable[..., Mapping[str, Any]] | None) -> None:
        self._functions, self._advance = functions, advance
        self.numbers = {name: ambient_numbers(group) for name, group in functions.group.factors.items()}
        shapes = {name: numbers.shape for name, numbers in self.numbers.items()}
        self._shapes = {_X: shapes, _U: _shapes_of(functions.controls), _P: _shapes_of(functions.parameters)}
        sizes = {kind: sum(_size(shape) for shape in of_kind.values()) for kind, of_kind in self._shapes.items()}
        self.arguments = (_TIME, *(Port(kind, kind, (size,)) for kind, size in sizes.items()))

    def written(self) -> list[tuple[str, ExportedFunction, str]]:
        """The functions: C declaration, program, and text of the body.

        Raises:
            ModelError: a part has no scalar form.
        """
        with jax.enable_x64(True):
            closed = jax.make_jaxpr(self._values)(*map(_shaped, self.arguments))
            program = scalarize(closed)
            values = exported("values", "rate", ["rates", "outputs"], program, self._values)
            seeds = tuple(Port("seed", f"seed_{port.name}", port.shape) for port in self.arguments[1:])
            slopes = exported(
                "derivatives", "rate", ["rates", "outputs"], tangent_program(program, (1, 2, 3)), self._values
            )
            written = [_in_c("values", self.arguments, values), _in_c("slopes", (*self.arguments, *seeds), slopes)]
            if self._advance is not None:
                h = Port("h", "", ())
                step = jax.make_jaxpr(self._after)(*map(_shaped, (*self.arguments, h)))
                after = exported("step", "next", ["next"], scalarize(step), self._after)
                written.append(_in_c("step", (*self.arguments, h), after))
        return written

    def flat(self, x: Values, u: Values, params: Values) -> list[np.ndarray]:
        """Values by name as the three vectors."""
        with jax.enable_x64(True):
            plain = {name: numbers.write(jnp.asarray(x[name], float)) for name, numbers in self.numbers.items()}
        every: Any = ((plain, self._shapes[_X]), (u, self._shapes[_U]), (params, self._shapes[_P]))
        return [
            np.concatenate([np.zeros(0), *(np.ravel(np.asarray(values[name], float)) for name in shapes)])
            for values, shapes in every
        ]

    # ---- in arrays ---------------------------------------------------------------------------------------------------

    def _split(self, kind: str, vector: jax.Array) -> Arrays:
        values, at = {}, 0
        for name, shape in self._shapes[kind].items():
            values[name] = vector[at : at + _size(shape)].reshape(shape)
            at += _size(shape)
        return values

    def _read(self, x: jax.Array, u: jax.Array, p: jax.Array) -> tuple[Arrays, Arrays, Arrays, Arrays]:
        """States as plain numbers and as elements, controls, parameters."""
        plain = self._split(_X, x)
        states = {name: numbers.read(plain[name]) for name, numbers in self.numbers.items()}
        return plain, states, self._split(_U, u), self._split(_P, p)

    def _values(self, t: jax.Array, x: jax.Array, u: jax.Array, p: jax.Array) -> list[jax.Array]:
        """Rates of the plain numbers, and outputs."""
        plain, *arguments = self._read(x, u, p)
        rates = self._functions.as_written("rates", t, *arguments)
        outputs = self._functions.as_written("outputs", t, *arguments)
        moved = [numbers.rate(plain[name], rates[name]).reshape(-1) for name, numbers in self.numbers.items()]
        flat = [jnp.zeros(0, x.dtype), *(a.reshape(-1).astype(x.dtype) for a in outputs.values())]
        return [jnp.concatenate(moved), jnp.concatenate(flat)]

    def _after(self, t: jax.Array, x: jax.Array, u: jax.Array, p: jax.Array, h: jax.Array) -> list[jax.Array]:
        """The plain numbers after a step."""
        assert self._advance is not None
        plain, *arguments = self._read(x, u, p)
        after = self._advance(t, *arguments, h)
        ends = {name: numbers.beside(numbers.write(after[name]), plain[name]) for name, numbers in self.numbers.items()}
        return [jnp.concatenate([a.reshape(-1) for a in ends.values()])]


def _in_c(name: str, arguments: Sequence[Port], function: ExportedFunction) -> tuple[str, ExportedFunction, str]:
    """The head, the program and the body of a function."""
    names = {port: port.name or port.kind for port in (*arguments, *function.results)}
    heads = [f"double {names[a]}" if a.by_value else f"const double *{names[a]}" for a in arguments]
    results = ["next"] if name == "step" else ["rates", "outputs"]
    heads += [f"double *{result}" for result in results]
    ignored = "".join(f"    (void){result};\n" for result in results)
    return f"static void model_{name}({', '.join(heads)})", function, ignored + body(function, arguments, names)


def _shaped(port: Port) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(port.shape, np.float64)


def _shapes_of(leaves: Sequence[Leaf]) -> dict[str, tuple[int, ...]]:
    return {leaf.name: leaf.shape for leaf in leaves}


def _size(shape: tuple[int, ...]) -> int:
    return int(np.prod(shape))
