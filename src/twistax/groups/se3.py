"""SE(3): poses as 4x4 matrices, tangents as body twists xi = [v; w] (linear first), wrenches and momenta as [f; tau].

T = [R p; 0 1] maps the coordinates of a point, p_a = T_ab p_b. Perturbations act on the right: g (+) d = g Exp(d), and
g' = g hat(xi). Every formula of SE(3) is the one of SO(3) with w replaced by the dual number w + e v, e^2 = 0: the
linear part of a result is the derivative of the angular part in the direction v.

Sources: Murray, Li, Sastry, A Mathematical Introduction to Robotic Manipulation (1994), ch. 2 and 4;
Chirikjian, Stochastic Models, Information Theory, and Lie Groups, vol. 2 (2012), ch. 10, for the Jacobians.
"""

from __future__ import annotations

import jax.numpy as jnp

from twistax.errors import ShapeError
from twistax.groups import so3
from twistax.groups.annotations import Array, Float
from twistax.groups.arrays import (
    Components,
    Input,
    add,
    compiled,
    cross,
    dot,
    dual_polynomial,
    element,
    floats,
    matrix,
    multiply,
    of_shape,
    pose_rate,
    rigid_polynomial,
    swept,
    unpack,
    vector,
)
from twistax.groups.series import exp_coefficients, inverse_coefficients, inverse_derivative, jacobian_coefficients

# fmt: off
__all__ = [
    "Ad", "Ad_dual", "act", "ad", "ad_dual", "between", "bracket", "coad", "compose", "exp", "hat", "inverse",
    "left_jacobian", "left_jacobian_inv", "log", "right_jacobian", "right_jacobian_inv",
    "right_jacobian_inv_apply", "vee",
]
# fmt: on


def _halves(xi: Array) -> tuple[Components, Components]:
    parts = unpack(xi)
    return parts[:3], parts[3:]


def _blocks(diagonal: Array, upper: Array, lower: Array) -> Array:
    """[D U; L D]."""
    return jnp.concatenate(
        [jnp.concatenate([diagonal, upper], axis=1), jnp.concatenate([lower, diagonal], axis=1)], axis=0
    )


@compiled
def transform(R: Array, p: Array) -> Array:
    """[R p; 0 1] of a rotation (3, 3) and a position (3,)."""
    top = jnp.concatenate([R, p[:, None]], axis=1)
    return jnp.concatenate([top, jnp.asarray([[0.0, 0.0, 0.0, 1.0]], dtype=top.dtype)], axis=0)


@compiled
def exp(xi: Input) -> Float[Array, "4 4"]:
    """$Exp(xi) = [Exp(w), J_l(w) v; 0, 1]$: the pose reached from the identity by the constant body twist xi in unit
    time.

    Shapes: xi = [v; w] (6,), v in any length unit, w in rad -> (4, 4). Raises ShapeError.
    """
    (xi,) = of_shape("se3.exp", {"xi": (6,)}, xi)
    v, w = _halves(xi)
    first, second, third = exp_coefficients(dot(w, w))
    return transform(rigid_polynomial(w, first, second), vector(swept(w, v, second, third)))


def log(T: Input) -> Float[Array, "6"]:
    """The twist xi = [v; w] with $Exp(xi) = T$ and $|w| <= pi$; for a drifted rotation, that of the nearest pose.

    At exactly a half turn, the axis is the one whose first non-zero component is positive. Derivatives of every order
    are those of the map on the group, finite at a half turn. Shapes: (4, 4) -> (6,). Raises ShapeError, and InputError
    for a matrix that is not a pose. For a traced reflection the result is NaN.
    """
    (T,) = of_shape("se3.log", {"T": (4, 4)}, T)
    return unchecked_log(element("se3.log", "T", T))


@compiled
def unchecked_log(T: Array) -> Array:
    """`log` without a check of the matrix. For a reflection, values and derivatives are NaN."""
    rotation = so3.unchecked_log(T[:3, :3])
    w = unpack(rotation)
    v = swept(w, unpack(T[:3, 3]), -0.5, inverse_derivative(0, dot(w, w)))
    return jnp.concatenate([vector(v), rotation])


