"""Expressions at many points by compiled kernels. Changes of numbers, or of the number of points, do not recompile."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ...expr import Control, Expr, Inputs, Leaf, Parameter, State, Time, evaluate_all, leaves_of
from ...expr.transformations.without_numbers import Structure
from ...solver.kernels import Argument, SmoothKernels
from ...system.functions import Cache
from .vectors import Flat

#: The functions that were used last, by the keys of their expressions.
_CACHE = Cache(128)


class PointValues:
    """Expressions of states, controls, parameters and time at points.

    Args:
        exprs: canonical.
    """

    def __init__(self, exprs: Sequence[Expr]) -> None:
        leaves = {leaf.key(): leaf for leaf in leaves_of(*exprs) if isinstance(leaf, (State, Control, Parameter))}
        self._leaves = list(leaves.values())
        self._moving = [leaf for leaf in self._leaves if not isinstance(leaf, Parameter)]
        self._params = Flat({leaf.name: leaf.shape for leaf in self._leaves if isinstance(leaf, Parameter)})
        self._points = Flat({leaf.name: leaf.shape for leaf in self._moving})
        self._places = {leaf.key(): k for k, leaf in enumerate(self._leaves)}
        self._defaults = {leaf.name: leaf.value for leaf in self._leaves if isinstance(leaf, Parameter)}
        self._structure = structure = Structure(exprs, self._token)
        arguments = {Argument.Z: self._points.size, Argument.SHARE: 1, Argument.DATA: self._params.size}
        key = ("values", structure.key)
        self._function = SmoothKernels(self._traced, arguments, 0, key, structure.numbers)

    @classmethod
    def of(cls, exprs: Sequence[Expr]) -> PointValues:
        """The object for these expressions; those of expressions that occurred before are cached."""
        kept: PointValues = _CACHE.get(tuple(expr.key() for expr in exprs), lambda: cls(exprs))
        return kept

    def __call__(self, ts: Array, x: Mapping[str, Any], u: Mapping[str, Any], params: Mapping[str, Any]) -> Array:
        """The values of all expressions (points, entries), from arrays with a row for each point.

        Raises:
            Exception: the error that a function executed by JAX has raised.
        """
        (kernel,) = self._function.kernels
        rows = len(ts)
        points = {leaf.name: (x if isinstance(leaf, State) else u)[leaf.name] for leaf in self._moving}
        arguments = {
            Argument.Z: self._points.joined(points, 1) if points else np.zeros((rows, 0)),
            Argument.SHARE: np.reshape(ts, (rows, 1)),
            Argument.DATA: self._params.joined({n: params.get(n, value) for n, value in self._defaults.items()})[None],
        }
        values = kernel(rows, self._function.rows, arguments)
        kernel.check()
        return values

    def _token(self, leaf: Leaf) -> Hashable:
        known = leaf.key() in self._places
        return "time" if isinstance(leaf, Time) else (self._places[leaf.key()], leaf.shape) if known else None

    def _traced(self, z: jax.Array, t: jax.Array, data: jax.Array, *numbers: jax.Array) -> jax.Array:
        points, params = self._points.split(z), self._params.split(data)
        hidden: dict[str, Any] = self._structure.params(numbers[0]) if numbers else {}
        inputs = Inputs(t[0], points, points, params | hidden, z.dtype)
        values = evaluate_all(self._structure.roots, lambda leaf: leaf.read(inputs))
        return jnp.concatenate([jnp.zeros(0, z.dtype), *(value.reshape(-1).astype(z.dtype) for value in values)])
