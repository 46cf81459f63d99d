"""A function under every transformation of JAX."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

__all__ = ["agree", "transformed"]


def transformed(f: Callable[..., jax.Array]) -> Callable[..., dict[str, Any]]:
    """What f(x, a) gives under every transformation; as one function, to be compiled once.

    That one takes x (3,), a (3, 3), and batches of both.
    """

    def total(x: Any, a: Any) -> Any:
        return jnp.sum(jnp.sin(f(x, a)))

    def rolled(x: Any, a: Any) -> Any:
        return lax.scan(lambda c, _: (0.5 * f(c, a), c[0]), x, None, length=3)

    def every(x: Any, a: Any, xs: Any, batch: Any) -> dict[str, Any]:
        value, push = jax.linearize(f, x, a)
        return {
            "value": f(x, a),
            "grad": jax.grad(total, (0, 1))(x, a),
            "jacfwd": jax.jacfwd(f, (0, 1))(x, a),
            "hessian": jax.hessian(total)(x, a),
            "vmap": jax.vmap(f)(xs, batch),
            "vmap of one": jax.vmap(f, in_axes=(None, 2))(x, jnp.moveaxis(batch, 0, 2)),
            "vmap of vmap": jax.vmap(jax.vmap(f, (0, None)), (None, 0))(xs, batch[:2]),
            "vmap of grad": jax.vmap(jax.grad(total))(xs, batch),
            "grad of vmap": jax.grad(lambda s: jax.vmap(total, (0, None))(s, a).sum())(xs),
            "jvp of vmap": jax.jvp(lambda s: jax.vmap(f)(s, batch), (xs,), (jnp.cos(xs),)),
            "scan": rolled(x, a),
            "grad of scan": jax.grad(lambda s: rolled(s, a)[1].sum() + rolled(s, a)[0].sum())(x),
            "vmap of grad of scan": jax.vmap(jax.grad(lambda s, m: rolled(s, m)[0].sum()))(xs, batch),
            "linearize": (value, push(jnp.ones(3), a)),
            "checkpoint": jax.grad(lambda s: jax.checkpoint(total)(s, a))(x),
            "float32": f(x.astype(np.float32), a.astype(np.float32)),
            "grad in float32": jax.grad(total)(x.astype(np.float32), a.astype(np.float32)),
        }

    return every


def agree(found: Any, expected: Any) -> None:
    """The same structure, types and shapes; values to round-off of their size."""
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for (path, own), other in zip(jax.tree.leaves_with_path(found), jax.tree.leaves(expected), strict=True):
        assert (own.shape, own.dtype) == (other.shape, other.dtype), path
        size = max(1.0, float(np.abs(other).max(initial=0.0)))
        near = 1e-12 if own.dtype == np.float64 else 1e-5
        np.testing.assert_allclose(own, other, rtol=0.0, atol=near * size, err_msg=str(path))
