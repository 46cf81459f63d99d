"""Runge-Kutta solvers of diffrax as Lie-group solvers, and a step size controller with tolerances."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ...checks import number, real_array
from ...errors import InputError, ModelError
from ...jax_inside import any_of_batch, wrapped_terms
from ...system.dynamics import Arrays, Dynamics, need_compiled
from ..ambient import Arguments, read_arguments
from ..charts.chart import Chart, Exponential, SplitExponential, chart_of
from ..charts.coordinates import Blocks
from ..method import Stepper
from ..methods.rkmk import RKMK
from ..options import tolerances_of
from ..step_control import StepControl, Tolerances
from ..tableaus import EULER
from .frame import ChartedSystem, DirectedSystem, LieTerms, explicit_step, parts_of


class LieInterpolation(diffrax.AbstractLocalInterpolation):
    """The state within a step: the wrapped solver's interpolation of the coordinates around the start."""

    t0: Any  # type: ignore[misc]
    t1: Any  # type: ignore[misc]
    start: Any
    coordinates: diffrax.AbstractLocalInterpolation
    frame: ChartedSystem = eqx.field(static=True)

    def evaluate(self, t0: Any, t1: Any = None, left: bool = True) -> Arrays:
        """The state at t0, in its group. Raises InputError for an increment, which is not defined on a group."""
        if t1 is not None:
            raise InputError(
                "an increment between two times is not defined for states on groups.\n"
                "  fix: evaluate at both times and use dynamics.difference(x, y)"
            )
        local, x = self.frame.local, dict(self.start)
        z = self.frame.packed(x)[1](self.coordinates.evaluate(t0, left=left))
        return local.value(local.settle(local.move(local.enter(x), z)))


@dataclasses.dataclass(frozen=True)
class _Interpolate:
    """Makes the interpolation of one step. Comparable by value, because diffrax stores it as structure."""

    coordinates: Any
    frame: ChartedSystem

    def __call__(self, *, t0: Any, t1: Any, start: Any, within: Any) -> LieInterpolation:
        return LieInterpolation(t0, t1, start, self.coordinates(t0=t0, t1=t1, **within), self.frame)


