"""A node of the user around jax.numpy: plain JAX, without this package, is the oracle."""

from collections.abc import Callable
from functools import cache
from random import Random

import jax
import jax.numpy as jnp
import numpy as np
from matrices import positive
from plans import Plan, maker
from term import Shape

#: Of an array of any shape, one a line.
ANY = """
jnp.sin(a) * 2
jnp.where(a > 0.5, a, -a)
jnp.clip(a, -0.5, 0.5)
jnp.arctan2(a, 1.0 + a * a)
a**3
jnp.round(a)
jnp.floor(a)
jnp.ceil(a)
jnp.logaddexp(a, 0.0)
jnp.sinc(a)
jnp.expm1(jnp.tanh(a))
jnp.log1p(jnp.abs(a))
jnp.remainder(a, 1.5)
jnp.fmod(a, 1.5)
jnp.sign(a)
jnp.copysign(a, -1.0)
jax.nn.sigmoid(a)
jax.nn.softplus(a)
jax.scipy.special.erf(a)
jnp.hypot(a, 2.0)
jnp.cbrt(a)
jax.lax.cond(jnp.sum(a) > 0, lambda b: b, lambda b: -2.0 * b, a)
jnp.square(a.astype(jnp.float32)).astype(a.dtype)
jax.lax.fori_loop(0, 3, lambda i, b: b * 0.5 + i, a)
jnp.where(jnp.isfinite(a), a, 0.0)
jnp.nan_to_num(a)
jnp.clip(jnp.trunc(a), -2e9, 2e9).astype(int).astype(a.dtype)
jnp.clip(1.7 * a, -2e9, 2e9).astype(int).astype(a.dtype)
jnp.clip(jnp.rint(a * 3.0), -9, 9).astype(jnp.int32).astype(a.dtype)
jax.lax.while_loop(lambda b: jnp.max(jnp.where(b < jnp.inf, b, 0.0)) > 1.0, lambda b: 0.5 * b, a)
jax.lax.stop_gradient(a) + a
jax.checkpoint(jnp.sin)(a)
jax.jit(jnp.cos)(a)
jax.vmap(jnp.sin)(a[None])[0]
""".strip().splitlines()

#: Of an array with an axis.
AXIS = """
jnp.cumsum(a, axis=-1)
jnp.cumprod(a, axis=0)
jnp.sort(a, axis=-1)
jnp.flip(a, axis=0)
jnp.roll(a, 1, axis=-1)
a - jnp.mean(a)
a / (1.0 + jnp.max(jnp.abs(a)))
jnp.take(a, jnp.arange(a.shape[0]), axis=0, mode='clip')
a.at[0].set(2.0 * a[-1])
a.at[..., 0].add(a[..., -1])
a.at[-1].multiply(3.0)
a.at[:1].apply(jnp.tanh)
a.at[0].min(0.25)
a.at[0].max(0.25)
jnp.take(a, jnp.array([7] * a.shape[0]), axis=0, mode='clip')
jnp.take(a, jnp.array([-1] * a.shape[0]), axis=0, mode='wrap')
jnp.take(a, jnp.array([7] + [0] * (a.shape[0] - 1)), axis=0, mode='fill', fill_value=7.0)
a.at[jnp.array([9, 0])].set(0.5, mode='drop')
a.at[jnp.array([9, 0])].add(0.5, mode='clip')
jnp.where(jnp.arange(a.shape[-1]) < 1, a, 2 * a)
jax.lax.cummax(a)
jax.lax.dynamic_update_slice(a, a[:1], (5,) + (0,) * (a.ndim - 1))
jax.nn.softmax(a)
a[jnp.argsort(jax.lax.stop_gradient(a.ravel())[: a.shape[0]])]
jax.lax.rev(a, (0,))
jnp.diff(a, axis=-1, append=a[..., :1])
jnp.convolve(a.ravel(), jnp.array([1.0, 2.0], a.dtype), 'full')[: a.size].reshape(a.shape)
jnp.einsum('...i,...i->...i', a, a)
jax.lax.scan(lambda c, row: (c + row, c * row), jnp.zeros(a.shape[1:], a.dtype), a)[1]
jnp.linalg.norm(a) * a
jnp.interp(a, jnp.array([-1.0, 0.5, 2.0], a.dtype), jnp.array([1.0, -1.0, 4.0], a.dtype))
a * jnp.argmax(a)
a * jnp.argmin(a)
jax.lax.dynamic_slice(a, (1,) + (0,) * (a.ndim - 1), (1,) + a.shape[1:]) + a
jnp.pad(a, [(1, 0)] + [(0, 0)] * (a.ndim - 1))[1:]
a * jax.random.normal(jax.random.key(3), a.shape, jnp.float32).astype(a.dtype)
jnp.searchsorted(jnp.array([-1.0, 0.0, 1.0], a.dtype), a) * a
jnp.concatenate([a[1:], a[:1]])
jnp.repeat(a, 2, axis=0)[::2]
jnp.tile(a, (2,) + (1,) * (a.ndim - 1))[: a.shape[0]]
a.T.reshape(a.shape)
jax.lax.reduce_precision(a, 8, 10)
jnp.median(a) + a
jnp.prod(a) - a
jnp.std(a) + a
""".strip().splitlines()


