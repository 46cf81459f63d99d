"""White noise as a leaf: zero in compiled systems, random for estimators."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from ..checks import reals, short
from ..errors import ModelError, ShapeError
from .graph import leaves_of
from .kinds.kinds import Kind
from .leaves import Constant, Control, Inputs, Leaf, Parameter, shape_of
from .node import Expr, Shape, to_expr


class Noise(Leaf):
    """White noise with zero mean, for rates and measurements. A compiled system sets it to zero.

    In rates it is continuous in time: $E[w(t) w(s)^T] = S S^T delta(t - s)$, S the density. A random walk is a state
    whose rate is a Noise. In a measurement with a sampling time T it adds the covariance $S S^T / T$.

    Args:
        name: unique among the leaves of a system.
        shape: shape of the value; () by default.
        density: amplitude spectral density in the unit of the value per sqrt(Hz): a number, one for each entry, or a
            matrix (n, n) for n entries. Numbers, a Parameter, or an expression of parameters.
        kind: of the value, such as `tx.FreeVector("body")`, which a system checks.
        unit: of the value, such as "m/s2", which a system checks.
    Raises:
        ModelError: a density that is negative, not finite, or depends on states or controls; an invalid kind or unit.
        ShapeError: a density of another shape.

    Example: `tx.Noise("gyro", shape=(3,), density=1e-4)`, in rad/s per sqrt(Hz).

    Source: Maybeck, Stochastic Models, Estimation, and Control, vol. 1 (1979), ch. 4.
    """

    density: Expr
    cases = ((lambda cls, w: cls("w", shape=(2,), density=0.1), {"w": [0.3, -1.0]}),)

    def __init__(
        self, name: str, shape: Shape | int = (), *, density: Any, kind: Kind | None = None, unit: Any = None
    ) -> None:
        shape = shape_of(name, shape)
        place = f"Noise {name!r}: density"
        expr = density if isinstance(density, Expr) else to_expr(reals(place, density, ModelError))
        n = int(np.prod(shape))
        allowed = [(), shape, (n,), (n, n)]
        if expr.shape not in allowed:
            raise ShapeError(f"{place} expects a number, shape {shape} or {(n, n)}, got {expr.shape}")
        for leaf in leaves_of(expr):
            if not isinstance(leaf, (Constant, Parameter)):
                raise ModelError(f"{place} expects numbers or parameters, got {short(leaf)}")
        value = expr.value if isinstance(expr, (Constant, Parameter)) else None
        if value is not None and not np.isfinite(value).all():
            raise ModelError(f"{place} expects finite numbers, got {short(value)}")
        if value is not None and expr.shape != (n, n) and (value < 0.0).any():
            raise ModelError(f"{place} expects numbers that are not negative, got {short(value)}")
        self._declare(name, shape, density=expr, kind=kind, unit=unit)

    def static_key(self) -> tuple[Any, ...]:
        return (self.name, self.shape, self.density.key())

    def as_control(self) -> Control:
        """A control that replaces the noise, for derivatives with respect to it."""
        return Control(self.name, self.shape)

    def read(self, inputs: Inputs) -> jax.Array:
        return jax.numpy.zeros(self.shape, inputs.dtype)
