"""The result of `identify`: estimates of the determined combinations with their accuracy, and the undetermined ones."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...checks import listed, number, short
from ...errors import InputError
from ..mechanism import Mechanism
from .base_parameters import BaseParameters, sum_of
from .regressor import BODY, DRIVE

Array = NDArray[np.float64]
#: The probability below which residuals or a physical fit are not explained by noise.
_UNLIKELY = 1e-4
#: Residuals below this fraction of the noise are round-off, whose correlation has no meaning.
_SMALL = 0.1
#: The largest distance, relative to its coefficients, of a combination from the determined ones.
_EQUAL = 1e-6


class IdentificationStatus(enum.Enum):
    """The status of an identification. If several apply, the last one in this list is returned:

    - `IDENTIFIED`: the data determine all base parameters, and the residuals are consistent with the noise.
    - `UNDETERMINED`: the residuals are consistent with the noise, but the data do not determine all base parameters;
      `undetermined` names these.
    - `UNPHYSICAL`: physical bodies and drives fit the data worse than noise explains.
    - `MISFIT`: residuals are larger than the noise, or correlated in time: the model is incomplete, and the covariance
      is too small.
    - `UNFINISHED`: the physical fit did not converge to a minimum.
    """

    IDENTIFIED = "identified"
    UNDETERMINED = "undetermined"
    UNPHYSICAL = "unphysical"
    MISFIT = "misfit"
    UNFINISHED = "unfinished"


@dataclasses.dataclass(frozen=True)
class Identification:
    """Estimated combinations of parameters, $beta = C theta$, with their covariance. Made by `identify`.

    Attributes:
        status: see `IdentificationStatus`.
        names: names of the r combinations that the data determine, such as "link1.Izz + link2.Iyy".
        values: (r,) estimates, each in the unit of the first parameter of its combination.
        covariance: (r, r): the Cramer-Rao bound of the linear problem.
        combinations: C (r, p).
        parameters: names of the p unknown parameters.
        undetermined: base parameters that the data do not determine: the combinations above hold for any values of
            these.
        base: the combinations that joint forces depend on, for any motion.
        noise: (n,), the standard deviation of the forces, N or N m.
        residuals: (samples, n), N or N m: measured less fitted forces.
        misfit: the mean square of the residuals in units of the noise, per degree of freedom: about 1 for a complete
            model.
        correlation: (n,) correlation of the residuals with those of the previous sample; 0 for white noise.
        excess: the sum of squares of the physical fit minus that of the linear one, in units of the noise; None without
            a physical fit.
        mechanism: the mechanism with fitted bodies and drives; None without a physical fit.
    """

    status: IdentificationStatus
    names: tuple[str, ...]
    values: Array
    covariance: Array
    combinations: Array
    parameters: tuple[str, ...]
    undetermined: tuple[str, ...]
    base: BaseParameters
    noise: Array
    residuals: Array
    misfit: float
    correlation: Array
    excess: float | None = None
    mechanism: Mechanism | None = None

    @property
    def standard_deviations(self) -> Array:
        """The standard deviations of `values`, (r,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Names of parameters that no joint force depends on."""
        return self.base.without_effect

    @property
    def inseparable(self) -> tuple[str, ...]:
        """Names of parameters that the data determine only within a combination of `names`. Each parameter without an
        estimate is in this list, in `without_effect`, or in a combination of `undetermined`.
        """
        C, units = self.combinations, np.eye(len(self.parameters))
        return tuple(
            name
            for name, column, unit in zip(self.parameters, C.T, units, strict=True)
            if column.any() and _weights(C, unit) is None
        )

    def estimate(self, combination: str | Mapping[str, float]) -> tuple[float, float]:
        """The value of a parameter, or of a sum of parameters, and its standard deviation, in its unit.

        Args:
            combination: the name of a parameter or of a combination, or coefficients by parameter, such as
                {"link1.Izz": 1.0, "link2.Iyy": 1.0}.
        Raises: InputError for an unknown name, or an undetermined combination.
        """
        wanted = np.zeros(len(self.parameters))
        if isinstance(combination, str) and combination in self.names:
            k = self.names.index(combination)
            return float(self.values[k]), float(self.standard_deviations[k])
        parts = {combination: 1.0} if isinstance(combination, str) else combination
        if not isinstance(parts, Mapping) or not parts:
            raise InputError(f"estimate expects a name, or a dict of coefficients by name, got {short(combination)}")
        for name, coefficient in parts.items():
            if name not in self.parameters:
                raise InputError(f"estimate: there is no parameter {name!r}; there are {listed(self.parameters, name)}")
            number(f"estimate: the coefficient of {name!r}", coefficient)
            wanted[self.parameters.index(name)] = coefficient
        weights = _weights(self.combinations, wanted)
        if weights is None:
            raise InputError(f"estimate: {self._obstacle(wanted, _sum(parts))}")
        return float(weights @ self.values), float(np.sqrt(weights @ self.covariance @ weights))

    def _obstacle(self, wanted: Array, name: str) -> str:
        """Why a combination has no estimate, and what helps: other motions, or fewer unknown parameters."""
        C = self.base.combinations
        if _weights(C, wanted) is not None:
            within = _containing(self.combinations, wanted, self.names)
            where = f"They determine it only within {listed(within)}" if within else "No combination contains it"
            return (
                f"the data do not determine {name}. {where}.\n"
                "  fix: record motions that depend on it more, as of tx.trajectory.exciting_problem; `undetermined` "
                "and `inseparable` list all such parameters"
            )
        within = _containing(C, wanted, self.base.names)
        if not within:
            return f"no joint force depends on {name}; `without_effect` lists all such parameters"
        cause = f"no motion determines {name}: joint forces depend on it only within {listed(within)}"
        fix = "estimate such a combination"
        # The links and the kinds of drives that it contains remain unknown.
        parts = [part.rpartition(".") for part in self.parameters]
        chosen = [parts[i] for i in np.flatnonzero(wanted)]
        links = list(dict.fromkeys(owner for owner, _, kind in chosen if kind in BODY))
        drives = list(dict.fromkeys(kind for _, _, kind in chosen if kind in DRIVE))
        left = [kind in drives if kind in DRIVE else owner in links for owner, _, kind in parts]
        if not all(left) and _weights(C[:, left], wanted[left]) is not None:
            fix += f", or take the other parameters as known: identify(..., links={links}, drives={drives})"
        return f"{cause}.\n  fix: {fix}"

    def __str__(self) -> str:
        lines = [f"{self.status.name}: {len(self.names)} combinations determined, misfit {self.misfit:.3g}"]
        width = max((len(name) for name in self.names), default=0)
        for name, value, deviation in zip(self.names, self.values, self.standard_deviations, strict=True):
            lines.append(f"  {name:<{width}}  {value: .5g} +- {deviation:.2g}")
        lists = ("not determined", self.undetermined), ("without effect", self.without_effect)
        for title, names in (*lists, ("only within a combination", self.inseparable)):
            if names:
                lines.append(f"  {title}: {', '.join(names)}")
        return "\n".join(lines)


def _weights(C: Array, wanted: Array) -> Array | None:
    """The coefficients (r,) of the rows of C (r, p) in a combination (p,); None if it is not a sum of them."""
    length = np.linalg.norm(C, axis=0)
    size = np.where(length > 0.0, 1.0 / np.where(length > 0.0, length, 1.0), 1.0)
    weights: Array = np.linalg.lstsq((C * size).T, wanted * size, rcond=None)[0].astype(np.float64)
    return None if np.abs(weights @ C - wanted).max() > _EQUAL * np.abs(wanted).max() else weights


def _containing(C: Array, wanted: Array, names: Sequence[str]) -> list[str]:
    """The names of the rows of C that contain a parameter of a combination."""
    return [name for name, row in zip(names, C, strict=True) if np.any(row[wanted != 0.0])]


def _sum(parts: Mapping[str, float]) -> str:
    return sum_of(np.array(list(parts.values()), dtype=np.float64), list(parts))


def correlation(residuals: Array, noise: Array) -> Array:
    """The correlation (n,) of residuals (samples, n) with those of the previous sample; zero if they are round-off."""
    power = np.sum(residuals**2, axis=0)
    small = power <= len(residuals) * (_SMALL * noise) ** 2
    return np.where(small, 0.0, np.sum(residuals[1:] * residuals[:-1], axis=0) / np.where(small, 1.0, power))


def status_of(
    misfit: float, freedom: int, serial: Array, count: int, excess: float | None, rank: int, finished: bool, left: int
) -> IdentificationStatus:
    """The status of an identification.

    Args:
        misfit, freedom: the mean square of residuals in units of the noise, and the number of degrees of freedom.
        serial, count: correlations between successive samples, and the number of samples.
        excess, rank: the excess of the physical fit, and the number of combinations.
        finished: whether the physical fit converged to a minimum.
        left: the number of undetermined base parameters.
    """
    from scipy.stats import chi2, norm

    white = np.abs(serial) * np.sqrt(count) <= norm.isf(0.5 * _UNLIKELY / len(serial)) + rank / np.sqrt(count)
    if not finished:
        return IdentificationStatus.UNFINISHED
    if freedom > 0 and (misfit * freedom > chi2.isf(_UNLIKELY, freedom) or not white.all()):
        return IdentificationStatus.MISFIT
    if excess is not None and excess > chi2.isf(_UNLIKELY, max(rank, 1)):
        return IdentificationStatus.UNPHYSICAL
    return IdentificationStatus.UNDETERMINED if left else IdentificationStatus.IDENTIFIED
