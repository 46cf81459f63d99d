"""Inverses of real and complex matrices of an implicit step."""

import jax.numpy as jnp
import numpy as np
import pytest

from twistax.integrators.methods.newton import inverse


@pytest.mark.parametrize("size", [1, 6, 30], ids=["one", "a body", "by a library"])
def test_inverses(size: int) -> None:
    rng = np.random.default_rng(size)
    # Rows of very different size, and pivots that vanish.
    scale = 10.0 ** rng.uniform(-8, 8, size=(size, 1))
    A, B = scale * rng.normal(size=(2, size, size))
    if size > 1:
        A[0, 0] = B[0, 0] = 0.0
    (real,) = inverse((jnp.asarray(A),))
    np.testing.assert_allclose(real * scale.T, np.linalg.inv(A / scale), rtol=1e-9, atol=1e-9)
    parts = np.asarray(inverse((jnp.asarray(A), jnp.asarray(B))))
    np.testing.assert_allclose((parts[0] + 1j * parts[1]) * scale.T, np.linalg.inv((A + 1j * B) / scale), atol=1e-9)
