"""Identification of the masses, inertias, friction and armature of a mechanism from joint records."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import instance, listed, number, reals
from ...errors import InputError, ModelError
from ...progress import watching
from ..algorithms.dynamics import checked
from ..mechanism import Mechanism
from .base_parameters import BaseParameters, identifiable_combinations, sum_of
from .determined import ZERO, LeastSquaresSolution, determined
from .identification import Identification, correlation, status_of
from .joint_records import LARGEST, JointRecords
from .physical_fit import PhysicalFit
from .regressor import DRIVE
from .stacked_regressor import StackedRegressor

Array = NDArray[np.float64]
#: The number of iterations of reweighting if the noise is unknown, and the smallest noise as a fraction of the forces.
_PASSES, _LEAST_NOISE = 4, 1e-12


@watching("identify")
def identify(
    mechanism: Mechanism,
    records: Mapping[str, Any],
    *,
    links: Collection[str] | None = None,
    drives: Collection[str] = (),
    noise: Any = None,
    physical: bool = False,
    tolerance: float = 0.1,
    size: tuple[float, float] | None = None,
    params: Mapping[str, Any] | None = None,
) -> Identification:
    """Parameters of bodies and drives from measured motions and joint forces, by weighted least squares.

    The motor forces are $tau = Y(q, qd, qdd) theta$ minus the spring forces, plus noise. The parameters $theta$ of
    known links and drives are those of the mechanism. With the base parameters $beta = C theta$ of the unknown ones,
    the function minimises

        $sum |(tau - Y_b beta) / sigma|^2$, with the covariance $(Y_b^T Sigma^-1 Y_b)^-1$,

    which is the Cramer-Rao bound if the noise of the forces is Gaussian, white and independent, and that of the motion
    is negligible.

    **Which parameters are determined.** Each unknown is divided by its size: kg, kg m and kg m2 of a mass `size[0]` at
    a distance `size[1]` for bodies; an inertia for an armature; the torque of the weight for friction; that torque at
    the speed of a pendulum of this length for damping. A direction of the parameters is determined if its standard
    deviation is at most `tolerance` of these sizes, which does not depend on units. The result contains only determined
    combinations.

    Source: M. Gautier, Dynamic Identification of Robots with Power Model, ICRA (1997), for the weights with unknown
    noise; M. Gautier (1991), as for `base_parameters`.

    Args:
        mechanism: a tree. It provides the values of the known parameters, and the start of a physical fit.
        records: "q", "qd", "qdd" and "tau", each (samples, n). tau are the joint forces of the motors, N or N m, zero
            for joints without a motor. Joints on groups have "<joint>_position". If samples are in the order of time,
            the status can distinguish noise from model errors.
        links: links with unknown bodies, by the name of the link or joint, each with all that is fixed to it; by
            default all links with a body.
        drives: kinds of drive parameters that are unknown, for all joints: "armature", "damping", "friction". The law
            of dry friction is $friction tanh(v / speed)$ with the `friction_speed` of each `Drive`, which is known. For
            friction by the sign of the velocity, set a `friction_speed` below all measured velocities, and omit samples
            at rest, where this law has no value.
        noise: standard deviation of tau, () or (n,), N or N m. By default it is estimated for each degree of freedom,
            together with the weights.
        physical: whether to fit physical parameters too: bodies in log-Cholesky form, and non-negative drive
            parameters. Undetermined directions stay near the mechanism's values.
        tolerance: (), the largest standard deviation of a determined direction, as a fraction of the sizes.
        size: (kg, m) of typical bodies. By default the mean mass of the mechanism's bodies, and the root mean square
            distance of their mass from their joints.
        params: values of Parameters; by default their declared values.
    Raises:
        ModelError: loop constraints; a mechanism without moving joints; an unknown link or drive; parameters whose size
            is not known; for a physical fit, an unknown body that is flat or missing.
        InputError: records with other names or of the wrong shape, or not finite; forces that are all zero; too few
            samples.

    Example:
        `identify(arm, {"q": q, "qd": qd, "qdd": qdd, "tau": tau}, links=["hand"], noise=0.1).estimate("hand.mass")`
    """
    instance("identify: params", params, Mapping | None, "values by name", InputError)
    task = _Task(mechanism, records, links, drives, dict(params or {}), size)
    number("identify: tolerance", tolerance, "a positive number", lambda x: 0.0 < x < np.inf)
    sigma = noise_of("identify", noise, mechanism.dofs)
    if sigma is None:
        sigma = task.estimated_noise()
    solution = task.solution(sigma, tolerance)
    fit = task.physical_fit(sigma) if physical else None
    return task.result(solution, sigma, fit)


class _Task:
    """The linear problem of one call of `identify`.

    Attributes:
        stacked: the regressor.
        theta: (p,) parameters of the mechanism.
        unknown: (p,) which of them are estimated.
        base: the base parameters of the unknown ones.
        Y: (samples n, unknown) the regressor of the records.
        y: (samples, n) the forces minus those of known parameters and springs.
        scales: sizes of the unknown parameters.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        records: Any,
        links: Collection[str] | None,
        drives: Collection[str],
        params: dict[str, Any],
        size: tuple[float, float] | None,
    ) -> None:
        checked("identify", mechanism)
        instance("identify: mechanism", mechanism, Mechanism, "a Mechanism", ModelError)
        if not mechanism.dofs:
            raise ModelError("identify expects a mechanism with a joint that moves, got none")
        if mechanism.loops:
            raise ModelError(
                "identify expects a tree, got loop constraints, whose wrenches are not known from the "
                "joint forces.\n  fix: use replace(loops=()) and records of the open mechanism"
            )
        self.mechanism, self.stacked = mechanism, StackedRegressor.of(mechanism, DRIVE)
        data = JointRecords.of("identify", records, self.stacked.states)
        if unknown := sorted(set(params) - self.stacked.params):
            raise InputError(
                f"identify: unknown names in params: {listed(unknown)}; possible names are "
                f"{listed(sorted(self.stacked.params))}"
            )
        self.theta = self.stacked.values(params)
        self.scales = self.stacked.scales(*self.stacked.typical("identify", self.theta, size))
        self.unknown = self.stacked.unknown("identify", links, drives)
        names = tuple(np.array(self.stacked.names, dtype=object)[self.unknown])
        random = self.stacked.random_matrix(params)
        self.base: BaseParameters = identifiable_combinations(random[:, self.unknown], names)
        Y = self.stacked.matrix(data.samples, params)
        known = np.where(self.unknown, 0.0, self.theta)
        self.y = data.tau + self.stacked.springs(data.samples, params) - Y @ known
        self.Y, self.samples, self.tau = Y[:, :, self.unknown], data.samples, data.tau
        if not np.any(data.tau):
            raise InputError("identify expects forces that are not all zero")

    # ---- least squares -----------------------------------------------------------------------------------------------

    def solution(self, sigma: Array, tolerance: float) -> LeastSquaresSolution:
        """The base parameters as fractions of their sizes, weighted by the noise (n,)."""
        columns = list(self.base.columns)
        A = self.Y[:, :, columns] * self.scales[self.unknown][columns] / sigma[:, None]
        return determined(A.reshape(-1, len(columns)), (self.y / sigma).ravel(), tolerance)

    def estimated_noise(self) -> Array:
        """The standard deviation (n,) of the residuals, consistent with the weights."""
        count, n = self.y.shape
        rank = self.base.rank
        if count * n <= rank or count < 2:
            raise InputError(
                f"identify: {count} samples of {n} forces are not enough to estimate {rank} unknown "
                "combinations and the noise.\n  fix: pass noise=..., or more samples"
            )
        floor = _LEAST_NOISE * float(np.sqrt(np.mean(self.tau**2)))
        sigma = np.maximum(np.sqrt(np.mean(self.tau**2, axis=0)), floor)
        for _ in range(_PASSES):
            left = self.solution(sigma, 1.0).residuals.reshape(count, n) * sigma
            sigma = np.maximum(np.sqrt(np.sum(left**2, axis=0) / (count - rank / n)), floor)
        return sigma

    # ---- the result --------------------------------------------------------------------------------------------------

    def physical_fit(self, sigma: Array) -> PhysicalFit:
        """Physical bodies and non-negative drive parameters, fitted to the data."""
        A = (self.Y * self.scales[self.unknown] / sigma[:, None]).reshape(-1, int(self.unknown.sum()))
        return PhysicalFit(self.mechanism, self.stacked, self.unknown, self.theta, self.scales, A, self.y / sigma)

    def result(self, solution: LeastSquaresSolution, sigma: Array, fit: PhysicalFit | None) -> Identification:
        """The result in the units of the parameters, with a coefficient of one for the first parameter of each
        combination.
        """
        names = tuple(np.array(self.stacked.names, dtype=object)[self.unknown])
        scales, count = self.scales[self.unknown], len(self.y)
        columns = scales[list(self.base.columns)]
        begin = columns[list(solution.pivots)]
        C = (begin[:, None] * solution.combinations / columns) @ self.base.combinations
        C[np.abs(C) < ZERO] = 0.0
        values, residuals = begin * solution.values, solution.residuals.reshape(self.y.shape) * sigma
        if fit is not None:
            values, residuals = C @ fit.theta[self.unknown], self.y - self.Y @ fit.theta[self.unknown]
        freedom, serial = residuals.size - self.base.rank + len(solution.left), correlation(residuals, sigma)
        misfit = float(np.sum((residuals / sigma) ** 2)) / max(freedom, 1)
        excess = None if fit is None else fit.excess
        finished = fit is None or fit.finished
        return Identification(
            status_of(misfit, freedom, serial, count, excess, len(C), finished, len(solution.left)),
            tuple(sum_of(row, names) for row in C),
            values,
            begin[:, None] * solution.covariance * begin,
            C,
            names,
            tuple(self.base.names[i] for i in solution.left),
            self.base,
            sigma,
            residuals,
            misfit,
            serial,
            excess,
            None if fit is None else fit.mechanism,
        )


def noise_of(owner: str, noise: Any, n: int) -> Array | None:
    """The standard deviation (n,) of the forces; None if it is not known. Raises InputError for invalid values."""
    if noise is None:
        return None
    sigma = reals(f"{owner}: noise", noise, InputError).astype(np.float64)
    if sigma.shape not in ((), (n,)) or not ((sigma >= 1.0 / LARGEST) & (sigma <= LARGEST)).all():
        raise InputError(f"{owner} expects noise as one positive number or ({n},) of them, got {noise!r}")
    return np.broadcast_to(sigma, (n,)).copy()
