"""What an integration gives back."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np

from ..errors import InputError
from ..jax_inside import is_traced
from ..lowering.dynamics import Arrays
from .dense import Dense
from .result import Result

__all__ = ["Solution", "Stats"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Stats:
    """Counts of an integration; `stats.steps` and `stats["steps"]` are the same.

    Attributes:
        steps: steps tried, accepted and rejected together.
        accepted, rejected: how many were kept and how many repeated with a smaller step.
        rhs_evaluations: evaluations of the right-hand side, those for saved times between steps included.
    """

    steps: Any
    accepted: Any
    rejected: Any
    rhs_evaluations: Any

    def __getitem__(self, name: str) -> Any:
        if name not in self.__dict__:
            raise KeyError(f"{name!r}; the counts are {', '.join(self.__dict__)}")
        return self.__dict__[name]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Solution:
    """A flight: states at the saved times. A pytree, so that jit, vmap and derivatives of an integration apply.

    Attributes:
        ts: (n,) saved times in s; without save_at the end alone.
        xs: states by name, leading axis n.
        stats: counts.
        code: the number of the Result.
        dense: what `evaluate` reads, with dense=True; else None.
        which: the number of the event that stopped it, -1 for none; None where none was watched for.
    """

    ts: jax.Array
    xs: Arrays
    stats: Stats
    code: Any
    dense: Dense | None = None
    which: Any = None

    @property
    def event(self) -> Any:
        """The number of the event that stopped it, or None; of traced or mapped solutions an array, -1 for none."""
        if self.which is None or is_traced(self.which) or np.ndim(self.which) > 0:
            return self.which
        return int(self.which) if int(self.which) >= 0 else None

    def evaluate(self, t: Any) -> Arrays:
        """The states by name at a time () or at times (n,), then on a leading axis. Needs a flight with dense=True.

        Each is one shorter step of the same method from the start of the step it lies in: in its group, and as accurate
        as the flight. Differentiable with respect to t too.

        Raises:
            InputError: no dense output was kept; times outside of what was flown.
        """
        if self.dense is None:
            raise InputError("this flight kept no dense output.\n  fix: tx.integrate(..., dense=True)")
        return self.dense.evaluate(t)

    @property
    def result(self) -> Any:
        """How it ended, a `Result`; of traced or mapped solutions an array of codes, which compare with `Result`."""
        unknown = is_traced(self.code) or np.ndim(self.code) > 0
        return self.code if unknown else Result(int(self.code))