class LieSolver(diffrax.AbstractWrappedSolver):
    """A Runge-Kutta-Munthe-Kaas method inside diffrax: the wrapped solver in coordinates around the start of each step.

        term, solver = tx.diffrax.lie_term(dynamics), tx.diffrax.LieSolver(diffrax.Tsit5(), dynamics)
        control = tx.diffrax.controller(rtol=1e-9, atol=1e-9)
        sol = diffrax.diffeqsolve(term, solver, 0.0, 10.0, None, x0, args=(u, params), stepsize_controller=control)

    The state y is that of `tx.integrate`: a dict with poses as (4, 4) and rotations as (3, 3). With $g = g_0 Exp(eta)$,
    the wrapped solver integrates $eta' = J_r(eta)^-1 Omega$, so poses stay in their group to round-off, between steps
    and in dense output, too. SaveAt, Event, progress meters and all adjoints except BacksolveAdjoint are supported.

    For an explicit solver, its tableau is used, and a step is compiled as one small function if this is supported.
    Implicit solvers solve their equations in the coordinates. KenCarp and Sil3, which treat one part implicitly,
    require `diffrax.MultiTerm(lie_term(explicit), lie_term(implicit))`, two systems with the same states.

    Attributes:
        solver: an explicit Runge-Kutta solver (Euler, Heun, Midpoint, Ralston, Bosh3, Tsit5, Dopri5, Dopri8), an
            implicit one (ImplicitEuler, Kvaerno3 to 5, KenCarp3 to 5, Sil3), or a HalfSolver of one.
        dynamics: the compiled system.
        chart: the coordinates. By default exponential coordinates, with as many commutators as the order of an explicit
            solver requires, or in closed form for other solvers.

    Raises:
        ModelError: another kind of solver, a system that is not compiled, an object that is not a chart, or a chart
            that an implicit solver cannot use.

    Source: Munthe-Kaas, High order Runge-Kutta methods on manifolds (1999).
    """

    solver: Any  # type: ignore[misc]
    frame: ChartedSystem = eqx.field(static=True)

    def __init__(self, solver: diffrax.AbstractSolver, dynamics: Dynamics, chart: Chart | None = None) -> None:
        _check(solver, dynamics, chart)
        self.solver = solver
        order: Any = solver.order(None) if _is_explicit(solver) else None
        default = Exponential(commutators=None if order is None else max(1, order - 2))
        self.frame = ChartedSystem(dynamics, default if chart is None else chart)
        _ = self.frame.ambient  # refuses groups without matrices, with their names

    # The interface of diffrax, in part that of the wrapped solver.
    term_structure = property(lambda self: LieTerms, doc="What terms must be.")
    interpolation_cls = property(
        lambda self: _Interpolate(self.solver.interpolation_cls, self.frame), doc="Makes the interpolation of a step."
    )
    scan_kind = property(lambda self: self.solver.scan_kind, doc="Set by ForwardMode and DirectAdjoint.")
    root_finder = property(lambda self: self.solver.root_finder, doc="Of an implicit solver.")
    root_find_max_steps = property(lambda self: self.solver.root_find_max_steps, doc="Its most iterations.")

    def order(self, terms: Any) -> Any:
        """The order of the wrapped solver."""
        return self.solver.order(terms)

    def error_order(self, terms: Any) -> Any:
        """The error order of the wrapped solver. Raises ModelError for terms of another kind."""
        self._parts(terms)
        return self.solver.error_order(terms)

    def func(self, terms: Any, t0: Any, y0: Mapping[str, Any], args: Any) -> Arrays:
        """The rates of the entries of y0, matrices as matrices."""
        parts = self._parts(terms)
        arguments = read_arguments(self.frame.dynamics, parts[0].direction * t0, y0, args)
        rates = [arguments.rates(part.dynamics) for part in parts]
        return self.frame.ambient.rates(arguments.x, jax.tree.map(lambda *parts: sum(parts[1:], parts[0]), *rates))

    def init(self, terms: Any, t0: Any, t1: Any, y0: Mapping[str, Any], args: Any) -> Any:
        """The solver state: the rate at the start, as a body velocity, or the state of the wrapped solver."""
        arguments, h = self._begin(terms, t0, t1, y0, args)
        if not _is_explicit(self.solver):
            return self.solver.init(
                self._in_chart(terms, arguments, h), t0, t1, self.frame.packed(arguments.x)[0], None
            )
        return self._rate(arguments, h) if self._hands_on(arguments) else None

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: Mapping[str, Any], args: Any, solver_state: Any, made_jump: Any
    ) -> tuple[Arrays, Arrays | None, dict[str, Any], Any, Any]:
        """One step in the chart around y0."""
        arguments, h = self._begin(terms, t0, t1, y0, args)
        if not _is_explicit(self.solver):
            return self._wrapped_step(terms, arguments, h, t0, t1, solver_state, made_jump)
        rate = solver_state
        if rate is not None and made_jump is not False:
            anew = any_of_batch(made_jump)
            rate = jax.lax.cond(anew, lambda: self._rate(arguments, h), lambda: solver_state)
        done = explicit_step(self.frame, self.solver.tableau, arguments, h, rate)
        within = {"y0": jnp.zeros_like(done.z), "y1": done.z, "k": done.k}
        handed = done.rate if self._hands_on(arguments) else None
        return done.x, done.error, {"start": arguments.x, "within": within}, handed, diffrax.RESULTS.successful

    def _wrapped_step(
        self, terms: Any, arguments: Arguments, h: jax.Array, t0: Any, t1: Any, state: Any, made_jump: Any
    ) -> tuple[Arrays, Arrays | None, dict[str, Any], Any, Any]:
        """A step of the wrapped solver itself, on the coordinates."""
        frame, local = self.frame, self.frame.local
        # A table may jump at the start of a step, and the last slope is that before the jump.
        made_jump = True if arguments.signals.jumps else made_jump
        inner, (origin, read) = self._in_chart(terms, arguments, h), frame.packed(arguments.x)
        z, e, within, state, result = self.solver.step(inner, t0, t1, origin, None, state, made_jump)
        moved = read(z)
        end = local.settle(local.move(local.enter(arguments.x), moved))
        x = local.value(end)
        error = None if e is None else frame.errors(x, end, read(e))
        if state is not None:
            first, slope = state
            state = first, jax.tree.map(lambda f: self._carried(arguments.x, moved, end, f), slope)
        return x, error, {"start": arguments.x, "within": within}, state, result

    def _in_chart(self, terms: Any, arguments: Arguments, h: jax.Array) -> Any:
        frame, local = self.frame, self.frame.local
        start, read = local.enter(arguments.x), frame.packed(arguments.x)[1]

        def in_chart(part: DirectedSystem) -> Any:
            def slope(t: Any, z: jax.Array, args: None) -> jax.Array:
                blocks = read(z)
                moved = local.move(start, blocks)
                at = dataclasses.replace(arguments, t=jnp.asarray(t, z.dtype), x=local.value(moved))
                return ravel_pytree(local.slope(blocks, moved, frame.rate(part.dynamics, at, arguments.t, h)))[0]

            return wrapped_terms()[0](diffrax.ODETerm(slope), part.direction)

        members = tuple(map(in_chart, self._parts(terms)))
        return diffrax.MultiTerm(*members) if len(members) > 1 else members[0]

    def _carried(self, x: Arrays, z: Blocks, end: Blocks, flat: jax.Array) -> jax.Array:
        """A slope at the end of a step, transformed from the coordinates around the start to those around the end.

        There a slope is the body velocity itself, Omega = J_r(eta) eta'.
        """
        local = self.frame.local
        eta, slopes = local.tangent(z), local.tangent(self.frame.packed(x)[1](flat))
        groups = self.frame.dynamics.group.factors
        omega = {name: group.right_jacobian(eta[name]) @ slopes[name] for name, group in groups.items()}
        return ravel_pytree(local.first_slope(end, local.rate(omega)))[0]

    def _rate(self, arguments: Arguments, h: jax.Array) -> jax.Array:
        return ravel_pytree(self.frame.rate(self.frame.dynamics, arguments, arguments.t, h))[0]

    def _hands_on(self, arguments: Arguments) -> bool:
        """Whether the last stage of a step is the first of the next (FSAL); not if a table may jump in between."""
        return bool(self.solver.tableau.fsal) and not arguments.signals.jumps

    def _begin(self, terms: Any, t0: Any, t1: Any, y0: Mapping[str, Any], args: Any) -> tuple[Arguments, jax.Array]:
        """The arguments at the start of a step, and its length, negative if diffrax integrates backwards."""
        direction = self._parts(terms)[0].direction
        arguments = read_arguments(self.frame.dynamics, direction * t0, y0, args)
        return arguments, jnp.asarray(direction * (t1 - t0), arguments.t.dtype)

    def _parts(self, terms: Any) -> tuple[DirectedSystem, ...]:
        """The systems among the terms. Raises ModelError where they are not those the solver takes."""
        parts = parts_of(terms)
        tableau = getattr(getattr(self.solver, "solver", self.solver), "tableau", None)
        expected = len(tableau.tableaus) if isinstance(tableau, diffrax.MultiButcherTableau) else 1
        if len(parts) != expected:
            take = "one tx.diffrax.lie_term(dynamics)"
            if expected > 1:
                take = "diffrax.MultiTerm(tx.diffrax.lie_term(explicit), tx.diffrax.lie_term(implicit)), two systems "
                take += "whose rates add up"
            raise ModelError(
                f"{type(self.solver).__name__} got {len(parts)} term{'s' * (len(parts) > 1)}.\n  fix: pass {take}"
            )
        for part in parts:
            if part.dynamics.group != self.frame.dynamics.group:
                raise ModelError(
                    f"the term's states are {part.dynamics.group!r}, the solver's {self.frame.dynamics.group!r}.\n"
                    "  fix: pass the same system to lie_term and LieSolver"
                )
        return parts


