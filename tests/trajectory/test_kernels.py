"""Steps as one kernel: what XLA makes of the same steps, to rounding, and the same solutions."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from trajectory_systems import HEUN, quick_jit

import twistax as tx
from twistax.lowering import array_call
from twistax.trajectory.decisions import Decisions
from twistax.trajectory.interior_point import InteriorPoint
from twistax.trajectory.stride import no_slopes, ordered, stride

pytest.importorskip("llvmlite")
pytestmark = pytest.mark.usefixtures("optimised")


def fastest() -> tx.trajectory.Problem:
    """Least time with limits, a free duration, and a limit of the path."""
    p, v, u = tx.State("p"), tx.State("v", max=0.8), tx.Control("u", min=-1.0, max=1.0)
    return tx.trajectory.Problem(
        tx.compile(tx.System(rates={p: v, v: u})),
        tx.Minimize(tx.Time()),
        nodes=6,
        final_time=(0.5, 6.0),
        initial={p: 0.0, v: 0.0},
        final={p: 1.0, v: 0.0},
        **HEUN,
    )


def flyer() -> tx.trajectory.Problem:
    """Poses: least work to turn and move past a ball."""
    g, twist = tx.State("g", group=tx.SE3), tx.Control("V", shape=(6,))
    clear = tx.linalg.Norm(g[:3, 3] - np.array([1.0, 0.0, 0.0])) >= 0.5
    return tx.trajectory.Problem(
        tx.compile(tx.System(rates={g: twist}, constraints=[clear])),
        tx.Minimize(tx.trajectory.Integral(twist @ twist)),
        nodes=5,
        final_time=2.0,
        initial={g: np.eye(4)},
        final={g: tx.pose(position=[2.0, 0.1, 0.0], euler=[0.0, 0.5, 1.0])},
        **HEUN,
    )


@pytest.mark.parametrize("make", [fastest, flyer])
def test_steps_are_those_of_XLA(make: Any) -> None:
    problem = make()
    point, given, *_ = problem.started()
    point, given = jax.tree.map(jnp.asarray, (point, given))
    solver = problem._solver(1e-6, point, given)
    method = InteriorPoint(problem.shooting, 1e-6)
    opening = solver.steps.opened(point, given)
    state, memory = opening.state, opening.memory

    def steps(*arguments: Any) -> Any:
        return stride(method, Decisions(problem.shooting, 1e-6), 1e-6, *arguments)

    by_kernel = jax.jit(lambda *a: array_call.array_call(steps, *a))
    assert "twistax_" in by_kernel.lower(state, no_slopes(problem.shooting), memory, given, ordered()).as_text()
    slopes, by_xla = no_slopes(problem.shooting), quick_jit(steps)
    for most in (0, 1, 3):
        orders = ordered(look=most == 0, decide=True, most=most, before=np.inf)
        own, other = (f(state, slopes, memory, given, orders) for f in (by_kernel, by_xla))
        assert int(own.count) == int(other.count)
        for a, b in zip(jax.tree.leaves(own), jax.tree.leaves(other), strict=True):
            size = np.abs(np.asarray(b, float)[np.isfinite(b)]).max(initial=1.0)
            np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-8 * size)
        state, slopes, memory = other.state, other.slopes, other.memory


def test_solutions_without_kernels_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    found = fastest().solve()
    monkeypatch.setattr(array_call, "installed", lambda: False)
    plain = fastest().solve()
    assert plain.status is found.status is tx.trajectory.Status.SOLVED
    assert plain.iterations == found.iterations
    np.testing.assert_allclose(plain.cost, found.cost, rtol=1e-9)
