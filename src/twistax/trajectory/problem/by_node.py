"""Parameters with a value for each node, linear in time between nodes: references and weights of an objective."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ...checks import reals, short
from ...errors import InputError, ModelError, ShapeError
from ...expr import Expr, Parameter, leaves_of
from ..transcription.vectors import Flat

#: Each row begins with the node's fraction of the duration and one over the fraction of the interval after it; zero for
#: the last node.
_HEAD = 2


@dataclasses.dataclass(frozen=True, eq=False)
class ByNode:
    """The parameters of a problem that have a value for each node.

    Attributes:
        leaves: the parameters by name, each with the shape of a single value.
        stated_shares: fractions of the duration at the nodes for which values are stated.
        shares: fractions of the duration at the nodes of the mesh.
    """

    leaves: Mapping[str, Parameter]
    stated_shares: Array
    shares: Array

    @classmethod
    def of(cls, value: Any, shares: Array) -> ByNode:
        """The `ByNode` of the argument `by_node=`.

        Raises:
            ModelError: the argument is not a list of parameters.
        """
        if isinstance(value, ByNode):
            return dataclasses.replace(value, shares=shares)
        listed = [] if value is None else value
        if not isinstance(listed, (list, tuple)) or not all(isinstance(leaf, Parameter) for leaf in listed):
            raise ModelError(f"by_node expects a list of parameters, such as [reference, weight], got {short(value)}")
        return cls({leaf.name: leaf for leaf in listed}, shares, shares)

    def check(
        self, objective: Iterable[Expr], elsewhere: Iterable[Expr], read: Iterable[str], free: Iterable[str]
    ) -> None:
        """Raise ModelError if anything but the objective reads one of these parameters, or if one is free.

        Args:
            objective, elsewhere: expressions of the objective, and all other expressions.
            read: names of the parameters that the system reads.
            free: names of the free parameters.
        """
        for name in self.leaves.keys() & set(free):
            raise ModelError(
                f"by_node and free both name {name!r}; a free parameter has one value for all nodes.\n"
                "  fix: leave it out of one of them; a control is a quantity that the optimiser chooses over time"
            )
        known = {leaf.name for expr in objective for leaf in leaves_of(expr)}
        elsewhere_read = {leaf.name for expr in elsewhere for leaf in leaves_of(expr)} | set(read)
        for name in self.leaves:
            if name in elsewhere_read:
                raise ModelError(
                    f"by_node names {name!r}, which a rate, a constraint or a bound of a norm reads; a value for each "
                    "node is for the objective.\n  fix: use a table over time there, or a square in place of a norm"
                )
            if name not in known:
                raise ModelError(
                    f"by_node names {name!r}, which the objective does not read.\n  fix: leave it out of by_node"
                )

    def values(self, name: str, value: Any) -> Array:
        """The values (nodes, ...) of a parameter: from a value for each node of this mesh or of the stated nodes, or
        from one for all.

        Raises:
            InputError, ShapeError: values that are not finite, or of another shape.
        """
        shape, rows = self.leaves[name].shape, reals(f"params[{name!r}]", value, InputError)
        if not np.isfinite(rows).all():
            raise InputError(f"params[{name!r}] expects finite numbers, got {short(rows)}")
        if rows.shape == shape:
            return np.broadcast_to(rows, (len(self.shares), *shape)).copy()
        if rows.shape == (len(self.shares), *shape):
            return rows
        expected = (len(self.stated_shares), *shape)
        if rows.shape != expected:
            raise ShapeError(
                f"params[{name!r}] expects a row for each node {expected}, or one value {shape}, got {rows.shape}"
            )
        columns = [np.interp(self.shares, self.stated_shares, column) for column in rows.reshape(len(rows), -1).T]
        return np.stack(columns, axis=1).reshape(-1, *shape)

    # ---- as kernels read them: a row for each node, with its own values and those of the next ------------------------

    @property
    def _flat(self) -> Flat:
        return Flat({name: leaf.shape for name, leaf in self.leaves.items()})

    @property
    def width(self) -> int:
        """The number of entries of a row."""
        return _HEAD + 2 * self._flat.size if self.leaves else 0

    def places(self, name: str) -> Array:
        """Index ranges of a parameter in the row of a node: (values at the node, values at the next node)."""
        flat = self._flat
        first = _HEAD + int(flat.places(name)[0]) + np.array([0, flat.size])
        return np.stack([first, first + self.width])

    def rows(self, params: Mapping[str, Any]) -> Array:
        """(nodes, width)"""
        if not self.leaves:
            return np.zeros((len(self.shares), 0))
        here = self._flat.joined(params, 1)
        slopes = np.append(1.0 / np.diff(self.shares), 0.0)
        return np.concatenate([self.shares[:, None], slopes[:, None], here, here[[*range(1, len(here)), -1]]], axis=1)

    def at(self, row: Any, share: Any) -> dict[str, Any]:
        """The values at a fraction of the duration, from the row of the node before it."""
        here, after = jnp.split(row[_HEAD:], 2)
        return self._flat.split(here + (share - row[0]) * row[1] * (after - here))

    def along(self, params: Mapping[str, Any], share: Any) -> dict[str, Any]:
        """The values at a fraction of the duration, from the values at all nodes."""
        place = jnp.clip(jnp.searchsorted(self.shares, share, side="right") - 1, 0, len(self.shares) - 2)
        part = (share - jnp.asarray(self.shares)[place]) / jnp.diff(jnp.asarray(self.shares))[place]
        return {name: params[name][place] * (1.0 - part) + params[name][place + 1] * part for name in self.leaves}


def only_once(parts: Sequence[ByNode]) -> None:
    """Raise ModelError if two phases name the same parameter in `by_node`."""
    seen = set[str]()
    for part in parts:
        for name in part.leaves:
            if name in seen:
                raise ModelError(
                    f"by_node names {name!r} in two phases.\n  fix: use a separate parameter in each phase"
                )
            seen.add(name)
