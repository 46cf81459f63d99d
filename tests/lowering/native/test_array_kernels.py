"""Functions of small arrays as kernels: operations beside XLA, in vectors of every width; loops, memory, batches."""

import itertools
import warnings
import weakref
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import twistax as tx
from twistax.lowering.array_call import array_call
from twistax.lowering.native.arrays import kernels
from twistax.lowering.native.arrays.kernels import array_kernel
from twistax.lowering.native.arrays.memory import Space
from twistax.lowering.native.arrays.tile import ArrayTile
from twistax.lowering.native.code import NotNative
from twistax.lowering.native.kernel import Kernel
from twistax.lowering.native.machine_code import Processor
from twistax.lowering.scalar.operations import OPERATIONS

RNG = np.random.default_rng(0)
A, B, V, W = (RNG.normal(size=shape) for shape in ((13, 18), (18, 7), (18,), (13,)))
S, T = RNG.normal(size=(5, 13, 18)), RNG.normal(size=(3, 2, 5, 4))
K = np.array(5)
FAR, BEFORE, SHORT = np.array(50), np.array(-3), np.array(4, np.int32)

#: A name, a function, its arguments.
CASES: dict[str, tuple[Callable[..., Any], *tuple[Any, ...]]] = {
    # ---- entry by entry
    "sums of products": (lambda a: a + 1.5 * jnp.sin(a) * a - jnp.cos(2 * a), A),
    "broadcast": (lambda a, v: a * v[None] + v[None, :].sum(), A, V),
    "one number": (lambda a: jnp.exp(a[0, 0]) + a[1, 2], A),
    "transposed": (lambda a: (a.T + 1.0) * 2, A),
    "beside its transpose": (lambda a: a + a.T * 2, A[:, :13]),
    "chosen": (lambda a: jnp.where(a > 0, a, -a * 2) * jnp.isfinite(a).astype(float), A),
    "one condition": (lambda a: jnp.where(a[0, 0] > 0, a, -a), A),
    "powers": (lambda a: jnp.abs(a) ** 1.3 + a**3 + lax.rsqrt(1.0 + a * a), A),
    "clipped": (lambda a: jnp.clip(a, -0.5, jnp.inf), A),
    "NaN and infinities": (lambda a: jnp.where(a > 1, jnp.nan, jnp.maximum(a, 0.0) / jnp.minimum(a, 0.0)), A),
    "integers": (lambda k: (k * 3 - 1, k & 3, k > 2, jnp.sign(k - 3), k.astype(float)), np.arange(7)),
    "truth": (lambda a: ((a > 0) & (a < 1) | ~(a > -1)).astype(int), A),
    "numbers alone": (
        lambda a: jnp.eye(13, 18) * jnp.arange(18.0)[None] + jnp.linspace(0.0, 1.0, 18)[None] + 0.0 * a,
        A,
    ),
    "a long chain": (lambda a: [a := a * 0.99 + 0.1 * jnp.tanh(a) for _ in range(40)][-1], A),
    # ---- products
    "product": (lambda a, b: a @ b, A, B),
    "transposed left": (lambda a: a.T @ a, A),
    "transposed right": (lambda a: a @ a.T, A),
    "both transposed": (lambda a, b: b.T @ a.T, A, B),
    "matrix and vector": (lambda a, v, w: (a @ v, a.T @ w, v @ a.T, w @ a), A, V, W),
    "inner and outer": (lambda v: (v @ v, jnp.outer(v, v)), V),
    "batches": (lambda s: (jnp.einsum("kij,klj->kil", s, s), jnp.einsum("kij,kil->kjl", s, s)), S),
    "batches of vectors": (lambda s, y: jnp.einsum("kni,kn->ki", s, y), S, S[:, :, 0]),
    "several axes": (
        lambda s, y: (jnp.einsum("ij,jkl->ikl", y, s), jnp.tensordot(s, s, ((0, 2), (0, 2)))),
        S,
        A[:5, :5],
    ),
    "batches of batches": (lambda t: jnp.einsum("abij,abkj->baik", t, t), T),
    "blocks and rests": (lambda a: a @ a.T @ a, RNG.normal(size=(33, 41))),
    "one row": (lambda a, b: (a[:1] @ b, b.T @ a[:1].T), A, B),
    # ---- along axes
    **{
        f"along {axes}": (
            lambda s, axes=axes: (
                *(s.sum(axes), s.max(axes), s.min(axes), jnp.abs(s).max(axes, initial=0.0)),
                *((s > 1).any(axes), (s > -3).all(axes), (s > 0).sum(axes)),
            ),
            S,
        )
        for axes in [(0,), (1,), (2,), (0, 1), (1, 2), (0, 2), (0, 1, 2)]
    },
    "along others": (lambda s: (s.transpose(2, 0, 1).sum(1), s[:, ::2].sum((0, 1)), s[..., :1].max(2)), S),
    "product of all": (lambda v: v.prod(), V),
    "NaN is the largest": (lambda v: (v.at[3].set(jnp.nan).max(), v.at[3].set(jnp.nan).min()), V),
    # ---- moves
    "joined": (
        lambda a: (jnp.concatenate([a, a[:3], jnp.zeros((2, 18))]), jnp.concatenate([a[:, 2:5], a[:, :1]], 1)),
        A,
    ),
    "stacked": (lambda v: (jnp.stack([v, 2 * v, v[::-1]], 1), jnp.split(v, [3, 9])), V),
    "padded": (lambda a: (jnp.pad(a, ((1, 2), (0, 3))), lax.pad(a, 1.0, [(1, 2, 2), (-1, 0, 0)])), A),
    "turned round": (lambda a: a[::-1, ::2] + 1, A),
    "reshaped": (lambda s: (s.reshape(5, -1) + 1, s.transpose(1, 0, 2).reshape(13, 90), s.T.ravel()), S),
    "set": (lambda a: (a.at[1:, 3].set(2.0), a.at[1:].add(-a[1:]), a.at[np.array([4, 2])].set(0.5)), A),
    "put apart": (lambda v: jnp.zeros(40).at[np.arange(18) * 2].set(v), V),
    "taken": (lambda a: (a[np.array([3, 1])][:, np.array([0, 0, 2])], a[np.arange(13)], a[5:3:-1]), A),
    "a window": (lambda a, k: lax.dynamic_slice(a, (k, k), (3, 4)), A, K),
    "a window moved inside": (lambda a, k: lax.dynamic_slice(a, (k, 2), (3, 4)), A, FAR),
    "a window before the first": (lambda a, k: lax.dynamic_slice_in_dim(a, k, 4), A, BEFORE),
    "an entry": (lambda a, k: lax.dynamic_index_in_dim(a, k, 1, False) * 2.0, A, SHORT),
    "a window of numbers": (lambda a, k: lax.dynamic_slice_in_dim(jnp.arange(20.0), k, 13)[:, None] * a, A, K),
    "updated": (lambda a, k: lax.dynamic_update_slice(a, jnp.ones((2, 3)), (k, k)), A, K),
    "largest place": (lambda v: (jnp.argmax(v), jnp.argmin(v)), V),
    "cumulative": (lambda a: jnp.cumsum(a, 0), A[:4, :4]),
    "one number moved": (lambda x: (jnp.flip(x), lax.slice(x, (), ()), lax.dynamic_slice(x, (), ())), np.array(3.25)),
    "one number replaced": (lambda x: lax.dynamic_update_slice(x, x + 1.0, ()), np.array(3.25)),
    "one number in a loop": (lambda x: lax.fori_loop(0, 4, lambda i, c: lax.rev(c, ()) * 0.5 + x, x), np.array(3.25)),
    "rows of nothing": (lambda v: lax.scan(lambda c, x: (c * 0.5 + x.sum(), c), v, np.zeros((5, 0))), V),
    "two precisions": (lambda a: jnp.sin(a.astype(np.float32)).astype(float) + jnp.cos(a) + jnp.sin(a * 1e-9), A),
    # ---- linear algebra of a few rows
    "Cholesky": (lambda a: jnp.linalg.cholesky(a @ a.T + jnp.eye(5)), A[:5]),
    "solved": (lambda a, b: jnp.linalg.solve(a, b), A[:5, :5], B[:5]),
    # ---- loops and branches
    "scan": (lambda a: lax.scan(lambda c, x: (c * 0.5 + x, c * x), jnp.zeros(18), a), A),
    "scan back": (lambda a: lax.scan(lambda c, x: (c * 0.5 + x, (c * x, c.sum())), a[0], a, reverse=True), A),
    "scan of two": (lambda a: lax.scan(lambda c, x: (c * 0.5 + x, c * x), jnp.zeros(18), a[:2], reverse=True), A),
    "scan of none": (lambda a: lax.scan(lambda c, x: (c + x, c), jnp.ones(18), a[:0]), A),
    "scan of scans": (lambda s: jax.vmap(lambda a: lax.scan(lambda c, x: (c * 0.5 + x, c * x), a[0], a))(s), S),
    "exchanged": (lambda a: lax.fori_loop(0, 5, lambda i, c: (c[1], c[0] + i), (a, 2 * a)), A),
    "turned in place": (lambda v: lax.fori_loop(0, 5, lambda i, c: c[::-1], v), V),
    "shifted in place": (lambda v: lax.fori_loop(0, 5, lambda i, c: jnp.concatenate([c[1:], c[:1]]), v), V),
    "a view of another": (
        lambda a, b: lax.fori_loop(0, 3, lambda i, c: (c[1][:13, :7], c[1] + c[0].sum()), (b[:13], b)),
        A,
        B,
    ),
    "while": (
        lambda a: lax.while_loop(lambda c: (c[0] < 7) & (c[1].max() < 50.0), lambda c: (c[0] + 1, c[1] * 1.7), (0, a)),
        A,
    ),
    "while of a batch": (
        jax.vmap(lambda r: lax.while_loop(lambda c: c[1].max() < 9.0, lambda c: (c[0] + 1, c[1] * 1.7), (0, r))),
        A,
    ),
    "while never": (lambda a: lax.while_loop(lambda c: c.max() < 0.0, lambda c: c * 2.0, a), A),
    "branches": (lambda a: lax.cond(a[0, 0] > 0, lambda: a * 2, lambda: a[::-1]), A),
    **{
        f"switch {k}": (lambda a, k: lax.switch(k, [lambda: a * 2, lambda: a[::-1], lambda: a + 1]), A, np.array(k))
        for k in (-3, 0, 1, 2, 7)
    },
    "a branch in a loop": (
        lambda a: lax.scan(lambda c, x: (lax.cond(x[0] > 0, lambda: c + x, lambda: c * 0.5), c.max()), a[0], a),
        A,
    ),
    "a loop in a branch": (
        lambda a: lax.cond(a[0, 0] < 9, lambda: lax.fori_loop(0, 3, lambda i, c: c @ a.T @ a / 20, a), lambda: a),
        A,
    ),
    "empty": (
        lambda a: (jnp.concatenate([a, jnp.zeros((0, 18))]), a[:0].sum(), jnp.zeros((3, 0)) @ jnp.zeros((0, 4)), a[:0]),
        A,
    ),
}


