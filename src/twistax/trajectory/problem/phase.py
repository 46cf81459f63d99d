"""The statement of a phase."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from ...checks import listed, short
from ...errors import ModelError
from ...expr import Expr
from ...expr.operations.soft import parts_of
from ...system.dynamics import Dynamics
from .bridges.lifted_functionals import functionals_of
from .conditions import split
from .functionals import Initial
from .statement import Objective


@dataclasses.dataclass(frozen=True, eq=False)
class Phase:
    """One phase of a problem: `tx.trajectory.Problem([Phase(...), Phase(...)])`.

    Args:
        dynamics: a compiled system.
        objective: the contribution of the phase to the objective. The final cost is evaluated at the end of the phase,
            where `tx.Time()` is the time since the start of the first phase. None means no contribution.
        nodes: number of state nodes, or their positions, as for a `Problem`.
        final_time: the duration of the phase, a number in s, or limits (low, high) to leave it free.
        initial, final, at: as for a `Problem`. For a phase after the first, values in `initial` replace the links of
            these states.
        by_node, controls, guess, final_time_guess, transcription, method, substeps, hessian: as for a `Problem`.
        name: its name in results and messages; "phase 0", "phase 1", ... by default.
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


def initials_of(phase: Phase) -> list[Initial]:
    """The functionals `Initial(...)` in the objective and the conditions of a phase."""
    exprs: list[Any] = [getattr(phase.objective, field, None) for field in ("final", "running")]
    at = phase.at.values() if isinstance(phase.at, Mapping) else []
    for what, conditions in (("initial", phase.initial), ("final", phase.final), *(("at", rows) for rows in at)):
        for constraint in split(what, conditions)[1].values():
            exprs += parts_of(constraint)
    leaves = functionals_of(*(e for e in exprs if isinstance(e, Expr)))
    return [leaf for leaf in leaves if isinstance(leaf, Initial)]


def check_phases(phases: Sequence[Any], arguments: Mapping[str, Any]) -> None:
    """Raise ModelError unless all are phases, and no argument of a phase is passed to `Problem` as well."""
    strangers = [phase for phase in phases if not isinstance(phase, Phase)]
    if strangers or not phases:
        got = short(strangers[0]) if strangers else "none"
        raise ModelError(
            f"Problem expects a compiled system as its first argument, or a list of tx.trajectory.Phase(...), got {got}"
        )
    defaults = {
        field.name: None if field.default is dataclasses.MISSING else field.default
        for field in dataclasses.fields(Phase)
    }
    names = {name for name, value in arguments.items() if value is not defaults[name]}
    if too_many := sorted(names - {"dynamics", "objective"}):
        raise ModelError(
            f"Problem of several phases accepts links, params and free only, got {listed(too_many)}.\n"
            "  fix: pass it to each tx.trajectory.Phase"
        )


def kind_of(phases: Sequence[Phase]) -> type[Objective]:
    """The kind of objective of all phases, `Minimize` or `Maximize`."""
    kinds = {type(phase.objective) for phase in phases if phase.objective is not None}
    if not kinds or len(kinds) > 1 or not all(issubclass(kind, Objective) for kind in kinds):
        raise ModelError(
            "the objectives of all phases must be of one kind, tx.Minimize(...) or tx.Maximize(...), and "
            "at least one phase needs one; got {listed(sorted(kind.__name__ for kind in kinds))}"
        )
    return kinds.pop()
