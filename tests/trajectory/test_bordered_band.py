"""The banded normal equations and the model's minimiser against dense linear algebra."""

import numpy as np
import pytest

from twistax.trajectory.model import BorderedBand, Model, NotPositiveDefinite

NODES, BLOCK = 6, 3
SIZE = NODES * BLOCK + 1


def chain(seed: int = 0) -> BorderedBand:
    free = np.random.default_rng(seed).random(SIZE) > 0.15
    free[-1] = True
    return BorderedBand(NODES, BLOCK, free)


def embedded(c: BorderedBand, rows: np.ndarray) -> np.ndarray:
    """Dense rows (intervals * rows, SIZE) from what the intervals see."""
    dense = np.zeros((*rows.shape[:2], SIZE))
    for k in range(NODES - 1):
        columns = [*range(k * BLOCK, (k + 2) * BLOCK), SIZE - 1]
        dense[k][:, columns] = rows[k]
    return dense.reshape(-1, SIZE)


def test_it_solves_the_dense_equations() -> None:
    c, rng = chain(), np.random.default_rng(1)
    slopes = rng.normal(size=(NODES - 1, 5, c.local))
    right = rng.normal(size=SIZE)
    dense = embedded(c, slopes)
    matrix = dense.T @ dense + 0.1 * np.eye(SIZE)
    expected = np.zeros(SIZE)
    expected[c.free] = np.linalg.solve(matrix[np.ix_(c.free, c.free)], right[c.free])
    found = c.solve(slopes.transpose(0, 2, 1) @ slopes, 0.1, right)
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_gather_and_scatter_are_adjoint() -> None:
    c, rng = chain(), np.random.default_rng(2)
    vector, local = rng.normal(size=SIZE), rng.normal(size=(NODES - 1, c.local))
    assert np.isclose((c.gather(vector) * local).sum(), vector @ c.scatter(local))


def test_an_indefinite_matrix_is_reported() -> None:
    c = chain()
    with pytest.raises(NotPositiveDefinite):
        c.solve(np.tile(-np.eye(c.local), (NODES - 1, 1, 1)), 0.5, np.zeros(SIZE))


@pytest.mark.parametrize("seed", range(5))
def test_the_model_is_least_where_its_gradient_vanishes(seed: int) -> None:
    c, rng = chain(seed), np.random.default_rng(seed)
    slopes = rng.normal(size=(NODES - 1, 6, c.local))
    start = rng.normal(size=(NODES - 1, 6))
    equality = np.arange(6) < 2
    pull = np.where(c.free, rng.normal(size=SIZE), 0.0)
    bends = np.tile(0.3 * np.eye(c.local), (NODES - 1, 1, 1))
    step, fall = Model(c, start, slopes, equality, pull, bends, 50.0).minimize(0.2, np.inf)

    dense, counts_always = embedded(c, slopes), np.tile(equality, NODES - 1)
    bent = sum(np.outer(row, row) for row in embedded(c, np.tile(np.sqrt(0.3) * np.eye(c.local), (NODES - 1, 1, 1))))

    def model(z: np.ndarray) -> float:
        rows = start.ravel() + dense @ z
        rows = np.where(counts_always | (rows > 0.0), rows, 0.0)
        return float(pull @ z + 0.5 * z @ bent @ z + 25.0 * rows @ rows)

    rows = start.ravel() + dense @ step
    rows = np.where(counts_always | (rows > 0.0), rows, 0.0)
    gradient = pull + bent @ step + 50.0 * dense.T @ rows + 0.2 * step
    np.testing.assert_allclose(gradient[c.free], 0.0, atol=1e-8)
    np.testing.assert_array_equal(step[~c.free], 0.0)
    assert np.isclose(fall, model(np.zeros(SIZE)) - model(step), rtol=1e-9)
    shorter, smaller_fall = Model(c, start, slopes, equality, pull, bends, 50.0).minimize(0.2, 0.01)
    assert np.abs(shorter).max() <= 0.01 + 1e-15
    assert np.isclose(smaller_fall, model(np.zeros(SIZE)) - model(shorter), rtol=1e-9)
