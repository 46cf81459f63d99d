"""Observability: the Gramian along a run, its rank, and the unobservable combinations of the state."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np


@dataclasses.dataclass(frozen=True)
class Observability:
    """The observability Gramian at the start of a run, $W = sum_k Phi_k0^T H_k^T R_k^-1 H_k Phi_k0$.

    Its entries have different units, so rank and condition number are those of the Gramian scaled to a unit diagonal.

    Attributes:
        gramian: (n, n).
        rank: the number of observable combinations of the initial state.
        condition: the condition number of the scaled Gramian: its largest eigenvalue over the smallest nonzero one.
        unobservable: names of the unobservable combinations, such as "r[2]" or "b + 0.5 c"; there are n - rank of them.
    """

    gramian: np.ndarray
    rank: int
    condition: float
    unobservable: tuple[str, ...]

    def __str__(self) -> str:
        n = len(self.gramian)
        text = f"observability: rank {self.rank} of {n}, condition {self.condition:.1e}"
        return "\n".join([text, *(f"  not observable: {name}" for name in self.unobservable)])


def observability(
    transitions: np.ndarray, information: np.ndarray, labels: Sequence[str], tolerance: float
) -> Observability:
    """The Gramian from the transition matrices and the information matrices of the measurements at the times of a run.

    Args:
        transitions, information: (k, n, n) transition matrices, each from the previous time; (k, n, n) $H^T R^-1 H$.
        labels: the name of each entry of a tangent.
        tolerance: eigenvalues of the scaled Gramian below this value, relative to the largest, count as zero.

    Source: Maybeck, Stochastic Models, Estimation, and Control, vol. 1 (1979), sec. 1.8.
    """
    n = len(labels)
    gramian, product = np.zeros((n, n)), np.eye(n)
    for transition, part in zip(transitions, information):
        product = transition @ product
        gramian += product.T @ part @ product
    size = np.sqrt(np.diag(gramian))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(gramian / np.outer(scale, scale))
    count = values > tolerance * max(float(values[-1]), np.finfo(float).tiny)
    rank = int(count.sum())
    condition = float(values[-1] / values[count][0]) if rank else np.inf
    # A null vector of the scaled Gramian is one of the Gramian in other units: v = scaled / scale.
    null = vectors[:, ~count] / scale[:, None]
    return Observability(gramian, rank, condition, tuple(named(row, labels) for row in reduced(null.T)))


def reduced(rows: np.ndarray) -> np.ndarray:
    """A basis of the same space that is sparse by elimination; the largest entry of each row is 1."""
    rows = rows / np.abs(rows).max(axis=1, initial=0.0, keepdims=True)
    for used in range(len(rows)):
        column = int(np.argmax(np.abs(rows[used:]).max(axis=0)))
        pivot = used + int(np.argmax(np.abs(rows[used:, column])))
        rows[[used, pivot]] = rows[[pivot, used]]
        rows[used] /= rows[used, column]
        rest = np.arange(len(rows)) != used
        rows[rest] -= np.outer(rows[rest, column], rows[used])
    return rows


def named(row: np.ndarray, labels: Sequence[str]) -> str:
    """A combination as text, with 1 as its largest coefficient; coefficients below 1e-6 are omitted."""
    terms = []
    for value, label in zip(normalized(row), labels):
        if abs(value) > 1e-6:
            factor = "" if abs(abs(value) - 1.0) < 5e-4 else f"{abs(value):.3g} "
            terms.append(f"{'-' if value < 0.0 else '+'} {factor}{label}")
    return " ".join(terms).removeprefix("+ ")


def normalized(row: np.ndarray) -> np.ndarray:
    """A combination scaled to a largest coefficient of 1; of equal coefficients the first one is chosen, regardless of
    round-off.
    """
    return np.asarray(row / row[np.argmax(np.abs(row) > (1.0 - 1e-6) * np.abs(row).max())])
