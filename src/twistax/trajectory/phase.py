"""One phase of a problem: its statement, and what it reads."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from ..expr import Expr, leaves_of
from ..expr.operations.soft import parts_of
from ..system.dynamics import Dynamics
from .border import boxes_of
from .conditions import split
from .reduction import functionals_of


@dataclasses.dataclass(frozen=True, eq=False)
class Phase:
    """One phase of a problem: `tx.trajectory.Problem([Phase(...), Phase(...)])`.

    Args:
        dynamics: a compiled system.
        objective: what the phase adds to the objective: at its end, where `tx.Time()` is the time since the beginning
            of the first phase, and along it. None adds nothing.
        nodes: number of state nodes, or where they lie, as for a `Problem`.
        final_time: how long the phase takes, a number in s, or limits (low, high) to leave it free.
        initial, final, at: as for a `Problem`. After the first phase, values in `initial` stand in place of what the
            phase before left.
        by_node, controls, guess, final_time_guess, transcription, method, substeps, hessian: as for a `Problem`.
        name: what results and messages call it; "phase 0", "phase 1", ... unless given.
    """

    dynamics: Dynamics
    objective: Any = None
    _: dataclasses.KW_ONLY
    nodes: Any = 25
    final_time: Any
    initial: Any = None
    final: Any = None
    at: Any = None
    by_node: Any = None
    controls: Any = None
    guess: Mapping[Any, Any] | None = None
    final_time_guess: Any = None
    transcription: Any = None
    method: Any = None
    substeps: int | None = None
    hessian: Any = None
    name: str | None = None


def as_dict(free: Any) -> dict[Any, Any]:
    if isinstance(free, (list, tuple)):
        return dict.fromkeys(free, (None, None))
    if free is not None and not isinstance(free, Mapping):
        boxes_of(free, (), ())  # which refuses it
    return dict(free or {})


def names_read(phase: Phase) -> set[str]:
    """The names that a phase reads; more than parameters."""
    reads = phase.dynamics._functions.reads
    names = set(reads["rates"]) | set(reads["constraints"])
    exprs = asked(phase)
    exprs += [leaf.operand for leaf in functionals_of(*exprs)]
    return names | {leaf.name for e in exprs for leaf in leaves_of(e)}


def asked(phase: Phase) -> list[Expr]:
    """The expressions that a phase states."""
    exprs: list[Any] = [getattr(phase.objective, field, None) for field in ("final", "running")]
    at = phase.at.values() if isinstance(phase.at, Mapping) else []
    for what, given in (("initial", phase.initial), ("final", phase.final), *(("at", own) for own in at)):
        for constraint in split(what, given)[1].values():
            exprs += parts_of(constraint)
    return [e for e in exprs if isinstance(e, Expr)]