def flattened(function: Callable[..., Any]) -> Callable[..., list[Any]]:
    return lambda *arguments: jax.tree.leaves(function(*arguments))


@pytest.mark.parametrize("bits", Processor.widths())
@pytest.mark.parametrize("name", CASES)
def test_every_operation_gives_what_XLA_gives(name: str, bits: int) -> None:
    function, *arguments = CASES[name]
    close = 3e-7 if name == "two precisions" else 1e-11
    expected = jax.jit(flattened(function))(*arguments)
    kernel = Kernel(ArrayTile(jax.make_jaxpr(flattened(function))(*arguments)), Processor.host(bits))
    found = kernel.run([np.asarray(arguments[k]).reshape(1, -1) for k in kernel.tile.read])
    for k, own in zip(kernel.tile.written, found, strict=True):
        assert own.dtype == expected[k].dtype
        np.testing.assert_allclose(own.reshape(expected[k].shape), expected[k], rtol=close, atol=1e-12)


@pytest.mark.parametrize("bits", Processor.widths())
def test_single_precision(bits: int) -> None:
    function = flattened(lambda a, b: (a @ b, jnp.sin(a).sum(1), a.T.max(0)))
    arguments = A.astype(np.float32), B.astype(np.float32)
    expected = jax.jit(function)(*arguments)
    kernel = Kernel(ArrayTile(jax.make_jaxpr(function)(*arguments)), Processor.host(bits))
    for own, other in zip(kernel.run([a.reshape(1, -1) for a in arguments]), expected, strict=True):
        np.testing.assert_allclose(own.reshape(other.shape), other, rtol=2e-5, atol=1e-5)


