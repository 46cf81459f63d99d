"""Parameters whose values form a pytree, such as the weights of a neural network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import InputError, ModelError, ShapeError
from ...jax_inside import is_traced
from ..leaves import Parameter


class ParameterTree:
    """A pytree of arrays as parameters: the weights of a neural network, a dictionary of tables.

    Each array of real numbers in the tree is a `tx.Parameter` named after the tree and its path, such as
    "net.layers[0].weight", of the shape of the array. A `tx.Function` that is applied to a ParameterTree receives the
    pytree. Systems, problems, sweeps and files treat these as ordinary parameters: `values` returns the `params` of a
    call, `parameters` the `free` of a Problem. Other leaves of the tree, such as activation functions and integers, are
    constants. Values have the units that the function expects. Source: JAX's documentation, "Pytrees".

    Args:
        name: the prefix of the names of the parameters.
        value: the tree, whose arrays are the default values. It may be an `equinox.Module`.
    Attributes:
        parameters: the parameters, in the order of `jax.tree.leaves`.
    Raises:
        ModelError: the tree contains no array of real numbers, or JAX is tracing one.

    Example:
        weights = tx.ParameterTree("net", {"A": np.zeros((2, 4)), "b": np.zeros(2)})
        affine = tx.Function(lambda p, x: p["A"] @ x + p["b"], shape=(2,))
        system = tx.System(rates={x: affine(weights, y)})
        dynamics(0.0, state, params=weights.values({"A": A, "b": b}))
    """

    def __init__(self, name: str, value: Any) -> None:
        arrays = _real_arrays(value)
        if not isinstance(name, str) or not name:
            raise ModelError(f"ParameterTree needs a name: a non-empty string, got {name!r}")
        if not arrays:
            raise ModelError(
                f"ParameterTree {name!r} expects a pytree with arrays of real numbers, got {type(value).__name__}.\n"
                "  fix: pass a tree with arrays of JAX or NumPy; for a single array use "
                f"tx.Parameter({name!r}, value=...)"
            )
        if is_traced(arrays):
            raise ModelError(
                f"ParameterTree {name!r} expects arrays with known numbers, got one that is traced by JAX.\n"
                "  fix: build the system outside of the transformation, and pass params=weights.values(tree) inside"
            )
        leaves, self._structure = jax.tree.flatten(value)
        self._leaves = [None if is_real_array(leaf) else leaf for leaf in leaves]
        self._places = [k for k, leaf in enumerate(leaves) if is_real_array(leaf)]
        self.name, self._paths = name, tuple(arrays)
        self.parameters = tuple(Parameter(name + path, value=np.asarray(a)) for path, a in arrays.items())

    def __repr__(self) -> str:
        return f"ParameterTree({self.name!r}, {len(self.parameters)} arrays)"

    def key(self) -> tuple[Any, ...]:
        """A hashable value that identifies this tree in functions."""
        return str(self._structure), self._paths

    def values(self, tree: Any) -> dict[str, Any]:
        """The values of the parameters by name, for `params` of a call, from a tree with the same arrays.

        It may be traced, so derivatives with respect to a tree are available. Leaves without real numbers are ignored.

        Raises:
            ShapeError: an array is missing, does not belong to this tree, or has another shape.
        """
        arrays, wanted = _real_arrays(tree), dict(zip(self._paths, self.parameters, strict=True))
        if strange := [
            *(path for path in wanted if path not in arrays),
            *(path for path in arrays if path not in wanted),
        ]:
            what = "is missing" if strange[0] in wanted else "is not one of them"
            raise ShapeError(
                f"ParameterTree {self.name!r} expects a tree with its {len(wanted)} arrays: {strange[0]!r} {what}",
                hint="pass a tree of the same structure",
            )
        for path, parameter in wanted.items():
            if np.shape(arrays[path]) != parameter.shape:
                raise ShapeError(f"{parameter.name!r} expects shape {parameter.shape}, got {np.shape(arrays[path])}")
        return {parameter.name: arrays[path] for path, parameter in wanted.items()}

    def tree(self, values: Mapping[str, Any] | None = None) -> Any:
        """The tree with values of the parameters by name, for example from the result of a problem.

        Other names are ignored. Without an argument it is the tree of the default values.

        Raises:
            InputError: a parameter has no value.
        """
        defaults = {parameter.name: parameter.value for parameter in self.parameters}
        chosen = defaults if values is None else values
        if missing := [name for name in defaults if name not in chosen]:
            raise InputError(
                f"ParameterTree {self.name!r} expects values of all its parameters: {missing[0]!r} is missing"
            )
        return self.filled([jnp.asarray(chosen[name]) for name in defaults])

    def filled(self, arrays: Sequence[Any]) -> Any:
        """The tree with these arrays, in the order of `parameters`."""
        leaves = list(self._leaves)
        for place, array in zip(self._places, arrays, strict=True):
            leaves[place] = array
        return jax.tree.unflatten(self._structure, leaves)


def is_real_array(leaf: Any) -> bool:
    return isinstance(leaf, (np.ndarray, jax.Array)) and jnp.issubdtype(leaf.dtype, jnp.floating)


def _real_arrays(tree: Any) -> dict[str, Any]:
    """The arrays of real numbers in a tree, by path."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path): leaf for path, leaf in leaves if is_real_array(leaf)}
