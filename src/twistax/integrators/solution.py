"""What an integration gives back."""

from __future__ import annotations

import dataclasses
import enum
from typing import Any

import jax
import numpy as np

from ..lowering.dynamics import Arrays
from .concrete import is_traced

__all__ = ["Result", "Solution", "Stats"]


class Result(enum.IntEnum):
    """How an integration ended; `sentence` says it in words."""

    DONE = 0
    NON_FINITE = 1
    MAX_STEPS = 2
    STEP_TOO_SMALL = 3

    @property
    def sentence(self) -> str:
        """What happened, in plain words."""
        return _SENTENCES[self]

    def __str__(self) -> str:
        return f"{self.name}: {self.sentence}"


_SENTENCES = {
    Result.DONE: "the end time was reached",
    Result.NON_FINITE: "a state became infinite or not a number",
    Result.MAX_STEPS: "the steps ran out before the end time",
    Result.STEP_TOO_SMALL: "no step is small enough for the tolerances",
}


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
    """

    ts: jax.Array
    xs: Arrays
    stats: Stats
    code: Any

    @property
    def result(self) -> Any:
        """How it ended, a `Result`; of traced or mapped solutions an array of codes, which compare with `Result`."""
        unknown = is_traced(self.code) or np.ndim(self.code) > 0
        return self.code if unknown else Result(int(self.code))
