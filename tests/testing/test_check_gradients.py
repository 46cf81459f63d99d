"""`check_gradients` passes derivatives that are right, and sees wrong, one-sided and missing ones."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.testing import LawError, check_gradients

x, v = tx.State("x"), tx.State("v")
DYNAMICS = tx.compile(tx.System(rates={x: v, v: -tx.Sin(x) * tx.Parameter("k", value=2.0)}))


def end(start: dict[str, Any], k: Any) -> dict[str, Any]:
    return tx.integrate(DYNAMICS, start, t1=1.0, dt=0.1, params={"k": k}).last


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_right_derivatives_pass(dtype: Any) -> None:
    start = {"x": dtype(0.3), "v": dtype(-0.2)}
    check_gradients(end, start, dtype(2.0))
    matrix = np.arange(6.0, dtype=dtype).reshape(2, 3)
    check_gradients(lambda a, n: {"product": a.T @ a, "count": n, "norm": 1e6 * jnp.sum(a**n)}, matrix, 3)
    check_gradients(lambda a: jnp.zeros(3, a.dtype), matrix)


def test_of_a_pose_by_its_tangent() -> None:
    g = np.asarray(tx.pose(position=[1.0, 2.0, 3.0], euler=[0.3, -0.4, 0.5]))
    check_gradients(lambda d: tx.lie.se3.log(g @ tx.lie.se3.exp(d)), np.full(6, 0.1))


def with_derivatives(forward: Any, reverse: Any) -> Any:
    """The sine, with these factors in place of one in its forward and its reverse derivative."""

    @jax.custom_jvp
    def sine(a: Any) -> Any:
        return jnp.sin(a)

    linear = jax.custom_derivatives.linear_call
    slope = lambda c, t: forward * c * t  # noqa: E731
    sine.defjvp(lambda p, t: (jnp.sin(p[0]), linear(slope, lambda c, t: reverse * c * t, jnp.cos(p[0]), t[0])))
    return sine


def test_wrong_derivatives_are_seen() -> None:
    point = {"a": np.ones(2), "b": np.array([0.5, 1.5])}
    f = lambda wrong: lambda q: jnp.sum(q["a"] ** 2) + with_derivatives(*wrong)(q["b"]).sum()  # noqa: E731
    check_gradients(f((1.0, 1.0)), point)
    with pytest.raises(LawError, match=r"the derivative by arguments\[0\]\['b'\] is that of the values"):
        check_gradients(f((1.001, 1.001)), point)
    with pytest.raises(LawError, match=r"reverse = forward by arguments\[0\]\['b'\]"):
        check_gradients(f((1.0, 1.001)), point)
    check_gradients(f((1.001, 1.001)), point, tolerance=1e-2)


def test_missing_and_infinite_derivatives_are_seen() -> None:
    @jax.custom_vjp
    def reverse_alone(a: Any) -> Any:
        return a

    reverse_alone.defvjp(lambda a: (a, None), lambda _, w: (w,))
    with pytest.raises(LawError, match="it has forward and reverse derivatives by arguments"):
        check_gradients(reverse_alone, 1.0)
    with pytest.raises(LawError, match=r"derivatives by arguments\[0\] are finite"):
        check_gradients(jnp.sqrt, np.zeros(2))


def test_bad_calls_are_refused() -> None:
    with pytest.raises(tx.InputError, match=r"write 1\.0 for 1"):
        check_gradients(lambda n: n, 1)
    with pytest.raises(tx.InputError, match="step must be above zero"):
        check_gradients(jnp.sin, 1.0, step=0.0)
