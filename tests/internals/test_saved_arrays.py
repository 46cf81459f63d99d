"""Arrays of saved systems."""

import io
from pathlib import Path

import numpy as np

from twistax.system.export import saved


def test_arrays_by_columns_and_empty_ones_come_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for array in (np.asfortranarray(rng.normal(size=(3, 2))), np.zeros((0, 3)), np.array(2.0), np.arange(6)[::2]):
        file = io.BytesIO()
        np.save(file, array)
        np.testing.assert_array_equal(saved._array(file.getvalue()), array)
