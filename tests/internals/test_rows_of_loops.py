"""Rows on polynomials in loops of XLA; programs that are kept for numbers of rows."""

import gc
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.scalar.loops import Repeated

POLYNOMIAL = {"rtol": 1e-7, "between": tx.Between.POLYNOMIAL}
KINDS = {
    "a loop of XLA": (tx.XLA(), POLYNOMIAL),
    "a kernel's loop": (tx.Native(), POLYNOMIAL),
    "a kernel's loop over fixed steps": (tx.Native(), {"steps": 500}),
}


@pytest.mark.parametrize(("backend", "steps"), KINDS.values(), ids=KINDS)
def test_rows_of_batches_of_batches_are_exact(
    backend: Any, steps: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oscillators of other frequencies, ends and starts, in loops of XLA, where each is at another row."""
    monkeypatch.setattr(Repeated, "kernel", lambda self, rows, platform: None)
    x, v, w = tx.State("x"), tx.State("v"), tx.Parameter("w")
    dynamics = tx.compile(tx.System({x: v, v: -w * w * x}), backend=backend)
    shares = np.append(np.linspace(0.0, 0.4, 210), [0.7, 1.0, 1.0])

    def flown(w: jax.Array, end: jax.Array, x: jax.Array) -> jax.Array:
        given: dict[str, Any] = {"params": {"w": w}, "t1": end, "save_at": shares * end, **steps}
        return tx.integrate(dynamics, {"x": x, "v": 0.0}, **given).xs["x"]

    ws, ends, begins = np.array([0.3, 2.0, 5.0]), np.array([2.0, 0.0]), np.array([1.0, -0.5])
    every = jax.vmap(jax.vmap(jax.vmap(flown, (None, None, 0)), (None, 0, None), out_axes=1), (0, None, None))
    found = jax.jit(every)(ws, ends, begins)
    phases = ws[:, None, None] * ends[:, None] * shares
    np.testing.assert_allclose(found, begins[:, None, None] * np.cos(phases)[:, None], atol=1e-6)


def test_programs_for_numbers_of_rows_go_with_what_was_traced_with_them() -> None:
    made = Repeated(Any, 0, lambda one: None)  # type: ignore[arg-type]
    used = made.of_length(3)
    assert made.of_length(3) is used
    del used
    gc.collect()
    assert not len(made._others)
