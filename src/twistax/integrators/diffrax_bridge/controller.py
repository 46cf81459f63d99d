"""Steps chosen by tolerances on groups, inside diffrax."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from ...errors import ModelError
from ..ambient import read_arguments
from ..charts import Exponential
from ..charts.coordinates import StateCoordinates
from ..method import Stepper
from ..rkmk import RKMK
from ..step_control import StepControl, first_step
from ..tableaus import EULER
from ..tolerances import Tolerances, tolerances_of
from .frame import Frame
from .term import parts_of

__all__ = ["LieController", "controller"]

_USUAL = StepControl()


class _State(eqx.Module):
    """What the controller remembers: the PID controller's state, and what the first call learned of the system."""

    pid: Any
    tolerances: Tolerances
    frame: Frame = eqx.field(static=True)


@dataclasses.dataclass(frozen=True)
class _Probe(RKMK):
    """A method of any error order, for the first step."""

    probed: int = 1

    @property
    def error_order(self) -> int:
        return self.probed


class LieController(diffrax.AbstractAdaptiveStepSizeController):
    """diffrax's PIDController, fed with errors in the tangent space. Made by `controller`.

    Attributes:
        rtol, atol, norm: for the equations of implicit solvers; atol the smallest of those given.
        allowed: the absolute tolerance as it was given, a number or a dict by state.
        pid: the controller of the length of the steps.
    """

    rtol: Any
    atol: Any
    norm: Any
    allowed: Any
    pid: diffrax.PIDController

    def wrap(self, direction: Any) -> LieController:
        """Itself: nothing here depends on the sense of time."""
        return self

    def init(
        self, terms: Any, t0: Any, t1: Any, y0: Mapping[str, Any], dt0: Any, args: Any, func: Any, error_order: Any
    ) -> tuple[Any, _State]:
        """The end of the first step, chosen by the rates where dt0 is None.

        Raises:
            ModelError: terms that are not those of `lie_term`, or another solver around `LieSolver`.
            InputError: tolerances that do not fit.
        """
        parts = parts_of(terms)
        if type(getattr(func, "__self__", None)) is diffrax.HalfSolver:
            raise ModelError(
                "HalfSolver(LieSolver(...)) compares matrices entry by entry.\n"
                "  fix: wrap the other way round: tx.diffrax.LieSolver(diffrax.HalfSolver(...), dynamics)"
            )
        dynamics, direction = parts[0]
        given = read_arguments(dynamics, direction * t0, y0, args)
        dtype = jnp.result_type(*given.x.values())
        tolerances = tolerances_of(dynamics, self.rtol, self.allowed, dtype)
        frame = Frame(dynamics, Exponential())
        if dt0 is None:
            dt0 = self._first(frame, given, tolerances, direction * (t1 - t0), error_order).astype(jnp.result_type(t0))
        t_end, pid = self.pid.init(terms, t0, t1, given.x, dt0, args, func, error_order)
        return t_end, _State(pid, tolerances, frame)

    def _first(self, frame: Frame, given: Any, tolerances: Tolerances, room: Any, error_order: Any) -> jax.Array:
        """The length of the first step."""
        room = jnp.asarray(room, given.t.dtype)
        method = _Probe(EULER, frame.chart, 1 if error_order is None else error_order)
        stepper = Stepper(frame.dynamics, method, given.signals, given.params)
        y = frame.local.enter(given.x)
        sense, length = jnp.sign(room), jnp.abs(room)
        rate = stepper.rate(given.t, y, sense * 1e-6 * length)
        h = first_step(stepper, tolerances, given.t, y, rate, 1e-3 * length, length)
        return jax.lax.stop_gradient(jnp.minimum(h, length))

    def adapt_step_size(
        self, t0: Any, t1: Any, y0: Any, y1_candidate: Any, args: Any, y_error: Any, error_order: Any, state: _State
    ) -> tuple[Any, Any, Any, Any, _State, Any]:
        """As PIDController, with the errors of the step in units of what is allowed."""
        scaled = None
        if y_error is not None:
            before, after, error = jax.lax.stop_gradient((dict(y0), dict(y1_candidate), dict(y_error)))
            scaled = _scaled(state.tolerances, state.frame, before, after, error)
        nothing = jnp.zeros(state.frame.dynamics.dimension, y0[next(iter(y0))].dtype)
        *found, pid, result = self.pid.adapt_step_size(t0, t1, nothing, nothing, args, scaled, error_order, state.pid)
        keep, start, end, jumped = found
        return keep, start, end, jumped, _State(pid, state.tolerances, state.frame), result


def _scaled(tolerances: Tolerances, frame: Frame, before: Any, after: Any, error: Any) -> jax.Array:
    """The errors of a step in units of what is allowed; infinite where they are NaN."""
    local: StateCoordinates = frame.local
    e = frame.deviations(after, error)
    scaled = tolerances.scaled(local, e, local.enter(before), local.enter(after))
    return jnp.where(jnp.isfinite(scaled), scaled, jnp.inf)


def controller(
    rtol: Any,
    atol: Any = None,
    *,
    pcoeff: float = _USUAL.pcoeff,
    icoeff: float = _USUAL.icoeff,
    dcoeff: float = _USUAL.dcoeff,
    safety: float = _USUAL.safety,
    factormin: float = _USUAL.factormin,
    factormax: float = _USUAL.factormax,
    dtmin: float | None = None,
    dtmax: float | None = None,
    force_dtmin: bool = True,
    step_ts: Any = None,
    jump_ts: Any = None,
) -> Any:
    """Steps for `LieSolver` whose error is at most atol + rtol x size, measured in the tangent space.

    Rotations count in rad against size 1, positions in their unit against their distance from the origin, other states
    entry by entry; as the tolerances of `tx.integrate`. A plain diffrax.PIDController works too and compares the
    entries of the matrices.

    Args:
        rtol: relative tolerance.
        atol: absolute tolerance, rtol if left out: a number, or a dict by state; for a pose a pair (rotation,
            position).
        pcoeff, icoeff, dcoeff, safety, factormin, factormax, dtmin, dtmax, force_dtmin: as in diffrax.PIDController,
            the numbers of `tx.StepControl` if left out.
        step_ts, jump_ts: times at which steps end, and at which rates or controls jump, as in
            diffrax.ClipStepSizeController.
    Raises:
        InputError: when the integration begins, for tolerances that do not fit the system.
    """
    pid = diffrax.PIDController(
        rtol=0.0,
        atol=1.0,
        pcoeff=pcoeff,
        icoeff=icoeff,
        dcoeff=dcoeff,
        safety=safety,
        factormin=factormin,
        factormax=factormax,
        dtmin=dtmin,
        dtmax=dtmax,
        force_dtmin=force_dtmin,
    )
    allowed = rtol if atol is None else atol
    found = LieController(rtol, _smallest(allowed), pid.norm, allowed, pid)
    if step_ts is None and jump_ts is None:
        return found
    return diffrax.ClipStepSizeController(found, step_ts=step_ts, jump_ts=jump_ts)


def _smallest(allowed: Any) -> Any:
    leaves = [jnp.min(jnp.asarray(leaf)) for leaf in jax.tree.leaves(allowed)]
    return functools.reduce(jnp.minimum, leaves)
