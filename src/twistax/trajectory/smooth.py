"""Functions of a vector with first and second derivatives as scalar programs of their own.

A program of a whole Jacobian computes every shared part once. Forward derivatives of JAX compute the function anew for
each of its columns, and those of a gradient the gradient.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..groups import Product
from ..scalar.backends import Backend
from ..scalar.fast import fast
from ..scalar.jax_primitive import Derived, call_program
from ..scalar.reader import emitted_form
from ..system.hessian import REFUSALS, WeightedHessian, hessian_in_arrays
from ..system.jacobian import Differentiated, RateJacobian


class _Programs(NamedTuple):
    slopes: Derived
    bends: Derived


class Smooth:
    """A vector f(z, ...) with its derivatives by the vector z; what follows z are pytrees of arrays.

    What the graph of scalars does not hold is differentiated by JAX.

    Args:
        function: takes z and others, gives a vector; pure.
        backend: what runs it.
    """

    def __init__(self, function: Callable[..., jax.Array], backend: Backend) -> None:
        self._function, self._backend = function, backend
        self._value = fast(function, backend=backend)
        self._programs: dict[Any, _Programs | None] = {}

    def __call__(self, z: jax.Array, *others: Any) -> jax.Array:
        found: jax.Array = self._value(z, *others)
        return found

    def slopes(self, z: jax.Array, *others: Any) -> jax.Array:
        """df / dz."""
        programs = self._of(z, others)
        if programs is None:
            return jax.jacfwd(self._value)(z, *others)
        return call_program(programs.slopes, z, *jax.tree.leaves(others))[0]

    def bends(self, weights: jax.Array, z: jax.Array, *others: Any) -> jax.Array:
        """The second derivative of weights . f by z."""
        programs = self._of(z, others)
        if programs is None:
            return hessian_in_arrays(lambda z: weights @ self._value(z, *others), z)
        return call_program(programs.bends, z, *jax.tree.leaves(others), weights)[0]

    def _of(self, z: jax.Array, others: tuple[Any, ...]) -> _Programs | None:
        """The programs for arguments of these shapes; None where there are none."""
        leaves, structure = jax.tree.flatten(others)
        arrays = [jax.ShapeDtypeStruct(jnp.shape(a), jnp.result_type(a)) for a in (z, *leaves)]
        key = (structure, *((a.shape, a.dtype) for a in arrays))
        if key not in self._programs:
            flat = lambda z, *leaves: [self._function(z, *jax.tree.unflatten(structure, leaves))]  # noqa: E731
            self._programs[key] = self._made(flat, arrays)
        return self._programs[key]

    def _made(self, flat: Callable[..., list[jax.Array]], arrays: list[Any]) -> _Programs | None:
        closed = jax.make_jaxpr(flat)(*arrays)
        # Only the kind that is differentiated has a meaning here.
        places = [("u" if k == 0 else "params", str(k)) for k in range(len(arrays))]
        given = Differentiated(closed, places, Product({}), ("u",))
        try:
            slopes = RateJacobian(given)
            if emitted_form(slopes.program).calls:
                return None
            bends = WeightedHessian(given).program
        except REFUSALS:
            return None
        return _Programs(self._backend.derived(slopes.program), self._backend.derived(bends))
