"""Single precision over a million steps: what rounding takes off a state is added again."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import twistax as tx
from twistax.integrators import Method

MILLION = 1_000_000
F32 = np.float32
RK4 = tx.tableaus.RK4


def clock() -> tx.Dynamics:
    """y' = 1 and z' = 2 t: whatever is off is rounding, of states or of time."""
    y, z = tx.State("y"), tx.State("z", shape=(17,))
    return tx.compile(tx.System(rates={y: 1.0 + 0.0 * y, z: 2.0 * tx.Time() + 0.0 * z}))


ZERO = {"y": F32(0.0), "z": np.zeros(17, F32)}


@pytest.mark.parametrize(
    "method", [tx.RKMK(RK4), tx.RKMK(tx.tableaus.EULER), tx.Magnus(), tx.CommutatorFree()], ids=lambda m: m.name
)
def test_a_million_steps_lose_nothing(method: Method) -> None:
    found = tx.integrate(clock(), ZERO, t1=1e5, steps=MILLION, method=method)
    assert found.xs["y"].dtype == np.float32
    assert float(found.xs["y"][-1]) == pytest.approx(1e5, rel=1e-6)
    # Euler's rule sees the starts of steps.
    short = 1e5 * 0.1 if method.order == 1 else 0.0
    np.testing.assert_allclose(np.float64(found.xs["z"][-1]), 1e10 - short, rtol=1e-6)


def test_without_kernels_too() -> None:
    y = tx.State("y")
    system = tx.compile(tx.System(rates={y: 1.0 + 0.0 * y}), backend=tx.JAX())
    found = tx.integrate(system, {"y": F32(0.0)}, t1=1e5, steps=MILLION)
    assert float(found.xs["y"][-1]) == pytest.approx(1e5, rel=1e-6)


def test_steps_that_are_chosen_lose_nothing() -> None:
    control = tx.StepControl(dtmax=0.05, max_steps=300_000)
    found = tx.integrate(clock(), ZERO, t1=1e4, rtol=1e-4, atol=1.0, control=control)
    assert found.stats.accepted > 190_000
    assert float(found.xs["y"][-1]) == pytest.approx(1e4, rel=1e-6)
    np.testing.assert_allclose(np.float64(found.xs["z"][-1]), 1e8, rtol=1e-6)


CHARTS = [None, tx.charts.Ambient(), tx.charts.Exponential(), tx.charts.SplitExponential()]


@pytest.mark.parametrize("method", [*(tx.RKMK(RK4, chart) for chart in CHARTS), tx.CommutatorFree()], ids=repr)
def test_poses_and_rotations_keep_what_a_step_adds(method: Method) -> None:
    """A circle flown 16 times, and 3741 rad about a fixed axis: 1e-7 of the way, where rounding alone leaves 1e-5."""
    g, R = tx.State("g", group=tx.SE3), tx.State("R", group=tx.SO3)
    rates = {g: np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.01]), R: np.array([0.3, 0.2, 0.1])}
    start = {"g": np.eye(4, dtype=F32), "R": np.eye(3, dtype=F32)}
    found = tx.integrate(tx.compile(tx.System(rates=rates)), start, t1=1e4, steps=MILLION, method=method)
    pose, turned = (np.asarray(found.xs[name][-1], float) for name in ("g", "R"))
    way = np.array([np.sin(100.0), 1.0 - np.cos(100.0), 0.0]) / 0.01
    np.testing.assert_allclose(pose[:3, 3], way, atol=2e-3)
    off = Rotation.from_matrix(turned).inv() * Rotation.from_rotvec(1e4 * rates[R])
    assert off.magnitude() < 4e-4
    np.testing.assert_allclose(turned.T @ turned, np.eye(3), atol=1e-6)


def test_implicit_steps_too() -> None:
    y = tx.State("y")
    system = tx.compile(tx.System(rates={y: 1.0 + 0.0 * y}))
    method = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA3)
    found = tx.integrate(system, {"y": F32(0.0)}, t1=1e4, steps=100_000, method=method)
    assert float(found.xs["y"][-1]) == pytest.approx(1e4, rel=1e-6)


def test_derivatives_and_batches() -> None:
    x, k = tx.State("x"), tx.Parameter("k", value=1.0)
    system = tx.compile(tx.System(rates={x: -k * x}))

    def end(x0: Any, k: Any) -> jax.Array:
        found = tx.integrate(system, {"x": x0}, t1=1.0, steps=500, params={"k": k})
        return found.xs["x"][-1]

    ks = jnp.array([0.5, 1.0, 2.0], jnp.float32)
    exact = np.exp(-np.asarray(ks, float))

    def slopes(k: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        start = jnp.float32(1.0)
        return end(start, k), jax.grad(end, 1)(start, k), jax.jacfwd(end, 1)(start, k)

    values, reverse, forward = jax.jit(jax.vmap(slopes))(ks)
    np.testing.assert_allclose(values, exact, rtol=3e-7)
    np.testing.assert_allclose(reverse, -exact, rtol=3e-5)
    np.testing.assert_allclose(forward, -exact, rtol=3e-5)
    assert reverse.dtype == forward.dtype == jnp.float32


def test_double_precision_carries_nothing_more() -> None:
    method, system = tx.RKMK(RK4), clock()
    plain = method.coordinates(system).enter({"y": jnp.float64(0.0), "z": jnp.zeros(17)})
    single = method.coordinates(system).enter(jax.tree.map(jnp.asarray, ZERO))
    assert [len(jax.tree.leaves(each)) for each in (plain, single)] == [2, 4]