# ---- calls -----------------------------------------------------------------------------------------------------------


def doubling(a: jax.Array, least: jax.Array) -> tuple[jax.Array, jax.Array]:
    """How often to double until the largest entry is beyond a limit, and what it is then."""
    return lax.while_loop(lambda c: c[1].max() < least, lambda c: (c[0] + 1, 2.0 * c[1]), (0, a))


def test_it_is_one_kernel_in_a_jitted_function() -> None:
    text = jax.jit(lambda a, k: array_call(doubling, a, k)).lower(A, 100.0).as_text()
    assert text.count("custom_call @twistax_") == 1
    assert "while" not in text


def test_rows_run_their_own_loops() -> None:
    limits = np.array([1.0, 1e2, 1e4, 1e1, 1e6])
    count, found = jax.jit(jax.vmap(lambda least: array_call(doubling, A, least)))(limits)
    size = A.max()
    np.testing.assert_array_equal(count, [max(0, int(np.ceil(np.log2(least / size)))) for least in limits])
    np.testing.assert_allclose(found, A * 2.0 ** np.asarray(count)[:, None, None], rtol=1e-14)


def test_batches_of_batches_with_shared_arguments() -> None:
    def function(s: Any, v: Any) -> Any:
        return array_call(lambda a, v: a @ v + a.sum(), s, v)

    batched = jax.jit(jax.vmap(jax.vmap(function, (0, None)), (None, 0)))(S, np.stack([V, 2 * V]))
    expected = np.stack([S @ own + S.sum((1, 2))[:, None] for own in (V, 2 * V)])
    np.testing.assert_allclose(batched, expected, rtol=1e-12, atol=1e-12)


