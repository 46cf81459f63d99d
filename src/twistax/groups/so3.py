"""SO(3): rotations as 3x3 matrices, tangents as rotation vectors w in rad. g (+) d = g Exp(d); g' = g hat(w).

Sources: Murray, Li, Sastry, A Mathematical Introduction to Robotic Manipulation (1994), ch. 2;
Chirikjian, Stochastic Models, Information Theory, and Lie Groups, vol. 2 (2012), ch. 10, for the Jacobians.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from twistax.errors import ShapeError
from twistax.groups import quaternions
from twistax.groups.annotations import Array, Float
from twistax.groups.arrays import (
    Input,
    compiled,
    cross,
    determinant,
    dot,
    element,
    floats,
    matrix,
    multiply,
    of_shape,
    rigid_polynomial,
    rotation_rate,
    scale,
    unpack,
    vector,
)
from twistax.groups.series import angle_ratio, exp_coefficients, inverse_derivative

# fmt: off
__all__ = [
    "Ad", "Ad_dual", "act", "ad", "ad_dual", "bracket", "coad", "compose", "exp", "hat", "inverse",
    "left_jacobian", "left_jacobian_inv", "log", "right_jacobian", "right_jacobian_inv",
    "right_jacobian_inv_apply", "vee",
]
# fmt: on


@compiled
def exp(w: Input) -> Float[Array, "3 3"]:
    """$Exp(w) = I + (sin t / t) W + ((1 - cos t) / t^2) W^2$, $t = |w|$: the rotation by t rad about w.

    Shapes: w (3,) in rad -> (3, 3). Raises ShapeError. Source: Rodrigues' formula.
    """
    (w,) = of_shape("so3.exp", {"w": (3,)}, w)
    parts = unpack(w)
    first, second, _ = exp_coefficients(dot(parts, parts))
    return rigid_polynomial(parts, first, second)


@jax.custom_jvp
def _unchecked_log(R: Array) -> Array:
    w, x, y, z = unpack(quaternions.unscaled(R))
    axis = (x, y, z)
    ratio = jnp.where(determinant(R) > 0.0, angle_ratio(dot(axis, axis), w), jnp.nan)
    return vector(scale(ratio, axis))


@_unchecked_log.defjvp
def _log_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    # d Log(R) = J_r^-1(Log R) (R^T dR)^v holds along every curve in the group, also at a half turn, and its own
    # derivatives are as smooth: no branch and no root is differentiated.
    (R,), (dR,) = primals, tangents
    w = _unchecked_log(R)
    return w, right_jacobian_inv_apply(w, vee(multiply(R.T, dR)))


@compiled
def unchecked_log(R: Array) -> Array:
    """`log` without a check of the matrix. For a reflection, values and derivatives are NaN."""
    return _unchecked_log(R)


def log(R: Input) -> Float[Array, "3"]:
    """The rotation vector w with $Exp(w) = R$, $|w| <= pi$, in rad; for a drifted R, that of the nearest rotation.

    At exactly a half turn, the axis is the one whose first non-zero component is positive. Derivatives of every order
    are those of the map on the group, finite at a half turn. Shapes: (3, 3) -> (3,). Raises ShapeError, and InputError
    for a matrix that is not a rotation. For a traced reflection the result is NaN.
    """
    (R,) = of_shape("so3.log", {"R": (3, 3)}, R)
    return unchecked_log(element("so3.log", "R", R))


@compiled
def hat(w: Input) -> Float[Array, "3 3"]:
    """W with $W u = w x u$. Shapes: (3,) -> (3, 3). Raises ShapeError."""
    (w,) = of_shape("so3.hat", {"w": (3,)}, w)
    x, y, z = unpack(w)
    o = jnp.zeros_like(x)
    return matrix([[o, -z, y], [z, o, -x], [-y, x, o]])


@compiled
def vee(W: Input) -> Float[Array, "3"]:
    """The inverse of hat. It uses the skew-symmetric part of W. Shapes: (3, 3) -> (3,). Raises ShapeError."""
    (W,) = of_shape("so3.vee", {"W": (3, 3)}, W)
    _, xy, xz, yx, _, yz, zx, zy, _ = unpack(W)
    return vector([0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)])


@compiled
def compose(R: Input, S: Input) -> Float[Array, "3 3"]:
    """R S. Shapes: (3, 3), (3, 3) -> (3, 3). Raises ShapeError."""
    return multiply(*of_shape("so3.compose", {"R": (3, 3), "S": (3, 3)}, R, S))


def inverse(R: Input) -> Float[Array, "3 3"]:
    """$R^T$. Shapes: (3, 3) -> (3, 3). Raises ShapeError."""
    (R,) = of_shape("so3.inverse", {"R": (3, 3)}, R)
    return R.T


@compiled
def act(R: Input, points: Input) -> Float[Array, "*points"]:
    """R p for a point (3,) or for each row of (n, 3). Raises ShapeError."""
    R, points = floats(R, points)
    of_shape("so3.act", {"R": (3, 3)}, R)
    if points.ndim not in (1, 2) or points.shape[-1] != 3:
        raise ShapeError(f"so3.act expects points with shape (3,) or (n, 3), got {points.shape}")
    return multiply(R, points) if points.ndim == 1 else multiply(points, R.T)


def ad(w: Input) -> Float[Array, "3 3"]:
    """The matrix of $u -> [w, u] = w x u$, which is hat(w). Shapes: (3,) -> (3, 3). Raises ShapeError."""
    return hat(w)


def ad_dual(w: Input) -> Float[Array, "3 3"]:
    """$ad*_w = -ad_w^T$, which is hat(w) again. Shapes: (3,) -> (3, 3). Raises ShapeError."""
    return hat(w)


def Ad(R: Input) -> Float[Array, "3 3"]:
    """The matrix of $w -> vee(R W R^T)$, which is R. Shapes: (3, 3) -> (3, 3). Raises ShapeError."""
    return of_shape("so3.Ad", {"R": (3, 3)}, R)[0]


def Ad_dual(R: Input) -> Float[Array, "3 3"]:
    """$Ad_R^(-T)$, which is R again. Shapes: (3, 3) -> (3, 3). Raises ShapeError."""
    return of_shape("so3.Ad_dual", {"R": (3, 3)}, R)[0]


@compiled
def bracket(w: Input, u: Input) -> Float[Array, "3"]:
    """$[w, u] = w x u$. Shapes: (3,), (3,) -> (3,). Raises ShapeError."""
    w, u = of_shape("so3.bracket", {"w": (3,), "u": (3,)}, w, u)
    return vector(cross(unpack(w), unpack(u)))


@compiled
def coad(w: Input, momentum: Input) -> Float[Array, "3"]:
    """$ad*_w L = w x L$. Shapes: (3,), (3,) -> (3,). Raises ShapeError."""
    w, momentum = of_shape("so3.coad", {"w": (3,), "momentum": (3,)}, w, momentum)
    return vector(cross(unpack(w), unpack(momentum)))


@compiled
def left_jacobian(w: Input) -> Float[Array, "3 3"]:
    """$J_l(w) = I + ((1 - cos t) / t^2) W + ((t - sin t) / t^3) W^2$: $Exp(w + d) = Exp(J_l d) Exp(w)$ to first order.

    Shapes: (3,) in rad -> (3, 3). Raises ShapeError.
    """
    (w,) = of_shape("so3.left_jacobian", {"w": (3,)}, w)
    parts = unpack(w)
    _, second, third = exp_coefficients(dot(parts, parts))
    return rigid_polynomial(parts, second, third)


def right_jacobian(w: Input) -> Float[Array, "3 3"]:
    """$J_r(w) = J_l(-w)$: $Exp(w + d) = Exp(w) Exp(J_r d)$ to first order.

    Shapes: (3,) -> (3, 3). Raises ShapeError.
    """
    return left_jacobian(-of_shape("so3.right_jacobian", {"w": (3,)}, w)[0])


@compiled
def left_jacobian_inv(w: Input) -> Float[Array, "3 3"]:
    """$J_l(w)^-1 = I - W/2 + d W^2$, $d = (1 - (t/2) cot(t/2)) / t^2$; singular at t = 2 pi.

    Shapes: (3,) in rad -> (3, 3). Raises ShapeError.
    """
    (w,) = of_shape("so3.left_jacobian_inv", {"w": (3,)}, w)
    parts = unpack(w)
    return rigid_polynomial(parts, -0.5, inverse_derivative(0, dot(parts, parts)))


def right_jacobian_inv(w: Input) -> Float[Array, "3 3"]:
    """$J_r(w)^-1 = J_l(-w)^-1$. Shapes: (3,) in rad -> (3, 3). Raises ShapeError."""
    return left_jacobian_inv(-of_shape("so3.right_jacobian_inv", {"w": (3,)}, w)[0])


@compiled
def right_jacobian_inv_apply(w: Input, u: Input) -> Float[Array, "3"]:
    """$J_r(w)^-1 u = u + w x u / 2 + d w x (w x u)$, by cross products.

    For $R' = R hat(u)$ and $R = R_0 Exp(w)$ this is $w'$. Shapes: (3,), (3,) -> (3,). Raises ShapeError.
    """
    w, u = of_shape("so3.right_jacobian_inv_apply", {"w": (3,), "u": (3,)}, w, u)
    a = unpack(w)
    return vector(rotation_rate(a, unpack(u), inverse_derivative(0, dot(a, a))))
