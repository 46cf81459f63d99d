"""The result of a fit: parameters, their covariance, and undetermined combinations."""

from __future__ import annotations

import dataclasses
from math import prod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import EstimationError, InputError
from ...linear.labels import labels
from ...system.dynamics import Arrays
from ..observability import named, normalized, reduced

#: A fit is converged if a further step would increase the log-likelihood by less than this: parameters are then within
#: 0.0014 standard deviations.
_GAIN = 1e-6
#: Eigenvalues of the scaled information below it count as zero, in units of the round-off.
_UNDETERMINED = 1e5


class Combination(NamedTuple):
    """A combination $c^T theta$ of parameters that the data determine, in the units of the parameters.

    Attributes:
        name: name such as "length" or "mass + 0.5 load".
        coefficients: (p,) for all entries of free parameters, in their order.
        value, deviation: the estimate, and its standard deviation.
    """

    name: str
    coefficients: np.ndarray
    value: float
    deviation: float


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ParameterEstimate:
    """The maximum-likelihood parameters, with standard deviations $((N^-1)_ii)^(1/2)$ in their units.

    A pytree: `jax.vmap` over data adds a leading axis to its arrays.

    Attributes:
        params: the free parameters by name.
        x0: the states at the start of each experiment by name, (experiments, *shape).
        information: (p, p) Fisher's information about the parameters, with unknown initial states eliminated and
            without priors.
        prior_information: (p, p) information of the priors.
        cost: the negative log posterior density.
        squares: the sum of $e^T S^-1 e$ over all measurements; its expected value is `residuals` minus the number of
            unknowns.
        residuals: the number of entries of all measurements.
        gain: the increase of the log posterior density by another Gauss-Newton step.
        on_bound: (p,), whether the parameter is at a bound, and the data fit better with a value beyond it.
        iterations: the number of steps that were tried.
        shapes: names and shapes of the free parameters in the order of p.
    """

    params: Arrays
    x0: Arrays
    information: jax.Array
    prior_information: jax.Array
    cost: jax.Array
    squares: jax.Array
    residuals: jax.Array
    gain: jax.Array
    on_bound: jax.Array
    iterations: jax.Array
    shapes: tuple[tuple[str, tuple[int, ...]], ...] = dataclasses.field(metadata={"static": True})

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the p entries of the free parameters."""
        return labels(dict(self.shapes))

    @property
    def result(self) -> str:
        """ "successful", or the cause of the failure, determined from one simulation of each experiment with the
        estimate.

        A fit is successful if a further step would increase the log-likelihood by less than 1e-6, and all parameters
        are determined.
        """
        gain = np.max(np.asarray(self.gain))
        if not np.isfinite(np.asarray(self.cost)).all() or not np.isfinite(gain):
            return "not finite"
        if gain > self._least_gain:
            return (
                f"not converged after {int(np.max(self.iterations))} steps: another would add {gain:.2g} to the "
                "logarithm of the likelihood"
            )
        if self.cost.ndim == 0 and (names := self.undetermined):
            return f"undetermined: {', '.join(names)}"
        return "successful"

    @property
    def _least_gain(self) -> float:
        # A cost is known to its round-off only.
        return max(_GAIN, 16.0 * float(jnp.finfo(self.cost.dtype).eps) * float(np.max(np.abs(self.cost))))

    @property
    def converged(self) -> bool:
        """Whether the estimate is a maximum of the posterior density, unique or not."""
        return self.result == "successful" or self.result.startswith("undetermined")

    # ---- what the data tells -----------------------------------------------------------------------------------------

    def _eigenvalues(self, with_prior: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Of the scaled information those that count, the vectors, the scale, and which vectors count."""
        if self.cost.ndim:
            raise InputError(
                "explain, deviations and covariance expect one estimate.\n  fix: jax.tree.map(lambda a: a[0], estimate)"
            )
        N = np.asarray(self.information + self.prior_information if with_prior else self.information, float)
        size = np.sqrt(np.clip(np.diag(N), 0.0, None))
        scale = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 1.0)
        values, vectors = np.linalg.eigh(N * np.outer(scale, scale))
        return values, vectors, scale, values > _UNDETERMINED * float(jnp.finfo(self.information.dtype).eps)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """The combinations of parameters on which no measurement depends, to first order about the estimate and without
        priors.

        They keep their initial values, or those of their priors.
        """
        _, vectors, scale, counts = self._eigenvalues(False)
        return tuple(named(row, self.names) for row in reduced((vectors[:, ~counts] * scale[:, None]).T))

    @property
    def combinations(self) -> tuple[Combination, ...]:
        """The combinations that the data determine: the parameters, if all of them are determined.

        A combination $c^T theta$ has the variance $c^T N^+ c$, with N the information of data and priors.

        Source: M. Gautier, Numerical Calculation of the Base Inertial Parameters of Robots, J. of Robotic Systems 8
        (1991), for the choice of combinations.
        """
        from ...mechanics.identification.base_parameters import identifiable_combinations

        values, vectors, scale, counts = self._eigenvalues(False)
        if not counts.any():
            return ()
        root = np.sqrt(values[counts])[:, None] * vectors[:, counts].T
        base = identifiable_combinations(root, self.names)
        rows = base.combinations * scale[list(base.columns)][:, None] / scale
        theta = np.concatenate([np.ravel(self.params[name]) for name, _ in self.shapes])
        covariance = self._pseudo_inverse()
        combinations = []
        for row in map(normalized, rows):
            deviation = float(np.sqrt(row @ covariance @ row))
            combinations.append(Combination(named(row, self.names), row, float(row @ theta), deviation))
        return tuple(combinations)

    def _pseudo_inverse(self) -> np.ndarray:
        values, vectors, scale, counts = self._eigenvalues(True)
        root = vectors[:, counts] / np.sqrt(values[counts]) * scale[:, None]
        return np.asarray(root @ root.T)

    @property
    def covariance(self) -> np.ndarray:
        """The covariance (p, p) of the free parameters: the inverse of Fisher's information, including that of the
        priors.

        Raises: EstimationError if data and priors leave a combination undetermined.
        """
        _, vectors, scale, counts = self._eigenvalues(True)
        if not counts.all():
            rows = reduced((vectors[:, ~counts] * scale[:, None]).T)
            raise EstimationError(
                f"the data does not determine {', '.join(named(row, self.names) for row in rows)}, so the "
                "covariance of all parameters is not defined.\n"
                "  fix: use fit.combinations, or pass priors=..., fewer free parameters or other data"
            )
        return self._pseudo_inverse()

    def deviations(self) -> dict[str, np.ndarray]:
        """Standard deviations of the parameters by name; infinite for a parameter in an undetermined combination."""
        _, vectors, _, counts = self._eigenvalues(True)
        part = np.abs(vectors[:, ~counts]).max(axis=1, initial=0.0) > 1e-6
        root = np.where(part, np.inf, np.sqrt(np.diag(self._pseudo_inverse())))
        ends = np.cumsum([prod(shape) for _, shape in self.shapes])[:-1]
        return {name: a.reshape(shape) for (name, shape), a in zip(self.shapes, np.split(root, ends))}

    def explain(self) -> str:
        """The result, the estimates with their deviations, and the undetermined combinations, as text."""
        unknowns = sum(self._eigenvalues(False)[3]) + sum(np.size(x) for x in self.x0.values())
        lines = [
            f"result: {self.result}",
            f"squares of residuals over their covariances: {float(self.squares):.4g} for {int(self.residuals)} "
            f"residuals and at most {int(unknowns)} unknowns",
        ]
        lines += [f"  {one.name} = {one.value:.6g} +- {one.deviation:.2g}" for one in self.combinations]
        lines += [f"  not determined: {name}" for name in self.undetermined]
        lines += [f"  on a bound: {name}" for name in self.names_on_bounds]
        return "\n".join(lines)

    @property
    def names_on_bounds(self) -> tuple[str, ...]:
        """The names of the entries that lie at a bound."""
        blocked: Any = np.asarray(self.on_bound).reshape(-1, len(self.names)).any(axis=0)
        return tuple(name for name, is_held in zip(self.names, blocked) if is_held)
