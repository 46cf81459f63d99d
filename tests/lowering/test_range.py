"""Derivatives in single precision at magnitudes at which powers of them leave its range, on every path."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

GM = 3.986e14
EPS = float(np.finfo(np.float32).eps)
BACKENDS = (tx.JAX(), tx.XLA(least=0), tx.Native(least=0, scalars=tx.XLA(least=0)))
#: Gravity as people write it.
WAYS: dict[str, Callable[[Any, Any], Any]] = {
    "power": lambda p, norm: -GM * p * norm(p) ** -3,
    "quotient": lambda p, norm: -GM * p / norm(p) ** 3,
    "reciprocal": lambda p, norm: -GM * p * (1.0 / norm(p) ** 3),
    "root": lambda p, norm: -GM * p * (p @ p) ** -1.5,
}
P, V = tx.State("p", shape=(3,)), tx.State("v", shape=(3,))
POSITION = np.array([7.0e6, 1.0e6, -2.0e6], np.float32)


def slope(p: np.ndarray) -> np.ndarray:
    """$d(-GM p / r^3) / dp = GM (3 p p^T / r^2 - 1) / r^3$."""
    p = p.astype(float)
    r = np.linalg.norm(p)
    return GM * (3.0 * np.outer(p, p) / r**2 - np.eye(3)) / r**3


def near(found: Any, right: np.ndarray, terms: float = 0.0) -> None:
    """To 100 eps of the terms."""
    assert np.asarray(found).dtype == np.float32
    np.testing.assert_allclose(found, right, rtol=0.0, atol=100.0 * EPS * (terms or np.abs(right).max()))


def curvature(p: np.ndarray) -> np.ndarray:
    """The second derivative of the sum of the accelerations, by the slope in double precision."""
    step = 1e-4 * np.linalg.norm(p.astype(float))
    ahead = [slope(p.astype(float) + step * e).sum(0) - slope(p.astype(float) - step * e).sum(0) for e in np.eye(3)]
    return np.array(ahead) / (2.0 * step)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("backend", BACKENDS, ids=lambda b: type(b).__name__)
def test_gravity_has_its_gradient(way: str, backend: Any) -> None:
    dynamics = tx.compile(tx.System({P: V, V: WAYS[way](P, tx.linalg.Norm)}), backend=backend)
    x = {"p": POSITION, "v": np.zeros(3, np.float32)}
    near(dynamics.jacobian(0.0, x)["x"][3:, :3], slope(POSITION))
    second = dynamics.hessian(0.0, x, None, None, {"v": np.ones(3, np.float32)})[:3, :3]
    np.testing.assert_allclose(second, curvature(POSITION), rtol=0.0, atol=1e-5 * np.abs(curvature(POSITION)).max())


@pytest.mark.parametrize("way", WAYS)
def test_gravity_of_the_sun_has_its_gradient(way: str) -> None:
    """At 1 au: the derivative of r^-3 is below the range of single precision, that of the product is not."""
    p = np.array([1.2e11, 0.8e11, -0.4e11], np.float32)
    right = slope(p) * (1.327e20 / GM)
    pull = WAYS[way](P, tx.linalg.Norm) * (1.327e20 / GM)
    dynamics, x = tx.compile(tx.System({P: V, V: pull})), {"p": p, "v": np.zeros(3, np.float32)}
    near(dynamics.jacobian(0.0, x)["x"][3:, :3], right)
    near(tx.trajectory.linearize(dynamics, 0.0, x).A[3:, :3], right)
    lowered, eye = tx.lower(pull), jnp.eye(3, dtype=np.float32)

    def check(function: Callable[[Any], Any]) -> None:
        near(jax.jacfwd(function)(jnp.asarray(p)), right)
        near(jax.jit(jax.jacfwd(function))(jnp.asarray(p)), right)
        near(jax.vmap(lambda v: jax.jvp(function, (jnp.asarray(p),), (v,))[1])(eye).T, right)

    check(lambda p: dynamics(0.0, {**x, "p": p})["v"])
    check(lambda p: lowered(0.0, {"p": p}))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("backend", [None, *BACKENDS[1:]], ids=["tx.lower", "XLA", "Native"])
def test_transformations_of_jax_give_the_gradient(way: str, backend: Any) -> None:
    """At 7,000 km and, where no derivative by r^3 is needed, at a million."""
    lowered = tx.lower(WAYS[way](P, tx.linalg.Norm))
    plain = lambda p: WAYS[way](p, jnp.linalg.norm)  # noqa: E731
    function = (lambda p: lowered(0.0, {"p": p})) if backend is None else tx.fast(plain, backend=backend)
    for p in (POSITION, POSITION * np.float32(150.0)):
        forward, back = jax.jacfwd(function)(p), jax.jacrev(function)(p)
        near(forward, slope(p))
        near(back, slope(p))
        near(jax.jvp(function, (p,), (p,))[1], slope(p) @ p)
        near(jax.grad(lambda p: function(p)[0])(p), slope(p)[0])
        near(jax.vmap(jax.jacfwd(function))(np.stack([p, 2.0 * p]))[0], slope(p))
    second = jax.jacfwd(jax.jacfwd(lambda p: function(p).sum()))(POSITION)
    np.testing.assert_allclose(second, curvature(POSITION), rtol=0.0, atol=1e-5 * np.abs(curvature(POSITION)).max())
    if backend is not None:
        near(tx.fast(jax.jacfwd(plain), backend=backend)(POSITION), slope(POSITION))


def test_integrations_carry_the_gradient() -> None:
    dynamics = tx.compile(tx.System({P: V, V: WAYS["power"](P, tx.linalg.Norm)}))
    start = {"p": POSITION, "v": np.zeros(3, np.float32)}

    def end(p: jax.Array) -> jax.Array:
        x = start | {"p": p}
        return tx.integrate(dynamics, x, t1=1.0, dt=0.5, method=tx.RKMK(tx.tableaus.RK4)).xs["v"][0]

    near(jax.jacfwd(end)(POSITION), slope(POSITION))
    near(tx.trajectory.linearize(dynamics, 0.0, start, {}).A[3:, :3], slope(POSITION))


def test_powers_are_differentiated_as_powers() -> None:
    grad = lambda f, x: float(jax.grad(tx.fast(f, backend=BACKENDS[1]))(x))  # noqa: E731
    assert grad(lambda r: r**-12 - r**-6, np.float32(2000.0)) == pytest.approx(6.0 / 2000.0**7, rel=1e-5)
    assert grad(lambda r: r**-12 - r**-6, 1e200) == 0.0
    for function in (lambda x: x**-2, lambda x: tx.lower(tx.State("x") ** -2)(0.0, {"x": x})):
        found = jax.grad(tx.fast(function, backend=BACKENDS[1]))(np.inf)
        assert found == 0.0
        assert np.signbit(found)
    for n in (-7, -3, -2, -1, 2, 3, 5, -1.5, -0.5, 2.5):
        node = tx.lower(tx.State("x") ** n)
        for function in (lambda x, n=n: x**n, lambda x, node=node: node(0.0, {"x": x})):
            for own in (function, tx.fast(function, backend=BACKENDS[1])):
                x = np.float32(3.0)
                assert float(own(x)) == pytest.approx(3.0**n, rel=1e-6)
                assert float(jax.grad(own)(x)) == pytest.approx(n * 3.0 ** (n - 1), rel=1e-6)
                assert float(jax.grad(jax.grad(own))(x)) == pytest.approx(n * (n - 1) * 3.0 ** (n - 2), rel=1e-6)


def test_the_derivative_of_a_quotient_has_no_square_of_the_divisor() -> None:
    """In both modes: of p / (x x), and of 1 / ((x x) (x x)) in reverse."""
    x = np.float32(1e8)
    for function, right in ((lambda x: 1e7 / (x * x * x * x), -4e-33), (lambda x: 1.0 / (x * x * x), -3e-32)):
        for backend in BACKENDS[1:]:
            fast = tx.fast(lambda x, f=function: jnp.asarray(f(x)), backend=backend)
            for found in (jax.grad(fast)(x), jax.jacfwd(fast)(x)):
                assert float(found) == pytest.approx(right, rel=1e-5)
    node = tx.lower(tx.State("a") / tx.State("b"))
    a, b = np.float32(1e-30), np.float32(1e-30)
    slopes = jax.jacfwd(lambda x: node(0.0, x))({"a": a, "b": b})
    assert float(slopes["b"]) == pytest.approx(-1e30, rel=1e-6)
    back = jax.linear_transpose(lambda a: node(0.0, {"a": a, "b": np.float32(4.0)}), a)(np.float32(1.0))
    assert float(back[0]) == 0.25


def test_products_with_an_inverse_square_have_the_range_of_their_factors() -> None:
    """b / y and c / y may leave the range where b c and y^-2 do not; y^-2 may leave it where b c / y does not."""
    function = lambda b, c, y: b * c * y**-2  # noqa: E731
    for backend in BACKENDS:
        fast = tx.fast(function, backend=backend)
        for b, c, y, right in (
            (1e30, 1e-30, 1e-10, 1e20),
            (1e30, 1e-30, 1e10, 1e-20),
            (1e-30, 1e30, 1e10, 1e-20),
            (1e15, 1e15, 1e15, 1.0),
        ):
            b, c, y = map(np.float32, (b, c, y))
            assert float(fast(b, c, y)) == pytest.approx(right, rel=1e-6)
            assert float(fast(-b, c, y)) == pytest.approx(-right, rel=1e-6)
    for backend in BACKENDS[1:]:
        fast = tx.fast(function, backend=backend)
        assert float(fast(*map(np.float32, (1e20, 1e17, 1e25)))) == pytest.approx(1e-13, rel=1e-6)


@pytest.mark.parametrize("size", [1e-30, 3e-16, 1.0, 7e18, 1e30])
def test_norms_need_no_square_in_range(size: float) -> None:
    p = np.array([3.0, -4.0, 12.0], np.float32) * np.float32(size)
    lowered = tx.lower(tx.linalg.Norm(P))
    functions = [lambda p: lowered(0.0, {"p": p})]
    for backend in BACKENDS[1:]:
        dynamics = tx.compile(tx.System({P: 0.0 * P}, outputs={"r": tx.linalg.Norm(P)}), backend=backend)
        functions.append(lambda p, own=dynamics: own.outputs(0.0, {"p": p})["r"])
    for function in functions:
        assert float(function(p)) == pytest.approx(13.0 * size, rel=1e-6)
        for slopes in (jax.jacfwd(function)(p), jax.jacrev(function)(p), jax.vmap(jax.grad(function))(p[None])[0]):
            np.testing.assert_allclose(slopes, np.array([3.0, -4.0, 12.0]) / 13.0, rtol=1e-6)


@pytest.mark.parametrize("count", [60, 4096, 50000])
@pytest.mark.parametrize("size", [1e-34, 5e-16, 5e17, 8e18, 5e35])
def test_norms_of_many_entries(count: int, size: float) -> None:
    """Each square is in range, or each scaled one; so is their sum. On scalars up to the size that is unrolled."""
    x = np.full(count, size, np.float32)
    value, right = tx.State("x", shape=(count,)), np.float32(size) * np.sqrt(count)
    backends = BACKENDS if count == 60 else BACKENDS[:1]
    for backend in backends:
        dynamics = tx.compile(tx.System({value: 0.0 * value}, outputs={"r": tx.linalg.Norm(value)}), backend=backend)
        assert float(dynamics.outputs(0.0, {"x": x})["r"]) == pytest.approx(right, rel=1e-5)


@pytest.mark.parametrize("size", [0.0, 1e-30, 1.0, 1e30])
def test_second_derivatives_of_norms(size: float) -> None:
    """(1 - p p^T / r^2) / r; zero at zero, as the first one is."""
    p = np.array([3.0, -4.0, 12.0], np.float32) * np.float32(size)
    along = np.array([3.0, -4.0, 12.0]) / 13.0
    right = (np.eye(3) - np.outer(along, along)) / (13.0 * size) if size else np.zeros((3, 3))
    lowered = tx.lower(tx.linalg.Norm(P))
    on_arrays = lambda p: lowered(0.0, {"p": p})  # noqa: E731
    for function in (on_arrays, *(tx.fast(on_arrays, backend=backend) for backend in BACKENDS[1:])):
        for found in (jax.hessian(function)(p), jax.jacfwd(jax.jacfwd(function))(p)):
            near(found, right)
    dynamics = tx.compile(tx.System({P: P * tx.linalg.Norm(P)}), backend=BACKENDS[1])
    near(dynamics.jacobian(0.0, {"p": p})["x"], 13.0 * size * (np.eye(3) + np.outer(along, along)))


def test_differences_keep_the_sign_of_zero() -> None:
    x, y = np.float64(0.3), np.float64(-0.3)
    for backend in BACKENDS:
        both = tx.fast(lambda x, y: (jnp.arctan2(x - y, -1.0), jnp.arctan2(y - x, -1.0)), backend=backend)
        assert [float(angle) for angle in both(x, x)] == [np.pi, np.pi]
        negative = tx.fast(lambda x, y: (jnp.arctan2(-x - y, -1.0), jnp.arctan2(0.0 - y, -1.0)), backend=backend)
        assert float(negative(x, y)[0]) == np.pi
        assert float(negative(x, 0.0)[1]) == np.pi
        over = tx.fast(lambda x, y: (1.0 / (x - y), 1.0 / (y - x)), backend=backend)
        assert [float(value) for value in over(x, x)] == [np.inf, np.inf]


def test_differences_in_derivatives_are_one() -> None:
    """There x - y is -(y - x), of which the sign counts."""
    for x, y in ((1.5, 0.25), (0.25, 1.5)):
        function = lambda x, y: (x - y) ** 3 * jnp.sin(x * y)  # noqa: E731
        found = jax.hessian(tx.fast(function, backend=BACKENDS[1]))(x, y)
        assert float(found) == pytest.approx(float(jax.hessian(function)(x, y)), rel=1e-12)


def test_each_reader_of_a_distance_gives_its_second_derivative() -> None:
    """However many read it: the sum of what they give r^2, as a number, changes out of range."""
    p = POSITION
    many = lambda p, norm: [norm(p) ** -3, norm(p), norm(p) ** 2.5, (p @ p) * 1e-9, norm(p) ** -1.5, p[0] / norm(p)]  # noqa: E731
    lowered = many(P, tx.linalg.Norm)
    r = np.linalg.norm(p.astype(float))
    right = (15.0 * np.outer(p, p) / r**2 - 3.0 * np.eye(3)) / r**5
    for backend in BACKENDS[1:]:
        fast = tx.fast(lambda p: jnp.stack(many(p, jnp.linalg.norm)), backend=backend)
        near(jax.hessian(fast)(p)[0], right)
        dynamics = tx.compile(tx.System({P: 0.0 * P}, outputs={"y": tx.Concat(*lowered)}), backend=backend)
        weights = {"y": np.eye(6, dtype=np.float32)[0]}
        near(dynamics.hessian(0.0, {"p": p}, None, None, weights), right)


@pytest.mark.parametrize("size", [10.0, 100.0])
def test_formulas_of_jax_are_put_in_range(size: float) -> None:
    """Of p / r^3 JAX's own is (p dr^3) / (r^3)^2, of a power n x^(n-1)."""
    p = POSITION * np.float32(size)
    for way in ("quotient", "reciprocal", "power", "root"):
        for backend in BACKENDS[1:]:
            plain = lambda p, way=way: WAYS[way](p, jnp.linalg.norm)  # noqa: E731
            near(tx.fast(jax.jacfwd(plain), backend=backend)(p), slope(p))
    x = np.float32(3e12)
    for backend in BACKENDS[1:]:
        found = tx.fast(jax.jacfwd(lambda x: 1e20 * x**-2), backend=backend)(x)
        assert float(found) == pytest.approx(-2e20 / 3e12**3, rel=1e-6)


