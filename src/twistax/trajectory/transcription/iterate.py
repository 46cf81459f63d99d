"""Points, steps and values of a transcribed problem, and its data."""

from __future__ import annotations

from typing import Any, NamedTuple


class Iterate(NamedTuple):
    """An iterate: states, controls and shared unknowns."""

    xs: Any  # states by name (nodes, ...); of several phases a tuple of such dicts
    us: Any  # (intervals, m)
    border: Any  # (g,) durations and free parameters

    def with_border(self, border: Any) -> Iterate:
        """The same states and controls with other durations and free parameters."""
        return self._replace(border=border)


class Instance(NamedTuple):
    """The data of a solve: parameters, ends of phases and limits."""

    params: Any
    final: Any  # states at the end; entries that are free stand for nothing; of phases `PhaseEnds`
    limits: Any  # (g, 2) of the border
    margins: Any = 0.0  # (rows,) by which rows are tightened

    def with_params(self, params: Any) -> Instance:
        """The same with other values of parameters."""
        return self._replace(params=params)

    def with_margins(self, margins: Any) -> Instance:
        """The same with rows tightened by other margins."""
        return self._replace(margins=margins)


class PhaseEnds(NamedTuple):
    """States at the ends of every phase; free entries have no meaning."""

    initial: Any
    final: Any


class Step(NamedTuple):
    """A step in the tangent space, or anything else with an entry for each unknown."""

    d: Any  # (nodes, n)
    u: Any  # (intervals, m)
    border: Any  # (g,)


class Values(NamedTuple):
    """The values of a problem at a point."""

    cost: Any
    defects: Any  # (intervals, n)
    rows: Any  # (rows,) those of all intervals, then those of the end; <= 0 or = 0
