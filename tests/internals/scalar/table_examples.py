"""For each primitive in the table a function in whose jaxpr it stands, and arrays to call it with."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from twistax.scalar.array_primitive import KernelOfArrays
from twistax.scalar.jax_primitive import Derived, call_program
from twistax.scalar.primitives.in_range import behind_barrier, norm, quotient
from twistax.scalar.primitives.table import OPERATIONS
from twistax.scalar.primitives.table_load import Table, load
from twistax.scalar.reader import scalarize
from twistax.scalar.targets.llvm.backend import Native

REAL, TRUTH, PLACES = np.array([0.5, -1.5]), np.array([True, False]), np.array([2, 0])
MATRIX, SQUARE, TRUTHS = (
    np.arange(12.0).reshape(3, 4),
    np.array([[4.0, 1.0], [1.0, 3.0]]),
    np.array([TRUTH, [True] * 2]),
)
BEHIND = np.array([np.nan, -1.5])

_PRODUCT = Derived(scalarize(lambda x: [x * x], jax.ShapeDtypeStruct((2,), float)))
_BY_KERNEL = Derived(_PRODUCT.program, None, Native().runner)
_SQUARED = jax.make_jaxpr(lambda x: [x * x])(jax.ShapeDtypeStruct((2,), float))
_IN_BATCHES = KernelOfArrays(_SQUARED, lambda _: _BY_KERNEL.kernel)


@jax.custom_jvp
def _doubled(x: jax.Array) -> jax.Array:
    return 2.0 * x


_doubled.defjvp(lambda p, t: (_doubled(*p), 2.0 * t[0]))


@jax.custom_vjp
def _doubled_back(x: jax.Array) -> jax.Array:
    return 2.0 * x


_doubled_back.defvjp(lambda x: (_doubled_back(x), None), lambda _, c: (2.0 * c,))


@jax.custom_batching.custom_vmap
def _doubled_by_rule(x: jax.Array) -> jax.Array:
    return 2.0 * x


_doubled_by_rule.def_vmap(lambda size, mapped, x: (2.0 * x, mapped[0]))


EXAMPLES: dict[str, tuple[Any, ...]] = {
    **{name: (o.array, *[np.array([0.5, 0.25])] * o.arity) for name, o in OPERATIONS.items() if name != "select"},
    "acosh": (lax.acosh, np.array([2.0])),
    **{name: (OPERATIONS[name].array, TRUTH, TRUTH[::-1]) for name in ("and", "or", "xor")},
    "not": (lax.bitwise_not, TRUTH),
    "stop_gradient": (lax.stop_gradient, REAL),
    "rsqrt": (lax.rsqrt, np.array([0.5])),
    "add_any": (lambda x: jax.grad(lambda y: y @ y)(x), REAL),
    "square": (lax.square, REAL),
    "integer_pow": (lambda x: lax.integer_pow(x, 3), REAL),
    "select_n": (lambda i, a: lax.select_n(i, a, -a), TRUTH, REAL),
    "le_to": (lambda a, b: lax.le_to_p.bind(a, b), REAL, BEHIND),
    "lt_to": (lambda a, b: lax.lt_to_p.bind(a, b), REAL, BEHIND),
    "convert_element_type": (lambda a: a.astype(np.float32), REAL),
    "reduce_precision": (lambda a: lax.reduce_precision(a, 11, 52), REAL),
    "copy": (jnp.copy, REAL),
    "table_load": (lambda i: load(Table([4.0, 5.0, 6.0, 7.0]), i, np.float64, 1), PLACES),
    "quotient": (quotient, REAL, REAL + 2.0),
    "norm": (jax.vmap(norm), MATRIX),
    "apart": (behind_barrier, REAL),
    "optimization_barrier": (lax.optimization_barrier, REAL),
    "round": (lax.round, REAL),
    # ---- movement
    "reshape": (lambda a: lax.reshape(a, (4, 3)), MATRIX),
    "squeeze": (lambda a: a[1, 2:], MATRIX),
    "transpose": (lambda a: a.T, MATRIX),
    "broadcast_in_dim": (lambda a: a[:, None, :], MATRIX),
    "concatenate": (lambda a: jnp.concatenate([a, a], 1), MATRIX),
    "stack": (lambda a: jnp.stack([a, -a], axis=1), MATRIX),
    "unstack": (lambda a: jnp.unstack(a, axis=1), MATRIX),
    "slice": (lambda a: a[1:, ::2], MATRIX),
    "rev": (lambda a: lax.rev(a, (0,)), MATRIX),
    "split": (lambda a: jnp.split(a, [1, 3], axis=1), MATRIX),
    "tile": (lambda a: jnp.tile(a, (2, 3)), MATRIX),
    "iota": (lambda a: a + lax.broadcasted_iota(a.dtype, (3, 4), 1), MATRIX),
    "pad": (lambda a: lax.pad(a, 7.0, ((1, -1, 0), (0, 1, 2))), MATRIX),
    "sort": (lambda i: jnp.sort(i), np.array([3, 1, 2])),
    "dynamic_slice": (lambda a: lax.dynamic_slice(a, (1, 2), (2, 2)), MATRIX),
    "dynamic_update_slice": (lambda a: lax.dynamic_update_slice(a, a[:1, :2], (1, 2)), MATRIX),
    "gather": (lambda a: a[:, PLACES], MATRIX),
    "scatter": (lambda a: a.at[PLACES].set(9.0), np.arange(5.0)),
    "scatter-add": (lambda a: a.at[PLACES].add(9.0), np.arange(5.0)),
    "scatter-mul": (lambda a: a.at[PLACES].multiply(9.0), np.arange(5.0)),
    # ---- products
    "dot_general": (lambda a: a @ a.T, MATRIX),
    "reduce_sum": (lambda a: a.sum(0), MATRIX),
    "reduce_prod": (lambda a: a.prod(0), MATRIX),
    "reduce_max": (lambda a: a.max(0), MATRIX),
    "reduce_min": (lambda a: a.min(0), MATRIX),
    "reduce_and": (lambda a: jnp.all(a, axis=0), TRUTHS),
    "reduce_or": (lambda a: jnp.any(a, axis=0), TRUTHS),
    "reduce_xor": (lambda a: lax.reduce_xor_p.bind(a, axes=(0,)), TRUTHS),
    "cumsum": (lambda a: lax.cumsum(a, 1), MATRIX),
    "cumprod": (lambda a: lax.cumprod(a, 1), MATRIX),
    "cummax": (lambda a: lax.cummax(a, 1), MATRIX),
    "cummin": (lambda a: lax.cummin(a, 1), MATRIX),
    "argmax": (lambda a: jnp.argmax(a, 1), MATRIX),
    "argmin": (lambda a: jnp.argmin(a, 1), MATRIX),
    "cholesky": (lambda a: lax.linalg.cholesky(a), SQUARE),
    "lu": (lambda a: lax.linalg.lu(a), SQUARE),
    "triangular_solve": (lambda a: lax.linalg.triangular_solve(a, a, left_side=True, lower=True), SQUARE),
    # ---- calls, loops and branches
    "jit": (jax.jit(lambda a: 2.0 * a), REAL),
    "remat2": (jax.checkpoint(lambda a: 2.0 * jnp.sin(a)), REAL),
    "call_hi_primitive": (lambda a: jnp.searchsorted(a, a), REAL),
    "custom_vmap_call": (_doubled_by_rule, REAL),
    "custom_jvp_call": (_doubled, REAL),
    "custom_vjp_call": (_doubled_back, REAL),
    "custom_linear_solve": (lambda b: jnp.linalg.solve(jnp.asarray(SQUARE) + jnp.diag(b), b), REAL),
    "scan": (lambda a: lax.scan(lambda c, row: (c + row, c * row), a[0], a), REAL),
    "cond": (lambda a: lax.cond(a[0] > 0.0, jnp.sin, jnp.cos, a), REAL),
    "platform_index": (lambda a: lax.platform_dependent(a, default=jnp.sin, tpu=jnp.cos), REAL),
    "while": (lambda a: lax.while_loop(lambda s: s[0] < 9.0, lambda s: 2.0 * s, a), REAL),
    "scalar_program": (lambda x: jax.jit(lambda y: call_program(_PRODUCT, y)[0])(x), REAL),
    "native_program": (lambda x: jax.jit(lambda y: call_program(_BY_KERNEL, y)[0])(x), REAL),
    "batched_function": (lambda x: jax.jit(lambda y: call_program(_IN_BATCHES, y)[0])(x), REAL),
}

if jax.__version_info__ < (0, 12):
    del EXAMPLES["call_hi_primitive"]
