"""The physical parameters that fit the forces best: bodies in log-Cholesky form, and non-negative drive parameters."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ..bodies import SpatialInertia
from ..drives import Drive
from ..mechanism import Mechanism
from .physical_inertia import log_cholesky
from .regressor import BODY
from .stacked_regressor import StackedRegressor

Array = NDArray[np.float64]
#: The standard deviation, of logarithms and of parameters as fractions of their sizes, of a weak prior at the
#: mechanism's values, which keeps undetermined parameters near these.
_PULL = 3.0
#: The largest number of iterations; and the predicted decrease of the sum of squares, in units of the noise, below
#: which a minimum is reached.
_ITERATIONS, _NEGLIGIBLE = 300, 0.25
#: The initial root of a drive's parameter that is zero in the mechanism, as a fraction of sizes: at zero the derivative
#: would vanish.
_LEAST_DRIVE = 0.03


class PhysicalFit:
    """The least squares fit of $A theta = y$ with noise of unit variance, over physical parameters.

    A body is represented by the factor U of its pseudo-inertia $U U^T$, see `physical_inertia`. A step multiplies U by
    the factor of ten log-Cholesky numbers, so steps are relative to the current body, and bodies remain physical. A
    drive parameter is represented as a square.

    Args:
        mechanism, stacked: the mechanism, and its stacked regressor.
        unknown: (p,) which of the parameters are fitted.
        theta, scales: (p,) the parameters of the mechanism, and their sizes.
        A: (N, unknown), in units of the noise, for parameters as fractions of their sizes.
        y: (N,), in units of the noise.
    Attributes:
        theta: (p,) the fitted parameters.
        excess: the sum of squares minus that of the linear fit.
        finished: whether the fit converged to a minimum.
        mechanism: the mechanism with fitted parameters.
    Raises: ModelError for an unknown body that is flat or missing.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        stacked: StackedRegressor,
        unknown: NDArray[np.bool_],
        theta: Array,
        scales: Array,
        A: Array,
        y: Array,
    ) -> None:
        segments = [i for i in range(len(mechanism.segments)) if unknown[i * len(BODY)]]
        R: Array = np.asarray(np.linalg.qr(np.column_stack([A, y.ravel()]), mode="r"))
        self._R, self._c, self._scales = R[:, :-1], R[:, -1], scales[unknown]
        for i in segments:
            _check_body(mechanism, i)
        bodies = theta[: len(BODY) * len(mechanism.segments)].reshape(-1, len(BODY))[segments]
        roots = np.sqrt((theta / scales)[unknown][bodies.size :] + _LEAST_DRIVE**2)
        self._start = _Physical(_factor(bodies), roots)
        self._back, self._roots = np.linalg.inv(self._start.U), roots
        values, self.finished = self._minimised()
        self.theta = theta.copy()
        self.theta[unknown] = values
        best = np.linalg.lstsq(self._R, self._c, rcond=None)[0]
        squares = [float(np.sum((self._R @ v - self._c) ** 2)) for v in (values / self._scales, best)]
        self.excess = max(squares[0] - squares[1], 0.0)
        self.mechanism = _fitted(mechanism, stacked, segments, self.theta, unknown)

    def _minimised(self) -> tuple[Array, bool]:
        """The parameters at the minimum by the Levenberg-Marquardt method, and whether it converged."""
        x, damping = self._start, 1e-3
        r = self._misfit(x)
        for _ in range(_ITERATIONS):
            J = self._slope(x)
            H, g = J.T @ J, J.T @ r
            if g @ np.linalg.solve(H, g) <= _NEGLIGIBLE:
                return self._parameters(x), True
            while damping < 1e12:
                with np.errstate(over="ignore", invalid="ignore"):
                    step: Array = np.asarray(np.linalg.solve(H + damping * np.diag(np.diag(H)), -g))
                    trial = x.moved(step)
                    after = self._misfit(trial)
                if np.sum(after**2) < np.sum(r**2):
                    x, r, damping = trial, after, 0.2 * damping
                    break
                damping *= 4.0
        return self._parameters(x), False

    def _parameters(self, x: _Physical) -> Array:
        """theta (unknown,)."""
        bodies = _parameters_of(x.U @ np.swapaxes(x.U, 1, 2)).ravel()
        return np.concatenate([bodies, x.roots**2 * self._scales[bodies.size :]])

    def _misfit(self, x: _Physical) -> Array:
        """The residuals in units of the noise, and the deviations of the bodies from those of the mechanism."""
        relative = self._back @ x.U
        logs = np.log(np.diagonal(relative, axis1=1, axis2=2))
        pulled = np.concatenate([np.concatenate([logs, relative[:, *_ABOVE]], axis=1).ravel(), x.roots - self._roots])
        return np.concatenate([self._R @ (self._parameters(x) / self._scales) - self._c, pulled / _PULL])

    def _slope(self, x: _Physical) -> Array:
        U, count = x.U[:, None], len(x.U)
        by_body = _parameters_of(U @ (_UNITS + np.swapaxes(_UNITS, 1, 2)) @ np.swapaxes(U, 2, 3))  # (bodies, 10, 10)
        turned = (self._back @ x.U)[:, None] @ _UNITS
        pulled = np.concatenate(
            [np.diagonal(_UNITS, axis1=1, axis2=2) + 0.0 * turned[..., 0], turned[..., *_ABOVE]], -1
        )
        J, P = self._R.copy(), np.eye(self._R.shape[1])
        for k in range(count):
            at = slice(len(BODY) * k, len(BODY) * (k + 1))
            J[:, at] = (self._R[:, at] / self._scales[at]) @ by_body[k].T
            P[at, at] = pulled[k].T
        J[:, len(BODY) * count :] *= 2.0 * x.roots
        return np.vstack([J, P / _PULL])


