"""What cannot work inside diffrax says so at once, and how to mend it."""

from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lie_solver_cases import halves, last, start, top
from lie_solver_cases import solve as solve_top

import twistax as tx

LIE = tx.diffrax.lie_term(top())
TSIT5 = tx.diffrax.LieSolver(diffrax.Tsit5(), top())


def solve(term: Any, solver: Any, x: Any = None, **rest: Any) -> Any:
    return diffrax.diffeqsolve(term, solver, 0.0, 1.0, 0.1, start() if x is None else x, **rest)


@pytest.mark.parametrize(
    "solver", [diffrax.Euler(), diffrax.Heun(), diffrax.Tsit5(), diffrax.HalfSolver(diffrax.Heun())]
)
def test_the_term_without_the_solver(solver: Any) -> None:
    with pytest.raises(tx.ModelError, match=r"body velocities.*\n  fix: wrap the solver, tx.diffrax.LieSolver"):
        solve(LIE, solver)


def test_the_solver_without_the_term() -> None:
    ambient = tx.diffrax.ambient_term(top())
    for term in (ambient, diffrax.ODETerm(lambda t, y, args: y), diffrax.MultiTerm(LIE, ambient)):
        with pytest.raises(tx.ModelError, match=r"need terms of tx.diffrax.lie_term, got (AmbientTerm|ODETerm)"):
            solve(term, TSIT5)


def test_the_controller_without_the_solver() -> None:
    ambient, control = tx.diffrax.ambient_term(top()), tx.diffrax.controller(1e-6)
    with pytest.raises(tx.ModelError, match=r"controller need terms of .*lie_term, got AmbientTerm"):
        solve(ambient, diffrax.Tsit5(), ambient.to_ambient(start()), stepsize_controller=control)
    with pytest.raises(tx.ModelError, match="compares matrices entry by entry"):
        solve(LIE, diffrax.HalfSolver(TSIT5), stepsize_controller=control)


def test_backsolve_adjoint() -> None:
    def end(w: jax.Array, adjoint: Any) -> jax.Array:
        return last(solve_top(diffrax.Tsit5(), 1.0, 0.1, {"R": start()["R"], "w": w}, adjoint=adjoint))["w"].sum()

    with pytest.raises(tx.ModelError, match=r"BacksolveAdjoint cannot work on groups(.|\n)*fix: leave adjoint out"):
        jax.grad(end)(jnp.asarray(start()["w"]), diffrax.BacksolveAdjoint())
    with pytest.raises(tx.ModelError, match="BacksolveAdjoint with a custom solver"):
        jax.grad(end)(jnp.asarray(start()["w"]), diffrax.BacksolveAdjoint(solver=diffrax.Dopri5()))


def test_solvers_that_are_no_runge_kutta_methods(unchecked: None) -> None:
    for solver in (diffrax.ReversibleHeun(), diffrax.LeapfrogMidpoint(), diffrax.SPaRK(), TSIT5, "Tsit5"):
        with pytest.raises(tx.ModelError, match="LieSolver wraps Runge-Kutta solvers, got"):
            tx.diffrax.LieSolver(solver, top())
    with pytest.raises(tx.ModelError, match=r"got its class.\n  fix: Tsit5\(\)"):
        tx.diffrax.LieSolver(diffrax.Tsit5, top())
    with pytest.raises(tx.ModelError, match="expects a compiled system, got System"):
        tx.diffrax.LieSolver(diffrax.Tsit5(), top().system)
    with pytest.raises(tx.ModelError, match="expects a compiled system, got System"):
        tx.diffrax.lie_term(top().system)
    with pytest.raises(tx.ModelError, match="expects a chart"):
        tx.diffrax.LieSolver(diffrax.Tsit5(), top(), "exponential")
    with pytest.raises(tx.ModelError, match="Kvaerno5 needs exponential coordinates"):
        tx.diffrax.LieSolver(diffrax.Kvaerno5(), top(), tx.charts.Ambient())


def test_the_number_of_terms() -> None:
    both = diffrax.MultiTerm(*(tx.diffrax.lie_term(half) for half in halves()))
    with pytest.raises(tx.ModelError, match=r"Tsit5 got 2 terms.\n  fix: pass one"):
        solve(both, TSIT5)
    control = tx.diffrax.controller(1e-6)
    with pytest.raises(tx.ModelError, match=r"KenCarp4 got 1 term.\n  fix: pass diffrax.MultiTerm"):
        solve(LIE, tx.diffrax.LieSolver(diffrax.KenCarp4(), top()), stepsize_controller=control)


def test_another_system() -> None:
    v = tx.State("v", shape=(3,))
    other = tx.compile(tx.System(rates={v: -v}))
    with pytest.raises(tx.ModelError, match="the same system"):
        solve(tx.diffrax.lie_term(other), TSIT5, {"v": np.ones(3)})


def test_arguments_and_tolerances() -> None:
    with pytest.raises(tx.InputError, match="args expects"):
        solve(LIE, TSIT5, args={"J": np.ones(3)})
    with pytest.raises(tx.InputError, match="unknown key 'K' in params"):
        solve(LIE, TSIT5, args=(None, {"K": np.ones(3)}))
    with pytest.raises(tx.InputError, match="below"):
        solve(LIE, TSIT5, stepsize_controller=tx.diffrax.controller(1e-17))
    with pytest.raises(tx.InputError, match="no entry for state 'w'"):
        solve(LIE, TSIT5, stepsize_controller=tx.diffrax.controller(1e-8, {"R": 1e-8}))
    with pytest.raises(RuntimeError, match="error estimates"):
        solve(LIE, tx.diffrax.LieSolver(diffrax.Euler(), top()), stepsize_controller=tx.diffrax.controller(1e-8))
