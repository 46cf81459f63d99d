"""Any Runge-Kutta solver of diffrax as a Lie-group solver."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ...errors import InputError, ModelError
from ...jax_inside import any_of_batch, wrapped_terms
from ...lowering import Dynamics
from ...lowering.dynamics import Arrays, not_compiled
from ..ambient import Arguments, read_arguments
from ..charts import Chart, Exponential, SplitExponential
from ..charts.coordinates import Blocks, chart_of
from ..controls import ByName
from .frame import ChartStep, Frame
from .term import LieTerms, Part, parts_of

__all__ = ["LieInterpolation", "LieSolver"]


class LieInterpolation(diffrax.AbstractLocalInterpolation):
    """The state within a step: the wrapped solver's interpolation of the coordinates, moved from the start."""

    t0: Any  # type: ignore[misc]
    t1: Any  # type: ignore[misc]
    start: Any
    coordinates: diffrax.AbstractLocalInterpolation
    frame: Frame = eqx.field(static=True)

    def evaluate(self, t0: Any, t1: Any = None, left: bool = True) -> Arrays:
        """The state at t0, in its group. Raises InputError for an increment, which has no meaning on a group."""
        if t1 is not None:
            raise InputError(
                "an increment between two times has no meaning for states on groups.\n"
                "  fix: evaluate at both times and take dynamics.difference(x, y)"
            )
        local, x = self.frame.local, dict(self.start)
        z = self.frame.read_coordinates(x, self.coordinates.evaluate(t0, left=left))
        return local.value(local.settle(local.move(local.enter(x), z)))


@dataclasses.dataclass(frozen=True)
class _Interpolate:
    """Makes the interpolation of one step. A value, as diffrax keeps it as structure."""

    coordinates: Any
    frame: Frame

    def __call__(self, *, t0: Any, t1: Any, start: Any, within: Any) -> LieInterpolation:
        return LieInterpolation(t0, t1, start, self.coordinates(t0=t0, t1=t1, **within), self.frame)