def test_quotients_of_quotients_and_powers_of_products_are_computed_as_written() -> None:
    """XLA makes a / (b / c) (a c) / b, (a / b) / c a / (b c), and (k x)^n k^n x^n."""
    a, b, c = map(np.float32, (1e30, 1e20, 1e15))
    forms: list[tuple[Callable[..., Any], float]] = [
        (lambda a, b, c: a / (b / c), 1e25),
        (lambda a, b, c: (a / b) / (b * 1e5), 1e-15),
        (lambda a, b, c: (1e-11 * b) ** 4 / c, 1e21),
        (lambda a, b, c: (1e-11 * b) ** -4 * a, 1e-6),
    ]
    A, B, C = map(tx.State, "abc")
    for form, right in forms:
        lowered = tx.lower(form(A, B, C))
        functions = [lambda a, b, c, f=lowered: f(0.0, {"a": a, "b": b, "c": c})]
        functions += [tx.fast(form, backend=backend) for backend in BACKENDS[1:]]
        for function in functions:
            assert float(jax.jit(function)(a, b, c)) == pytest.approx(right, rel=1e-5)
            slopes = jax.vmap(jax.grad(function))(a[None], b[None], c[None])
            assert float(slopes[0]) in (0.0, pytest.approx(right / a, rel=1e-5))


def test_negative_powers_that_are_not_whole_have_reverse_derivatives() -> None:
    """Of s^-1.5 by s at 7e13 that of s^1.5 would take s^-3."""
    lowered, p = tx.lower((P @ P) ** -1.5), POSITION.astype(float)
    found = jax.jit(jax.jacrev(lambda p: jnp.stack([lowered(0.0, {"p": p})])))(POSITION)
    near(found[0], -3.0 * p / np.linalg.norm(p) ** 5)
    assert float(tx.lower(tx.State("s") ** -1.5)(0.0, {"s": np.float32(4.0)})) == 0.125
    fast = tx.fast(lambda m, p: 1e20 * m / (p @ p) ** 1.5, backend=BACKENDS[1])
    q = POSITION * np.float32(2000.0)
    mixed = jax.jacfwd(jax.jacfwd(fast), argnums=1)(np.float32(2.0), q)
    near(mixed, -3e20 * q.astype(float) / np.linalg.norm(q.astype(float)) ** 5)