@dataclasses.dataclass(frozen=True)
class _Physical:
    """Factors U (bodies, 4, 4) of pseudo-inertias, and the roots (drives,) of non-negative parameters."""

    U: Array
    roots: Array

    def moved(self, step: Array) -> _Physical:
        """The parameters after a step of ten numbers for each body, and one for each drive."""
        z = step[: len(BODY) * len(self.U)].reshape(-1, len(BODY))
        T = np.zeros_like(self.U)
        T[:, range(4), range(4)] = np.exp(z[:, :4])
        T[:, *_ABOVE] = z[:, 4:]
        return _Physical(self.U @ T, self.roots + step[z.size :])


#: The indices above the diagonal, and the unit matrices (10, 4, 4) for the diagonal and for these entries.
_ABOVE = np.triu_indices(4, 1)
_UNITS = np.zeros((len(BODY), 4, 4))
_UNITS[range(10), [*range(4), *_ABOVE[0]], [*range(4), *_ABOVE[1]]] = 1.0


def _factor(bodies: Array) -> Array:
    """The upper triangular factors U (count, 4, 4) of the pseudo-inertias for parameters (count, 10)."""
    m, (xx, xy, yy, xz, yz, zz) = bodies[:, 0], bodies[:, 4:].T
    J = np.empty((len(bodies), 4, 4))
    J[:, 3, 3], J[:, :3, 3], J[:, 3, :3] = m, bodies[:, 1:4], bodies[:, 1:4]
    J[:, 0, 0], J[:, 1, 1], J[:, 2, 2] = 0.5 * (yy + zz - xx), 0.5 * (xx + zz - yy), 0.5 * (xx + yy - zz)
    J[:, 0, 1] = J[:, 1, 0] = -xy
    J[:, 0, 2] = J[:, 2, 0] = -xz
    J[:, 1, 2] = J[:, 2, 1] = -yz
    return np.asarray(np.linalg.cholesky(J[:, ::-1, ::-1])[:, ::-1, ::-1])


def _parameters_of(J: Array) -> Array:
    """The parameters (..., 10) of pseudo-inertias (..., 4, 4); linear in them."""
    x, y, z = J[..., 0, 0], J[..., 1, 1], J[..., 2, 2]
    moments = [y + z, -J[..., 0, 1], x + z, -J[..., 0, 2], -J[..., 1, 2], x + y]
    return np.stack([J[..., 3, 3], *(J[..., i, 3] for i in range(3)), *moments], axis=-1)


def _check_body(mechanism: Mechanism, i: int) -> None:
    """Raise ModelError for a segment whose body is missing, flat or not physical."""
    segment = mechanism.segments[i]
    if segment.body is None:
        raise ModelError(
            f"identify: link {segment.link.name!r} has no body, which a physical fit needs as its start.\n"
            f"  fix: use with_inertia({{...}}) with a body of about the right size"
        )
    try:
        log_cholesky(segment.body)
    except ModelError as error:
        raise ModelError(
            f"identify: a physical fit cannot start from the body of {segment.link.name!r}: {error}"
        ) from None


def _fitted(
    mechanism: Mechanism,
    stacked: StackedRegressor,
    segments: list[int],
    theta: Array,
    unknown: NDArray[np.bool_],
) -> Mechanism:
    """The mechanism with bodies, which include all that is fixed to their links, and with drives of parameters (p,)."""
    bodies: dict[str, SpatialInertia | None] = {
        link.name: None for link in mechanism.links if mechanism.frame(link.name).segment in segments
    }
    for i in segments:
        m, *rest = theta[len(BODY) * i : len(BODY) * (i + 1)].tolist()
        xx, xy, yy, xz, yz, zz = rest[3:]
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        center = np.array(rest[:3]) / m
        bodies[mechanism.segments[i].link.name] = SpatialInertia.about_origin(
            mass=m, center_of_mass=center, inertia=tensor
        )
    drives: dict[str, Drive] = {}
    for k in np.flatnonzero(unknown[len(BODY) * len(mechanism.segments) :]) + len(BODY) * len(mechanism.segments):
        joint, _, kind = stacked.names[k].rpartition(".")
        drive = drives.get(joint, mechanism.segment_of(joint).link.drive)
        drives[joint] = dataclasses.replace(drive, **{kind: float(theta[k])})
    return mechanism.with_inertia(bodies).replace(drives=drives)
