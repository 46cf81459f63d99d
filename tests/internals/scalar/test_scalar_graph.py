"""What a scalar program leaves out, shares and keeps."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scalar_cases import evaluate

import twistax as tx
from twistax.expr.matrices.solve import eliminate
from twistax.scalar.backends import array_operations
from twistax.scalar.derivatives import cotangent_program, jacobian, tangent_program
from twistax.scalar.graph import TooLarge
from twistax.scalar.program import ScalarProgram
from twistax.scalar.reader import emitted_form, scalarize
from twistax.scalar.targets.xla import as_function

VECTOR = jax.ShapeDtypeStruct((3,), float)
NUMBER = jax.ShapeDtypeStruct((), float)


def program_of(function: Any, *shapes: Any, **options: Any) -> ScalarProgram:
    return scalarize(lambda *a: jax.tree.leaves(function(*a)), *shapes, **options)


def test_zeros_and_ones_disappear() -> None:
    """A matrix with one entry off the identity: one product, one sum."""
    shear = jnp.eye(3).at[0, 2].set(2.0)
    assert program_of(lambda v: shear @ v, VECTOR).counts() == {"add": 1, "mul": 1}
    assert program_of(lambda v: jnp.eye(3) @ v, VECTOR).counts() == {}
    assert program_of(lambda v: jnp.zeros((3, 3)) @ v + 1.0, VECTOR).counts() == {}
    assert program_of(lambda a: a * 1.0 + 0.0 - 0.0 / a + (a - a), VECTOR).counts() == {}


def test_products_of_what_is_skew() -> None:
    """[w]x [w]x: six products of two entries and three sums, not 27 and 18."""

    def square(w: jax.Array) -> jax.Array:
        hat = (
            jnp.zeros((3, 3))
            .at[[0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]]
            .set(jnp.stack([-w[2], w[1], w[2], -w[0], -w[1], w[0]]))
        )
        return hat @ hat

    counts = program_of(square, VECTOR).counts()
    assert counts["mul"] == 6
    assert counts["add"] + counts.get("sub", 0) == 3


def test_equal_parts_are_one() -> None:
    def function(a: jax.Array, b: jax.Array) -> Any:
        return [jnp.sin(a * b) + a, jnp.sin(b * a) + a, -jnp.sin(-a * b), a - b, b - a, jnp.cos(-a), jnp.cos(a)]

    assert program_of(function, NUMBER, NUMBER).counts() == {
        "add": 1, "cos": 1, "mul": 1, "sin": 1, "sub": 2,
    }  # fmt: skip


def test_numbers_are_folded() -> None:
    program = program_of(lambda a: [jnp.sin(jnp.ones(())) * 2.0 * a, jnp.exp(jnp.zeros(())) * a], NUMBER)
    assert program.counts() == {"mul": 1}
    np.testing.assert_allclose(evaluate(program, 3.0), [6.0 * np.sin(1.0), 3.0], rtol=1e-15)


def test_numbers_that_meet_again_give_what_they_gave() -> None:
    def function(a: jax.Array) -> jax.Array:
        two, three = jnp.full((), 2.0), jnp.full((), 3.0)
        return jnp.stack([two - three, three - two, two / three, two * three, two - three, three / two]) + a

    expected = np.array([-1.0, 1.0, 2.0 / 3.0, 6.0, -1.0, 1.5]) + 0.5
    np.testing.assert_array_equal(evaluate(program_of(function, NUMBER), 0.5)[0], expected)


def test_a_known_choice_leaves_the_rest_out() -> None:
    program = program_of(lambda a: jnp.where(jnp.array([True, False, True]), jnp.sin(a), jnp.cos(a)), VECTOR)
    assert program.counts() == {"cos": 1, "sin": 2}


def test_a_choice_by_what_is_not_so_is_the_other_one() -> None:
    program = program_of(lambda a: jnp.where(~(a > 1.0), jnp.sin(a), a), NUMBER)
    assert program.counts() == {"gt": 1, "select": 1, "sin": 1}
    assert [evaluate(program, a)[0] for a in (3.0, 0.5)] == [3.0, np.sin(0.5)]


def test_what_no_result_needs_is_left_out() -> None:
    program = program_of(lambda a: (jnp.sin(a) * jnp.exp(a))[:1], VECTOR)
    assert program.counts() == {"exp": 1, "mul": 1, "sin": 1}


def test_a_reciprocal_is_shared_when_emitted() -> None:
    program = program_of(lambda v, d: [v[0] / d, v[1] / d, v[2] / d, v[0] / v[1]], VECTOR, NUMBER)
    assert program.counts() == {"div": 4}
    assert emitted_form(program).counts() == {"div": 2, "mul": 3}
    kept = program_of(lambda v, d: v / d, VECTOR, NUMBER, checked=True)
    assert emitted_form(kept).counts() == {"div": 3}


def test_division_by_a_number() -> None:
    """A product with its inverse, unless that leaves the range of numbers or the program is checked."""
    assert program_of(lambda a: a / 3.0, NUMBER).counts() == {"mul": 1}
    assert program_of(lambda a: a / 3.0, NUMBER, checked=True).counts() == {"div": 1}
    assert program_of(lambda a: a / 1e-310, NUMBER).counts() == {"div": 1}
    assert program_of(lambda a: a / 1e308, NUMBER).counts() == {"div": 1}
    np.testing.assert_array_equal(evaluate(program_of(lambda a: a / 1e-310, NUMBER), 1e-310), [1.0])


def _not_finite(v: jax.Array, w: jax.Array) -> Any:
    zero = jnp.zeros(3)
    return [zero * v, zero / v, v - v, jnp.diag(jnp.ones(3)) @ v, v / w, jnp.dot(zero, v) + w, 0.0 * v * w - 0.0 * v]


@pytest.mark.parametrize("shared", [False, True])
def test_checked_programs_keep_what_is_not_finite(shared: bool) -> None:
    """As JAX has it, entry by entry; by default what is zero for finite numbers is zero."""
    v, w = np.array([np.inf, np.nan, 2.0]), np.array([0.0, np.inf, -1.0])
    program = program_of(_not_finite, VECTOR, VECTOR, checked=True)
    program = emitted_form(program) if shared else program
    for own, other in zip(evaluate(program, v, w), _not_finite(jnp.asarray(v), jnp.asarray(w)), strict=True):
        np.testing.assert_array_equal(own, other)
    default = evaluate(program_of(_not_finite, VECTOR, VECTOR), v, w)
    for k in (0, 1, 2, 6):
        np.testing.assert_array_equal(default[k], np.zeros(3))
    np.testing.assert_array_equal(default[3], v)
    np.testing.assert_array_equal(default[5], w)


def test_infinite_numbers_in_the_code_stay() -> None:
    program = program_of(lambda a: [a * jnp.inf, a + jnp.nan, jnp.minimum(a, jnp.inf), jnp.zeros(()) * jnp.inf], NUMBER)
    np.testing.assert_array_equal(evaluate(program, 2.0), [np.inf, np.nan, 2.0, np.nan])


def test_a_choice_hides_what_is_not_finite() -> None:
    """Values and forward derivatives as JAX; the reverse one too, where JAX multiplies zero by infinity."""

    def root(a: jax.Array) -> jax.Array:
        return jnp.where(a > 0.0, jnp.sqrt(a), a)

    program, at = program_of(root, NUMBER), np.float64(-1.0)
    assert evaluate(program, at) == [-1.0]
    assert evaluate(tangent_program(program, [0]), at, np.float64(1.0)) == [1.0]
    assert evaluate(cotangent_program(program, [0]), at, np.float64(1.0)) == [1.0]
    assert np.isnan(jax.grad(root)(-1.0))


def test_derivatives_keep_zeros() -> None:
    """The Jacobian of entry-by-entry functions is diagonal; that of a triangular product has its shape."""
    program = program_of(jnp.sin, VECTOR)
    assert set(jacobian(program, [0])) == {(0, 0), (1, 1), (2, 2)}
    lower = jnp.tril(jnp.arange(1.0, 10.0).reshape(3, 3))
    program = program_of(lambda v: lower @ jnp.exp(v), VECTOR)
    assert set(jacobian(program, [0])) == {(i, j) for i in range(3) for j in range(i + 1)}
    # exp, its products with the matrix (one factor is one of none), nothing else.
    entries = program.restricted([np.array(list(jacobian(program, [0]).values()))])
    assert entries.counts() == {"exp": 3, "mul": 5}


def test_a_stopped_entry_is_structurally_zero() -> None:
    program = program_of(lambda v: jnp.stack([v[0] * jax.lax.stop_gradient(v[1]), jnp.floor(v[2])]), VECTOR)
    assert set(jacobian(program, [0])) == {(0, 0)}


def test_an_empty_derivative_costs_nothing() -> None:
    program = program_of(lambda v: [jnp.ones(3), jnp.floor(v)], VECTOR)
    for derivative in (tangent_program(program, [0]), cotangent_program(program, [0])):
        assert derivative.counts() == {}


def test_too_large() -> None:
    def square(a: jax.Array) -> jax.Array:
        return jnp.outer(a, a)

    shape = jax.ShapeDtypeStruct((30,), float)
    with pytest.raises(TooLarge, match="more than 200 scalars"):
        program_of(square, shape, largest=200)
    assert program_of(square, shape, largest=1000).operations == 465


def test_emitters_choose_by_size() -> None:
    small = jax.make_jaxpr(lambda v: [jnp.sin(v)])(jnp.ones(3))
    assert tx.XLA().emit(small).program is None
    assert tx.XLA(least=0).emit(small).program is not None
    assert tx.XLA(least=0, largest=5).emit(small).program is None
    assert "more than 5" in tx.XLA(least=0, largest=5).emit(small).reason
    assert tx.JAX().emit(small).program is None


def test_what_just_fits_has_derivatives_of_any_order() -> None:
    # Sines of sums: 12 scalars, of the gradient and of the Hessian more than the limit.
    closed = jax.make_jaxpr(lambda v: [jnp.sum(jnp.sin(v * v[::-1] + 0.1))])(jnp.ones(4))
    found = tx.XLA(least=0, largest=30).emit(closed)
    assert found.program is not None
    at = jnp.array([0.3, -0.4, 0.9, 1.2])
    angle = at * at[::-1] + 0.1
    gradient = jax.grad(lambda v: found.function(v)[0])
    np.testing.assert_allclose(gradient(at), 2.0 * jnp.cos(angle) * at[::-1], rtol=1e-14)
    expected = np.diag(-2.0 * np.sin(angle) * at[::-1] ** 2)
    expected += np.diag(2.0 * np.cos(angle) - 2.0 * np.sin(angle) * at * at[::-1])[::-1]
    np.testing.assert_allclose(jax.hessian(lambda v: found.function(v)[0])(at), expected, rtol=1e-13, atol=1e-15)
    assert len(found.program.graph.nodes) > 30


@pytest.mark.parametrize("wrapped", [lambda f: f, jax.jit], ids=["plain", "inside a call"])
def test_wide_arrays_stay_arrays(wrapped: Any) -> None:
    """Written out they would compile for minutes and gain nothing; also where only an inner function sees them."""
    function = wrapped(lambda v: jnp.sin(jnp.outer(v, v)).sum(0))
    wide, narrow = (jax.make_jaxpr(lambda v: [function(v)])(jnp.ones(n)) for n in (12, 11))
    assert tx.XLA(least=0).emit(wide).reason == "arrays: one of the arrays has more than 128 entries"
    assert tx.XLA(least=0).emit(narrow).program is not None


def test_the_emitted_function_is_the_program() -> None:
    """Each operation by XLA as by NumPy, calls and numbers among the results included."""

    def function(v: jax.Array, n: jax.Array) -> Any:
        return [jnp.sin(v) / v[0], v, jnp.sort(v) / v[0], jnp.ones(2), n * 2, v[1] > 0.0, v[:0], jnp.zeros((0, 2), int)]

    program = program_of(function, VECTOR, jax.ShapeDtypeStruct((2,), int))
    arguments = np.array([0.5, -2.0, 1.5]), np.array([3, 4])
    for own, other in zip(jax.jit(as_function(program))(*arguments), evaluate(program, *arguments), strict=True):
        assert (own.shape, own.dtype) == (other.shape, other.dtype)
        np.testing.assert_allclose(own, other, rtol=1e-14)


def test_what_is_structurally_zero_never_becomes_a_pivot() -> None:
    """A diagonal matrix divides; unrolled with all its zeros a 3x3 elimination takes some sixty operations."""
    program = program_of(lambda a, b: eliminate(jnp.diag(a), b[:, None]), VECTOR, VECTOR)
    assert emitted_form(program).counts() == {"div": 3}
    greater = program_of(lambda a, b: (jax.lax.gt(0.0 * b, jnp.abs(a)), a > jnp.abs(b), a < 0.0), VECTOR, VECTOR)
    found = evaluate(greater, np.array([-1.0, np.nan, 2.0]), np.array([0.5, 1.0, np.nan]))
    np.testing.assert_array_equal(found, [[False] * 3, [False] * 3, [True, False, False]])
    assert greater.outputs[0].tolist() == [greater.graph.constant(False, np.dtype(bool))] * 3


def test_a_linear_solve_counts_once() -> None:
    """The jaxprs that it holds for its derivatives do not run."""
    jaxpr = jax.make_jaxpr(lambda a, b: eliminate(a, b))(jnp.eye(2), jnp.ones((2, 1))).jaxpr
    counts = array_operations(jaxpr)
    assert counts["div"] == 3
    assert counts["gt"] == 1
