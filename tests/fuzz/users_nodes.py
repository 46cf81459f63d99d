"""A node of the user around jax.numpy: plain JAX, without this package, is the oracle."""

from __future__ import annotations

from random import Random

import jax
import jax.numpy as jnp
import numpy as np
from operations import Plan, maker
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
jnp.trunc(a).astype(int).astype(a.dtype)
jax.lax.while_loop(lambda b: jnp.max(b) > 1.0, lambda b: 0.5 * b, a)
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
jnp.where(jnp.arange(a.shape[-1]) < 1, a, 2 * a)
jax.lax.cummax(a)
jax.lax.dynamic_update_slice(a, a[:1], (5,) + (0,) * (a.ndim - 1))
jax.nn.softmax(a)
a[jnp.argsort(jax.lax.stop_gradient(a.ravel())[: a.shape[0]])]
jax.lax.rev(a, (0,))
jnp.diff(a, axis=-1, append=a[..., :1])
jnp.convolve(a.ravel(), jnp.array([1.0, 2.0]), 'full')[: a.size].reshape(a.shape)
jnp.einsum('...i,...i->...i', a, a)
jax.lax.scan(lambda c, row: (c + row, c * row), jnp.zeros(a.shape[1:], a.dtype), a)[1]
jnp.linalg.norm(a) * a
jnp.interp(a, jnp.array([-1.0, 0.5, 2.0]), jnp.array([1.0, -1.0, 4.0]))
a * jnp.argmax(a)
a * jnp.argmin(a)
jax.lax.dynamic_slice(a, (1,) + (0,) * (a.ndim - 1), (1,) + a.shape[1:]) + a
jnp.pad(a, [(1, 0)] + [(0, 0)] * (a.ndim - 1))[1:]
a * jax.random.normal(jax.random.key(3), a.shape, a.dtype)
jnp.searchsorted(jnp.array([-1.0, 0.0, 1.0]), a) * a
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
    body = source.choice(ANY + (AXIS if shape else []))
    name = f"User{(ANY + AXIS).index(body)}"
    setup = (
        f"class {name}(tx.Expr):\n"
        '    """A node of the user."""\n'
        "    a: tx.expr.fields.Operand\n"
        "    def infer_shape(self, a): return a\n"
        f"    def evaluate(self, a): return {body}"
    )
    evaluate = eval(f"lambda a: {body}", {"jnp": jnp, "jax": jax})
    return Plan(f"{name}({{0}})", lambda a: np.asarray(evaluate(jnp.asarray(a, float))), (shape,), setup)
