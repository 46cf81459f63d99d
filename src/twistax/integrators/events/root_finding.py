"""The search for a root of a function between two points with different signs, and for an extremum near zero between
points with equal signs.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

#: More evaluations than halving a bracket down to the smallest number that matters would take.
_MOST = 120


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Bracket:
    """The bracket of a root. `narrowed` halves it, or interpolates where that is known to be safe. Traceable.

    A zero counts as past the root, and NaN as before it, so the first of several successive zeros is found.

    Source: Chandrupatla, A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear function
    without using derivatives (1997).
    """

    a: Any  # the last place tried, with its value
    b: Any  # the other end of the bracket
    c: Any  # the place before
    at_low: Any  # the value where the bracket began
    finest: Any  # how close the root is wanted
    place: Any  # where to look next
    tries: Any
    done: Any

    @classmethod
    def between(
        cls, low: jax.Array, high: jax.Array, at_low: jax.Array, at_high: jax.Array, finest: jax.Array
    ) -> Bracket:
        """The bracket between low and high, where the values are known.

        If round-off makes the signs at both ends equal, the root is the end with the smaller value; if at_low is zero,
        it is low.
        """
        none = jnp.zeros((), int)
        begun = cls((high, at_high), (low, at_low), (low, at_low), at_low, finest, low, none, none > 0)
        return dataclasses.replace(begun, a=(high, begun.signed(at_high))).looking(jnp.full_like(low, 0.5))

    @property
    def root(self) -> jax.Array:
        """The end with the smaller value."""
        return jnp.where(jnp.abs(self.a[1]) < jnp.abs(self.b[1]), self.a[0], self.b[0])

    def narrowed(self, value: jax.Array) -> Bracket:
        """The bracket after an evaluation of the function at its place."""
        (a, fa), (b, fb), x, fx = self.a, self.b, self.place, self.signed(value)
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
        return dataclasses.replace(self, a=(a, fa), b=(b, fb), c=(c, fc), tries=self.tries + 1).looking(share)

    def signed(self, value: jax.Array) -> jax.Array:
        past = -jnp.sign(self.at_low) * float(jnp.finfo(value.dtype).tiny)
        return jnp.where(jnp.isnan(value), self.at_low, jnp.where(value == 0.0, past, value))

    def looking(self, share: jax.Array) -> Bracket:
        """The bracket with its next point at a fraction of the distance from a to b, or finished if it is narrow
        enough.
        """
        signs_differ = jnp.sign(self.a[1]) * jnp.sign(self.b[1]) < 0.0
        wide = jnp.abs(self.b[0] - self.a[0]) > 2.0 * self.finest
        place = self.a[0] + share * (self.b[0] - self.a[0])
        return dataclasses.replace(self, place=place, done=~(signs_differ & wide & (self.tries < _MOST)))


def _nonzero(a: jax.Array) -> jax.Array:
    return jnp.where(a == 0.0, 1.0, a)


def near_zero(values: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Where functions with one sign at two neighbouring points may reach zero between them.

    This holds if a parabola through three neighbouring points has its extremum there, and the extremum is past zero or
    closer to zero than half the second difference, which bounds the effect of cubic terms.

    Args:
        values: (k, m) of m functions at k places at equal distances, k > 2.
    Returns:
        (k - 1, m) whether, for each pair of neighbours; where the extremum lies between them, as a share.
    """
    a, b, c = values[:-2], values[1:-1], values[2:]
    bend, slope = a - 2.0 * b + c, 0.5 * (c - a)
    place = -slope / _nonzero(bend)
    toward = (jnp.sign(b) * bend > 0.0) & (jnp.sign(b) * (b + 0.5 * slope * place) <= 0.5 * jnp.abs(bend))
    none = jnp.zeros_like(toward[:1])
    # Of the pair that begins with the middle of the three, and of the one that ends with it.
    after, before = (jnp.concatenate(halves) for halves in ((none, toward), (toward, none)))
    shares = jnp.pad(place, ((1, 0), (0, 0))), jnp.pad(place, ((0, 1), (0, 0))) + 1.0
    after = after & (shares[0] >= 0.0) & (shares[0] <= 1.0)
    before = before & (shares[1] >= 0.0) & (shares[1] <= 1.0)
    same_sign = jnp.sign(values[:-1]) * jnp.sign(values[1:]) > 0.0
    return same_sign & (after | before), jnp.where(after, shares[0], shares[1])


class ExtremumSearch(NamedTuple):
    """The extremum of a function nearest to zero, between two points beyond which it is farther from zero.

    `narrowed` interpolates with a parabola, for a few times. Traceable.
    """

    low: tuple[jax.Array, jax.Array]  # a place, with its value
    middle: tuple[jax.Array, jax.Array]
    high: tuple[jax.Array, jax.Array]
    place: jax.Array  # where to look next
    past: jax.Array  # whether the function is zero or has the other sign in the middle
    tries: jax.Array

    @property
    def done(self) -> jax.Array:
        """Whether the extremum is known, or the iterations are used up."""
        return self.past | (self.tries > _LOOKS)

    def narrowed(self, value: jax.Array) -> ExtremumSearch:
        """The search after an evaluation of the function at its place."""
        sign, new = jnp.sign(self.low[1]), (self.place, value)
        past = sign * value <= 0.0
        first, nearer = self.tries == 0, sign * value < sign * self.middle[1]
        left = self.place < self.middle[0]

        def pick(condition: jax.Array, one: Any, other: Any) -> Any:
            return tuple(jnp.where(condition, a, b) for a, b in zip(one, other, strict=True))

        # The middle becomes an end where the new place is nearer to zero, else the new place does.
        end = pick(nearer, self.middle, new)
        goes_low = jnp.where(nearer, ~left, left) & ~first
        goes_high = jnp.where(nearer, left, ~left) & ~first
        low, high = pick(goes_low, end, self.low), pick(goes_high, end, self.high)
        middle = pick(nearer | first | past, new, self.middle)
        return ExtremumSearch(low, middle, high, _vertex(low, middle, high), past, self.tries + 1)


#: Places at which an extremum is looked for.
_LOOKS = 5


def _vertex(low: Any, middle: Any, high: Any) -> jax.Array:
    """Where the parabola through three places has its extremum; half way to the further end where it has none there."""
    (a, fa), (b, fb), (c, fc) = low, middle, high
    over = (b - a) ** 2 * (fb - fc) - (b - c) ** 2 * (fb - fa)
    under = (b - a) * (fb - fc) - (b - c) * (fb - fa)
    place = b - 0.5 * over / _nonzero(under)
    half_way = jnp.where(b - a > c - b, 0.5 * (a + b), 0.5 * (b + c))
    return jnp.where((place > a) & (place < c) & (place != b), place, half_way)
