"""Tables: linear, bilinear and cubic, against SciPy."""

from random import Random
from typing import Any

import numpy as np
import scipy.interpolate
from plans import Plan, maker
from term import Shape

_KNOTS, _LINES = [-1.0, 0.25, 1.0, 3.0], [-2.0, 0.0, 1.5]
_TABLE = (np.arange(12.0).reshape(4, 3) ** 1.5 % 5.0).round(2).tolist()


def _cubic(method: str) -> Any:
    kind = {"cubic": scipy.interpolate.CubicSpline, "pchip": scipy.interpolate.PchipInterpolator}[method]
    return kind(_KNOTS, np.array(_TABLE)[:, 0])


def _bilinear(x: Any, y: Any) -> Any:
    points = np.stack(np.broadcast_arrays(np.clip(x, -1.0, 3.0), np.clip(y, -2.0, 1.5)), axis=-1)
    return scipy.interpolate.RegularGridInterpolator((_KNOTS, _LINES), _TABLE)(points).reshape(points.shape[:-1])


@maker
def table(source: Random, shape: Shape) -> Plan | None:
    found = [
        Plan(f"tx.Linterp({{0}}, {_KNOTS}, np.array({_TABLE})[:, 1])",
             lambda a: np.interp(a, _KNOTS, np.array(_TABLE)[:, 1]), (shape,)),
        Plan(f"tx.Bilerp({{0}}, {{1}}, {_KNOTS}, {_LINES}, {_TABLE})", _bilinear, (shape, ())),
        *(
            Plan(f'tx.Cinterp(tx.Tanh({{0}}), {_KNOTS}, np.array({_TABLE})[:, 0], "{method}")',
                 lambda a, method=method: _cubic(method)(np.tanh(a)), (shape,))
            for method in ("cubic", "pchip")
        ),
    ]  # fmt: skip
    if shape and shape[-1] == 3:
        found.append(
            Plan(
                f"tx.Linterp({{0}}, {_KNOTS}, {_TABLE})",
                lambda a: np.stack([np.interp(a, _KNOTS, column) for column in np.transpose(_TABLE)], axis=-1),
                (shape[:-1],),
            )
        )
    return source.choice(found)
