"""The root of a function of one number between two places where its signs differ, one evaluation at a time."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

#: More evaluations than halving a bracket down to the smallest number that matters would take.
_MOST = 120


class Bracket(NamedTuple):
    """Where a root lies. `narrowed` halves it, or interpolates where that is known to be safe. Traceable.

    A zero counts as past the root, NaN as before it, so of many zeros in a row the first is found.

    Source: Chandrupatla, A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear function
    without using derivatives (1997).
    """

    a: tuple[jax.Array, jax.Array]  # the last place tried, with its value
    b: tuple[jax.Array, jax.Array]  # the other end of the bracket
    c: tuple[jax.Array, jax.Array]  # the place before
    at_low: jax.Array  # the value where the bracket began
    finest: jax.Array  # how close the root is wanted
    place: jax.Array  # where to look next
    tries: jax.Array
    done: jax.Array

    @classmethod
    def between(
        cls, low: jax.Array, high: jax.Array, at_low: jax.Array, at_high: jax.Array, finest: jax.Array
    ) -> Bracket:
        """Between low and high, where the values are known.

        Where the signs at the two ends are the same, because of round-off, the root is at the end with the smaller
        value; where at_low is zero it is low.
        """
        none = jnp.zeros((), int)
        begun = cls((high, at_high), (low, at_low), (low, at_low), at_low, finest, low, none, none > 0)
        return begun._replace(a=(high, begun._signed(at_high)))._looking(jnp.full_like(low, 0.5))

    @property
    def root(self) -> jax.Array:
        """The end with the smaller value."""
        return jnp.where(jnp.abs(self.a[1]) < jnp.abs(self.b[1]), self.a[0], self.b[0])

    def narrowed(self, value: jax.Array) -> Bracket:
        """After the function was found to have a value at the place."""
        (a, fa), (b, fb), x, fx = self.a, self.b, self.place, self._signed(value)
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
        edge = jnp.minimum(self.finest / width, 0.5)
        share = jnp.clip(jnp.where(safe, quadratic, 0.5), edge, 1.0 - edge)
        return self._replace(a=(a, fa), b=(b, fb), c=(c, fc), tries=self.tries + 1)._looking(share)

    def _signed(self, value: jax.Array) -> jax.Array:
        past = -jnp.sign(self.at_low) * float(jnp.finfo(value.dtype).tiny)
        return jnp.where(jnp.isnan(value), self.at_low, jnp.where(value == 0.0, past, value))

    def _looking(self, share: jax.Array) -> Bracket:
        """With the next place a share of the way from a to b, unless what is known is enough."""
        apart = jnp.sign(self.a[1]) * jnp.sign(self.b[1]) < 0.0
        wide = jnp.abs(self.b[0] - self.a[0]) > 2.0 * self.finest
        place = self.a[0] + share * (self.b[0] - self.a[0])
        return self._replace(place=place, done=~(apart & wide & (self.tries < _MOST)))


def _nonzero(a: jax.Array) -> jax.Array:
    return jnp.where(a == 0.0, 1.0, a)
