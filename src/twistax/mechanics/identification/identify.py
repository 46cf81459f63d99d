"""Identification: masses, inertias, friction and armature of a mechanism from records of its joints."""

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
#: How often weights and residuals alternate where the noise is unknown, and the least noise as a part of the forces.
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

    The motor forces are $tau = Y(q, qd, qdd) theta$ minus the spring forces, with noise. With $theta$ of known
    links and drives taken from the mechanism, and the base parameters $beta = C theta$ of the unknown ones, it
    minimises

        $sum |(tau - Y_b beta) / sigma|^2$,  covariance $(Y_b^T Sigma^-1 Y_b)^-1$,

    which is the Cramer-Rao bound where the noise of the forces is Gaussian, white and independent, and that of the
    motion is negligible.

    **What the data determine.** Unknowns are counted in parts of their sizes: kg, kg m and kg m2 of a mass `size[0]` at
    a distance `size[1]`; an armature as an inertia, a friction as the weight's, a damping as the weight's at the speed
    of a pendulum of this length. A direction of the parameters is determined if its standard deviation is at most
    `tolerance` of that. The measure does not depend on units. The result has numbers for determined combinations only.

    Source: M. Gautier, Dynamic Identification of Robots with Power Model, ICRA (1997), for the weights of unknown
    noise; M. Gautier (1991), as for `base_parameters`.

    Args:
        mechanism: a tree. Its numbers are those of known parameters, and where a physical fit begins.
        records: "q", "qd", "qdd" and "tau", each (samples, n); tau are the joint forces of the motors, N or N m, zero
            where there is none. Joints on groups have "<joint>_position". If samples are in the order of time, the
            status can tell noise from errors of the model.
        links: with unknown bodies, by name or joint, each with all that is fixed to it; all with a body by default.
        drives: kinds that are unknown, for all joints: "armature", "damping", "friction".
        noise: standard deviation of tau, () or (n,), N or N m. By default it is estimated for each freedom, with the
            weights.
        physical: also fit bodies in log-Cholesky form, and drives that are not negative. Undetermined directions stay
            near the mechanism's.
        tolerance: (), the largest standard deviation of what counts as determined, in parts of the sizes.
        size: (kg, m): of typical bodies. By default the mean mass of the mechanism's bodies, and the root mean square
            distance of their mass from their joints.
        params: values of Parameters; their defaults otherwise.
    Raises:
        ModelError: closures; nothing that moves; a link or drive that is not known; a size that is not known; for a
            physical fit, an unknown body that is flat or missing.
        InputError: records of other names or shapes, or not finite; forces that are all zero; too few samples.

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
        theta: (p,) of the mechanism.
        unknown: (p,), which are estimated.
        base: the base parameters of these.
        Y: (samples n, unknown) of the records.
        y: (samples, n), the forces without those of known parameters and springs.
        scales: of the unknown parameters.
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
                "identify expects a tree, got closures, whose wrenches are not in the forces of its joints.\n"
                "  fix: replace(loops=()) and records of the open mechanism"
            )
        self.mechanism, self.stacked = mechanism, StackedRegressor.of(mechanism, DRIVE)
        data = JointRecords.of("identify", records, self.stacked.states)
        if unknown := sorted(set(params) - self.stacked.params):
            raise InputError(f"identify: params has {listed(unknown)}; it takes {listed(sorted(self.stacked.params))}")
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
            raise InputError("identify expects forces that are not all zero: without any the parameters have no scale")

    # ---- least squares -----------------------------------------------------------------------------------------------

    def solution(self, sigma: Array, tolerance: float) -> LeastSquaresSolution:
        """The base parameters in parts of their sizes, weighted by the noise (n,)."""
        columns = list(self.base.columns)
        A = self.Y[:, :, columns] * self.scales[self.unknown][columns] / sigma[:, None]
        return determined(A.reshape(-1, len(columns)), (self.y / sigma).ravel(), tolerance)

    def estimated_noise(self) -> Array:
        """The standard deviation (n,) of the residuals, which are weighted by it."""
        count, n = self.y.shape
        rank = self.base.rank
        if count * n <= rank or count < 2:
            raise InputError(
                f"identify: {count} samples of {n} forces leave no residuals of {rank} unknown combinations, so the "
                "noise is not known.\n  fix: noise=..., or more samples"
            )
        floor = _LEAST_NOISE * float(np.sqrt(np.mean(self.tau**2)))
        sigma = np.maximum(np.sqrt(np.mean(self.tau**2, axis=0)), floor)
        for _ in range(_PASSES):
            left = self.solution(sigma, 1.0).residuals.reshape(count, n) * sigma
            sigma = np.maximum(np.sqrt(np.sum(left**2, axis=0) / (count - rank / n)), floor)
        return sigma

    # ---- the result --------------------------------------------------------------------------------------------------

    def physical_fit(self, sigma: Array) -> PhysicalFit:
        """Bodies that are physical, and drives that are not negative."""
        A = (self.Y * self.scales[self.unknown] / sigma[:, None]).reshape(-1, int(self.unknown.sum()))
        return PhysicalFit(self.mechanism, self.stacked, self.unknown, self.theta, self.scales, A, self.y / sigma)

    def result(self, solution: LeastSquaresSolution, sigma: Array, fit: PhysicalFit | None) -> Identification:
        """All of it in the units of the parameters, with a one for the first parameter of each combination."""
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
            self.base.without_effect,
            sigma,
            residuals,
            misfit,
            serial,
            excess,
            None if fit is None else fit.mechanism,
        )


def noise_of(owner: str, noise: Any, n: int) -> Array | None:
    """The standard deviation (n,) of the forces; None where it is not known. Raises InputError."""
    if noise is None:
        return None
    sigma = reals(f"{owner}: noise", noise, InputError).astype(np.float64)
    if sigma.shape not in ((), (n,)) or not ((sigma >= 1.0 / LARGEST) & (sigma <= LARGEST)).all():
        raise InputError(f"{owner} expects noise as one positive number or ({n},) of them, got {noise!r}")
    return np.broadcast_to(sigma, (n,)).copy()