@maker
def users_node(source: Random, shape: Shape) -> Plan:
    """A node of one's own around jax.numpy. Plain JAX, without this package, is the oracle."""
    return around(source.choice(ANY + (AXIS if shape else [])), shape)


def around(body: str, shape: Shape) -> Plan:
    name = f"User{(ANY + AXIS).index(body)}"
    setup = (
        f"class {name}(tx.Expr):\n"
        '    """A node of the user."""\n'
        "    a: tx.expr.fields.Operand\n"
        "    def infer_shape(self, a): return a\n"
        f"    def evaluate(self, a): return {body}"
    )
    return Plan(f"{name}({{0}})", lambda a: np.asarray(_alone(body)(jnp.asarray(a, float))), (shape,), setup)


@cache
def _alone(body: str) -> Callable[[jax.Array], jax.Array]:
    """Jitted: step by step each step of each shape would be compiled."""
    evaluate: Callable[[jax.Array], jax.Array] = jax.jit(eval(f"lambda a: {body}", {"jnp": jnp, "jax": jax}))
    return evaluate


@maker
def pair_of_weights(source: Random, shape: Shape) -> Plan:
    """Two nodes of one class with long static arrays that differ in one entry."""
    place, kind = source.randrange(2000), source.choice(["np.asarray", "jnp.asarray", "tuple"])
    setup = (
        "class Weighted(tx.Expr):\n"
        '    """Scaled by the sum of weights."""\n'
        "    a: tx.expr.fields.Operand\n"
        "    w: object\n"
        "    def infer_shape(self, a): return a\n"
        "    def evaluate(self, a): return a * jnp.sum(jnp.asarray(self.w, a.dtype))"
    )
    two, five = (f"Weighted({{0}}, w={kind}({by} * (np.arange(2000) == {place})))" for by in (2.0, 5.0))
    return Plan(f"({two} - {five})", lambda a: 2.0 * a - 5.0 * a, (shape,), setup)


@maker
def factorised(source: Random, shape: Shape) -> Plan | None:
    """Linear algebra of jax.numpy inside a node of the user."""
    if len(shape) != 2 or shape[0] != shape[1]:
        return None
    n = shape[0]
    body, numpy = source.choice(
        [
            ("jnp.linalg.cholesky(S)", np.linalg.cholesky),
            ("jnp.linalg.inv(S)", np.linalg.inv),
            ("jnp.linalg.solve(jnp.tanh(a) + 2.5 * jnp.eye(n, dtype=a.dtype), S)", None),
            ("jnp.broadcast_to(jnp.linalg.det(S), a.shape)", lambda S: np.full(S.shape, np.linalg.det(S))),
        ]
    )
    setup = (
        f"class Factorised{len(body)}Of{n}(tx.Expr):\n"
        '    """A node of the user."""\n'
        "    a: tx.expr.fields.Operand\n"
        "    def infer_shape(self, a): return a\n"
        "    def evaluate(self, a):\n"
        f"        n = {n}\n"
        "        S = jnp.tanh(a) @ jnp.tanh(a).T + 2.0 * jnp.eye(n, dtype=a.dtype)\n"
        f"        return {body}"
    )
    expected = (
        (lambda a: np.linalg.solve(np.tanh(a) + 2.5 * np.eye(n), positive(a)))
        if numpy is None
        else lambda a: numpy(positive(a))
    )
    return Plan(f"{setup.split('(')[0].split()[1]}({{0}})", expected, (shape,), setup)