def _is_explicit(solver: Any) -> bool:
    if not isinstance(solver, diffrax.AbstractERK) or isinstance(solver, diffrax.HalfSolver):
        return False
    return isinstance(solver.tableau, diffrax.ButcherTableau) and not solver.tableau.c1


def _check(solver: Any, dynamics: Any, chart: Any) -> None:
    need_compiled("LieSolver", dynamics)
    if isinstance(solver, type):
        raise ModelError(f"LieSolver expects a solver instance, got its class.\n  fix: {solver.__name__}()")
    inner = solver.solver if type(solver) is diffrax.HalfSolver else solver
    known = (diffrax.AbstractRungeKutta, diffrax.Euler, diffrax.ImplicitEuler)
    if not isinstance(inner, known) or isinstance(inner, diffrax.AbstractWrappedSolver):
        raise ModelError(
            f"LieSolver wraps Runge-Kutta solvers, got {type(solver).__name__}. The stages of a step must be "
            "coordinates around the state at its start.\n"
            "  fix: use diffrax.Tsit5(), diffrax.Dopri8(), diffrax.Kvaerno5() or another Runge-Kutta solver"
        )
    chart_of("LieSolver", chart, Exponential())
    tangents = isinstance(chart, Exponential) and not isinstance(chart, SplitExponential)
    if chart is not None and not tangents and not _is_explicit(solver):
        raise ModelError(
            f"{type(solver).__name__} needs exponential coordinates of the whole state, got {chart!r}.\n"
            "  fix: leave chart out, or pass tx.charts.Exponential()"
        )


# ---- steps chosen by tolerances -----------------------------------------------------------------------------------


class _State(eqx.Module):
    """The state of the PID controller, the tolerances and the system in its chart."""

    pid: Any
    tolerances: Tolerances
    frame: ChartedSystem = eqx.field(static=True)


@dataclasses.dataclass(frozen=True)
class _Probe(RKMK):
    """A method with any error order, to choose the first step."""

    error_order: int = 1


