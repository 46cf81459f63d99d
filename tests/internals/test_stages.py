"""The loop over stages inside and outside of a small function, against the loop written out in NumPy."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.integrators.methods.rkmk import stage_slopes
from twistax.integrators.tableaus import ButcherTableau, StageRows
from twistax.scalar.small_call import small_call, stored_once

pytestmark = pytest.mark.skipif(jax.default_backend() != "cpu", reason="small calls are for the CPU")

_MATRIX = np.array([[0.3, -1.1, 0.4], [0.9, 0.2, -0.6], [-0.5, 0.7, 0.1]])


def _slope(t: Any, z: Any, xp: Any) -> Any:
    return xp.sin(_MATRIX @ z + t * np.array([1.0, -2.0, 0.5])) + z


def _written_out(tableau: ButcherTableau, first: Any, t: float, h: float) -> Any:
    k = [first]
    for i in range(1, tableau.stages):
        z = h * sum(tableau.a[i, j] * k[j] for j in range(i))
        k.append(_slope(t + tableau.c[i] * h, z, np))
    return np.array(k), h * sum(b * each for b, each in zip(tableau.b, k, strict=True))


@pytest.mark.parametrize("tableau", [tx.tableaus.RK4, tx.tableaus.DOP853], ids=lambda tableau: tableau.name)
@pytest.mark.parametrize("inside", [True, False])
def test_slopes_are_those_of_the_loop_written_out(tableau: ButcherTableau, inside: bool) -> None:
    first, t, h = np.array([0.2, -0.4, 1.3]), 0.7, 0.3

    def run(first: jax.Array, t: jax.Array, h: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        def slope(time: jax.Array, z: tuple[jax.Array]) -> tuple[tuple[jax.Array], jax.Array]:
            return (_slope(time, z[0], jnp),), time

        slopes, last = stage_slopes(StageRows(tableau.a, tableau.c), slope, (first,), t, t, h)
        return slopes.rows, slopes.combine(tableau.b, h)[0], last

    arguments = [jnp.asarray(value, float) for value in (first, t, h)]
    rows, end, last = jax.jit(lambda *a: small_call(run, *a))(*arguments) if inside else jax.jit(run)(*arguments)
    expected, z = _written_out(tableau, first, t, h)
    np.testing.assert_allclose(rows, expected, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(end, z, rtol=0.0, atol=1e-14)
    assert last == pytest.approx(t + tableau.c[-1] * h)


def test_held_numbers_are_worked_out_once() -> None:
    def products(keep: Callable[[Any], Any]) -> int:
        def f(x: jax.Array) -> list[jax.Array]:
            a = x[0]
            for i in range(20):
                a = a * (x[0] + float(i))
            a, b = keep((a, a + 1.0))
            # Scalars of their own, as coordinates are.
            return [a * x[i] + b for i in range(8)]

        return jax.jit(lambda x: small_call(f, x)).lower(jnp.ones(8)).compile().as_text().count(" multiply(")

    assert products(stored_once) < 0.5 * products(lambda pair: pair)