def test_derivatives_are_those_of_the_function() -> None:
    def function(a: Any) -> Any:
        return lax.scan(lambda c, x: (jnp.sin(c) * x, c), a[0], a)[0].sum()

    called = lambda a: array_call(function, a)  # noqa: E731
    np.testing.assert_allclose(jax.grad(called)(A), jax.grad(function)(A), rtol=1e-12)
    np.testing.assert_allclose(jax.jvp(called, (A,), (A,))[1], jax.jvp(function, (A,), (A,))[1], rtol=1e-12)
    step = 1e-6
    numeric = (function(A + step * A) - function(A - step * A)) / (2.0 * step)
    np.testing.assert_allclose(jax.jvp(called, (A,), (A,))[1], numeric, rtol=1e-7)


def test_values_that_it_closes_over_are_traced() -> None:
    found = jax.grad(lambda x: array_call(lambda a: (a * x).sum(), A))(2.0)
    np.testing.assert_allclose(found, A.sum(), rtol=1e-12)


def test_scalar_programs_inside_run_by_their_kernels() -> None:
    """Of one body and of many, in a loop."""
    fast = tx.fast(lambda v: jnp.sin(v) * v @ v + v, backend=tx.Native(least=0))

    def function(points: Any) -> Any:
        return lax.fori_loop(0, 3, lambda i, p: jax.vmap(fast)(p) / 10.0 + fast(p[0])[None], points)

    points = RNG.normal(size=(7, 3))
    assert "native_program" in str(jax.make_jaxpr(function)(points))
    np.testing.assert_allclose(array_call(function, points), function(points), rtol=1e-12)