class LieSolver(diffrax.AbstractWrappedSolver):
    """A Runge-Kutta-Munthe-Kaas method inside diffrax: the wrapped solver in coordinates around the start of each step.

        term, solver = tx.diffrax.lie_term(dynamics), tx.diffrax.LieSolver(diffrax.Tsit5(), dynamics)
        control = tx.diffrax.controller(rtol=1e-9, atol=1e-9)
        sol = diffrax.diffeqsolve(term, solver, 0.0, 10.0, None, x0, args=(u, params), stepsize_controller=control)

    y is the state as `tx.integrate` takes it: a dict, poses as (4, 4), rotations as (3, 3). With g = g_0 Exp(eta) the
    wrapped solver integrates eta' = J_r(eta)^-1 Omega, so poses stay in their group to round-off, between steps and in
    dense output too. SaveAt, Event, progress meters and all adjoints but BacksolveAdjoint work.

    Explicit solvers lend their tableau, and a step is compiled as one small function where that is known to work.
    Implicit ones solve their equations in the coordinates. KenCarp and Sil3, which treat one part implicitly, take
    `diffrax.MultiTerm(lie_term(explicit), lie_term(implicit))`, two systems with the same states.

    Attributes:
        solver: an explicit Runge-Kutta solver (Euler, Heun, Midpoint, Ralston, Bosh3, Tsit5, Dopri5, Dopri8), an
            implicit one (ImplicitEuler, Kvaerno3 to 5, KenCarp3 to 5, Sil3), or a HalfSolver of one.
        dynamics: the compiled system.
        chart: the coordinates; exponential ones if left out, with as many commutators as an explicit solver's order
            needs, in closed form for the others.

    Raises:
        ModelError: another kind of solver, no compiled system, no chart, or a chart that an implicit solver cannot use.

    Source: Munthe-Kaas, High order Runge-Kutta methods on manifolds (1999).
    """

    solver: Any  # type: ignore[misc]
    frame: Frame = eqx.field(static=True)

    def __init__(self, solver: diffrax.AbstractSolver, dynamics: Dynamics, chart: Chart | None = None) -> None:
        _check(solver, dynamics, chart)
        self.solver = solver
        self.frame = Frame(dynamics, _default_chart(solver) if chart is None else chart)
        _ = self.frame.ambient  # refuses groups without matrices, by name

    @property
    def term_structure(self) -> Any:
        """Terms of `lie_term`; diffrax asks before the first step."""
        return LieTerms

    @property
    def interpolation_cls(self) -> Any:  # type: ignore[override]
        """Makes the interpolation within a step."""
        return _Interpolate(self.solver.interpolation_cls, self.frame)

    @property
    def scan_kind(self) -> Any:
        """The wrapped solver's: ForwardMode and DirectAdjoint set it."""
        return self.solver.scan_kind

    @property
    def root_finder(self) -> Any:
        """The wrapped solver's."""
        return self.solver.root_finder

    @property
    def root_find_max_steps(self) -> int:
        """The wrapped solver's."""
        return self.solver.root_find_max_steps

    def order(self, terms: Any) -> Any:
        """The wrapped solver's."""
        return self.solver.order(terms)

    def error_order(self, terms: Any) -> Any:
        """The wrapped solver's. Raises ModelError for terms that do not fit."""
        self._parts(terms)
        return self.solver.error_order(terms)

    def func(self, terms: Any, t0: Any, y0: Mapping[str, Any], args: Any) -> Arrays:
        """The rates of the entries of y0, matrices changing as matrices do; for what diffrax measures with them."""
        parts = self._parts(terms)
        given = read_arguments(self.frame.dynamics, parts[0].direction * t0, y0, args)
        found = [given.rates(part.dynamics) for part in parts]
        return self.frame.ambient.rates(given.x, jax.tree.map(lambda *parts: sum(parts[1:], parts[0]), *found))

    def init(self, terms: Any, t0: Any, t1: Any, y0: Mapping[str, Any], args: Any) -> Any:
        """What a step hands to the next: the rate there, as a body velocity, or the wrapped solver's state."""
        given, h = self._begin(terms, t0, t1, y0, args)
        if not _is_explicit(self.solver):
            return self.solver.init(self._in_chart(terms, given, h), t0, t1, self._origin(given.x), None)
        return self._rate(given, h) if self._hands_on(given) else None

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: Mapping[str, Any], args: Any, solver_state: Any, made_jump: Any
    ) -> tuple[Arrays, Arrays | None, dict[str, Any], Any, Any]:
        """One step in the chart around y0."""
        given, h = self._begin(terms, t0, t1, y0, args)
        if not _is_explicit(self.solver):
            return self._wrapped_step(terms, given, h, t0, t1, solver_state, made_jump)
        rate = solver_state
        if rate is not None and made_jump is not False:
            anew = any_of_batch(made_jump)
            rate = jax.lax.cond(anew, lambda: self._rate(given, h), lambda: solver_state)
        done = ChartStep(self.frame, self.solver.tableau)(given, h, rate)
        within = {"y0": jnp.zeros_like(done.z), "y1": done.z, "k": done.k}
        handed = done.rate if self._hands_on(given) else None
        return done.x, done.error, {"start": given.x, "within": within}, handed, diffrax.RESULTS.successful

    def _wrapped_step(
        self, terms: Any, given: Arguments, h: jax.Array, t0: Any, t1: Any, state: Any, made_jump: Any
    ) -> tuple[Arrays, Arrays | None, dict[str, Any], Any, Any]:
        """A step of the wrapped solver itself, on the coordinates."""
        frame, local = self.frame, self.frame.local
        # A table may jump where a step begins, and the last slope is that before the jump.
        made_jump = True if _reads_tables(given) else made_jump
        inner = self._in_chart(terms, given, h)
        z, e, within, state, result = self.solver.step(inner, t0, t1, self._origin(given.x), None, state, made_jump)
        moved = frame.read_coordinates(given.x, z)
        end = local.settle(local.move(local.enter(given.x), moved))
        x = local.value(end)
        error = None if e is None else frame.errors(x, end, frame.read_coordinates(given.x, e))
        if state is not None:
            first, slope = state
            state = first, jax.tree.map(lambda f: self._carried(given.x, moved, end, f), slope)
        return x, error, {"start": given.x, "within": within}, state, result

    def _in_chart(self, terms: Any, given: Arguments, h: jax.Array) -> Any:
        """The terms in coordinates around the start of a step."""
        frame, local = self.frame, self.frame.local
        start = local.enter(given.x)

        WrapTerm, _ = wrapped_terms()

        def of(part: Part) -> Any:
            def slope(t: Any, z: jax.Array, args: None) -> jax.Array:
                blocks = frame.read_coordinates(given.x, z)
                moved = local.move(start, blocks)
                at = given._replace(t=jnp.asarray(t, z.dtype), x=local.value(moved))
                return ravel_pytree(local.slope(blocks, moved, frame.rate(part.dynamics, at, given.t, h)))[0]

            return WrapTerm(diffrax.ODETerm(slope), part.direction)

        members = tuple(of(part) for part in self._parts(terms))
        return diffrax.MultiTerm(*members) if len(members) > 1 else members[0]

    def _carried(self, x: Arrays, z: Blocks, end: Blocks, flat: jax.Array) -> jax.Array:
        """A slope at the end of a step, in the coordinates around its start, in those around its end.

        There a slope is the body velocity itself, Omega = J_r(eta) eta'.
        """
        local = self.frame.local
        eta, slopes = local.tangent(z), local.tangent(self.frame.read_coordinates(x, flat))
        groups = self.frame.dynamics.group.factors
        omega = {name: group.right_jacobian(eta[name]) @ slopes[name] for name, group in groups.items()}
        return ravel_pytree(local.first_slope(end, local.rate(omega)))[0]

    def _rate(self, given: Arguments, h: jax.Array) -> jax.Array:
        """The rate at the start of a step, flat."""
        return ravel_pytree(self.frame.rate(self.frame.dynamics, given, given.t, h))[0]

    def _hands_on(self, given: Arguments) -> bool:
        """Whether the last stage of a step is the first of the next; not where a table may jump in between."""
        return bool(self.solver.tableau.fsal) and not _reads_tables(given)

    def _origin(self, x: Arrays) -> jax.Array:
        local = self.frame.local
        return jnp.zeros_like(ravel_pytree(local.first_slope(local.enter(x), self.frame.still(x)))[0])

    def _begin(self, terms: Any, t0: Any, t1: Any, y0: Mapping[str, Any], args: Any) -> tuple[Arguments, jax.Array]:
        """The arguments where a step begins, and its length, negative where diffrax integrates backwards."""
        direction = self._parts(terms)[0].direction
        given = read_arguments(self.frame.dynamics, direction * t0, y0, args)
        return given, jnp.asarray(direction * (t1 - t0), given.t.dtype)

    def _parts(self, terms: Any) -> tuple[Part, ...]:
        """The systems among the terms. Raises ModelError where they are not those the solver takes."""
        parts = parts_of(terms)
        expected, name = _terms_taken(self.solver), type(self.solver).__name__
        if len(parts) != expected:
            take = (
                "diffrax.MultiTerm(tx.diffrax.lie_term(explicit), tx.diffrax.lie_term(implicit)), two systems whose "
                "rates add up"
                if expected > 1
                else "one tx.diffrax.lie_term(dynamics)"
            )
            raise ModelError(f"{name} got {len(parts)} term{'s' * (len(parts) > 1)}.\n  fix: give it {take}")
        for part in parts:
            if part.dynamics.group != self.frame.dynamics.group:
                raise ModelError(
                    f"the term's states are {part.dynamics.group!r}, the solver's {self.frame.dynamics.group!r}.\n"
                    "  fix: give lie_term and LieSolver the same system"
                )
        return parts