@compiled
def hat(xi: Input) -> Float[Array, "4 4"]:
    """$[W, v; 0, 0]$ of $xi = [v; w]$. Shapes: (6,) -> (4, 4). Raises ShapeError."""
    (xi,) = of_shape("se3.hat", {"xi": (6,)}, xi)
    (a, b, c), (x, y, z) = _halves(xi)
    o = jnp.zeros_like(x)
    return matrix([[o, -z, y, a], [z, o, -x, b], [-y, x, o, c], [o, o, o, o]])


@compiled
def vee(X: Input) -> Float[Array, "6"]:
    """The inverse of hat. It uses the skew-symmetric part of the rotation block. Shapes: (4, 4) -> (6,).

    Raises ShapeError.
    """
    (X,) = of_shape("se3.vee", {"X": (4, 4)}, X)
    return jnp.concatenate([X[:3, 3], so3.vee(X[:3, :3])])


@compiled
def compose(T: Input, S: Input) -> Float[Array, "4 4"]:
    """T S. Shapes: (4, 4), (4, 4) -> (4, 4). Raises ShapeError."""
    return multiply(*of_shape("se3.compose", {"T": (4, 4), "S": (4, 4)}, T, S))


@compiled
def inverse(T: Input) -> Float[Array, "4 4"]:
    """$[R^T, -R^T p; 0, 1]$. Shapes: (4, 4) -> (4, 4). Raises ShapeError."""
    (T,) = of_shape("se3.inverse", {"T": (4, 4)}, T)
    Rt = T[:3, :3].T
    return transform(Rt, -multiply(Rt, T[:3, 3]))


@compiled
def between(T: Input, S: Input) -> Float[Array, "4 4"]:
    """$T^-1 S$, with the positions subtracted first to avoid cancellation of large common positions.

    Shapes: (4, 4), (4, 4) -> (4, 4). Raises ShapeError.
    """
    T, S = of_shape("se3.between", {"T": (4, 4), "S": (4, 4)}, T, S)
    Rt = T[:3, :3].T
    return transform(multiply(Rt, S[:3, :3]), multiply(Rt, S[:3, 3] - T[:3, 3]))


@compiled
def act(T: Input, points: Input) -> Float[Array, "*points"]:
    """R p + t for a point p (3,) or for each row of (n, 3). Raises ShapeError."""
    T, points = floats(T, points)
    of_shape("se3.act", {"T": (4, 4)}, T)
    if points.ndim not in (1, 2) or points.shape[-1] != 3:
        raise ShapeError(f"se3.act expects points with shape (3,) or (n, 3), got {points.shape}")
    return so3.act(T[:3, :3], points) + jnp.broadcast_to(T[:3, 3], points.shape)


@compiled
def ad(xi: Input) -> Float[Array, "6 6"]:
    """$ad_xi = [W, V; 0, W]$, so that $ad_xi eta = [xi, eta]$. Shapes: (6,) -> (6, 6). Raises ShapeError."""
    (xi,) = of_shape("se3.ad", {"xi": (6,)}, xi)
    return _blocks(so3.hat(xi[3:]), so3.hat(xi[:3]), jnp.zeros((3, 3), xi.dtype))


@compiled
def ad_dual(xi: Input) -> Float[Array, "6 6"]:
    """$ad*_xi = -ad_xi^T = [W, 0; V, W]$; $M xi' = F - ad*_xi (M xi)$. Shapes: (6,) -> (6, 6). Raises ShapeError."""
    (xi,) = of_shape("se3.ad_dual", {"xi": (6,)}, xi)
    return _blocks(so3.hat(xi[3:]), jnp.zeros((3, 3), xi.dtype), so3.hat(xi[:3]))


@compiled
def Ad(T: Input) -> Float[Array, "6 6"]:
    """$Ad_T = [R, [p]R; 0, R]$: twists from frame b to frame a for T = T_ab.

    Shapes: (4, 4) -> (6, 6). Raises ShapeError.
    """
    (T,) = of_shape("se3.Ad", {"T": (4, 4)}, T)
    R = T[:3, :3]
    return _blocks(R, multiply(so3.hat(T[:3, 3]), R), jnp.zeros((3, 3), T.dtype))


@compiled
def Ad_dual(T: Input) -> Float[Array, "6 6"]:
    """$Ad*_T = Ad_T^-T = [R, 0; [p]R, R]$: wrenches from frame b to frame a for T = T_ab.

    Shapes: (4, 4) -> (6, 6). Raises ShapeError.
    """
    (T,) = of_shape("se3.Ad_dual", {"T": (4, 4)}, T)
    R = T[:3, :3]
    return _blocks(R, jnp.zeros((3, 3), T.dtype), multiply(so3.hat(T[:3, 3]), R))


