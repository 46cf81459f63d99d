"""Operations that move entries, sums and factorisations, as scalars: as JAX has them."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from scalar_cases import Case, as_jax, evaluate

from twistax.scalar.reader import scalarize

_rng = np.random.default_rng(0)
V, W, M, N = (_rng.normal(size=shape) for shape in ((6,), (6,), (3, 4), (4, 2)))
T = _rng.normal(size=(2, 3, 4))
S = _rng.normal(size=(3, 3)) + 3.0 * np.eye(3)
P = S @ S.T
NO_DIAGONAL = np.array([[0.0, 2.0, 1.0], [1.0, 0.0, 3.0], [2.0, 1.0, 0.0]]) + 0.0
TIES = np.array([[1.0, 3.0, 3.0], [2.0, 2.0, -1.0]])
EVEN = np.array([[1.0, 3.0, 3.0, 3.0], [2.0, 2.0, 2.0, 5.0]])
K = np.array(2)
MASK = np.array([True, False, True, True, False, True])


def at(*places: Any) -> np.ndarray:
    return np.array(places)


def _set(kind: str, places: Any, mode: str | None = None) -> Any:
    return lambda a, b: getattr(a.at[places], kind)(b, mode=mode)


def _lu(a: jax.Array) -> Any:
    return lax.linalg.lu(a)


MOVES = [
    Case("transpose", lambda a: a.transpose(2, 0, 1), (T,)),
    Case("reshape", lambda a: a.reshape(4, 6), (T,)),
    Case(
        "broadcast",
        lambda a, b: (jnp.broadcast_to(a, (2, 6)), jnp.broadcast_to(b[:, :, None], (3, 4, 2))[..., 0]),
        (V, M),
    ),
    Case("concatenate", lambda a, b: jnp.concatenate([a, jnp.ones(2), b, a]), (V, W)),
    Case("stack", lambda a, b: (jnp.stack([a, b]), jnp.stack([a, b], axis=1), jnp.stack([a, b], axis=-1)), (V, W)),
    Case("unstack", lambda a: jnp.unstack(a, axis=1), (M,)),
    Case("pad", lambda a: lax.pad(a, 7.0, ((1, 2, 0), (0, 1, 2))), (M,)),
    Case("pad by less than nothing", lambda a: lax.pad(a, 0.0, ((-1, -1, 0), (-2, 3, 1))), (M,)),
    Case("pad with a variable", lambda a, b: lax.pad(a, b[0], ((1, -1, 1),)), (V, W)),
    Case("slices", lambda a: (a[1:5:2], a[::-1], a[-2:], a[5:1:-2]), (V,)),
    Case("reverse", lambda a: lax.rev(a, (0, 2)), (T,)),
    Case("split", lambda a: jnp.split(a, [1, 4]), (V,)),
    Case("tile", lambda a: jnp.tile(a, (2, 3)), (M,)),
    Case("repeat", lambda a: jnp.repeat(a, 2, axis=1), (M,)),
    Case("roll", lambda a: jnp.roll(a, 2), (V,)),
    Case("iota", lambda a: a * lax.broadcasted_iota(a.dtype, (3, 4), 1) + jnp.arange(3.0)[:, None], (M,)),
    Case(
        "eye, tri", lambda a: (jnp.tril(a) - jnp.triu(a, 1), a * jnp.eye(3), jnp.diag(a), jnp.diag(jnp.diag(a))), (S,)
    ),
    Case("dynamic slice, known", lambda a: lax.dynamic_slice(a, (1, 2), (2, 2)), (M,)),
    Case(
        "dynamic slice, moved inside",
        lambda a: (lax.dynamic_slice(a, (5, -9), (2, 2)), lax.dynamic_index_in_dim(a, 9)),
        (M,),
    ),
    Case(
        "dynamic slice, unknown",
        lambda a, k: (lax.dynamic_slice(a, (k,), (1,)), lax.dynamic_slice(a, (k,), (3,))),
        (V, K),
    ),
    Case(
        "dynamic slice, unknown beyond",
        lambda a, k: (lax.dynamic_slice(a, (k + 9,), (1,)), lax.dynamic_slice(a, (k - 9,), (1,))),
        (V, K),
    ),
    Case(
        "dynamic slice, unknown along some axes",
        lambda a, k: (
            lax.dynamic_slice(a, (1, k), (2, 1)),
            lax.dynamic_slice(a, (k - 9, 1), (1, 3)),
            lax.dynamic_slice(a, (k - 1, k + 9), (1, 1)),
            lax.dynamic_slice(a, (k, 0), (2, 1)),
        ),
        (M, K),
    ),
    Case("dynamic update, known", lambda a, b: lax.dynamic_update_slice(a, b[:2], (3,)), (V, W)),
    Case("dynamic update, moved inside", lambda a, b: lax.dynamic_update_slice(a, b[:2], (9,)), (V, W)),
    Case("dynamic update, unknown", lambda a, b, k: lax.dynamic_update_slice(a, b[:2], (k,)), (V, W, K)),
    Case(
        "indices",
        lambda a: (a[0, 1], a[-1], a[:, -2], a[at(0, 2, 0)], a[at(2, 0), at(1, -1)], a[1:, at(0, 3)], a[None, ..., 1]),
        (M,),
    ),
    Case(
        "indices of higher rank",
        lambda a: (a[:, at([0, 1], [2, 2])], a[at(1, 0), :, at(3, 0)], a[..., at(0, -1)]),
        (T,),
    ),
    Case("index unknown", lambda a, k: (a[k], a[k + 3], a[-k], a[jnp.stack([k, k - 1])]), (V, K)),
    Case("row unknown", lambda a, k: a[k], (M, K)),
    Case("place among sorted", lambda a, b: jnp.searchsorted(jnp.cumsum(jnp.abs(a)), b), (V, W)),
    Case("long table, place unknown", lambda a, k: jnp.tile(a, 4)[k], (V, K)),
    Case("mask", lambda a: (a[MASK], jnp.where(MASK, a, 0.0)), (V,)),
    Case("take", lambda a: [jnp.take(a, jnp.array([-7, -2, 1, 6, 13]), mode=m) for m in ("clip", "wrap")], (V,)),
    Case("take, filled", lambda a: jnp.take(a, jnp.array([-2, 1, 6]), mode="fill", fill_value=5.0), (V,)),
    Case(
        "take, place unknown",
        lambda a, k: [jnp.take(a, k + jnp.arange(3), mode=m, fill_value=9.0) for m in ("clip", "wrap", "fill")],
        (V, np.array(4)),
    ),
    Case("set", _set("set", np.array([0, -1, 3])), (V, W[:3])),
    Case("set a row", _set("set", (slice(None), 2)), (M, W[:3])),
    Case("add, repeated places", _set("add", np.array([0, 3, 0, 0])), (V, W[:4])),
    Case("multiply", lambda a, b: a.at[at(5, 1)].multiply(b, unique_indices=True), (V, W[:2])),
    Case("set beyond", _set("set", np.array([7, 1])), (V, W[:2])),
    Case("add beyond", _set("add", np.array([7, -9, 1])), (V, W[:3])),
    Case("add beyond, clipped", _set("add", np.array([7, 1]), "clip"), (V, W[:2])),
    Case("largest at places", _set("max", np.array([2, 1])), (V, W[:2])),
    Case("set, place unknown", lambda a, b, k: a.at[k].set(b[0]), (V, W, K)),
    Case("set a block", lambda a, b: a.at[1:, 1:3].set(b[:2]), (M, N)),
    Case("set rows of a tensor", lambda a, b: a.at[:, at(2, 0)].add(b[None, :2, :]), (T, M)),
    Case("sort", lambda a, b: (jnp.sort(a), jnp.argsort(a), b[jnp.argsort(a)]), (V, W)),
    Case("sort pairs, one read", lambda a, b: lax.sort((a, b), num_keys=1)[1], (V, W)),
    Case("nothing", lambda a, b: (jnp.concatenate([a, b[:0]]), b[:0], jnp.sum(b[:0]), jnp.zeros((0, 3), int)), (V, W)),
    Case(
        "empty arguments",
        lambda a, b: (a * 2.0, a[:, None] @ jnp.ones((1, 3)), b, a**2, jnp.cumsum(a)),
        (np.zeros(0), V),
    ),
    Case("same result twice", lambda a: (a, a, jnp.sin(a), jnp.sin(a), a[0], jnp.ones(2)), (V,)),
]

SUMS = [
    Case("products", lambda a, b: (a @ b, b.T @ a.T, a @ a.T), (M, N)),
    Case("batched products", lambda a, b: (jnp.einsum("bij,bkj->bik", a, a), jnp.einsum("bij,jk->ibk", a, b)), (T, N)),
    Case(
        "tensor products",
        lambda a, b: (jnp.einsum("bij,ij->b", a, b), jnp.tensordot(a, a, 3), jnp.outer(b[0], b[1])),
        (T, M),
    ),
    Case("product of nothing", lambda a: a[:, :0] @ a[:, :0].T + a @ a.T, (M,)),
    Case("integer products", lambda a: (a @ a.T, a.sum(), jnp.cumsum(a, 0)), (np.arange(6).reshape(2, 3),)),
    Case("wide product", lambda a: lax.dot(a, a.T, preferred_element_type=np.float64), (M.astype(np.float32),)),
    Case("sums", lambda a: (a.sum(), a.sum(1), a.sum((0, 2)), a.mean(), a.prod(0), jnp.linalg.norm(a[0])), (T,)),
    Case("extremes", lambda a: (a.max(), a.min(1), a.max((0, 2))), (T,)),
    Case("extremes at ties", lambda a: (a.max(1), a.min(1)), (TIES,)),
    Case("extremes at ties of three", lambda a: (a.max(1), a.min(1)), (EVEN,)),
    Case("all, any", lambda a: (jnp.all(a > 0.0), jnp.any(a > 1.0, axis=1), jnp.sum(a > 0.0)), (TIES,)),
    Case(
        "cumulative",
        lambda a: (
            jnp.cumsum(a, 1),
            jnp.cumprod(a, 0),
            lax.cumsum(a, 1, reverse=True),
            lax.cumprod(a, 0, reverse=True),
        ),
        (M,),
    ),
    Case("cumulative extremes", lambda a: (lax.cummax(a, 1), lax.cummin(a, 0), lax.cummax(a, 1, reverse=True)), (M,)),
    Case("cumulative log of sums", lambda a: lax.cumlogsumexp(a, 1), (M,)),
    Case(
        "places of extremes", lambda a: (jnp.argmax(a), jnp.argmax(a, 1), jnp.argmin(a, 0), jnp.argmin(a, 1)), (TIES,)
    ),
    Case("convolution", lambda a, b: jnp.convolve(a, b[:3]), (V, W)),
    Case(
        "cross, trace, kron",
        lambda a, b: (jnp.cross(a[:3], b[:3]), jnp.trace(jnp.outer(a, b)), jnp.kron(a[:2], b[:2])),
        (V, W),
    ),
    Case("interpolation", lambda a: jnp.interp(a, jnp.array([-1.0, 0.2, 2.0]), jnp.array([3.0, -1.0, 5.0])), (V,)),
    Case("polynomial", lambda a, b: jnp.polyval(b[:4], a), (V, W)),
]

ALGEBRA = [
    Case("Cholesky", lambda a: jnp.linalg.cholesky(a), (P,)),
    Case("Cholesky of a batch", lambda a: jnp.linalg.cholesky(a), (np.stack([P, P + np.eye(3)]),)),
    Case("LU", lambda a: _lu(a)[0], (S,)),
    Case("LU with rows swapped", _lu, (NO_DIAGONAL,), forward=False, reverse=False),
    Case("LU with rows swapped, derivative", lambda a: _lu(a)[0], (NO_DIAGONAL,)),
    Case(
        "LU of structural zeros",
        lambda a: _lu(jnp.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) * a),
        (S,),
        forward=False,
        reverse=False,
    ),
    Case("LU, tall", lambda a: _lu(a)[0], (N,)),
    Case("LU of a batch", lambda a: _lu(a)[0], (np.stack([S, NO_DIAGONAL]),)),
    *[
        Case(
            f"triangular solve {left} {lower} {trans} {unit}",
            functools.partial(
                lax.linalg.triangular_solve, left_side=left, lower=lower, transpose_a=trans, unit_diagonal=unit
            ),
            (S, M if left else M.T),
        )
        for left, lower, trans, unit in [
            (1, 1, 0, 0),
            (1, 0, 1, 0),
            (0, 1, 0, 1),
            (0, 0, 1, 0),
            (0, 1, 1, 0),
            (1, 0, 0, 1),
        ]
    ],
    Case("solve", lambda a, b: (jnp.linalg.solve(a, b), jnp.linalg.solve(a.T, b[:, 0])), (S, M)),
    Case("solve with rows swapped", lambda a, b: jnp.linalg.solve(a, b), (NO_DIAGONAL, M)),
    Case("solve a batch", lambda a, b: jnp.linalg.solve(a, b), (np.stack([S, NO_DIAGONAL]), np.stack([M, 2.0 * M]))),
    Case("solve by Cholesky", lambda a, b: jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(a + a.T), b), (P, M)),
    Case(
        "inverse, determinant",
        lambda a: (jnp.linalg.inv(a), jnp.linalg.det(a), jnp.linalg.slogdet(a)),
        (NO_DIAGONAL + 0.1 * S,),
    ),
    Case("determinant of four", lambda a: jnp.linalg.det(a), (np.kron(N[:2], S[:2, :2]) + np.eye(4)[::-1],)),
    Case("a large inverse", lambda a: jnp.linalg.inv(jnp.kron(jnp.eye(5), a)), (S,)),
    Case("QR", lambda a: jnp.linalg.qr(a), (S,)),
    Case("eigenvalues", lambda a: jnp.linalg.eigvalsh(a + a.T), (S,)),
    Case("Fourier transform", lambda a: jnp.abs(jnp.fft.fft(a)) ** 2, (V,)),
    Case("Fourier transform and back", lambda a, b: jnp.fft.irfft(jnp.fft.rfft(a) * jnp.fft.rfft(b)), (V, W)),
    Case("matrix exponential", lambda a: jax.scipy.linalg.expm(0.1 * a), (S,), reverse=False),
]

CASES = [*MOVES, *SUMS, *ALGEBRA]


test_as_jax = as_jax(CASES)


def test_nan_has_the_place_that_jax_gives_it() -> None:
    """The first of NaN is the extreme; sorted it is last, in a precision that is not the program's too."""

    def function(a: jax.Array) -> list[jax.Array]:
        return [jnp.argmax(a, 1), jnp.argmin(a, 0), jnp.sort(a[0].astype(np.float32))]

    a = np.array([[3.0, np.nan, 2.0], [np.nan, 5.0, np.nan], [1.0, 4.0, 0.0]])
    found = evaluate(scalarize(function, jax.ShapeDtypeStruct(a.shape, a.dtype)), a)
    for mine, theirs in zip(found, function(jnp.asarray(a)), strict=True):
        np.testing.assert_array_equal(mine, theirs)
