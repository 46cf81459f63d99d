"""Base parameters: the combinations of parameters that motions determine, by the rank of a stacked regressor."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import name_list, number, reals, whole
from ...errors import ModelError
from ...progress import watching
from ..algorithms.dynamics import checked
from ..kinematic_tree import KinematicTree
from .determined import ZERO
from .stacked_regressor import StackedRegressor


@dataclasses.dataclass(frozen=True)
class BaseParameters:
    """The combinations of parameters that a regressor determines, $beta = C theta$. Made by
    `base_parameters` and `identifiable_combinations`.

    Attributes:
        names: names of the combinations, such as "link1.Izz + link2.Iyy".
        combinations: C (r, p), in the units of the parameters; r is the rank. Its columns `columns` form the identity
            matrix.
        columns: indices of r independent columns of the regressor: $Y theta = Y[:, columns] beta$.
        without_effect: names of parameters that no force depends on.
    """

    names: tuple[str, ...]
    combinations: NDArray[np.float64]
    columns: tuple[int, ...]
    without_effect: tuple[str, ...]

    @property
    def rank(self) -> int:
        """The number r of combinations."""
        return len(self.columns)


def identifiable_combinations(W: Any, names: Sequence[str], tolerance: float = 1e-8) -> BaseParameters:
    """The combinations of parameters that measurements with the stacked regressor W (N, p) determine.

    Columns are processed in order. A column depends on the previous ones if its distance from their span is below
    `tolerance` times its length. Then $W_d = W_b K$ for dependent columns d and independent columns b, and $beta =
    theta_b + K theta_d$, in the units of the parameters.

    Source: M. Gautier, Numerical Calculation of the Base Inertial Parameters of Robots, J. of Robotic Systems 8 (1991).

    Args:
        W: stacked regressors of all samples, from real motions or random ones.
        names: names of the p parameters.
        tolerance: (), between 0 and 1; for measured motions, choose it as large as their noise.
    Raises: ModelError for a W of another shape, or entries that are not finite.
    """
    owner = "identifiable_combinations"
    names = name_list(f"{owner}: names", names, ModelError)
    matrix = reals(f"{owner}: W", W, ModelError).astype(np.float64)
    if matrix.ndim != 2 or matrix.shape[1] != len(names) or not np.isfinite(matrix).all():
        raise ModelError(
            f"{owner} expects W with finite entries and a column for each of {len(names)} names, got {matrix.shape}"
        )
    number(f"{owner}: tolerance", tolerance, "a number between 0 and 1", lambda x: 0.0 < x < 1.0, ModelError)
    lengths = np.linalg.norm(matrix, axis=0)
    floor = tolerance * lengths.max(initial=0.0)
    basis, columns = np.zeros((matrix.shape[0], 0)), list[int]()
    for j in np.flatnonzero(lengths > floor):
        rest = matrix[:, j]
        for _ in range(2):  # the second pass removes the round-off of the first
            rest = rest - basis @ (basis.T @ rest)
        if np.linalg.norm(rest) > tolerance * lengths[j]:
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
            columns.append(int(j))
    C = np.zeros((0, len(names)))
    if columns:
        C = np.asarray(np.linalg.lstsq(matrix[:, columns], matrix, rcond=None)[0], dtype=np.float64)
    C[:, lengths <= floor] = 0.0
    C[:, columns] = np.eye(len(columns))
    C[np.abs(C) < ZERO] = 0.0
    without = tuple(names[int(j)] for j in np.flatnonzero(lengths <= floor))
    return BaseParameters(tuple(sum_of(row, names) for row in C), C, tuple(columns), without)


def sum_of(row: NDArray[np.float64], names: Sequence[str]) -> str:
    """The text of a combination."""
    words = list[str]()
    for coefficient, name in zip(row, names, strict=True):
        if coefficient:
            size = "" if abs(abs(coefficient) - 1.0) < ZERO else f"{abs(coefficient):.4g} "
            sign = ("-" if coefficient < 0.0 else "") if not words else (" - " if coefficient < 0.0 else " + ")
            words.append(f"{sign}{size}{name}")
    return "".join(words)


@watching("identify")
def base_parameters(
    mechanism: KinematicTree, *, drives: Collection[str] | None = None, samples: int | None = None, seed: int = 0
) -> BaseParameters:
    """The combinations of inertial parameters that joint forces determine, for arbitrary motions of the mechanism.

    They are those of `identifiable_combinations`, $beta = C theta$, for the regressor at random positions, velocities
    and accelerations. Units are those of `Regressor`.

    Source: M. Gautier, Numerical Calculation of the Base Inertial Parameters of Robots, J. of Robotic Systems 8 (1991).

    Args:
        mechanism: a tree or a chain, with numbers, or Parameters with default values, for axes and mounts.
        drives: as in `inverse_dynamics_regressor`.
        samples: the number of random states, at least one; by default there are three times as many equations as
            parameters.
        seed: seed of the random states.
    Raises: ModelError as for `inverse_dynamics_regressor`.

    Example:
        `base_parameters(tx.mechanics.chain_models.panda()).rank` is 43.
    """
    whole("base_parameters: seed", seed, 0, ModelError)
    checked("base_parameters", mechanism)
    if not mechanism.dofs:
        raise ModelError("base_parameters expects a mechanism with a joint that moves, got none")
    kinds = None if drives is None else name_list("base_parameters: drives", drives, ModelError)
    stacked = StackedRegressor.of(mechanism, kinds)
    count = None if samples is None else whole("base_parameters: samples", samples, 1, ModelError)
    return identifiable_combinations(stacked.random_matrix({}, count, seed), stacked.names)
