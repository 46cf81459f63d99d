"""The result of an integration of phases: a solution for each phase, and their common states as one solution."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import listed
from ...errors import InputError, in_phase
from ...jax_inside import is_traced
from ...plots import Pictured, draw
from ...progress import watching
from ...system.dynamics import Arrays
from ...system.labels import declared_labels
from ..loop.rollout import wide
from ..results.solution import AnySolution, Solution, Stats, need_one, need_within, times_to_evaluate
from ..results.table_export import Column, columns_of

if TYPE_CHECKING:
    from ...view import Scene


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PhasedSolution(AnySolution):
    """The result of `tx.integrate_phases`: one `Solution` for each phase. A pytree, so that jit, vmap and derivatives
    apply.

    With `save_at` each phase has rows for its start, for the saved times inside it, and for its end. So a switch
    between two phases has two rows: before and after the jump. Under `jit` and `vmap` each phase has a row for every
    saved time: rows before its start repeat the start, rows after its end repeat the end, or are NaN if an event ended
    it.

    Attributes:
        phases: the `Solution` of each phase up to the first that failed, with `ts`, `xs`, `outputs`, `event`, `result`.
        starts: the states at the start of each phase, after the jump, by name.
        t_starts: the time at the start of each phase, s.
        code: the number of the overall Result: that of the first phase that failed, else of the last phase.
        save_at: (n,) the requested saved times, or None.
        names: names of the phases.
        on_grid: whether every phase has a row for every saved time.
    """

    phases: tuple[Solution, ...]
    starts: tuple[Arrays, ...]
    t_starts: tuple[jax.Array, ...]
    code: Any
    save_at: jax.Array | None
    names: tuple[str, ...] = dataclasses.field(metadata={"static": True})
    on_grid: bool = dataclasses.field(metadata={"static": True})

    def __getitem__(self, name: str) -> Solution:
        """The solution of a phase, by name."""
        if name not in self.names:
            raise InputError(f"the solution has no phase {name!r}; its phases are: {listed(self.names, name)}")
        return self.phases[self.names.index(name)]

    @property
    def durations(self) -> dict[str, Any]:
        """The duration of each phase, s, by name."""
        return {name: p.ts[..., -1] - t for name, p, t in zip(self.names, self.phases, self.t_starts, strict=True)}

    @property
    def stats(self) -> Stats:
        """The sums of the counts of all phases."""
        return jax.tree.map(lambda *counts: sum(counts), *(phase.stats for phase in self.phases))

    @functools.cached_property
    def ts(self) -> jax.Array:
        """(n,) the saved times up to the end, s; without save_at only the final time."""
        if self.save_at is None:
            return self.phases[-1].ts[..., -1:]
        return self.save_at if self.on_grid else jnp.asarray(np.asarray(self.save_at)[self._inside])

    @functools.cached_property
    def xs(self) -> Arrays:
        """The states that all phases have, by name, at `ts`; at a transition, the state after the jump."""
        return self._joined(lambda phase: phase.xs)

    @functools.cached_property
    def us(self) -> Arrays:
        """The controls that all phases have, by name, at `ts`."""
        return self._joined(lambda phase: phase.us)

    @functools.cached_property
    def outputs(self) -> Arrays:
        """The outputs that all phases have, by name, at `ts`. Raises the errors of `Solution.outputs`."""
        return self._joined(lambda phase: phase.outputs)

    def evaluate(self, t: Any) -> Arrays:
        """The states that all phases have, at a time () or at times (n,); at a transition, the state after the jump.
        Requires dense=True.

        Raises:
            InputError: there is no dense output; times outside of the integration.
        """
        ts = times_to_evaluate(t, self.phases[0].ts.dtype)
        ends = [phase.ts[-1] for phase in self.phases]
        if not is_traced((ts, ends, self.t_starts)):
            need_within(ts, self.t_starts[0], ends[-1], "those of the flight")
        states: Arrays = {}
        for phase, begin, end in zip(self.phases, self.t_starts, ends, strict=True):
            here = phase.evaluate(jnp.clip(ts, begin, end))
            if not states:
                states = here
            after = ts >= begin
            states = {k: jnp.where(wide(after, v), here[k], v) for k, v in states.items() if _alike(here.get(k), v)}
        return states

    @watching("plot")
    def plot(self, *names: Any, units: Mapping[str, str] | None = None) -> Any:
        """A matplotlib figure of the states that all phases have, over time, with gaps between phases.

        Args:
            names: of the states and joints to draw; by default all states that the phases have in common.
            units: units of the drawn values by name, as in `Solution.plot`.
        Raises:
            InputError: a name that not all phases have; no saved times; a solution that is traced or of a batch.
            ModelError: matplotlib is not installed.
        """
        parts = self._reached("plot")
        if self.save_at is None:
            raise InputError(
                "plot expects saved times, got only the ends of the phases.\n"
                "  fix: tx.integrate_phases(..., save_at=times)"
            )
        system = None if self.phases[0].stepper is None else self.phases[0].stepper.dynamics.system

        def pieces(name: str) -> list[tuple[Any, Any]]:
            return [(np.asarray(part.ts), np.asarray(part.xs[name])) for part in parts]

        labels, declared = ({}, {}) if system is None else (system.labels, declared_labels(system))
        return draw(Pictured(list(self.xs), [], pieces, labels, units, declared).panels(names))

    def show(self, path: Any = None, **choices: Any) -> Scene:
        """An animation of all phases in three dimensions, with the states that all have; see `Solution.show`.

        Raises:
            InputError: as `Solution.show`; no saved times.
            ModelError: viser, the extra `view`, is not installed.
        """
        from ...view.motion import Motion, joined, shown

        parts = self._reached("show")
        if self.save_at is None:
            raise InputError(
                "show expects saved times, got only the ends of the phases.\n"
                "  fix: tx.integrate_phases(..., save_at=times)"
            )
        signals = [lambda of=of: joined([getattr(part, of) for part in parts]) for of in ("us", "outputs")]
        params = {name: value for p in parts if p.stepper is not None for name, value in p.stepper.params.items()}
        ts = np.concatenate([np.asarray(part.ts) for part in parts])
        return shown(Motion(ts, joined([part.xs for part in parts]), signals, params), path, **choices)

    def video(self, path: Any, *, size: tuple[int, int] = (1280, 720), **choices: Any) -> Path:
        """A video of what `show` draws; see `Solution.video`."""
        return self.show(opened=False, **choices).video(path, size=size)

    def _columns(self, layout: Any) -> list[Column]:
        tables, count = [], []
        for name, part in zip(self.names, self._reached("a table"), strict=True):
            with in_phase(name):
                columns = columns_of(part, layout)
            tables.append({column.header: column for column in columns})
            count.append(len(part.ts))
        shared = [column for header, column in tables[0].items() if all(header in table for table in tables)]
        joined = [Column(c.name, c.unit, np.concatenate([table[c.header].values for table in tables])) for c in shared]
        return [*joined[:1], Column("phase", "", np.repeat(np.arange(len(tables)), count)), *joined[1:]]

    def _reached(self, what: str) -> list[Solution]:
        """The phases, without rows of times that they do not cover."""
        need_one(what, self.phases[0])
        if not self.on_grid:
            return list(self.phases)
        phases = []
        for phase in self.phases:
            states = jax.tree.leaves(jax.tree.map(np.asarray, phase.xs))
            good = np.all([np.isfinite(v.reshape(len(v), -1)).all(1) for v in states], axis=0)
            xs = {name: value[good] for name, value in phase.xs.items()}
            phases.append(dataclasses.replace(phase, ts=phase.ts[good], xs=xs))
        return phases

    @property
    def _inside(self) -> np.ndarray:
        """Which of the saved times lie within the flight, known ones."""
        times = np.asarray(self.save_at)
        return (times >= np.asarray(self.t_starts[0])) & (times <= np.asarray(self.phases[-1].ts[-1]))

    def _joined(self, of: Callable[[Solution], Arrays]) -> Arrays:
        """Values that all phases have, at `ts`."""
        values = [of(phase) for phase in self.phases]
        axis = self.phases[0].ts.ndim - 1
        tail = lambda value: value.shape[axis + 1 :]  # noqa: E731
        names = [
            n for n, v in values[0].items() if all(n in arrays and tail(arrays[n]) == tail(v) for arrays in values)
        ]
        if self.save_at is None:
            return {name: values[-1][name][(*[slice(None)] * axis, slice(-1, None))] for name in names}
        return {name: self._rows(self.save_at, [arrays[name] for arrays in values]) for name in names}

    def _rows(self, save_at: jax.Array, values: list[Any]) -> jax.Array:
        if self.on_grid:
            return self._on_grid(save_at, values)
        times = np.asarray(save_at)[self._inside]
        owner = np.searchsorted(np.asarray(self.t_starts), times, side="right") - 1
        rows = [
            np.asarray(v)[np.searchsorted(p.ts, times[owner == k])] for k, (p, v) in enumerate(zip(self.phases, values))
        ]
        return jax.device_put(np.concatenate(rows))

    def _on_grid(self, times: jax.Array, values: list[Any]) -> jax.Array:
        axis = times.ndim - 1
        cut = (*[slice(None)] * axis, slice(1, times.shape[-1] + 1))
        result = jnp.full_like(values[0][cut], jnp.nan if jnp.issubdtype(values[0].dtype, jnp.inexact) else 0)
        ends = [*(begin[..., None] for begin in self.t_starts[1:]), None]
        for phase, begin, end, value in zip(self.phases, self.t_starts, ends, values, strict=True):
            before = times <= phase.ts[..., -1:]
            if end is not None:  # NaN after a phase that failed
                before = jnp.where(jnp.isnan(end), before, times < end)
            result = jnp.where(wide((times >= begin[..., None]) & before, result), value[cut], result)
        return result


def _alike(one: Any, other: jax.Array) -> bool:
    return one is not None and one.shape == other.shape
