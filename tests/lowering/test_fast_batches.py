"""A batch inside of a function of `tx.fast`, by `vmap`, `lax.map` or an axis of arrays, becomes that of a kernel."""

import functools
import re
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fast_cases import A, X, around, close, counted, every, recursion, scalar, straight

import twistax as tx

pytest.importorskip("llvmlite")

RANDOM = np.random.default_rng(8)
#: Of more entries than an array of scalars has, and no length of anything else.
ROWS = 150
XS = around(X, ROWS)
MATRICES = jnp.asarray(RANDOM.normal(size=(ROWS, 6, 6)) + 6.0 * np.eye(6))
SIDES = jnp.asarray(RANDOM.normal(size=(ROWS, 6)))


@pytest.fixture(autouse=True)
def _promoted() -> Iterator[None]:
    """Arrays of different ranks meet here, as in programs of users."""
    with jax.numpy_rank_promotion("allow"):
        yield


def rollout(x: jax.Array, controls: jax.Array) -> jax.Array:
    """The cost of a pendulum that turns from a state that all members share."""

    def step(state: tuple[jax.Array, jax.Array], u: jax.Array) -> Any:
        angle, rate = state
        rate = rate + 0.05 * (9.81 * jnp.sin(angle) + u - 0.1 * rate)
        angle = angle + 0.05 * rate
        return (angle, rate), angle**2 + 0.1 * rate**2 + 0.01 * u**2

    return jax.lax.scan(step, (x[0], x[1]), controls)[1].sum()


def path_integral(x: jax.Array, plan: jax.Array, noise: jax.Array) -> jax.Array:
    """Model-predictive path integral control: members meet in the weights."""
    costs = jax.vmap(rollout, (None, 0))(x, plan + noise)
    weights = jnp.exp(costs.min() - costs)
    return plan + weights / weights.sum() @ noise


# ---- what is recognised ----------------------------------------------------------------------------------------------


@every
def test_a_vmap_inside(function: Callable[..., Any]) -> None:
    """Also of loops that end for each member by themselves."""
    batched = jax.vmap(function, (None, 0))
    own = tx.fast(batched)
    close(own(A, XS), jax.jit(batched)(A, XS), 1e-11)
    lines = own.explain(A, XS).splitlines()
    assert any(f"batch of {ROWS}" in line for line in lines)
    assert all("batch of" in line or "more than 128 entries" not in line for line in lines)


@pytest.mark.parametrize(("in_axes", "out_axes"), [((0, 0), 0), ((2, 1), 1), ((None, 1), 2), ((1, None), 0)])
def test_axes(in_axes: Any, out_axes: int) -> None:
    def product(a: jax.Array, x: jax.Array) -> jax.Array:
        return jnp.outer(jnp.linalg.solve(a + 4.0 * jnp.eye(3), x), a @ x)

    arrays = [
        a if axis is None else jnp.moveaxis(around(a, ROWS), 0, axis) for a, axis in zip((A, X), in_axes, strict=True)
    ]
    batched = jax.vmap(product, in_axes, out_axes)
    close(tx.fast(batched)(*arrays), jax.jit(batched)(*arrays), 1e-12)
    assert f"batch of {ROWS}: native" in tx.fast(batched).explain(*arrays)


def test_rows_that_each_member_chooses() -> None:
    """JAX's rule for gathers of batches counts axes in integers of NumPy, which its `vmap` refuses."""

    def chosen(a: jax.Array, x: jax.Array) -> jax.Array:
        rows = jnp.linalg.solve(a + jnp.diag(x), a) * jnp.exp(x)
        return rows[jnp.argmax(rows[:, 0])]

    batched = jax.vmap(chosen, (None, 0))
    close(tx.fast(batched)(A, XS), jax.jit(batched)(A, XS), 1e-11)


def test_arrays_with_an_axis_for_members() -> None:
    """Written without vmap."""
    own = tx.fast(lambda a, b: jnp.linalg.solve(a, b[..., None])[..., 0] * jnp.exp(b))
    expected = np.linalg.solve(MATRICES, SIDES[..., None])[..., 0] * np.exp(SIDES)
    np.testing.assert_allclose(own(MATRICES, SIDES), expected, rtol=1e-11)
    assert own.explain(MATRICES, SIDES).startswith(f"batch of {ROWS}: native")


