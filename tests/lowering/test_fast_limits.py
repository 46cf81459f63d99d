"""What `tx.fast` does not keep, and its warning where it gives no speed-up."""

import importlib.util
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

pytest.importorskip("llvmlite")


def test_signs_of_zeros_are_those_that_are_documented() -> None:
    x = jnp.array([-0.0, 0.0, -3.0])

    def negative(function: Callable[..., Any], checked: bool) -> list[bool]:
        backend = tx.Native(tx.XLA(checked=checked), least=0)
        return list(np.signbit(tx.fast(function, backend=backend)(x)).tolist())

    assert negative(lambda x: 0.0 * x, False) == [False, False, False]
    assert negative(lambda x: 0.0 * x, True) == [True, False, True]
    for checked in (False, True):
        assert negative(lambda x: 0.0 - x, checked) == [False, True, False]
        assert negative(lambda x: jnp.where(x < 0.0, -0.0, x), checked) == [True, False, False]
        for function in (lambda x: -x, lambda x: x - x[::-1], lambda x: 1.0 / x, jnp.sin):
            assert negative(function, checked) == np.signbit(function(x)).tolist()


# ---- where nothing is gained -----------------------------------------------------------------------------------------

LARGE = jnp.asarray(np.random.default_rng(0).normal(size=(100, 100)))


def square_of_large(a: Any) -> Any:
    return a @ a


def noisy(x: Any) -> Any:
    return jax.random.normal(jax.random.key(0), x.shape, x.dtype) + x


def loud(x: Any) -> Any:
    jax.debug.callback(lambda value: None, x[0])
    return jnp.sin(x)


@pytest.mark.parametrize(
    ("function", "arguments", "reason"),
    [
        (square_of_large, (LARGE,), "arrays: one of the arrays has more than 128 entries"),
        (lambda x: jnp.linalg.eigh(jnp.outer(x, x))[0], (jnp.ones(3),), "eigh"),
        (noisy, (jnp.ones(3),), "effects or random keys"),
        (loud, (jnp.ones(3),), "effects or random keys"),
        (lambda a: jax.lax.scan(lambda c, _: (0.1 * LARGE @ c, None), a, None, 300)[0], (LARGE,), "more than 128"),
    ],
)
def test_it_warns_once_and_says_why(function: Callable[..., Any], arguments: Any, reason: str) -> None:
    own = tx.fast(function)
    with pytest.warns(RuntimeWarning, match=f"gives no speed-up, JAX executes the function: .*{reason}"):
        result = own(*arguments)
    np.testing.assert_allclose(result, function(*arguments), atol=1e-12)
    own(*arguments)


@pytest.mark.filterwarnings("ignore:.*gives no speed-up")
def test_layers_of_a_network_are_left_to_xla() -> None:
    """Its products with large matrices, and hyperbolic tangents, are faster there."""
    net = tx.fast(lambda x: jnp.tanh(jnp.tanh(x @ LARGE) @ LARGE.T))
    assert "native" not in net.explain(jnp.ones((1000, 100)))


def test_no_warning_where_a_part_gains_or_nothing_is_computed() -> None:
    """Warnings are errors here."""
    tx.fast(lambda a: (a @ a, jax.vmap(lambda x: jnp.sin(x) * jnp.exp(x @ x))(a)))(LARGE)
    tx.fast(lambda a: a.T)(LARGE[:3, :3])
    tx.fast(lambda x: jnp.sin(x) + 1.0)(jnp.ones(3))
    tx.fast(lambda a: a @ a, backend=tx.JAX())(LARGE)


def test_without_llvmlite_the_warning_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda of, *a: None if of == "llvmlite" else find(of, *a))
    with pytest.warns(RuntimeWarning, match=r"fewer than 500 scalar operations; llvmlite, .* is not installed"):
        tx.fast(lambda x: jnp.sin(x) + x)(jnp.ones(3))
