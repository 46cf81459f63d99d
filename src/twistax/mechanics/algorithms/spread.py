"""The quantities of bodies that the derivatives of the dynamics need, in one frame: the parts of I and B, which are
additive over bodies.

For a body with mass m, centre c, second moment of mass Sigma about the origin and twist V = [v; w],

    I x = V -> momentum = [m v + w x h; h x v + (tr Sigma - Sigma) w],    h = m c,
    B x = V x* I x - I (V x x) + x x* I V = 2 [-p x b; -(w x Sigma b) - h x (v x b)]    of x = [a; b],

where p is the linear momentum. The terms with a cancel, and those with b combine by Jacobi's identity and by J [w] +
[w] J + [J w] = tr(J) [w]. So B takes 12 numbers in place of 36. Masses that move within the body exert the wrench X =
X_0 + X_1 w, and add X_1 b to B x; the upper half of X_1 is -2 [m c'], where m c' is the linear part of their momentum.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...expr import Constant, Cross, Dot, Expr, Outer, Trace
from ...expr.lie import Act, CoadjointAction, Hat, angular, linear, twist
from ..tree import Segment


class Spread(NamedTuple):
    """The mass distribution about the origin of a frame, and its motion."""

    mass: Expr  # ()
    moment: Expr  # h (3,)
    second: Expr  # Sigma (3, 3)
    momentum: Expr  # p (3,)
    turning: Expr  # -[w] Sigma - [h][v], and half of the lower part of X_1 (3, 3)

    @classmethod
    def of(cls, segment: Segment, T: Expr, V: Expr) -> Spread:
        """The mass distribution of a segment's body with pose T and twist V in the frame."""
        body, inner = segment.body, segment.inner_motion
        if body is None:
            return cls(*(Constant(np.zeros(shape)) for shape in ((), (3,), (3, 3), (3,), (3, 3))))
        second_about_center = 0.5 * Trace(body.inertia) * np.eye(3) - body.inertia
        R, c = T[:3, :3], Act(T, body.center_of_mass)
        second, h = R @ second_about_center @ R.T + body.mass * Outer(c, c), body.mass * c
        v, w = linear(V), angular(V)
        turning, p = Dot(h, v) * np.eye(3) - Outer(v, h) - Hat(w) @ second, body.mass * v + Cross(w, h)
        if inner is not None:
            p = p + R @ linear(inner.momentum)
            turning = turning + 0.5 * CoadjointAction(T, inner.turning)[3:] @ R.T
        return cls(body.mass, h, second, p, turning)

    def plus(self, other: Spread) -> Spread:
        return Spread(*(a + b for a, b in zip(self, other, strict=True)))

    def inertia(self, x: Expr) -> Expr:
        """The wrench I x (6,)."""
        a, b = linear(x), angular(x)
        tensor = Trace(self.second) * np.eye(3) - self.second
        return twist(linear=self.mass * a - Cross(self.moment, b), angular=Cross(self.moment, a) + tensor @ b)

    def coupled(self, b: Expr) -> Expr:
        """The wrench B x (6,), with b (3,) the angular part of x."""
        return 2.0 * twist(linear=-Cross(self.momentum, b), angular=self.turning @ b)

    def coupled_back(self, x: Expr) -> Expr:
        """The angular part (3,) of B' x; the linear part is zero."""
        return 2.0 * (Cross(self.momentum, linear(x)) + self.turning.T @ angular(x))