@compiled
def bracket(xi: Input, eta: Input) -> Float[Array, "6"]:
    """$[xi, eta] = ad_xi eta = [w1 x v2 + v1 x w2; w1 x w2]$. Shapes: (6,), (6,) -> (6,). Raises ShapeError."""
    (v, w), (y, u) = map(_halves, of_shape("se3.bracket", {"xi": (6,), "eta": (6,)}, xi, eta))
    return vector(add(cross(w, y), cross(v, u)) + cross(w, u))


@compiled
def coad(xi: Input, momentum: Input) -> Float[Array, "6"]:
    """$ad*_xi mu = [w x p; v x p + w x L]$ for $mu = [p; L]$. Shapes: (6,), (6,) -> (6,). Raises ShapeError."""
    (v, w), (p, L) = map(_halves, of_shape("se3.coad", {"xi": (6,), "momentum": (6,)}, xi, momentum))
    return vector(cross(w, p) + add(cross(v, p), cross(w, L)))


@compiled
def left_jacobian(xi: Input) -> Float[Array, "6 6"]:
    """$J_l(xi) = [J, Q; 0, J]$: $Exp(xi + d) = Exp(J_l d) Exp(xi)$ to first order.

    J is the left Jacobian of SO(3) at w, Q its derivative in the direction v. Shapes: (6,) -> (6, 6).
    Raises ShapeError.
    """
    (xi,) = of_shape("se3.left_jacobian", {"xi": (6,)}, xi)
    v, w = _halves(xi)
    second, third, second_slope, third_slope = jacobian_coefficients(dot(w, w))
    Q = dual_polynomial(w, v, second, third, second_slope, third_slope)
    return _blocks(rigid_polynomial(w, second, third), Q, jnp.zeros((3, 3), xi.dtype))


def right_jacobian(xi: Input) -> Float[Array, "6 6"]:
    """$J_r(xi) = J_l(-xi)$: $Exp(xi + d) = Exp(xi) Exp(J_r d)$ to first order.

    Shapes: (6,) -> (6, 6). Raises ShapeError.
    """
    return left_jacobian(-of_shape("se3.right_jacobian", {"xi": (6,)}, xi)[0])


@compiled
def left_jacobian_inv(xi: Input) -> Float[Array, "6 6"]:
    """$J_l(xi)^-1 = [D, E; 0, D]$, $D = I - W/2 + d W^2$, E its derivative in the direction v; singular at |w| = 2 pi.

    $d = (1 - (t/2) cot(t/2)) / t^2$, $t = |w|$. Shapes: (6,) -> (6, 6). Raises ShapeError.
    """
    (xi,) = of_shape("se3.left_jacobian_inv", {"xi": (6,)}, xi)
    v, w = _halves(xi)
    d, slope = inverse_coefficients(dot(w, w))
    E = dual_polynomial(w, v, -0.5, d, 0.0, slope)
    return _blocks(rigid_polynomial(w, -0.5, d), E, jnp.zeros((3, 3), xi.dtype))


def right_jacobian_inv(xi: Input) -> Float[Array, "6 6"]:
    """$J_r(xi)^-1 = J_l(-xi)^-1$. Shapes: (6,) -> (6, 6). Raises ShapeError."""
    return left_jacobian_inv(-of_shape("se3.right_jacobian_inv", {"xi": (6,)}, xi)[0])


@compiled
def right_jacobian_inv_apply(eta: Input, omega: Input) -> Float[Array, "6"]:
    """$J_r(eta)^-1 Omega$ by cross products, with no 6x6 matrix.

    For $g' = g hat(Omega)$ and $g = g_0 Exp(eta)$ this is $eta'$. With $b = w x u$ the angular part is
    $u + b/2 + d w x b$; the linear part is its derivative in the direction of the linear parts.
    Shapes: (6,), (6,) -> (6,). Raises ShapeError.
    """
    eta, omega = of_shape("se3.right_jacobian_inv_apply", {"eta": (6,), "omega": (6,)}, eta, omega)
    z = unpack(eta)
    return vector(pose_rate(z, unpack(omega), *inverse_coefficients(dot(z[3:], z[3:]))))
