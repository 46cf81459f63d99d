"""Quotients and norms as operations of JAX, whose derivatives do not overflow or underflow prematurely.

JAX's derivative of a / b by b is -a b^-2 db, and that of sqrt(sum x^2) passes through the sum of squares. In single
precision b^-2 is zero for b beyond 1e19, as r^3 is at 7e6 m from the centre of the Earth, and x^2 infinite.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ...jax_inside import Primitive, ad, batching, jet, mlir, varying_alike

_taylor_rules: dict[Any, Any] = jet.jet_rules


def _defined(name: str, function: Callable[..., jax.Array], abstract: Callable[..., Any], *names: str) -> Primitive:
    """An operation that runs as a function of arrays."""
    primitive = Primitive(name)
    primitive.def_impl(functools.partial(jax.jit, static_argnames=names)(function))
    primitive.def_abstract_eval(abstract)
    mlir.register_lowering(primitive, mlir.lower_fun(function, multiple_results=False))
    return primitive


# ---- quotients -------------------------------------------------------------------------------------------------------


def quotient(a: Any, b: Any) -> jax.Array:
    """a / b, entry by entry with broadcasting. Its derivative is da / b - (a / b) (db / b)."""
    dtype = jnp.result_type(a, b)
    if not jnp.issubdtype(dtype, jnp.floating) or a.dtype != b.dtype:
        return a / b
    shape = jnp.broadcast_shapes(a.shape, b.shape)
    numerator, divisor = varying_alike([jnp.broadcast_to(x, shape) for x in (a, b)])
    result: jax.Array = quotient_p.bind(numerator, divisor)
    return result


def _quotient_jvp(primals: Any, tangents: Any) -> Any:
    (a, b), (da, db) = primals, tangents
    y = quotient(a, b)
    terms = [] if type(da) is ad.Zero else [quotient(da, b)]
    if type(db) is not ad.Zero:
        terms.append(-(y * quotient(db, b)))
    return y, functools.reduce(jnp.add, terms) if terms else ad.Zero(jax.typeof(y).to_tangent_aval())


def _quotient_transpose(cotangent: Any, a: Any, b: Any) -> Any:
    if ad.is_undefined_primal(b):
        raise NotImplementedError("a quotient is not linear in its divisor: it cannot be transposed")
    return [cotangent if type(cotangent) is ad.Zero else quotient(cotangent, b), None]


def _quotient_batched(arguments: Any, axes: Any) -> Any:
    size = next(a.shape[d] for a, d in zip(arguments, axes, strict=True) if d is not None)
    return quotient(*(batching.bdim_at_front(a, d, size) for a, d in zip(arguments, axes, strict=True))), 0


quotient_p = _defined("quotient", jnp.divide, lambda a, b: a.update(weak_type=False))
ad.primitive_jvps[quotient_p] = _quotient_jvp
ad.primitive_transposes[quotient_p] = _quotient_transpose
batching.primitive_batchers[quotient_p] = _quotient_batched
_taylor_rules[quotient_p] = jet.jet_rules[jax.lax.div_p]


# ---- products --------------------------------------------------------------------------------------------------------


def behind_barrier(x: jax.Array) -> jax.Array:
    """x behind an optimization barrier, so that XLA does not combine it with other factors whose product may be out of
    range.
    """
    result: jax.Array = apart_p.bind(x)
    return result


apart_p = _defined("apart", lambda x: jax.lax.optimization_barrier(x), lambda x: x.update(weak_type=False))
ad.deflinear2(apart_p, lambda cotangent, _: [cotangent])
batching.defvectorized(apart_p)
_taylor_rules[apart_p] = lambda primals, series, **_: (primals[0], series[0])


# ---- norms -----------------------------------------------------------------------------------------------------------


def scales(dtype: Any, terms: int) -> tuple[float, float, float]:
    """(least, largest, factor): numbers between the first two can be squared, and so many squares added; others times
    factor, or 1 / factor, can. Powers of two: a product with them is exact."""
    info = jnp.finfo(dtype)
    half = -int(info.minexp) // 2
    # A sum of so many squares is at most the square of 2^room times the largest entry.
    room = ((terms - 1).bit_length() + 1) // 2
    return 2.0 ** (info.nmant // 2 + 1 - half), 2.0 ** (half - room), 2.0 ** (half + 4 + room)


def norm(x: Any) -> jax.Array:
    """The root of the sum of squares of all entries. Its derivative is $sum (x_i / |x|) dx_i$; all are zero at zero."""
    result: jax.Array = norm_p.bind(x, kept=0)
    return result


def _norm(x: jax.Array, *, kept: int) -> jax.Array:
    """Over all axes but the first ones that are kept, in units of a power of two near the largest entry."""
    axes = tuple(range(kept, x.ndim))
    if not x.size:
        return jnp.zeros(x.shape[:kept], x.dtype)
    least, largest, factor = scales(x.dtype, math.prod(x.shape[kept:]))
    size = jnp.max(jnp.abs(x), axis=axes, keepdims=True)
    large, small = size > largest, size < least
    unit = jnp.where(large, 1.0 / factor, jnp.where(small, factor, 1.0)).astype(x.dtype)
    scaled = x * unit
    back = jnp.where(large, factor, jnp.where(small, 1.0 / factor, 1.0)).astype(x.dtype)
    return jnp.sqrt(jnp.sum(scaled * scaled, axis=axes)) * back.reshape(x.shape[:kept])


def _norm_jvp(primals: Any, tangents: Any, *, kept: int) -> Any:
    (x,), (dx,) = primals, tangents
    y = norm_p.bind(x, kept=kept)
    size = y.reshape(*y.shape, *(1 for _ in x.shape[kept:]))
    zero = size == 0.0
    # At zero the numerator is a number too: so is its derivative zero.
    direction = quotient(jnp.where(zero, 0.0, x).astype(x.dtype), jnp.where(zero, 1.0, size).astype(x.dtype))
    return y, jnp.sum(direction * ad.instantiate_zeros(dx), axis=tuple(range(kept, x.ndim)))


def _norm_batched(arguments: Any, axes: Any, *, kept: int) -> Any:
    (x,), (axis,) = arguments, axes
    return norm_p.bind(jnp.moveaxis(x, axis, 0), kept=kept + 1), 0


def _norm_abstract(x: Any, *, kept: int) -> Any:
    spec = jax.sharding.PartitionSpec(*x.sharding.spec[:kept])
    return x.update(shape=x.shape[:kept], weak_type=False, sharding=x.sharding.update(spec=spec))


def _norm_series(primals: Any, series: Any, *, kept: int) -> Any:
    axes = tuple(range(kept, primals[0].ndim))
    return jet.jet(lambda x: jnp.sqrt(jnp.sum(x * x, axis=axes)), primals, series, factorial_scaled=False)


norm_p = _defined("norm", _norm, _norm_abstract, "kept")
ad.primitive_jvps[norm_p] = _norm_jvp
batching.primitive_batchers[norm_p] = _norm_batched
_taylor_rules[norm_p] = _norm_series
