"""Quaternions as a browser has them."""

import numpy as np
from scipy.spatial.transform import Rotation

from twistax.view.stage import quaternions


def test_quaternions_are_scalar_first() -> None:
    turns = Rotation.from_rotvec(np.random.default_rng(0).normal(size=(20, 3)))
    product = np.sum(quaternions(turns.as_matrix())[:, [1, 2, 3, 0]] * turns.as_quat(), axis=1)
    np.testing.assert_allclose(np.abs(product), 1.0, atol=1e-12)
