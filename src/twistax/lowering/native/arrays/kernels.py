"""Kernels of functions of small arrays, and whether they can be trusted here."""

from __future__ import annotations

import functools
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ....jax_inside import ClosedJaxpr, say_once
from ....walk import uncollected
from ..backend import KERNEL_EVENT
from ..code import NotNative
from ..kernel import Kernel
from ..machine_code import BuildError, Processor
from .tile import ArrayTile

#: How far the probe may be from XLA's numbers, relative and absolute.
_CLOSE = 1e-10


def array_kernel(closed: ClosedJaxpr) -> Kernel | None:
    """The kernel of a function of small arrays.

    None where something in the function has no native form, and, with a message, where kernels cannot be had.
    """
    started = time.perf_counter()
    try:
        with uncollected():
            found = Kernel(ArrayTile(closed), Processor.host())
            if not found.lease.checked:
                _check()
                found.lease.keep()
    except NotNative:
        return None
    except (ImportError, BuildError) as error:
        say_once(f"no native kernel, XLA compiles the function instead: {error}")
        return None
    jax.monitoring.record_event_duration_secs(KERNEL_EVENT, time.perf_counter() - started)
    return found


@functools.cache
def _check() -> None:
    """Compare a function that has something of everything with what XLA makes of it.

    Raises:
        BuildError: they differ.
    """
    rng = np.random.default_rng(0)
    given = [rng.normal(size=(5, 11)), rng.normal(size=(11, 9)), np.array(3)]
    with jax.ensure_compile_time_eval(), jax.default_device(jax.local_devices(backend="cpu")[0]):
        expected = [np.asarray(own) for own in jax.jit(_probe)(*given)]
        kernel = Kernel(ArrayTile(jax.make_jaxpr(_probe)(*given)), Processor.host())
    found = kernel.run([a.reshape(1, -1) for a in given])
    for own, other in zip(found, expected, strict=True):
        if not np.allclose(own.reshape(other.shape), other, rtol=_CLOSE, atol=_CLOSE):
            raise BuildError("functions of arrays differ from those of XLA")


def _probe(a: jax.Array, b: jax.Array, k: jax.Array) -> list[Any]:
    """Products, reductions, entries, windows, loops and branches."""
    product = a @ b
    waves = jnp.sin(product) + jnp.exp(-jnp.abs(product.T)).T
    chosen = jnp.where(waves > 0.5, waves, jnp.sqrt(jnp.abs(waves)) / (2.0 + waves**2))

    def turn(own: Any) -> Any:
        count, held = own
        return count + 1, held @ held.T / (1.0 + jnp.abs(held).max())

    count, square = jax.lax.while_loop(lambda own: (own[0] < k) & jnp.isfinite(own[1]).all(), turn, (0 * k, a @ a.T))
    last, lines = jax.lax.scan(lambda sum, row: (0.5 * sum + row, sum.max() - row), a[0], a[::-1], reverse=True)
    branch = jax.lax.cond(k > 2, lambda: chosen[:, ::2], lambda: chosen[:, ::-2])
    window = jax.lax.dynamic_slice(b, (k, k + 20), (4, 3))
    mixed = jnp.concatenate([a[np.array([3, 0, 0])], jax.lax.dynamic_update_slice(a, a[:2], (k, 0))])
    return [chosen.sum(axis=0), square, count, last, lines, branch, window, mixed, (a > 0.0).any(axis=1), a.min()]
