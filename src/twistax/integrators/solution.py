"""What an integration gives back: states, counts, how it ended, and the state at any time."""

from __future__ import annotations

import dataclasses
import enum
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..jax_inside import is_traced
from ..lowering.dynamics import Arrays
from .charts.coordinates import Blocks
from .method import Stepper
from .steps import Trail

__all__ = ["Dense", "Result", "Solution", "Stats"]


class Result(enum.IntEnum):
    """How an integration ended; `sentence` says it in words. SUCCESS and EVENT are no failures."""

    SUCCESS = 0
    NON_FINITE = 1
    MAX_STEPS = 2
    STEP_TOO_SMALL = 3
    NEWTON_FAILED = 4
    EVENT = 5

    @property
    def sentence(self) -> str:
        """What happened, in plain words."""
        return _SENTENCES[self]

    def __str__(self) -> str:
        return f"{self.name}: {self.sentence}"


_SENTENCES = {
    Result.SUCCESS: "the end time was reached",
    Result.NON_FINITE: "a state became infinite or NaN",
    Result.MAX_STEPS: "the steps ran out before the end time",
    Result.STEP_TOO_SMALL: "no step is small enough for the tolerances",
    Result.NEWTON_FAILED: "the equations of an implicit step could not be solved",
    Result.EVENT: "an event stopped it",
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
class Dense:
    """The starts of all steps and what takes a step. A pytree.

    Between two of them the state is one shorter step of the same method, so it stays in its group and is as accurate as
    the others; an interpolating polynomial would cost order and leave the group.
    """

    stepper: Stepper
    trail: Trail

    def evaluate(self, t: Any) -> Arrays:
        """The states at a time () or at times (n,), on a leading axis then; see `Solution.evaluate`."""
        ts = jnp.asarray(t, self.trail.t.dtype)
        if ts.ndim > 1:
            raise InputError(f"evaluate expects a time or times with shape (n,), got shape {ts.shape}")
        if not is_traced((ts, self.trail)):
            known = np.asarray(self.trail.t)
            start, end = float(known[0]), float(known[int(self.trail.steps)])
            room = 1e-6 * (end - start)
            times = np.asarray(ts).reshape(-1)
            outside = ~((times >= start - room) & (times <= end + room))
            if outside.any():
                wrong = float(times[int(np.argmax(outside))])
                raise InputError(f"evaluate expects times in [{start:g}, {end:g}], the integrated span, got {wrong:g}")
        found = _states(self, ts.reshape(-1))
        return {name: value[0] for name, value in found.items()} if ts.ndim == 0 else found


@jax.jit
def _states(dense: Dense, ts: jax.Array) -> Arrays:
    trail, stored = dense.trail, dense.stepper.stored
    last = jnp.maximum(trail.steps - 1, 0)
    before = jnp.searchsorted(trail.t, ts, side="right").astype(last.dtype) - 1
    k = jnp.clip(before, 0, last)

    def state(t: jax.Array, start: jax.Array, y: Blocks) -> Arrays:
        return stored.value(dense.stepper.advance(start, y, t - start))

    return jax.vmap(state)(ts, trail.t[k], jax.tree.map(lambda a: a[k], trail.y))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Solution:
    """States at the saved times. A pytree, so that jit, vmap and derivatives of an integration apply.

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
        """The states by name at a time () or at times (n,), then on a leading axis. Needs dense=True.

        Each is one shorter step of the same method from the start of the step it lies in: in its group, and as accurate
        as the saved states. Differentiable with respect to t too.

        Raises:
            InputError: no dense output was kept; times outside of what was integrated.
        """
        if self.dense is None:
            raise InputError("this solution kept no dense output.\n  fix: tx.integrate(..., dense=True)")
        return self.dense.evaluate(t)

    @property
    def result(self) -> Any:
        """How it ended, a `Result`; of traced or mapped solutions an array of codes, which compare with `Result`."""
        unknown = is_traced(self.code) or np.ndim(self.code) > 0
        return self.code if unknown else Result(int(self.code))
