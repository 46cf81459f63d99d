"""By default batches of small functions are kernels, one member alone is not; and the numbers are the same."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental import jet

import twistax as tx
from twistax.mechanics import ALIGNED, chain_models, frame_jacobian, mass_matrix

pytest.importorskip("llvmlite")

RNG = np.random.default_rng(4)
w, torque = tx.State("w", shape=(3,)), tx.Control("torque", shape=(3,))
INERTIA = np.diag([1.0, 2.0, 3.0])
#: Some twenty operations.
SMALL = tx.System(rates={w: tx.linalg.Solve(INERTIA, torque - tx.linalg.Cross(w, INERTIA @ w))})


def rate(backend: Any = "auto") -> Any:
    dynamics = tx.compile(SMALL, backend=backend)
    return lambda w, torque: dynamics(0.0, {"w": w}, {"torque": torque})["w"]


def drawn(rows: int) -> tuple[Any, Any]:
    return jnp.asarray(RNG.normal(size=(rows, 3))), jnp.asarray(RNG.normal(size=(rows, 3)))


def calls_kernel(function: Any, *arguments: Any) -> bool:
    return "twistax_" in jax.jit(function).lower(*arguments).as_text()


def test_enough_operations_in_a_batch_are_a_kernel() -> None:
    ws, torques = drawn(1000)
    batched = jax.vmap(rate(), (0, None))
    assert calls_kernel(batched, ws, torques[0])
    assert not calls_kernel(batched, ws[:4], torques[0])
    assert not calls_kernel(rate(), ws[0], torques[0])
    np.testing.assert_allclose(batched(ws, torques[0]), jax.vmap(rate(tx.JAX()), (0, None))(ws, torques[0]), atol=1e-14)


def test_batches_that_mostly_move_numbers_stay_with_xla() -> None:
    """A kernel reads rows of members, which XLA's loops over entries do not have to."""
    x = tx.State("x", shape=(3,))
    dynamics = tx.compile(tx.System(rates={x: -0.5 * x}))
    assert not calls_kernel(jax.vmap(lambda x: dynamics(0.0, {"x": x})["x"]), drawn(1000)[0])


def test_functions_of_a_robot_are_kernels_in_batches() -> None:
    arm = chain_models.panda()
    q, qd = tx.State("q", shape=(7,)), tx.State("qd", shape=(7,))
    outputs = {"M": mass_matrix(arm, q), "J": frame_jacobian(arm, arm.links[-1].name, q, axes=ALIGNED)}
    system, qs = tx.System(rates={q: qd, qd: -qd}, outputs=outputs), jnp.asarray(RNG.normal(size=(40, 7)))

    def of(backend: Any) -> Any:
        dynamics = tx.compile(system, backend=backend)
        return jax.vmap(lambda q: dynamics.outputs(0.0, {"q": q, "qd": q}))

    assert calls_kernel(of("auto"), qs)
    for name, found in of("auto")(qs).items():
        np.testing.assert_allclose(found, of(tx.JAX())(qs)[name], atol=1e-13)


# ---- transformations -------------------------------------------------------------------------------------------------


def test_derivatives_of_batches_are_those_of_arrays() -> None:
    ws, torques = drawn(50)

    def derivatives(rate: Any) -> dict[str, Any]:
        def total(w: Any, torque: Any) -> Any:
            return (jnp.sin(rate(w, torque)) * w).sum()

        return {
            "grad": jax.vmap(jax.grad(total, (0, 1)))(ws, torques),
            "of the sum": jax.grad(lambda ws: jax.vmap(total, (0, None))(ws, torques[0]).sum())(ws),
            "jacfwd": jax.vmap(jax.jacfwd(rate))(ws, torques),
            "jacrev": jax.vmap(jax.jacrev(rate, 1))(ws, torques),
            "hessian": jax.vmap(jax.hessian(total))(ws, torques),
            "twice": jax.vmap(jax.vmap(rate, (0, None)), (None, 0))(ws[:20], torques[:30]),
            "in a scan": jax.lax.scan(lambda c, u: (c + 0.1 * jax.vmap(rate)(c, torques), u), ws, None, 5)[0],
        }

    found, expected = jax.jit(derivatives, static_argnums=0), derivatives(rate(tx.JAX()))
    for name, own in found(rate()).items():
        for a, b in zip(jax.tree.leaves(own), jax.tree.leaves(expected[name]), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-12, err_msg=name)


def test_gradients_of_batches() -> None:
    ws, torques = drawn(50)

    def slope(rate: Any) -> Any:
        return jax.jit(jax.grad(lambda ws: (jax.vmap(rate, (0, None))(ws, torques[0]) ** 2).sum()))

    found, expected = slope(rate()), slope(rate(tx.JAX()))
    assert calls_kernel(found, ws)
    np.testing.assert_allclose(found(ws), expected(ws), atol=1e-13)


def test_taylor_series() -> None:
    (ws, torques), series = drawn(100), [jnp.ones((100, 3)), jnp.zeros((100, 3))]
    for backend in ("auto", tx.JAX()):
        batched = jax.vmap(rate(backend), (0, None))
        found = jet.jet(lambda ws, f=batched: f(ws, torques[0]), (ws,), (series,))
        if backend == "auto":
            own = found
    for a, b in zip(jax.tree.leaves(own), jax.tree.leaves(found), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_exported_programs_call_no_kernel() -> None:
    """They run in other processes, as those of small functions always did."""
    ws, torques = drawn(1000)
    exported = jax.export.export(jax.jit(jax.vmap(rate())))(ws, torques)
    assert "twistax_" not in exported.mlir_module()
    np.testing.assert_allclose(exported.call(ws, torques), jax.vmap(rate(tx.JAX()))(ws, torques), atol=1e-14)


def test_it_is_part_of_kernels_around_it() -> None:
    ws, torques = drawn(1)
    small = rate()

    @tx.fast
    def rollout(w: Any, torque: Any) -> Any:
        return jax.lax.scan(lambda w, _: (w + 1e-3 * small(w, torque), None), w, None, 1000)[0]

    assert rollout.explain(ws[0], torques[0]) == "scan: all iterations in one kernel"
    plain = rate(tx.JAX())
    expected = jax.lax.fori_loop(0, 1000, lambda k, w: w + 1e-3 * plain(w, torques[0]), ws[0])
    np.testing.assert_allclose(rollout(ws[0], torques[0]), expected, atol=1e-12)


def test_explain_says_so() -> None:
    assert "batches of 500 operations and more are kernels" in str(tx.compile(SMALL).explain())
