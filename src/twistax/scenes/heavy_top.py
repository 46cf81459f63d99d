"""The Lagrange top: a symmetric body that rotates about a fixed point on its axis, under gravity."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import twistax as tx

from .scene import Array, Scene, about, said, stored_end

#: Moments of inertia about the fixed point, kg m2.
INERTIA = (1.0, 1.0, 0.5)
#: Weight times the distance of the centre of mass, which lies on the axis above the fixed point, N m.
MOMENT = 2.0


def system(inertia: Sequence[float] = INERTIA) -> tx.System:
    """R' = R [w]x and J w' = (J w) x w + (R' e_z) x (MOMENT e_z). States R (body to world, z up) and w (3,), rad/s.

    J = diag(inertia), kg m2, about the fixed point. Outputs, constant in the true motion of a symmetric one: energy, J;
    vertical_momentum and axial_momentum, N m s.
    """
    J = np.array(inertia)
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    L, up = J * w, R[2]
    return tx.System(
        rates={R: w, w: (tx.linalg.Cross(L, w) + tx.linalg.Cross(up, np.array([0.0, 0.0, MOMENT]))) / J},
        outputs={
            "energy": 0.5 * tx.linalg.Dot(w, L) + MOMENT * R[2, 2],
            "vertical_momentum": up @ L,
            "axial_momentum": L[2],
        },
    )


# ---- the motion, up to one-dimensional integrals ---------------------------------------------------------------------

#: Samples of a period, at least and at most. The integrands are smooth and periodic, so that the rule's error falls as
#: a power of their number; tops that all but pass through the vertical need many.
_SAMPLES, _MOST = 64, 8192

_UP = np.array([0.0, 0.0, 1.0], np.longdouble)


@dataclasses.dataclass(frozen=True, eq=False)
class LagrangeTop:
    """A top with moments J1, J1, J3 about its tip and weight times arm W, leaning by an angle that is never 0 or pi.

    The cosine u of the lean obeys u'^2 = (2 W / J1) (u - a)(u - b)(u - c) with a <= u <= b <= 1 <= c. With
    u = a + (b - a) sin^2(phi),

        phi' = sqrt(W / (2 J1) (c - a) (1 - m sin^2 phi)),   m = (b - a)/(c - a),

    so that time, precession and spin are integrals over phi of functions with period pi. All is in the longest float
    NumPy has: where that has 64 bits of mantissa, the angle after 1e5 rad is known to 1e-13.

    Source: Landau and Lifshitz, Mechanics, section 35, problem 1.
    """

    transverse: float  # J1, kg m2
    axial: float  # J3, kg m2
    moment: float  # W, N m
    rotation: Array  # R at t = 0, (3, 3), body to world, z up
    rate: Array  # w at t = 0, (3,), body axes, rad/s

    def at(self, t: float) -> tuple[Array, Array]:
        """R (3, 3) and w (3,) at t in s."""
        n, z, w = self._start
        phi = self._clock.inverse(self._clock.at(self._phase) + np.longdouble(t))
        u, sine = self._cosine(phi), np.sqrt(1 - self._cosine(phi) ** 2)
        precession = np.arctan2(z[0], -z[1]) + self._turn.at(phi) - self._turn.at(self._phase)
        spin = np.arctan2(n[0], n[1]) + w[2] * np.longdouble(t)
        spin = spin - (self._turned.at(phi) - self._turned.at(self._phase))
        R = about(_UP, precession) @ about(np.array([1.0, 0.0, 0.0], np.longdouble), np.arctan2(sine, u))
        leaning = -2 * (self._roots[1] - self._roots[0]) * np.sin(phi) * np.cos(phi) / (sine * self._pace(phi))
        R_spin = about(_UP, spin)
        rate = R_spin.T @ np.array([leaning, self._precession(u) * sine, 0]) + w[2] * _UP
        return (R @ R_spin).astype(float), rate.astype(float)

    @functools.cached_property
    def _start(self) -> tuple[Array, Array, Array]:
        """Up in body axes, the body's axis in the world, and w, at t = 0."""
        R = self.rotation.astype(np.longdouble)
        return R[2], R[:, 2], self.rate.astype(np.longdouble)

    @functools.cached_property
    def _momenta(self) -> tuple[Any, Any]:
        """The vertical and the axial component of the angular momentum."""
        n, _, w = self._start
        L = w * [self.transverse, self.transverse, self.axial]
        return n @ L, L[2]

    @functools.cached_property
    def _roots(self) -> Array:
        """a, b, c: Newton's method in extended precision, from the roots in doubles."""
        n, _, w = self._start
        J, W, (vertical, axial) = np.longdouble(self.transverse), self.moment, self._momenta
        energy = J / 2 * (w[0] ** 2 + w[1] ** 2) + W * n[2]
        cubic = np.array([2 * W, -2 * energy, -2 * W, 2 * energy]) / J
        cubic[1:] += [-((axial / J) ** 2), 2 * vertical * axial / J**2, -((vertical / J) ** 2)]
        slope = cubic[:3] * [3, 2, 1]
        x = np.sort(np.roots(cubic.astype(float)).real).astype(np.longdouble)
        for _ in range(3):
            x = x - np.polyval(cubic, x) / np.polyval(slope, x)
        return x

    @functools.cached_property
    def _phase(self) -> Any:
        """phi at t = 0, from u and u', so that it is exact at the turning points too."""
        n, _, w = self._start
        a, b, _ = self._roots
        share = (n[2] - a) / (b - a)
        flow = n[0] * w[1] - n[1] * w[0]
        # u' = (b - a) sin(2 phi) phi', and cos(2 phi) = 1 - 2 sin^2(phi). 1 / phi' depends on sin^2(phi) alone.
        double_sine = flow / (b - a) * self._pace(np.arcsin(np.sqrt(np.clip(share, 0, 1))))
        return np.arctan2(double_sine, 1 - 2 * share) / 2

    def _cosine(self, phi: Any) -> Any:
        a, b, _ = self._roots
        return a + (b - a) * np.sin(phi) ** 2

    def _pace(self, phi: Any) -> Any:
        """1 / phi'."""
        a, b, c = self._roots
        return np.sqrt(2 * self.transverse / (np.longdouble(self.moment) * (c - a - (b - a) * np.sin(phi) ** 2)))

    def _precession(self, u: Any) -> Any:
        """The rate at which the axis goes round, rad/s."""
        vertical, axial = self._momenta
        return (vertical - axial * u) / (self.transverse * (1 - u**2))

    @functools.cached_property
    def _clock(self) -> _Integral:
        return _Integral.of(self._pace)

    @functools.cached_property
    def _turn(self) -> _Integral:
        return _Integral.of(lambda phi: self._pace(phi) * self._precession(self._cosine(phi)))

    @functools.cached_property
    def _turned(self) -> _Integral:
        """The part of the precession that the body sees along its own axis."""
        return _Integral.of(lambda phi: self._pace(phi) * self._precession(self._cosine(phi)) * self._cosine(phi))


@dataclasses.dataclass(frozen=True, eq=False)
class _Integral:
    """The integral of an even function with period pi from 0: mean x + sum_k c_k sin(2 k x) / (2 k)."""

    rate: Callable[[Any], Any]
    mean: Any
    waves: Array

    @staticmethod
    def of(rate: Callable[[Any], Any]) -> _Integral:
        """By the trapezoidal rule, with as many samples as it takes for the last waves to vanish."""
        half_turn, samples, enough = np.arctan2(np.longdouble(0), -1), _SAMPLES, False
        while not enough:
            x = np.arange(samples, dtype=np.longdouble) * (half_turn / samples)
            values, k = rate(x), np.arange(1, samples // 2)
            mean, waves = np.mean(values), 2 * np.cos(2 * k[:, None] * x) @ values / samples
            enough = np.max(np.abs(waves[-4:])) <= 100 * np.finfo(np.longdouble).eps * abs(mean) or samples >= _MOST
            samples *= 2
        return _Integral(rate, mean, waves / (2 * k))

    def at(self, x: Any) -> Any:
        """The integral from 0 to x."""
        return self.mean * x + np.sin(2 * np.arange(1, self.waves.size + 1) * x) @ self.waves

    def inverse(self, value: Any) -> Any:
        """Where the integral of a positive function has this value."""
        x = value / self.mean
        for _ in range(60):
            change = (self.at(x) - value) / self.rate(x)
            x = x - change
            if abs(change) <= 4 * np.finfo(np.longdouble).eps * max(1, abs(x)):
                break
        return x


# ---- the scenes ------------------------------------------------------------------------------------------------------

HEAVY_TOP = Scene(
    **said("heavy-top"),
    build=system,
    start={"R": about((1.0, 0.0, 0.0), 0.6), "w": np.array([0.3, 0.1, 8.0])},
    duration=20.0,
    reference=stored_end("heavy-top"),
    invariants=("energy", "vertical_momentum", "axial_momentum"),
)

_TOP = LagrangeTop(INERTIA[0], INERTIA[2], MOMENT, HEAVY_TOP.start["R"], HEAVY_TOP.start["w"])

LONG_HEAVY_TOP = dataclasses.replace(
    HEAVY_TOP,
    **said("long-heavy-top"),
    duration=1e3,
    reference=None,
    exact=lambda t: dict(zip(("R", "w"), _TOP.at(t))),
)
