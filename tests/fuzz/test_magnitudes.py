"""The fuzzer at physical magnitudes: some cases of it, and that it sees what is wrong."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import magnitudes
import numpy as np
import outside
import pytest
from paths import BACKENDS

import twistax as tx


@pytest.mark.parametrize(("number", "by"), list(zip((0, 1, 3, 5), (*BACKENDS, "scalars"), strict=True)))
def test_single_precision_gives_values_and_derivatives(number: int, by: str) -> None:
    state, parts = magnitudes.drawn(0, number)
    assert magnitudes.wrong(state, parts, by) == ""


@pytest.mark.parametrize("way", outside.WAYS)
def test_ways_outside_of_transformations_give_them_too(way: str) -> None:
    state, parts = magnitudes.drawn(0, 4)
    assert outside.wrong(state, parts, way) == ""


def test_the_oracle_is_that_of_double_precision() -> None:
    """Values and derivatives are JAX's in double precision."""
    state, parts = magnitudes.drawn(0, 3)
    z = state.astype(float)
    for part in parts:
        function = lambda z, part=part: part.make((z, magnitudes.Arithmetic))  # noqa: E731
        number = part.number
        for found, right in ((number.value, function), (number.slope, jax.grad(function))):
            np.testing.assert_allclose(found, right(z), rtol=1e-10, atol=0.0)
        right, size = np.asarray(jax.hessian(function)(z)), number.sums[2].max()
        np.testing.assert_allclose(number.curvature, right, rtol=1e-10, atol=1e-12 * size)


def test_a_wrong_slope_is_seen() -> None:
    state, parts = magnitudes.drawn(0, 0)
    part = parts[0]
    off = replace(part, make=lambda c: part.make(c) * 1.01)
    assert "kernel: " in magnitudes.wrong(state, [off, *parts[1:]], "kernel")


def test_lost_terms_are_seen() -> None:
    """-2 r^-3 is right in single precision where r^-6 is zero: an error of that derivative is larger than allowed."""
    r = magnitudes.power(magnitudes.leaf(7e6, 0), -3)
    assert r.holds()
    wrong = jnp.float32(-3.0) * jnp.float32(7e6) ** 2 * (jnp.float32(7e6) ** -6)
    assert abs(float(wrong) - r.slope[0]) > magnitudes.BAR * np.finfo(np.float32).eps * r.sums[1][0]
    assert tx.lower(tx.State("x") ** -3)(0.0, {"x": np.float32(7e6)}).dtype == np.float32
