"""`tx.fast` gives what the function gives, under every transformation, and loops become kernels."""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fast_cases import (
    FUNCTIONS,
    LENGTH,
    MANY,
    RANDOM,
    A,
    X,
    around,
    around_others,
    close,
    counted,
    every,
    mixed,
    nested,
    recursion,
    scalar,
    smooth,
    straight,
    until,
)
from jax.test_util import check_grads

import twistax as tx

pytest.importorskip("llvmlite")


# ---- values ----------------------------------------------------------------------------------------------------------


@every
def test_values_are_those_of_the_function(function: Callable[..., Any]) -> None:
    close(tx.fast(function)(A, X), jax.jit(function)(A, X))


@pytest.mark.filterwarnings("ignore:.*gives no speed-up")
@every
@pytest.mark.parametrize("backend", [tx.XLA(), tx.JAX()], ids=str)
def test_and_so_they_are_by_other_backends(function: Callable[..., Any], backend: Any) -> None:
    close(tx.fast(function, backend=backend)(A, X), jax.jit(function)(A, X))


#: One row, part of a tile, and full tiles: of a loop over rows, of one with its own end, and with every kind of number.
ROWS = [
    (function, rows)
    for function in FUNCTIONS
    for rows in ((1, 5, 16) if function in (recursion, until, mixed) else (5,))
]


@pytest.mark.parametrize(("function", "rows"), ROWS, ids=[f"{f.__name__}-{rows}" for f, rows in ROWS])
def test_batches_are_their_members(function: Callable[..., Any], rows: int) -> None:
    xs = around(X, rows)
    found = jax.jit(jax.vmap(tx.fast(function), in_axes=(None, 0)))(A, xs)
    close(found, jax.jit(jax.vmap(function, in_axes=(None, 0)))(A, xs), 1e-11)


def test_batches_of_batches() -> None:
    a, xs = around(A, 3), around(X, 5)
    own, other = (jax.vmap(jax.vmap(f, (0, None)), (None, 0), out_axes=1) for f in (tx.fast(recursion), recursion))
    close(own(a, xs), other(a, xs), 1e-11)


@every
def test_single_precision(function: Callable[..., Any]) -> None:
    a, x = A.astype(jnp.float32), X.astype(jnp.float32)
    close(tx.fast(function)(a, x), jax.jit(function)(a, x), 1e-4 if function is not until else 1e-2)


# ---- derivatives -----------------------------------------------------------------------------------------------------


@smooth
def test_gradients_in_reverse(function: Callable[..., Any]) -> None:
    found = jax.jit(jax.grad(scalar(tx.fast(function)), argnums=(0, 1)))(A, X)
    close(found, jax.jit(jax.grad(scalar(function), argnums=(0, 1)))(A, X), 1e-10)


@every
def test_derivatives_forward(function: Callable[..., Any]) -> None:
    close(*(jax.jit(jax.jacfwd(scalar(f)))(A, X) for f in (tx.fast(function), function)), 1e-10)


@smooth
def test_hessians(function: Callable[..., Any]) -> None:
    close(*(jax.jit(jax.hessian(scalar(f), argnums=1))(A, X) for f in (tx.fast(function), function)), 1e-9)


def test_batches_of_gradients_and_gradients_of_batches() -> None:
    xs = around(X, 5)
    expected = jax.vmap(jax.grad(scalar(counted), argnums=(0, 1)), in_axes=(None, 0))(A, xs)
    own = scalar(tx.fast(counted))
    close(jax.vmap(jax.grad(own, argnums=(0, 1)), in_axes=(None, 0))(A, xs), expected, 1e-11)
    summed = jax.grad(lambda a, xs: jax.vmap(own, in_axes=(None, 0))(a, xs).sum(), argnums=(0, 1))(A, xs)
    close(summed, (expected[0].sum(0), expected[1]), 1e-11)


def test_forward_is_reverse_is_numeric() -> None:
    check_grads(tx.fast(lambda x: counted(A, x)), (X,), order=2, modes=("fwd", "rev"), rtol=1e-6, eps=1e-4)


@pytest.mark.filterwarnings("ignore:.*gives no speed-up")
def test_derivatives_of_complex_results() -> None:
    def turned(x: jax.Array) -> jax.Array:
        def body(c: jax.Array, row: jax.Array) -> tuple[jax.Array, None]:
            return c * jnp.exp(1j * row.astype(complex)) * 0.999, None

        return jax.lax.scan(body, x.astype(complex), MANY)[0]

    def turned_at_once(x: jax.Array) -> jax.Array:
        for _ in range(60):
            x = jnp.sin(x) + 0.1 * x
        return x.astype(complex) * jnp.exp(1j * x.astype(complex))

    for function in (turned, turned_at_once):
        own, plain = (
            lambda x, f=f: jnp.sum(jnp.abs(f(x)) ** 2 + jnp.real(f(x))) for f in (tx.fast(function), function)
        )
        close(jax.grad(own)(X), jax.grad(plain)(X), 1e-11)
        close(jax.jvp(own, (X,), (X,)), jax.jvp(plain, (X,), (X,)), 1e-11)


