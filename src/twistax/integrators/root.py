"""A root of a function of one number between two places of opposite sign."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

__all__ = ["bracketed_root"]

#: More evaluations than halving a bracket down to the smallest number that matters would take.
_MOST = 120


class _Bracket(NamedTuple):
    """The last place tried, the other end of the bracket, the place before, with their values, and the next share."""

    a: tuple[jax.Array, jax.Array]
    b: tuple[jax.Array, jax.Array]
    c: tuple[jax.Array, jax.Array]
    share: jax.Array
    tries: jax.Array


def bracketed_root(
    function: Callable[[jax.Array], jax.Array], low: jax.Array, high: jax.Array, at_low: jax.Array, finest: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The root between low and high, to `finest`, and the number of evaluations. Traceable.

    Halves the bracket, or interpolates where that is known to be safe. A zero counts as past the root, what is not a
    number as before it, so of many zeros in a row the first is found. Where the signs at the two ends are the same,
    because of round-off, the root is at the end with the smaller value; where at_low is zero it is low.

    Source: Chandrupatla, A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear function
    without using derivatives (1997).
    """
    past = -jnp.sign(at_low) * float(jnp.finfo(at_low.dtype).tiny)

    def signed(x: jax.Array) -> jax.Array:
        value = function(x)
        return jnp.where(jnp.isnan(value), at_low, jnp.where(value == 0.0, past, value))

    at_high = signed(high)

    def best(now: _Bracket) -> tuple[jax.Array, jax.Array]:
        first = jnp.abs(now.a[1]) < jnp.abs(now.b[1])
        return jnp.where(first, now.a[0], now.b[0]), jnp.where(first, now.a[1], now.b[1])

    def unsolved(now: _Bracket) -> jax.Array:
        apart = jnp.sign(now.a[1]) * jnp.sign(now.b[1]) < 0.0
        return apart & (jnp.abs(now.b[0] - now.a[0]) > 2.0 * finest) & (now.tries < _MOST)

    def narrow(now: _Bracket) -> _Bracket:
        (a, fa), (b, fb) = now.a, now.b
        x = a + now.share * (b - a)
        fx = signed(x)
        same = jnp.sign(fx) == jnp.sign(fa)
        # What the new place replaces becomes the third one.
        c, fc = jnp.where(same, a, b), jnp.where(same, fa, fb)
        b, fb = jnp.where(same, b, a), jnp.where(same, fb, fa)
        a, fa = x, fx
        width = jnp.where(b == a, 1.0, jnp.abs(b - a))
        xi, phi = (a - b) / _nonzero(c - b), (fa - fb) / _nonzero(fc - fb)
        safe = (phi * phi < xi) & ((1.0 - phi) * (1.0 - phi) < 1.0 - xi)
        quadratic = fa / _nonzero(fb - fa) * (fc / _nonzero(fb - fc)) + (c - a) / _nonzero(b - a) * (
            fa / _nonzero(fc - fa)
        ) * (fb / _nonzero(fc - fb))
        edge = jnp.minimum(finest / width, 0.5)
        share = jnp.clip(jnp.where(safe, quadratic, 0.5), edge, 1.0 - edge)
        return _Bracket((a, fa), (b, fb), (c, fc), share, now.tries + 1)

    half, none = jnp.full_like(low, 0.5), jnp.zeros((), int)
    start = _Bracket((high, at_high), (low, at_low), (low, at_low), half, none)
    end = jax.lax.while_loop(unsolved, narrow, start)
    return best(end)[0], end.tries + 1


def _nonzero(a: jax.Array) -> jax.Array:
    return jnp.where(a == 0.0, 1.0, a)
