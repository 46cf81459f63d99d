"""The quality of a result, for one phase or several."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from numpy import ndarray as Array

from ...errors import IntegrationError, TrajectoryError
from ...jax_inside import in_double
from ..contact.relaxed import products
from ..strategy.accuracy import Accuracy
from ..strategy.outcome import Outcome
from ..strategy.status import AT_OPTIMUM, Status
from ..strategy.undetermined import Undetermined, undetermined
from ..strategy.warm import WarmStart
from ..transcription.border import Border
from ..transcription.shooting import Transcribed
from .singular import singular

#: Constraints with a larger scaled multiplier count as active.
_ACTIVE = 1e-5
#: The message for a stationary point that is not a minimum.
_SADDLE = ", at a saddle: the objective falls to second order from here, and no search beside it found better"
#: The tolerance of a solver that only evaluates solutions.
_LOOKED_AT = 1e-6
#: The number of violations between nodes that a message lists.
_NAMED = 3
#: Remedies for a coarse mesh.
_FINER = "solve(refine=1e-4), more nodes or substeps, for stiff rates Collocation(tx.tableaus.RADAU_IIA5)"


@dataclasses.dataclass(frozen=True)
class Optimality:
    """Residuals of the first-order (KKT) conditions of an optimum, in scaled form.

    Each unknown is divided by its change along the trajectory, and the objective by its change under these changes.

    Attributes:
        stationarity: largest entry of the gradient of the Lagrangian.
        feasibility: largest residual of the dynamics or of a constraint.
        complementarity: largest product of a slack and its multiplier.
        gap: a first-order bound on the error of the objective: the sum of |multiplier times slack or residual|.
        excess: estimate of the objective's difference from the minimum nearby, relative to the objective: the decrease
            by a Newton step without a barrier. It does not depend on units. NaN if it is not known.
    """

    stationarity: float
    feasibility: float
    complementarity: float
    gap: float
    excess: float = math.nan


@dataclasses.dataclass(frozen=True)
class Quality:
    """The errors of a result and its multipliers. All arrays are NumPy, double precision.

    Attributes:
        final_time: the time at the end, s.
        params: the values of all parameters, including the optimal values of free ones.
        cost: the objective as stated (a maximum is not negated).
        violation: the largest violation of a constraint, each measured in its own scale; 0 if all hold.
        violations: row name -> largest violation at the nodes, in the constraint's own unit, for all rows of the
            problem.
        optimality: the residuals of the first-order conditions.
        multipliers: row name -> multipliers for the minimised objective, in the objective's unit over that of the row,
            one for each place of the row, in order; for a norm, they belong to the squared norm. "dynamics of <state>"
            has shape (intervals, dimension).
        active: names of the active constraints, those with the largest effect on the objective first.
        accuracy: the integration error, and the violations between nodes; None for a point that is not finite.
        status: how the solve ended; `message` explains it in one sentence, and names the worst constraint and its
            place.
        iterations: iterations of the solver in the try that led to this result.
        tries: (status, cost, violation, iterations) of every try.
        compile_seconds, solve_seconds: wall time; with `solve(refine=...)` that of all meshes.
        warm: the start for `solve(warm=...)`.
        slacks: (rows,) the slack of every inequality in its own unit, as the solver has it.
        saddle: whether the point is a saddle: the objective decreases to second order within the constraints, and
            searches from nearby points found nothing better.
    """

    problem: Any
    final_time: float
    params: dict[str, Array]
    cost: float
    violation: float
    violations: dict[str, float]
    optimality: Optimality
    multipliers: dict[str, Array]
    active: tuple[str, ...]
    accuracy: Accuracy | None
    status: Status
    message: str
    iterations: int
    tries: tuple[tuple[Status, float, float, int], ...]
    compile_seconds: float
    solve_seconds: float
    warm: WarmStart
    slacks: Array
    saddle: bool

    @property
    def solved(self) -> bool:
        """Whether the status is SOLVED."""
        return self.status is Status.SOLVED

    @property
    def soft(self) -> dict[str, float]:
        """Name of a soft constraint, entry by entry -> its largest violation at the nodes, in its unit."""
        return {name: size for name, size in self.violations.items() if name in self.problem.soft}

    @functools.cached_property
    def complementarity(self) -> dict[str, float]:
        """Name of a complementarity constraint, entry by entry -> its largest product at the ends of intervals."""
        return products(self)

    @functools.cached_property
    def undetermined(self) -> dict[str, Array]:
        """Controls that the optimum does not determine: name of an entry -> (intervals,) the fraction, 0 to 1, of its
        change that has no effect.

        A change has no effect if constraints remain satisfied and the objective is constant, to second
        order. Empty where the status is not SOLVED, and where the Hessian is not exact.
        """
        return {entry.name: entry.free_share for entry in self._undetermined}

    @functools.cached_property
    def _undetermined(self) -> list[Undetermined]:
        problem, warm = self.problem, self.warm
        if not self.solved or any(part.hessian is not None for part in problem.parts):
            return []
        with in_double():
            instance = problem.started().instance.with_params(warm.params)
            staged = problem.core(_LOOKED_AT, warm.point, instance).staged
            return undetermined(staged, warm, instance, [part.continuous.derivatives for part in problem.parts])

    def explain(self) -> str:
        """A summary as text with one fact per line: errors, active constraints, undetermined
        controls, a finer rollout.
        """
        return _explained(self, self._undetermined)

    def shifted(self, steps: int = 1) -> WarmStart:
        """A warm start for `solve(warm=...)` that is shifted by `steps` intervals, for a receding horizon.

        Controls, states and multipliers are shifted. The last control is repeated, and the states are integrated.

        Raises:
            TrajectoryError: `steps` is not a positive whole number; interval lengths differ; several phases.
        """
        return self.warm.shifted(steps)

    def _need_finite(self) -> None:
        """Raise TrajectoryError if the solution is not finite, so that it has no rollout."""
        if not np.isfinite(list(self.violations.values())).all():
            raise TrajectoryError(f"a point that is not finite has no rollout. {self.message}")

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.message} cost={self.cost:.6g}, violation={self.violation:.1e}, "
            f"final_time={self.final_time:.6g}, iterations={self.iterations}, "
            f"compile {self.compile_seconds:.1f} s, solve {self.solve_seconds:.1f} s)"
        )


def _explained(result: Any, undetermined: list[Undetermined]) -> str:
    size = {name: float(np.abs(result.multipliers[name]).max()) for name in result.active}
    errors = ", ".join(f"{name} {value:.1e}" for name, value in dataclasses.asdict(result.optimality).items())
    lines = [
        result.message,
        f"first-order conditions: {errors}",
        f"active, by multiplier: {', '.join(f'{name} ({size[name]:.3g})' for name in result.active) or 'none'}",
    ]
    left = {"soft constraints, by violation": result.soft, "complementarity, products left": result.complementarity}
    lines += [f"{what}: {', '.join(f'{n} {v:.3g}' for n, v in of.items())}" for what, of in left.items() if of]
    if undetermined:
        lines.append(_open(undetermined, result.problem.sign))
    if result.accuracy is not None:
        lines.append(_mesh(result.accuracy, result.status))
    try:
        lines += _rolled_out(result)
    except (TrajectoryError, IntegrationError) as error:
        lines.append(f"no finer rollout: {str(error).splitlines()[0]}")
    for m in result.meshes:
        lines.append(f"mesh of {m.nodes} nodes, {m.substeps} substeps: error {m.error:.1e}, cost {m.cost:.9g}")
    return "\n".join(lines)


def _rolled_out(result: Any) -> list[str]:
    """The lines of `explain` about a finer rollout.

    Raises:
        TrajectoryError: node times decrease.
        IntegrationError: the rollout diverges.
    """
    missed = "; ".join(
        f"{name} {', '.join(f'{kind} {value:.2g}' for kind, value in misses.items())}"
        for name, misses in result.mesh_error.items()
    )
    broken = {name: value for name, value in result.between_nodes.items() if value > 0.0}
    return [
        f"error of the final state by a finer rollout: {missed}",
        "limits exceeded by that rollout: " + (", ".join(f"{n} by {v:.2g}" for n, v in broken.items()) or "none"),
    ]


def _open(every: list[Undetermined], sign: float) -> str:
    """The lines about undetermined controls, and about terms that would determine them."""
    named = ", ".join(f"{entry.name} (in {entry.intervals} of {len(entry.free_share)} intervals)" for entry in every)
    weights = ("+ " if sign > 0.0 else "- ") + (" + " if sign > 0.0 else " - ").join(
        f"{entry.weight:g} * {entry.entry}**2" for entry in every
    )
    return (
        f"the optimum does not determine {named}: other values cost the same; "
        f"a small weight on their squares does: running=... {weights}"
    )


def _mesh(accuracy: Accuracy, status: Status) -> str:
    """A sentence on the mesh error, with a remedy if it is large."""
    line = f"largest mesh error, relative to the scales of the states: {accuracy.error:.1e} {accuracy.place}"
    if status in AT_OPTIMUM and status is not Status.DEGENERATE:  # elsewhere multipliers are meaningless
        line += f"; a mesh without error changes the objective by about {accuracy.change:.2g}"
    return line + (f"; the mesh is too coarse for this path: {_FINER}" if accuracy.coarse else "")


@dataclasses.dataclass(frozen=True)
class Attempts:
    """The outcomes of all tries of a solve, with their times.

    Attributes:
        outcomes: the outcomes of all tries.
        params: the parameter values of the solve.
        tolerance: tolerance of the first-order conditions.
        compile_seconds, solve_seconds: wall time.
    """

    outcomes: Sequence[Outcome]
    params: dict[str, Array]
    tolerance: float
    compile_seconds: float
    solve_seconds: float

    @property
    def best(self) -> Outcome:
        """The best attempt: the solved one of least cost; else one on the finest mesh; else the one with the least
        violation.
        """

        def rank(outcome: Outcome) -> tuple[int, float]:
            order = [Status.SOLVED, Status.EXCEEDED, Status.ACCEPTABLE, Status.COARSE, Status.DEGENERATE]
            if (
                outcome.status is Status.COARSE and outcome.accuracy is not None
            ):  # its cost may be too low because of mesh errors
                return order.index(outcome.status), outcome.accuracy.error
            if outcome.status in order:
                return order.index(outcome.status), outcome.cost
            last = outcome.status in (Status.NON_FINITE, Status.REFUSED)
            return len(order) + last, outcome.violation

        return min(self.outcomes, key=rank)

    def fields(
        self, problem: Any, params: dict[str, Array], violations: Mapping[str, float], shown: Collection[str]
    ) -> dict[str, Any]:
        """The attributes of the `Quality` of the best try that do not depend on phases.

        Args:
            params: values including those of optimal free parameters.
            violations: by name.
            shown: names of the rows whose violations are those of the constraints as users wrote them, not in the
                solver's form.
        """
        best, sign = self.best, problem.sign
        point = jax.tree.map(np.asarray, best.point)
        return {
            "params": params,
            "cost": sign * best.cost,
            "violation": best.violation,
            "violations": violations,
            "optimality": Optimality(*best.errors),
            "active": _active(problem.shooting, best),
            "accuracy": None
            if best.accuracy is None
            else dataclasses.replace(best.accuracy, change=sign * best.accuracy.change),
            "status": best.status,
            # The violation of a soft constraint is not that of its row, which has a slack.
            "message": _message(problem.shooting, best, violations, set(shown) - problem.soft, self.tolerance)
            + _singular(problem, best, params),
            "iterations": best.iterations,
            "tries": tuple((o.status, sign * o.cost, o.violation, o.iterations) for o in self.outcomes),
            "compile_seconds": self.compile_seconds,
            "solve_seconds": self.solve_seconds,
            "warm": WarmStart(problem, point, best.dynamics, best.rows, best.scales, params, units=best.units),
            "slacks": best.slack,
            "saddle": best.saddle,
        }


def params_of(border: Border, outcome: Outcome, params: dict[str, Array]) -> dict[str, Array]:
    """The parameter values, with those of optimal free parameters."""
    return params | {name: np.asarray(value) for name, value in border.params(np.asarray(outcome.point.border)).items()}


def _active(shooting: Transcribed, outcome: Outcome) -> tuple[str, ...]:
    """The names of constraints with a nonzero multiplier, the largest first."""
    largest = shooting.labels.largest(np.abs(outcome.scaled_rows))
    return tuple(sorted((name for name, size in largest.items() if size > _ACTIVE), key=lambda n: -largest[n]))


def _message(
    shooting: Transcribed, outcome: Outcome, sizes: Mapping[str, float], shown: Collection[str], tolerance: float
) -> str:
    """A sentence on the status; for a failure also the worst constraint and the errors."""
    if outcome.status is Status.REFUSED:
        return f"{outcome.status}. {outcome.refusal}"
    worst, count = [], shooting.intervals * shooting.n
    if outcome.status in AT_OPTIMUM:
        return " ".join([f"{outcome.status}{_SADDLE if outcome.saddle else ''}.", *_looked_at(outcome, tolerance)])
    rows, dynamics = outcome.violations[count:], outcome.violations[:count].reshape(-1, shooting.n)
    if outcome.status is Status.NON_FINITE:
        return f"{outcome.status}. {_first_not_finite(shooting, outcome)}."
    by_ends = rows * (shooting.determined & ~shooting.redundant)  # no unknown changes these
    why = ", by the fixed initial and final values alone" if by_ends.max(initial=0.0) > tolerance else ""
    if rows.max(initial=0.0) > tolerance:
        row = int((by_ends if why else rows).argmax())
        name, raw = shooting.names[row], abs(float(outcome.values.rows[row]))
        size = sizes[name] if name in shown and not why else raw
        worst.append(f"{name!r} {shooting.places[row]} is violated by {size:.3g}{why}")
    if dynamics.max(initial=0.0) > tolerance and not why:
        stage, column = divmod(int(dynamics.argmax()), shooting.n)
        size = abs(float(outcome.values.defects[stage, column]))
        worst.append(f"{shooting.defect(stage, column)} is violated by {size:.3g}")
    sentence = f"Worst: {'; '.join(worst)}" if worst else "Every constraint holds"
    if outcome.status in (Status.MAX_ITERATIONS, Status.OUT_OF_TIME, Status.STOPPED, Status.STALLED):
        errors = outcome.errors
        feasibility = f"feasibility {errors.feasibility:.1e}{'' if worst else ' (of the slacks)'}"
        sentence += f"; scaled, stationarity is {errors.stationarity:.1e}, {feasibility} and the gap {errors.gap:.1e}"
    return f"{outcome.status}. {sentence}."


def _looked_at(outcome: Outcome, tolerance: float) -> list[str]:
    """Sentences on rows whose gradient vanishes, a coarse mesh, and violations between nodes."""
    sentences, accuracy = list[str](), outcome.accuracy
    if outcome.flat is not None:
        name, place, size = outcome.flat
        sentences.append(
            f"The multiplier of {name!r} {place} is {size:.1e}, scaled: the constraint has zero derivatives there. "
            "Write it with a nonzero gradient where it is active, as v == 0 in place of v**2 <= 0."
        )
    if accuracy is None:
        return sentences
    if accuracy.coarse and accuracy.factor > 1.0:
        sentences.append(
            f"The method is not stable on this mesh: {accuracy.unstable_place} each step multiplies a mode of the "
            f"equations that does not grow by {accuracy.factor:.2g}, so the optimum on this mesh avoids this mode: "
            f"{_FINER}."
        )
    elif accuracy.coarse:
        sentences.append(
            f"By accurate integration the interval {accuracy.place} misses its end by {accuracy.error:.2g} in scales "
            f"of the states, and the objective has an error of about {accuracy.share:.1g} of its size, where "
            f"{accuracy.tolerance:g} is allowed: {_FINER}."
        )
    if accuracy.exceeded:
        named = [
            f"{name!r} by {it.by:.2g} {it.place} ({it.share / tolerance:.2g} times the tolerance)"
            for name, it in accuracy.exceeded.items()
        ]
        more = f"; and {len(named) - _NAMED} more" if len(named) > _NAMED else ""
        sentences.append(f"Exceeded between nodes: {'; '.join(named[:_NAMED])}{more}.")
    return sentences


def _singular(problem: Any, outcome: Outcome, params: dict[str, Array]) -> str:
    """A sentence on an expression that is not finite at an end of a phase."""
    if outcome.status is not Status.NON_FINITE:
        return ""
    for part, segment in zip(problem.parts, problem.shooting.segments):
        expression = singular(part, segment.of(outcome.point), params, outcome.point.border)
        if expression is not None:
            return f" {problem.shooting.named(segment, expression)}."
    return ""


def _first_not_finite(shooting: Transcribed, outcome: Outcome) -> str:
    values = outcome.values
    rows, defects = np.asarray(values.rows), np.asarray(values.defects)
    for row in np.flatnonzero(~np.isfinite(rows) & (shooting.exists | shooting.determined)):
        return f"{shooting.names[row]!r} {shooting.places[row]} is {rows[row]:g}"
    for stage, column in np.argwhere(~np.isfinite(defects)):
        return f"{shooting.defect(int(stage), int(column))} is {defects[stage, column]:g}"
    return "Its derivatives are not finite" if np.isfinite(outcome.cost) else f"The objective is {outcome.cost:g}"
