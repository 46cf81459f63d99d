"""Torque-free rotation of a rigid body in closed form. R maps body to world axes, w is the body's angular velocity."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from .scene import Array, about


@dataclasses.dataclass(frozen=True, eq=False)
class SymmetricBody:
    """A body with inertia diag(transverse, transverse, axial), no torque.

    Its motion is two steady rotations: R(t) = R0 Exp(t L / transverse) Exp(t s e3), with L = J w0 in body axes at the
    start and s = (1 - axial / transverse) w3, and w(t) = Exp(-t s e3) w0. Angles are taken in the longest float NumPy
    has, so that many turns cost no digits: 64 bits of mantissa on x86, where 1e4 rad are known to 1e-15.

    Source: Landau and Lifshitz, Mechanics, section 33 (regular precession of a free symmetrical top).
    """

    transverse: float  # moments of inertia, kg m2
    axial: float
    rotation: Array  # R0, (3, 3)
    rate: Array  # w0, (3,), rad/s

    @property
    def inertia(self) -> Array:
        """The principal moments, (3,)."""
        return np.array([self.transverse, self.transverse, self.axial])

    def at(self, t: float) -> tuple[Array, Array]:
        """R (3, 3) and w (3,) at t in s."""
        J = self.inertia.astype(np.longdouble)
        w0, time = self.rate.astype(np.longdouble), np.longdouble(t)
        L = J * w0
        size = np.sqrt(L @ L)
        axis = np.array([0.0, 0.0, 1.0], np.longdouble)
        R_spin = about(axis, (1 - J[2] / J[0]) * w0[2] * time)
        R = self.rotation.astype(np.longdouble) @ about(L / size, size / J[0] * time) @ R_spin
        return R.astype(float), (R_spin.T @ w0).astype(float)


@dataclasses.dataclass(frozen=True, eq=False)
class TriaxialBody:
    """A body with three different principal moments, no torque: the Euler top, by elliptic functions and integrals.

    Take axes a, b, c, with b the middle moment and c the axis about which the body turns on the whole. Then

        w = (A cn, B sn, C dn)(tau, m),  tau = p t + tau0,

    and the body turns about its momentum L, which is fixed in the world, by

        psi' = L (2 E - J_a w_a^2) / (L^2 - J_a^2 w_a^2),

    E the kinetic energy: the component along L of the velocity of axis a. Its integral is an elliptic integral of the
    third kind. Where L points in the body gives the rest of the attitude.

    Source: Landau and Lifshitz, Mechanics, section 37, for w; the integral in Carlson's form, NIST Digital Library of
    Mathematical Functions, section 19.25.
    """

    inertia: Array  # principal moments about the body axes, (3,), kg m2, all different
    rotation: Array  # R at t = 0, (3, 3)
    rate: Array  # w at t = 0, (3,), rad/s; not a motion that tends to a spin about the middle axis

    @functools.cached_property
    def _axes(self) -> Array:
        """Rows: the axes a, b, c, right-handed, with w_c > 0."""
        J, w = self.inertia, self.rate
        order = np.argsort(J)
        if (J * w) @ (J * w) < J[order[1]] * ((J * w) @ w):
            order = order[::-1]
        axes = np.eye(3)[order]
        axes[2] *= np.round(np.linalg.det(axes))
        axes[[0, 2]] *= np.sign(axes[2] @ w)
        return axes

    @functools.cached_property
    def _motion(self) -> _Motion:
        return _Motion.of(np.abs(self._axes) @ self.inertia, self._axes @ self.rate)

    def at(self, t: float) -> tuple[Array, Array]:
        """R (3, 3) and w (3,) at t in s."""
        axes, motion = self._axes, self._motion
        w0, turned0 = motion.at(0.0)
        w, turned = motion.at(t)
        between = motion.from_momentum(w0).T @ about(np.array([0.0, 0.0, 1.0]), turned - turned0)
        return self.rotation @ axes.T @ between @ motion.from_momentum(w) @ axes, axes.T @ w


@dataclasses.dataclass(frozen=True, eq=False)
class _Motion:
    """The motion in the axes a, b, c: moments J, amplitudes (A, B, C), |L|, p, m, tau0, and a factor of the turn."""

    J: Array
    amplitudes: Array
    momentum: float
    p: float
    m: float
    phase: float

    @staticmethod
    def of(J: Array, w: Array) -> _Motion:
        from scipy import special

        a, b, c = J
        # L^2 - 2 E a and 2 E c - L^2, without their cancellation; both are negative where a > b > c.
        above = b * (b - a) * w[1] ** 2 + c * (c - a) * w[2] ** 2
        below = a * (c - a) * w[0] ** 2 + b * (c - b) * w[1] ** 2
        amplitudes = np.sqrt([below / (a * (c - a)), below / (b * (c - b)), above / (c * (c - a))])
        p = np.sign(c - a) * np.sqrt((c - b) * above / (a * b * c))
        m = (b - a) * below / ((c - b) * above)
        angle = np.arctan2(w[1] * np.sqrt(b * abs(c - b)), w[0] * np.sqrt(a * abs(c - a)))
        return _Motion(J, amplitudes, float(np.linalg.norm(J * w)), p, m, special.ellipkinc(angle, m))

    def at(self, t: float) -> tuple[Array, float]:
        """w (3,) and psi at t, up to a constant.

        L^2 - J_a^2 w_a^2 is (J_c C)^2 (1 - n sn^2) with n = -(J_a A / J_c C)^2, so that

            psi = L t / J_c - L (J_c - J_a) n / (3 J_a J_c p) Q(tau),   Q' = 3 sn^2 / (1 - n sn^2),

        two terms of one sign. Q = sn^3 R_J(cn^2, dn^2, 1, 1 - n sn^2) for |tau| up to the quarter period K, and twice
        its value at K more for every half period.
        """
        from scipy import special

        a, _, c = self.J
        n = -((a * self.amplitudes[0]) ** 2) / (c * self.amplitudes[2]) ** 2
        quarter = special.ellipk(self.m)
        tau = self.p * t + self.phase
        halves = np.round(tau / (2.0 * quarter))
        sn, cn, dn, _ = special.ellipj(tau - 2.0 * halves * quarter, self.m)
        Q = sn**3 * special.elliprj(cn**2, dn**2, 1.0, 1.0 - n * sn**2)
        Q += 2.0 * halves * special.elliprj(0.0, 1.0 - self.m, 1.0, 1.0 - n)
        psi = self.momentum * (t / c - (c - a) * n / (3.0 * a * c * self.p) * Q)
        sign = 1.0 - 2.0 * (halves % 2.0)
        return self.amplitudes * np.array([sign * cn, sign * sn, dn]), float(psi)

    def from_momentum(self, w: Array) -> Array:
        """The rotation (3, 3) from a, b, c to axes z along L and x along e_a x L."""
        z = self.J * w / np.linalg.norm(self.J * w)
        x = np.array([0.0, -z[2], z[1]]) / np.hypot(z[1], z[2])
        return np.array([x, np.cross(z, x), z])