@pytest.mark.parametrize(
    ("function", "arguments"), [(jnp.linalg.solve, (MATRICES, SIDES)), (recursion, (around(A, ROWS), XS))]
)
def test_the_kernel_is_that_of_a_batch_around_it(function: Callable[..., Any], arguments: Any) -> None:
    """So it takes as long."""
    texts = [jax.jit(f).lower(*arguments).as_text() for f in (tx.fast(jax.vmap(function)), jax.vmap(tx.fast(function)))]
    inside, outside = (set(re.findall(r"twistax_\w+", text)) for text in texts)
    assert inside == outside
    assert inside


def test_maps_are_batches() -> None:
    for function in (straight, recursion):
        own = tx.fast(lambda xs, f=function: jax.lax.map(lambda x: f(A, x), xs))
        close(own(XS), jax.vmap(lambda x, f=function: f(A, x))(XS), 1e-11)
        assert f"batch of {ROWS}" in own.explain(XS)
    few = tx.fast(lambda xs: jax.lax.map(lambda x: recursion(A, x), xs, batch_size=50))
    close(few(XS), jax.vmap(lambda x: recursion(A, x))(XS), 1e-11)


def test_members_meet_between_batches() -> None:
    plan, noise, x = jnp.zeros(50), jnp.asarray(RANDOM.normal(size=(ROWS, 50))), jnp.array([0.3, 0.0])
    own = tx.fast(path_integral)
    np.testing.assert_allclose(own(x, plan, noise), jax.jit(path_integral)(x, plan, noise), atol=1e-12)
    assert own.explain(x, plan, noise).startswith(f"batch of {ROWS}: native: 8")


def test_long_programs_entry_by_entry_are_batches_of_entries() -> None:
    """As scalars they would take LLVM twelve times as long."""

    def long(x: jax.Array) -> jax.Array:
        y = x
        for k in range(150):
            y = y + 0.01 * jnp.sin((1.0 + k) * y) * x if k % 3 else jnp.tanh(y) + x * jnp.exp(-(y**2))
        return y

    x = jnp.linspace(0.1, 1.0, 12)
    assert tx.fast(long).explain(x).startswith("batch of 12: native")
    np.testing.assert_allclose(tx.fast(long)(x), jax.jit(long)(x), rtol=1e-12)


def test_a_batch_of_batches() -> None:
    a, xs = around(A, 30), around(X, 20)
    twice = jax.vmap(jax.vmap(recursion, (0, None)), (None, 0), out_axes=1)
    close(tx.fast(twice)(a, xs), jax.jit(twice)(a, xs), 1e-11)
    assert "batch of 30" in tx.fast(twice).explain(a, xs)
    assert "batch of 20" in tx.fast(twice).explain(a, xs)


