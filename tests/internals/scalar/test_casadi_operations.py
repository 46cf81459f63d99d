"""Every scalar operation as CasADi has it."""

from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.scalar.primitives.entry import convert
from twistax.scalar.primitives.table import OPERATIONS
from twistax.system.export.casadi_function import expression


@pytest.fixture
def casadi() -> Any:
    return pytest.importorskip("casadi", reason="casadi is not installed (extra twistax[casadi])")


def test_operations(casadi: Any) -> None:
    """Those that CasADi has not by one name, and branches, tables and conversions."""
    points = np.array([[0.3, -0.7, 0.2], [-2.5, 1.5, 3.0], [4.0, 2.0, -1.0], [1.0, 1.0, 1.0]])
    real, truth, whole = np.dtype(float), np.dtype(bool), np.dtype("int64")
    symbols = [casadi.SX.sym(n) for n in "abc"]
    rows, expected = [], []
    with np.errstate(all="ignore"):
        for operation in OPERATIONS.values():
            n = operation.arity
            bits = operation.name in ("and", "or", "xor", "not")
            given = [s > 0.5 for s in symbols[:n]] if bits else list(symbols[:n])
            values = [p > 0.5 for p in points.T[:n]] if bits else list(points.T[:n])
            if operation.name == "select":
                given[0], values[0] = given[0] > 0.5, values[0] > 0.5
            rows.append(expression(casadi, operation, truth if bits else real, *given))
            expected.append(np.asarray(operation.number(*values)).astype(float))
    rows.append(expression(casadi, convert(whole), real, symbols[0]))
    expected.append(np.trunc(points[:, 0]))
    rows.append(expression(casadi, OPERATIONS["div"], whole, casadi.SX(-7), casadi.SX(2)))
    expected.append(np.full(4, -3.0))
    found = casadi.Function("f", symbols, [casadi.vertcat(*rows)])
    names = [o.name for o in OPERATIONS.values()] + ["whole", "divided"]
    for k, row in enumerate(points):
        for name, own, other in zip(names, np.array(found(*row)).reshape(-1), expected, strict=True):
            np.testing.assert_allclose(own, other[k], rtol=1e-14, atol=1e-15, err_msg=f"{name} at {row}")
    with pytest.raises(tx.ModelError, match="CasADi does not have the operation and for int64"):
        expression(casadi, OPERATIONS["and"], whole, *symbols[:2])
