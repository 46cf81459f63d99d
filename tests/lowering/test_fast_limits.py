"""What `tx.fast` does not keep, and what it says where it gains nothing."""

from collections.abc import Callable
from typing import Any

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