def _is_explicit(solver: Any) -> bool:
    """Whether the solver's tableau is all there is to it."""
    if not isinstance(solver, diffrax.AbstractERK) or isinstance(solver, diffrax.HalfSolver):
        return False
    return isinstance(solver.tableau, diffrax.ButcherTableau) and not solver.tableau.c1


def _reads_tables(given: Arguments) -> bool:
    return isinstance(given.signals, ByName) and bool(given.signals.jumps)


def _terms_taken(solver: Any) -> int:
    """How many terms a solver takes."""
    tableau = getattr(getattr(solver, "solver", solver), "tableau", None)
    return len(tableau.tableaus) if isinstance(tableau, diffrax.MultiButcherTableau) else 1


def _check(solver: Any, dynamics: Any, chart: Any) -> None:
    if not isinstance(dynamics, Dynamics):
        raise not_compiled("LieSolver", dynamics)
    if isinstance(solver, type):
        raise ModelError(f"LieSolver expects a solver, got its class.\n  fix: {solver.__name__}()")
    inner = solver.solver if type(solver) is diffrax.HalfSolver else solver
    known = (diffrax.AbstractRungeKutta, diffrax.Euler, diffrax.ImplicitEuler)
    if not isinstance(inner, known) or isinstance(inner, diffrax.AbstractWrappedSolver):
        raise ModelError(
            f"LieSolver wraps Runge-Kutta solvers, got {type(solver).__name__}: its steps do not stay in coordinates "
            "around one start.\n"
            "  fix: take diffrax.Tsit5(), diffrax.Dopri8(), diffrax.Kvaerno5() or another Runge-Kutta solver"
        )
    chart_of("LieSolver", chart, Exponential())
    tangents = isinstance(chart, Exponential) and not isinstance(chart, SplitExponential)
    if chart is not None and not tangents and not _is_explicit(solver):
        raise ModelError(
            f"{type(solver).__name__} needs exponential coordinates of the whole state, got {chart!r}.\n"
            "  fix: leave chart out, or take tx.charts.Exponential()"
        )


def _default_chart(solver: Any) -> Chart:
    if not _is_explicit(solver):
        return Exponential()
    return Exponential(commutators=max(1, solver.order(None) - 2))
