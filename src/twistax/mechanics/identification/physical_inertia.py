"""Inertias that are physical for all values of ten parameters: the log-Cholesky form of the pseudo-inertia.

The pseudo-inertia of a body is the integral of $r r^T$ over its mass, with $r = [x, y, z, 1]$. It is positive definite
if and only if the body has a positive mass that does not lie in a single plane. With an upper triangular factor

    J = U U^T,  U = e^a [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]]

the mass is e^(2a), the centre of mass is t, and $e^(2a) S S^T$ is the second moment about it, with S the upper left
block. So every vector of the ten parameters describes a body, and every body that is not flat has exactly one vector.

Source: C. Rucker, P. Wensing, Smooth Parameterization of Rigid-Body Inertia, IEEE Robotics and Automation Letters 7
(2022), equations 8 to 10.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...checks import short
from ...errors import ModelError
from ...expr import Concat, Constant, Exp, Expr, Stack
from ...expr.fields import ExprLike
from ..arguments import known_value, of_kind, of_shape
from ..bodies import SpatialInertia

_ZERO = Constant(0.0)
#: Second moments below this fraction of the largest one are round-off of the inertia.
_ROUND_OFF = 8.0 * np.finfo(float).eps


def physical_inertia(parameters: ExprLike) -> SpatialInertia:
    """A body from ten parameters $[a, d1, d2, d3, s12, s23, s13, t1, t2, t3]$, physical for all their values.

    The mass is $m = e^(2 a)$ kg, and the centre of mass is t, m. With S the upper triangular matrix that has the
    diagonal $e^d$ and the entries s,

        $Sigma = m S S^T, I_c = tr(Sigma) 1 - Sigma$.

    If the ten parameters are a `Parameter`, any optimiser can fit them without constraints; `log_cholesky` returns
    initial values.

    Source: C. Rucker, P. Wensing, Smooth Parameterization of Rigid-Body Inertia (2022), equations 8 to 10.

    Args:
        parameters: (10,), any finite numbers.
    Raises: ShapeError if they are not of shape (10,); ModelError for numbers that are not finite.
    Example: `arm.with_inertia({"tool": physical_inertia(tx.Parameter("tool_inertia", shape=(10,)))})`.
    """
    x = of_shape("physical_inertia", "parameters", parameters, (10,))
    if isinstance(x, Constant) and not np.isfinite(x.value).all():
        raise ModelError(f"physical_inertia expects finite parameters, got {short(parameters)}")
    mass = Exp(2.0 * x[0])
    S = Stack(Concat(Exp(x[1]), x[4], x[6]), Concat(_ZERO, Exp(x[2]), x[5]), Concat(_ZERO, _ZERO, Exp(x[3])))
    second: Expr = mass * (S @ S.T)
    trace = second[0, 0] + second[1, 1] + second[2, 2]
    return SpatialInertia(mass=mass, center_of_mass=x[7:], inertia=trace * np.eye(3) - second)


def log_cholesky(body: SpatialInertia) -> NDArray[np.float64]:
    """The ten parameters (10,) of a body, the inverse of `physical_inertia`.

    With S the upper triangular Cholesky factor of the second moment about the centre of mass, per kg:

        $S S^T = (tr(I_c) 1 / 2 - I_c) / m, a = log(m) / 2, d = log(diag S)$.

    Source: C. Rucker, P. Wensing, Smooth Parameterization of Rigid-Body Inertia (2022), equations 8 to 10.

    Args:
        body: a body whose mass, centre of mass and inertia are numbers, or Parameters with values.
    Raises: ModelError for an object of another type; a body that is flat, a line or a point; or a body that is not
    physical.
    Example: `log_cholesky(arm.link("tool").body)`.
    """
    of_kind("log_cholesky", "body", body, SpatialInertia)
    mass, center, tensor = (_number(name, getattr(body, name)) for name in ("mass", "center_of_mass", "inertia"))
    second = 0.5 * np.trace(tensor) * np.eye(3) - tensor
    moments = np.linalg.eigvalsh(second)
    if not (mass > 0.0 and moments[0] > _ROUND_OFF * moments[2]):
        raise ModelError(
            "log_cholesky expects a body that is not flat: each principal moment must be below the sum of "
            f"the other two, got {float(mass)} kg and {np.linalg.eigvalsh(tensor).tolist()} kg m2.\n"
            "  fix: give it a thickness"
        )
    flip = np.eye(3)[::-1]
    S = flip @ np.linalg.cholesky(flip @ (second / mass) @ flip) @ flip
    logs = [0.5 * np.log(mass), *np.log(np.diag(S))]
    return np.array([*logs, S[0, 1], S[1, 2], S[0, 2], *center])


def _number(name: str, value: ExprLike) -> NDArray[np.float64]:
    known = known_value(value)
    if known is None:
        raise ModelError(f"log_cholesky expects numbers as {name}, got {short(value)}")
    return known
