"""The overhead of a call of `tx.integrate` in addition to its steps: in Python, and for saved times."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

import twistax as tx

from ...mechanics import chain_models, forward_dynamics
from ..harness.expected import at_most, between
from ..harness.measurement import Section, table
from ..harness.timing import Race, Repeats, Timed

_SAVED = 301


def _body() -> tuple[tx.Dynamics, dict[str, Any], dict[str, Any]]:
    """A body in a wind that is a table of time, 20 s."""
    g, V, wind = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,)), tx.Control("wind", shape=(3,))
    M = np.diag([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
    air = V[:3] - g[:3, :3].T @ wind
    drag = tx.Concat(-0.1 * tx.linalg.Norm(air) * air, np.zeros(3))
    rates: dict[Any, Any] = {g: V, V: tx.linalg.Solve(M, drag - tx.lie.AdjointDual(V, M @ V))}
    gusts = np.random.default_rng(0).normal(size=(21, 3))
    u = {"wind": tx.FirstOrderHold(np.linspace(0.0, 20.0, 21), gusts)}
    x0 = {"g": tx.pose(), "V": np.array([1.0, 0.0, 0.0, 0.1, 2.0, 0.1])}
    return tx.compile(tx.System(rates)), x0, {"t1": 20.0, "rtol": 1e-9, "atol": 1e-9, "u": u}


def _panda() -> tuple[tx.Dynamics, dict[str, Any], dict[str, Any]]:
    """A Panda that falls against damping, 2 s."""
    q, qd, tau = tx.State("q", shape=(7,)), tx.State("qd", shape=(7,)), tx.Control("tau", shape=(7,))
    rates: dict[Any, Any] = {q: qd, qd: forward_dynamics(chain_models.panda(), q, qd, tau - 0.5 * qd)}
    x0 = {"q": np.full(7, 0.3), "qd": np.zeros(7)}
    return tx.compile(tx.System(rates)), x0, {"t1": 2.0, "rtol": 1e-8, "atol": 1e-8, "u": {"tau": np.zeros(7)}}


_END, _IN_JIT, _MADE = "end alone", "end alone, in jit", "of a simulator"
_STEPS, _POLYNOMIALS = "rows by steps", "rows by polynomials"


def called(make: Callable[[], Any]) -> dict[str, Timed]:
    """Five calls of one rollout, those with saved times inside of `jit`; all have the same end."""
    dynamics, x0, options = make()
    saved = {"save_at": np.linspace(0.0, options["t1"], _SAVED)}
    in_jit: dict[str, Any] = {_IN_JIT: {}, _STEPS: saved, _POLYNOMIALS: saved | {"between": tx.Between.POLYNOMIAL}}

    def jitted(more: dict[str, Any]) -> Timed:
        run = jax.jit(lambda x: tx.integrate(dynamics, x, **options, **more).xs)
        return Timed(lambda: run(x0))

    fly = tx.simulator(dynamics, x0, **options)
    programs = {_END: Timed(lambda: tx.integrate(dynamics, x0, **options).xs), _MADE: Timed(lambda: fly(x0).xs)}
    return programs | {name: jitted(more) for name, more in in_jit.items()}


def _race(make: Callable[[], Any]) -> Race:
    return Race(
        lambda: called(make), 1e-6, Repeats(15, 7), lambda xs: {name: values[-1] for name, values in xs.items()}
    )


CALLS: Section = table(
    {"a body in a wind table": _race(_body), "a Panda": _race(_panda)},
    {
        f"a call, {_IN_JIT}": (between(unit="ms"), lambda race: race.seconds(_IN_JIT, 1e-3)),
        "a call over the same in jit": (between(), lambda race: race.ratio(_END, _IN_JIT)),
        "a call of a simulator over the same in jit": (at_most(1.3), lambda race: race.ratio(_MADE, _IN_JIT)),
        f"{_SAVED} {_STEPS} over none, in jit": (between(), lambda race: race.ratio(_STEPS, _IN_JIT)),
        f"{_SAVED} {_POLYNOMIALS} over none, in jit": (at_most(1.2), lambda race: race.ratio(_POLYNOMIALS, _IN_JIT)),
    },
)