class LieController(diffrax.AbstractAdaptiveStepSizeController):
    """diffrax's PIDController with errors in the tangent space. Made by `controller`.

    Attributes:
        rtol, atol, norm: tolerances for the equations of implicit solvers; atol is the smallest absolute tolerance.
        allowed: the absolute tolerance as passed, a number or a dict by state.
        pid: the controller of the step size.
    """

    rtol: Any
    atol: Any
    norm: Any
    allowed: Any
    pid: diffrax.PIDController

    def wrap(self, direction: Any) -> LieController:
        """The unchanged controller, because it does not depend on the direction of time."""
        return self

    def init(
        self, terms: Any, t0: Any, t1: Any, y0: Mapping[str, Any], dt0: Any, args: Any, func: Any, error_order: Any
    ) -> tuple[Any, _State]:
        """The end of the first step, estimated from the rates if dt0 is None.

        Raises:
            ModelError: terms that are not those of `lie_term`, or another solver around `LieSolver`.
            InputError: tolerances that do not match the system.
        """
        parts = parts_of(terms)
        if type(getattr(func, "__self__", None)) is diffrax.HalfSolver:
            raise ModelError(
                "HalfSolver(LieSolver(...)) compares matrices entry by entry.\n"
                "  fix: use tx.diffrax.LieSolver(diffrax.HalfSolver(...), dynamics)"
            )
        dynamics, direction = parts[0]
        arguments = read_arguments(dynamics, direction * t0, y0, args)
        dtype = jnp.result_type(*arguments.x.values())
        tolerances = tolerances_of(dynamics, self.rtol, self.allowed, dtype)
        frame = ChartedSystem(dynamics, Exponential())
        if dt0 is None:
            room = jnp.asarray(direction * (t1 - t0), arguments.t.dtype)
            length, method = jnp.abs(room), _Probe(EULER, frame.chart, 1 if error_order is None else error_order)
            stepper = Stepper(dynamics, method, arguments.signals, arguments.params)
            y = frame.local.enter(arguments.x)
            rate = stepper.rate(arguments.t, y, jnp.sign(room) * 1e-6 * length)
            h = stepper.first_step(tolerances, arguments.t, y, rate, 1e-3 * length, length)
            dt0 = jax.lax.stop_gradient(jnp.minimum(h, length)).astype(jnp.result_type(t0))
        t_end, pid = self.pid.init(terms, t0, t1, arguments.x, dt0, args, func, error_order)
        return t_end, _State(pid, tolerances, frame)

    def adapt_step_size(
        self, t0: Any, t1: Any, y0: Any, y1_candidate: Any, args: Any, y_error: Any, error_order: Any, state: _State
    ) -> tuple[Any, Any, Any, Any, _State, Any]:
        """As PIDController, with the errors of the step relative to the tolerance."""
        scaled = None
        if y_error is not None:
            before, after, error = jax.lax.stop_gradient((dict(y0), dict(y1_candidate), dict(y_error)))
            local, e = state.frame.local, state.frame.deviations(after, error)
            scaled = state.tolerances.scaled(local, e, local.enter(before), local.enter(after))
            scaled = jnp.where(jnp.isfinite(scaled), scaled, jnp.inf)
        nothing = jnp.zeros(state.frame.dynamics.dimension, y0[next(iter(y0))].dtype)
        results = self.pid.adapt_step_size(t0, t1, nothing, nothing, args, scaled, error_order, state.pid)
        keep, start, end, jumped, pid, result = results
        return keep, start, end, jumped, _State(pid, state.tolerances, state.frame), result


_USUAL = StepControl()


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
    """A step size controller for `LieSolver`: errors are at most atol + rtol x size, measured in the tangent space.

    Errors of rotations are in rad with size 1, those of positions relative to their distance from the origin, those of
    other states entry by entry, as in `tx.integrate`. A plain diffrax.PIDController also works, but compares the
    entries of the matrices.

    Args:
        rtol: relative tolerance.
        atol: absolute tolerance, rtol by default: a number, or a dict by state; for a pose a pair (rotation,
            position).
        pcoeff, icoeff, dcoeff, safety, factormin, factormax, dtmin, dtmax, force_dtmin: as in diffrax.PIDController;
            the defaults are those of `tx.StepControl`.
        step_ts, jump_ts: times at which steps end, and at which rates or controls jump, as in
            diffrax.ClipStepSizeController.
    Raises:
        InputError: when the integration begins, for tolerances that do not match the system.
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
    number("rtol", rtol, "a number from 0 on", lambda value: 0.0 <= value < np.inf)
    allowed = rtol if atol is None else atol
    smallest = functools.reduce(jnp.minimum, [jnp.min(real_array("atol", leaf)) for leaf in jax.tree.leaves(allowed)])
    control = LieController(rtol, smallest, pid.norm, allowed, pid)
    if step_ts is None and jump_ts is None:
        return control
    return diffrax.ClipStepSizeController(control, step_ts=step_ts, jump_ts=jump_ts)