# ---- what stands around it -------------------------------------------------------------------------------------------


def test_inside_of_a_loop_and_of_a_branch() -> None:
    def loop(f: Callable[..., Any], x: jax.Array) -> jax.Array:
        def body(c: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
            return jax.lax.cond(c[0] > 0, lambda c: f(A, c), lambda c: -c, c), c

        return jax.lax.scan(body, x, None, 3)[1]

    close(*(jax.jit(functools.partial(loop, f))(X) for f in (tx.fast(counted), counted)))


def test_values_it_closes_over_may_be_traced() -> None:
    def outer(f: Callable[..., Any]) -> Callable[..., Any]:
        return lambda a: f(lambda x: counted(a, x))(X).sum()

    close(jax.jit(jax.value_and_grad(outer(tx.fast)))(A), jax.value_and_grad(outer(lambda g: g))(A), 1e-11)


def test_a_partial_function_of_another_kind_that_it_closes_over_stays_of_that_kind() -> None:
    class Twice(functools.partial[Any]):
        def __call__(self, *args: Any) -> Any:
            return 2.0 * super().__call__(*args)

    def slope(k: Any) -> Any:
        known, traced = Twice(jnp.multiply, 3.0), Twice(jnp.multiply, k)
        return tx.fast(lambda x: known(x) + traced(x))(1.0)

    assert jax.value_and_grad(slope)(0.5) == (7.0, 2.0)


def test_static_arguments_and_names() -> None:
    @functools.partial(tx.fast, static_argnames=("times", "kind"))
    def powers(x: jax.Array, *, times: int, kind: str = "sum") -> jax.Array:
        assert isinstance(times, int)
        y = jax.lax.fori_loop(0, times, lambda k, c: c * x + 1e-3, x)
        return y if kind == "sum" else -y

    np.testing.assert_allclose(powers(X * 0.1, times=3), (((X * 0.1) ** 2 + 1e-3) * X * 0.1 + 1e-3) * X * 0.1 + 1e-3)
    np.testing.assert_array_equal(powers(X, times=900, kind="minus"), -powers(X, times=900))
    assert "scan" in powers.explain(X, times=900)


def test_a_method() -> None:
    class Model:
        gain = 0.3

        @functools.partial(tx.fast, static_argnums=0)
        def run(self, x: jax.Array) -> jax.Array:
            return jax.lax.fori_loop(0, LENGTH, lambda k, c: jnp.sin(c) * self.gain + c, x)

    expected = X
    for _ in range(LENGTH):
        expected = np.sin(expected) * 0.3 + expected
    np.testing.assert_allclose(Model().run(X), expected, rtol=1e-12)
    assert Model.run.__name__ == "run"
    assert Model().run.explain(X) == "scan: all iterations in one kernel"


def test_its_own_derivative_is_kept() -> None:
    @jax.custom_vjp
    def clipped(x: jax.Array) -> jax.Array:
        return jnp.sin(x)

    clipped.defvjp(lambda x: (jnp.sin(x), x), lambda x, c: (1.98 * c,))

    def loop(x: jax.Array) -> jax.Array:
        return jax.lax.scan(lambda c, _: (0.5 * clipped(c), None), x, None, 900)[0]

    with_loop = jax.grad(lambda x: tx.fast(loop)(x).sum())(X)
    np.testing.assert_allclose(with_loop, 0.99**900 * np.ones(3), rtol=1e-10)


@pytest.mark.filterwarnings("ignore:.*gives no speed-up")
def test_what_has_no_scalar_form_runs_as_it_is() -> None:
    def noisy(x: jax.Array) -> jax.Array:
        return jax.random.normal(jax.random.key(0), (3,), x.dtype) + x

    seen: list[float] = []

    def loud(x: jax.Array) -> jax.Array:
        jax.debug.callback(lambda value: seen.append(float(value)), x[0])
        return jax.lax.fori_loop(0, LENGTH, lambda k, c: jnp.sin(c), x)

    def large(x: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, 50, lambda k, c: jnp.linalg.eigh(jnp.diag(jnp.tile(c, 20)))[0][:3], x)

    for function in (noisy, loud, large):
        close(tx.fast(function)(X), function(X))
    jax.effects_barrier()
    assert seen == [float(X[0])] * 2


def test_nothing_of_it_is_an_array() -> None:
    assert tx.fast(lambda: 3)() == 3
    close(tx.fast(lambda x: {"constant": jnp.arange(3), "same": x})(X), {"constant": jnp.arange(3), "same": X})
    close(tx.fast(lambda x: jax.lax.scan(lambda c, u: (c, u), x, jnp.zeros((0, 3))))(X), (X, jnp.zeros((0, 3))))


def test_long_tables_are_arguments() -> None:
    table = jnp.asarray(RANDOM.normal(size=(4000, 3)))

    def function(x: jax.Array) -> jax.Array:
        return jax.lax.scan(lambda c, row: (jnp.sin(c + row), None), x, table)[0]

    close(tx.fast(function)(X), function(X))
    assert "kernel" in tx.fast(function).explain(X)


def test_a_loop_that_never_begins_gives_its_start() -> None:
    def function(x: jax.Array) -> Any:
        return jax.lax.while_loop(lambda c: c[1] < 0, lambda c: (c[0] / 0.0, c[1] // 0), (x, 3))

    close(tx.fast(function)(X), (X, jnp.asarray(3)))


def test_members_of_a_batch_end_by_themselves() -> None:
    def collatz(n: jax.Array) -> jax.Array:
        return jax.lax.while_loop(
            lambda c: c[0] != 1, lambda c: (jnp.where(c[0] % 2 == 0, c[0] // 2, 3 * c[0] + 1), c[1] + 1), (n, 0)
        )[1]

    def steps(n: int) -> int:
        return 0 if n == 1 else 1 + steps(n // 2 if n % 2 == 0 else 3 * n + 1)

    numbers = range(1, 38)
    assert jax.vmap(tx.fast(collatz))(jnp.asarray(numbers)).tolist() == [steps(n) for n in numbers]


@pytest.mark.parametrize("backend", ["auto", tx.XLA(least=0), tx.Native()], ids=str)
def test_a_compiled_system_in_a_loop_is_part_of_its_kernel(backend: Any) -> None:
    w, torque = tx.State("w", shape=(3,)), tx.Control("torque", shape=(3,))
    inertia = tx.Parameter("J", shape=(3, 3), value=np.diag([1.0, 2.0, 3.0]))
    rate = tx.linalg.Solve(inertia, torque - tx.linalg.Cross(w, inertia @ w))
    dynamics = tx.compile(tx.System(rates={w: rate}), backend=backend)

    def rollout(x: dict[str, jax.Array], u: dict[str, jax.Array]) -> Any:
        def step(x: dict[str, jax.Array], t: jax.Array) -> Any:
            return {"w": x["w"] + 1e-3 * dynamics(t, x, u)["w"]}, x["w"]

        return jax.lax.scan(step, x, jnp.linspace(0.0, 1.0, 1001))

    x, u = {"w": X}, {"torque": 0.1 * X}
    assert tx.fast(rollout).explain(x, u).splitlines()[-1] == "scan: all iterations in one kernel"
    close(tx.fast(rollout)(x, u), jax.jit(rollout)(x, u))
    gradients = (jax.grad(lambda u, f=f: jnp.sum(f(x, u)[0]["w"] ** 2))(u) for f in (tx.fast(rollout), rollout))
    close(*gradients, 1e-11)


def _long(x: jax.Array) -> jax.Array:
    """Enough of it to become scalars."""
    for _ in range(200):
        x = jnp.sin(x) + 0.1 * x
    return x


@pytest.mark.parametrize("backend", [tx.XLA(), tx.Native()], ids=str)
def test_integers_that_are_known_are_as_xla_has_them(backend: Any) -> None:
    big = jnp.asarray([2**53 + 1, 2**62 + 1, -(2**60) - 1, -7, 7])
    reals = jnp.asarray([1e300, -1e300, jnp.nan, jnp.inf, -2.7, 200.5])

    def function(x: jax.Array) -> Any:
        # At run time by XLA; behind the barrier nothing is known.
        kinds = (jnp.int8, jnp.uint8, jnp.int32, jnp.int64, jnp.uint32)
        divisors = jnp.asarray([1, 3, -1, -2, 2])
        quotients = [jax.lax.div(big, divisors), jax.lax.rem(big, divisors), big // divisors, big % divisors]
        return _long(x), quotients, [reals.astype(kind) for kind in kinds]

    def later(x: jax.Array) -> Any:
        numbers = jax.lax.optimization_barrier((big, reals, jnp.asarray([1, 3, -1, -2, 2])))
        a, r, d = numbers
        kinds = (jnp.int8, jnp.uint8, jnp.int32, jnp.int64, jnp.uint32)
        return _long(x), [jax.lax.div(a, d), jax.lax.rem(a, d), a // d, a % d], [r.astype(kind) for kind in kinds]

    close(tx.fast(function, backend=backend)(X), jax.jit(later)(X))


def test_signs_of_unsigned_integers() -> None:
    def function(x: jax.Array, u: jax.Array) -> Any:
        return _long(x), jax.lax.sign(-u), jnp.abs(-u)

    u = jnp.asarray([0, 3, 2**32 - 1], jnp.uint32)
    close(tx.fast(function)(X, u), jax.jit(function)(X, u))


def test_a_loop_over_a_large_state_is_one_kernel() -> None:
    def function(a: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, 300, lambda k, c: jnp.tanh(a @ c), a)

    a = jnp.asarray(0.2 * RANDOM.normal(size=(12, 12)))
    assert tx.fast(function).explain(a).startswith("scan: native: loops over arrays")
    close(tx.fast(function)(a), jax.jit(function)(a))


def test_a_fast_function_in_a_loop_is_part_of_its_kernel() -> None:
    inner = tx.fast(lambda x: jax.lax.fori_loop(0, 300, lambda k, c: jnp.sin(A @ c) * x + 0.1, x))

    def outer(x: jax.Array) -> jax.Array:
        return jax.lax.scan(lambda c, _: (inner(c), c), x, None, length=20)[1]

    assert "one kernel" in tx.fast(outer).explain(X)
    close(tx.fast(outer)(X), jax.jit(outer)(X), 1e-11)


def test_without_jit_and_looking_for_nan() -> None:
    with jax.disable_jit():
        close(tx.fast(lambda x: x if x[0] > 100 else -x)(X), -X)
    with jax.debug_nans(True), pytest.raises(FloatingPointError):
        tx.fast(counted)(A, X * jnp.nan)
    assert "stablehlo" in tx.fast(counted).lower(A, X).as_text()


# ---- what is said ----------------------------------------------------------------------------------------------------


def test_what_became_of_it_is_said() -> None:
    assert tx.fast(recursion).explain(A, X) == "scan: all iterations in one kernel"
    said = tx.fast(mixed).explain(A, X).splitlines()
    assert len(said) == 3
    assert said[1] == "scan: all iterations in one kernel"
    assert "while: all iterations" in tx.fast(until).explain(A, X)
    assert tx.fast(nested).explain(A, X).endswith("\nscan: scan: all iterations in one kernel")
    assert tx.fast(around_others).explain(A, X).count("while: scan: all iterations in one kernel") == 2
    assert "tx.fast(recursion" in repr(tx.fast(recursion))
    assert "operations" in tx.fast(straight).explain(A, X)
    assert tx.fast(lambda a: a.T).explain(A) == "numbers are moved, nothing is computed"
    assert tx.fast(lambda a: recursion(a.T, a[0])).explain(A) == "scan: all iterations in one kernel"


@pytest.mark.usefixtures("unchecked")
def test_nonsense_is_refused() -> None:
    with pytest.raises(tx.ModelError, match="fast expects a function, got int"):
        tx.fast(3)
    with pytest.raises(tx.ModelError, match='backend expects "auto"'):
        tx.fast(recursion, backend="native")


def test_other_values_compile_nothing_anew() -> None:
    traced = []

    def function(x: jax.Array) -> jax.Array:
        traced.append(None)
        return counted(A, x)

    own = tx.fast(function)
    for k in range(3):
        own(X + k)
    assert len(traced) == 1
    assert math.isfinite(float(own(X)[0]))


def test_a_batch_of_factors_is_scalars() -> None:
    """As a solve inside of vmap is, which would be a call of a library."""
    draw = np.random.default_rng(0)
    matrices, right = draw.normal(size=(3, 4, 4)) + 4.0 * np.eye(4), draw.normal(size=(3, 4))
    solved = tx.fast(jax.vmap(jnp.linalg.solve))
    assert "operations" in solved.explain(matrices, right)
    np.testing.assert_allclose(solved(matrices, right), np.linalg.solve(matrices, right[..., None])[..., 0], rtol=1e-12)
    lower = np.tril(matrices)
    substituted = tx.fast(jax.vmap(lambda a, b: jax.scipy.linalg.solve_triangular(a, b, lower=True)))
    assert "operations" in substituted.explain(lower, right)
    np.testing.assert_allclose(substituted(lower, right), np.linalg.solve(lower, right[..., None])[..., 0], rtol=1e-12)
