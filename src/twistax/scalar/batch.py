"""Batches: the axes that an equation's arguments have before those of one member."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import batching

#: From the number of rows, and arguments (rows, *shape), or (1, *shape) where all rows share one, to results.
Rows: TypeAlias = Callable[..., list[jax.Array]]


@dataclasses.dataclass(frozen=True)
class Batch:
    """The batch axes of the arguments of an equation.

    Attributes:
        depth: the number of batch axes; they come first.
        shared: the arguments without batch axes, which all members of the batch share.
    """

    depth: int = 0
    shared: frozenset[int] = frozenset()

    def shape(self, arguments: Sequence[Any]) -> tuple[int, ...]:
        """The lengths of these axes."""
        return next((np.shape(a)[: self.depth] for k, a in enumerate(arguments) if k not in self.shared), ())

    def each(self, function: Callable[..., list[jax.Array]], arguments: Sequence[Any]) -> list[jax.Array]:
        """A function of one member, applied to all of them at once."""
        axes = [None if k in self.shared else 0 for k in range(len(arguments))]
        for _ in range(self.depth):
            function = jax.vmap(function, in_axes=axes)
        return function(*arguments)

    def rows(self, function: Rows, arguments: Sequence[Any]) -> list[jax.Array]:
        """A function of rows, with all batch axes as one."""
        shape = self.shape(arguments)
        rows = math.prod(shape)
        flat = [
            jnp.reshape(a, (1, *jnp.shape(a)) if k in self.shared else (rows, *jnp.shape(a)[self.depth :]))
            for k, a in enumerate(arguments)
        ]
        return [jnp.reshape(r, (*shape, *r.shape[1:])) for r in function(rows, *flat)]

    def batched(self, arguments: Sequence[Any], axes: Sequence[int | None]) -> tuple[Batch, list[Any]]:
        """The batch with one more axis in front, and the arguments with that axis moved there."""
        size = next(a.shape[d] for a, d in zip(arguments, axes, strict=True) if d is not None)
        unbatched = {k for k, d in enumerate(axes) if d is None and (k in self.shared or self.depth == 0)}
        moved = [
            a if k in unbatched else batching.bdim_at_front(a, d, size)
            for k, (a, d) in enumerate(zip(arguments, axes, strict=True))
        ]
        result = Batch(self.depth + 1, frozenset(unbatched))
        # Those that only the axes from before share are no longer the same for all.
        shape = Batch(self.depth + 1, self.shared | unbatched).shape(moved)
        for k in self.shared - unbatched:
            entry = moved[k].shape[1:]
            moved[k] = jnp.broadcast_to(moved[k].reshape(size, *(1 for _ in shape[1:]), *entry), (*shape, *entry))
        return result, moved