def test_a_kernel_that_was_traced_before_is_part_of_another() -> None:
    inner = jax.jit(lambda a: array_call(lambda b: jnp.sin(b) @ b.T, a))
    inner(A)
    text = jax.jit(lambda a: array_call(lambda b: inner(b) + 1.0, a)).lower(A).as_text()
    assert text.count("custom_call @twistax_") == 1


# ---- where there is no kernel ----------------------------------------------------------------------------------------


def test_what_has_no_native_form_runs_as_it_is() -> None:
    function = lambda k: k // 3 + k % 4  # noqa: E731
    with pytest.raises(NotNative, match="div of i64"):
        Kernel(ArrayTile(jax.make_jaxpr(lambda k: [function(k)])(np.arange(9))), Processor.host())
    np.testing.assert_array_equal(array_call(function, np.arange(9)), np.arange(9) // 3 + np.arange(9) % 4)


@pytest.mark.parametrize(
    "function",
    [
        lambda a: jnp.linalg.cholesky(a @ a.T + 40 * jnp.eye(13)),
        lambda a: jax.pure_callback(lambda x: x, jax.ShapeDtypeStruct(a.shape, a.dtype), a) + 1.0,
        lambda a: lax.complex(a, a).real,
        lambda a: a.astype(jnp.int8),
        lambda a: a * jax.random.uniform(jax.random.key(3), a.shape),
    ],
)
def test_large_factors_callbacks_and_other_types_stay_with_XLA(function: Callable[..., Any]) -> None:
    assert array_kernel(jax.make_jaxpr(lambda a: [function(a)])(A)) is None
    np.testing.assert_allclose(array_call(function, A), function(A), rtol=1e-12)


def test_kernels_that_are_wrong_are_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    """The probe is compiled with the operation that is broken: here sums are differences."""
    monkeypatch.setenv("TWISTAX_CACHE", str(tmp_path))
    monkeypatch.setitem(vars(OPERATIONS["add"]), "llvm", OPERATIONS["sub"].llvm)
    kernels._check.cache_clear()
    closed = jax.make_jaxpr(lambda a: [a * 3.25])(A)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        assert array_kernel(closed) is None
    assert "no native kernel" in str(said[0].message)
    monkeypatch.undo()
    kernels._check.cache_clear()
    assert array_kernel(closed) is not None


# ---- memory ----------------------------------------------------------------------------------------------------------


def test_arrays_that_live_never_share_memory() -> None:
    rng, space, living = np.random.default_rng(1), Space(), list[Any]()
    for _ in range(400):
        if living and rng.random() < 0.45:
            living.pop(rng.integers(len(living)))
        else:
            living.append(space.view(np.empty(int(rng.integers(1, 60)))))
        spans = sorted((own.offset, own.offset + own.array.nbytes) for own in living)
        assert all(first[1] <= second[0] for first, second in itertools.pairwise(spans))
        assert not spans or spans[-1][1] <= space.size


def test_memory_is_used_again() -> None:
    space = Space()
    for _ in range(50):
        space.view(np.empty(100))
    assert space.size < 1000


def test_large_functions_take_their_memory_from_the_heap() -> None:
    big = RNG.normal(size=(90, 90))
    found = array_call(lambda a: lax.fori_loop(0, 4, lambda i, c: c @ a / 50.0 + i, a), big)
    own = big
    for i in range(4):
        own = own @ big / 50.0 + i
    np.testing.assert_allclose(found, own, rtol=1e-11, atol=1e-11)


def test_a_kernel_goes_with_its_function() -> None:
    kernel = array_kernel(jax.make_jaxpr(lambda a: [jnp.sin(a) * 1.2345])(A))
    gone = weakref.ref(kernel.lease)
    del kernel
    assert gone() is None