def test_in_a_loop() -> None:
    def steps(xs: jax.Array) -> jax.Array:
        def step(xs: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
            xs = jax.vmap(lambda x: jnp.sin(A @ x) + 0.5 * x)(xs)
            return xs - xs.mean(0), xs.mean(0)

        return jax.lax.scan(step, xs, None, 20)[1]

    np.testing.assert_allclose(tx.fast(steps)(XS), jax.jit(steps)(XS), atol=1e-13)
    assert "scan: batch of" in tx.fast(steps).explain(XS)


def test_a_compiled_system_for_each_member() -> None:
    w = tx.State("w", shape=(3,))
    dynamics = tx.compile(tx.System(rates={w: tx.linalg.Cross(w, A @ w) - w}))
    own = tx.fast(jax.vmap(lambda x: x + 0.1 * dynamics(0.0, {"w": x})["w"]))
    np.testing.assert_allclose(own(XS), XS + 0.1 * (np.cross(XS, XS @ A.T) - XS), atol=1e-14)
    assert own.explain(XS).startswith(f"batch of {ROWS}: native")


# ---- derivatives -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("function", [straight, functools.partial(counted, length=100)], ids=["straight", "counted"])
def test_derivatives(function: Callable[..., Any]) -> None:
    batched = scalar(jax.vmap(function, (None, 0)))
    own = scalar(tx.fast(jax.vmap(function, (None, 0))))
    close(*(jax.jit(jax.grad(f, (0, 1)))(A, XS) for f in (own, batched)), 1e-10)
    close(*(jax.jit(lambda a, f=f: jax.jvp(f, (a, XS), (a, XS)))(A) for f in (own, batched)), 1e-10)
    inside = jax.vmap(jax.grad(scalar(function), 1), (None, 0))
    close(tx.fast(inside)(A, XS), jax.jit(inside)(A, XS), 1e-10)


def test_rows_that_a_loop_saves_stay_arrays() -> None:
    """The size of a derivative's program does not grow with the iterations: XLA would take minutes to compile it."""
    batched = scalar(tx.fast(jax.vmap(functools.partial(counted, length=701), (None, 0))))
    assert jax.jit(jax.grad(batched, (0, 1))).lower(A, XS).as_text().count("slice") < 200


def test_derivatives_where_members_meet() -> None:
    plan, noise, x = jnp.zeros(50), jnp.asarray(RANDOM.normal(size=(ROWS, 50))), jnp.array([0.3, 0.0])
    slopes = [
        jax.jit(jax.grad(lambda p, f=f: (f(x, p, noise) ** 2).sum())) for f in (tx.fast(path_integral), path_integral)
    ]
    np.testing.assert_allclose(slopes[0](plan), slopes[1](plan), atol=1e-11)


# ---- what mixes members stays right ----------------------------------------------------------------------------------

BIG = jnp.asarray(RANDOM.normal(size=(ROWS, ROWS)))
MIXING: dict[str, Callable[[jax.Array], Any]] = {
    "sums": lambda x: jnp.sin(x).sum(0) * jnp.cos(x) + jnp.exp(x).sum(1, keepdims=True),
    "running sums": lambda x: jnp.cumsum(jnp.sin(x), 0) + jnp.cumsum(jnp.cos(x), 1),
    "neighbours": lambda x: jnp.sin(x)[1:] - jnp.cos(x)[:-1] * jnp.tanh(x[:-1]),
    "rolled": lambda x: jnp.roll(jnp.sin(x), 3, 0) * jnp.cos(x) ** 2 + jnp.flip(jnp.exp(x), 0),
    "products": lambda x: jnp.sin(x) @ jnp.cos(x).T @ jnp.tanh(x),
    "square": lambda x: jnp.sin(BIG @ x) + jnp.tanh(BIG.T @ jnp.cos(BIG)) @ x,
    "transposed": lambda x: jnp.sin(x.T @ BIG) @ jnp.cos(BIG.T + BIG),
    "reshaped": lambda x: jnp.sin(x).reshape(3, ROWS) + jnp.cos(x.T) * jnp.exp(x.reshape(-1)[::3]),
    "flat": lambda x: jnp.sin(x.reshape(-1)).reshape(ROWS, 3) @ jnp.cos(A) + jnp.exp(x),
    "gathered": lambda x: jnp.sin(x)[jnp.arange(ROWS)[::-1]] * jnp.cos(x) + jnp.tanh(x)[jnp.arange(ROWS) // 2],
    "looked up": lambda x: jnp.sin(x) * jnp.take(jnp.cos(x[0]), jnp.argmax(x, 1))[:, None] + x[jnp.argmax(x, 0)].sum(0),
    "set": lambda x: jnp.sin(x).at[2].set(0.5).at[:, 1].multiply(2.0).at[jnp.arange(3), 0].add(jnp.cos(x[:3, 1])),
    "sliced": lambda x: jax.lax.dynamic_slice(jnp.sin(x), (5, 0), (100, 3)) * jnp.cos(x[50:]),
    "padded": lambda x: jnp.pad(jnp.sin(x), ((1, 0), (0, 2)))[:-1, :3] * jnp.tanh(x),
    "shifted": lambda x: jax.lax.pad(jnp.sin(x), 0.0, ((1, -1, 0), (0, 0, 0))) * jnp.cos(x),
    "sorted": lambda x: jnp.sort(jnp.sin(x), 0) * jnp.sort(jnp.cos(x), 1),
    "scan over members": lambda x: jax.lax.scan(lambda c, r: (jnp.sin(c + r), c * r), x[0], x),
    "carried with a shared one": lambda x: jax.lax.scan(lambda c, r: (jnp.sin(c) * r, r + c.sum()), x, jnp.arange(7.0)),
    "swapped": lambda x: jax.lax.fori_loop(0, 5, lambda k, c: (c[1], jnp.sin(c[0]) + x), (x, jnp.zeros((ROWS, 3)))),
    "given back": lambda x: jax.lax.fori_loop(0, 5, lambda k, c: (jnp.sin(x), c[0] * k), (x * 0, x)),
    "branch": lambda x: jax.lax.cond(x.sum() > 0, lambda x: (jnp.sin(x), x), lambda x: (jnp.zeros((ROWS, 3)), -x), x),
    "twice the length": lambda x: jnp.stack([jnp.sin(x), jnp.cos(x)]).reshape(2 * ROWS, 3) @ jnp.tanh(A),
    "repeated": lambda x: (
        jnp.broadcast_to(x[0], (ROWS, ROWS, 3))[:, 0] * jnp.sin(x) + jnp.eye(ROWS)[:, :3] * jnp.cos(x)
    ),
    "largest": lambda x: [
        jnp.argmax(jnp.sin(x), 0),
        jnp.argmin(jnp.cos(x), 1),
        jnp.exp(x).max(0) * jnp.tanh(x).min(1)[0],
    ],
    "by one member": lambda x: jnp.linalg.solve(jnp.outer(x[3], x[4]) + 9.0 * jnp.eye(3), jnp.sin(x).T),
    "factors": lambda x: jnp.linalg.cholesky(jnp.sin(x)[:, :, None] * jnp.sin(x)[:, None] + 2.0 * jnp.eye(3)),
}


@pytest.mark.filterwarnings("ignore:.*gives no speed-up")
@pytest.mark.parametrize("name", MIXING)
def test_the_numbers_are_those_of_the_function(name: str) -> None:
    function = MIXING[name]
    close(tx.fast(function)(XS), jax.jit(function)(XS), 1e-11)


@pytest.mark.filterwarnings("ignore:.*gives no speed-up")
def test_a_length_that_is_that_of_other_axes_too() -> None:
    """Of a square the axis of the members is not known: the numbers are right whichever is tried."""
    for a in (BIG, BIG[:, :, None] * XS[:, None]):
        own, plain = (jax.jit(f)(a) for f in (tx.fast(lambda a: jax.vmap(_poly)(a)), lambda a: jax.vmap(_poly)(a)))
        np.testing.assert_allclose(own, plain, atol=1e-11)
        turned, plain = (jax.jit(f)(a) for f in (tx.fast(lambda a: jax.vmap(_poly, 1, 1)(a)), jax.vmap(_poly, 1, 1)))
        np.testing.assert_allclose(turned, plain, atol=1e-11)


def _poly(row: jax.Array) -> jax.Array:
    return jnp.sin(row) * jnp.cos(row[::-1]) + jnp.tanh(row[0]) - jnp.cumsum(row, 0)


@pytest.mark.parametrize(
    "rows", [lambda: jnp.asarray(SIDES), lambda: jnp.cumsum(jnp.arange(ROWS * 6.0).reshape(-1, 6))]
)
def test_rows_that_are_constant_are_those_of_their_members(rows: Callable[[], jax.Array]) -> None:
    """A table of numbers that a function holds has a row for each member of a batch."""

    def each(xs: jax.Array) -> jax.Array:
        return jax.vmap(lambda row, x: jnp.sin(row * x) @ MATRICES[0])(rows().reshape(-1, 6), xs)

    xs = SIDES[::-1]
    own = tx.fast(each)
    assert f"batch of {ROWS}" in own.explain(xs)
    np.testing.assert_allclose(own(xs), jax.jit(each)(xs), atol=1e-11)


def test_rows_that_are_constant_leave_a_loop_one_kernel() -> None:
    """Its iterations read one row each: the 400 rows are no batch."""

    def walk(x: Any) -> Any:
        rows = jnp.linspace(0.0, 1.0, 400)
        return jax.lax.scan(lambda x, k: (x + 0.01 * jnp.tanh(jnp.sin(x) * jnp.exp(-x) + k), x), x, rows)

    x = jnp.full(3, 0.3)
    assert str(tx.fast(walk).explain(x)) == "scan: all iterations in one kernel"
    np.testing.assert_allclose(tx.fast(walk)(x)[1], jax.jit(walk)(x)[1], rtol=1e-12)
