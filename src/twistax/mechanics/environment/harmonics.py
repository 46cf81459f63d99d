"""Gravity of a planet as a series of spherical harmonics, and of the Earth to degree and order 8 of EGM2008."""

from __future__ import annotations

import dataclasses
import json
import math
from functools import cached_property
from pathlib import Path

import jax.numpy as jnp
from jax import Array

from ...checks import listed, number, short, whole
from ...errors import ModelError
from ...expr import Expr
from ...expr.fields import ExprLike, Operand, positive
from ...expr.kinds.rules import FixedUnits
from ...expr.kinds.unit import METRE, SECOND
from ..arguments import of_shape

__all__ = ["EGM2008", "HarmonicPull", "Harmonics"]


@dataclasses.dataclass(frozen=True)
class Harmonics:
    """Gravity as the gradient of the potential $U = GM/r sum_nm (R/r)^n P_nm(sin(phi)) (C_nm cos(m lambda) + S_nm sin(m
    lambda))$.

    Here phi and lambda are the geocentric latitude and the longitude, P_nm the fully normalised associated Legendre
    functions, and C_00 = 1. Coefficients that are not in `terms` are zero.

    Attributes:
        gm: gravitational constant times mass, m3/s2.
        radius: the reference radius R, m.
        terms: (n, m, C_nm, S_nm), fully normalised: degree, order, cosine, sine.
    Raises: ModelError if gm or radius is not positive, an order is above its degree, a degree is not from 2 to 40, a
        coefficient is not finite, or a term occurs twice.
    """

    gm: float
    radius: float
    terms: tuple[tuple[int, int, float, float], ...]

    def __post_init__(self) -> None:
        positive(self, "gm", self.gm)
        positive(self, "radius", self.radius)
        if not isinstance(self.terms, (list, tuple)):
            raise ModelError(
                f"Harmonics expects terms (degree, order, cosine, sine) in a tuple, got {short(self.terms)}"
            )
        for term in self.terms:
            if not isinstance(term, (list, tuple)) or len(term) != 4:
                raise ModelError(f"Harmonics expects terms (degree, order, cosine, sine), got {short(term)}")
            n, m, *coefficients = term
            whole("Harmonics: a degree", n, 2, ModelError)
            whole("Harmonics: an order", m, 0, ModelError)
            if m > n or n > 40:
                raise ModelError(f"Harmonics expects orders up to the degree and degrees up to 40, got {(n, m)}")
            for value in coefficients:
                number(f"Harmonics: a coefficient of {(n, m)}", value, error=ModelError)
        object.__setattr__(self, "terms", tuple(map(tuple, self.terms)))
        if len({term[:2] for term in self.terms}) != len(self.terms):
            raise ModelError(f"Harmonics expects each degree and order once, got {listed(t[:2] for t in self.terms)}")

    @property
    def axisymmetric(self) -> bool:
        """Whether there are zonal terms only."""
        return all(m == 0 for _, m, *_ in self.terms)

    @cached_property
    def degree(self) -> int:
        """The largest degree."""
        return max((n for n, *_ in self.terms), default=0)

    def up_to(self, degree: int, order: int | None = None) -> Harmonics:
        """A model with the terms up to a degree and an order; up_to(2, 0) is the point mass with J2.

        Raises: ModelError for a degree above that of this model.
        """
        if whole("up_to: degree", degree, 0, ModelError) > self.degree:
            raise ModelError(
                f"up_to expects a degree up to {self.degree}, the degree of this model, got {short(degree)}"
            )
        most = degree if order is None else whole("up_to: order", order, 0, ModelError)
        return dataclasses.replace(self, terms=tuple(t for t in self.terms if t[0] <= degree and t[1] <= most))

    def acceleration(self, position: ExprLike) -> Expr:
        """The gradient of U (3,), m/s2, at a planet-fixed position (3,) from the centre in m. Raises ShapeError for a
        position of another shape.
        """
        return HarmonicPull(of_shape("acceleration", "position", position, (3,)), self)


class HarmonicPull(Expr):
    """The gradient of the potential of `Harmonics`. Shapes: (3,) -> (3,), m -> m/s2.

    Computed by the recursions of V_nm and W_nm, which are $(R/r)^(n+1) P_nm$ times the cosine and sine and have no
    singularity at the poles. P_nm is fully normalised, because otherwise single precision overflows at degree 30. Each
    term takes some 20 operations.

    Attributes:
        position: planet-fixed position from the centre, m.
        model: the coefficients.
    Raises: ShapeError if position is not of shape (3,).
    Source: Cunningham, On the computation of the spherical harmonic terms needed during the numerical integration of
    the orbital motion of an artificial satellite, Celestial Mechanics 2 (1970); Montenbruck and Gill, Satellite Orbits,
    eqs. (3.29) to (3.33).
    """

    position: Operand
    model: Harmonics
    takes, gives = ((3,),), (3,)
    kinds = FixedUnits((METRE,), METRE / SECOND**2, one_frame=True)
    cases = (
        {
            "position": [0.9, -0.7, 0.6],
            "model": Harmonics(2.0, 0.8, ((2, 0, -0.02, 0.0), (2, 2, 0.01, -0.03), (3, 1, 0.02, 0.01))),
        },
    )

    def evaluate(self, *values: Array) -> Array:
        model, (x, y, z) = self.model, values[0]
        inverse = 1.0 / (x * x + y * y + z * z)
        ratio = model.radius * inverse
        V: dict[tuple[int, int], Array] = {(0, 0): model.radius * jnp.sqrt(inverse)}
        W: dict[tuple[int, int], Array] = {(0, 0): jnp.zeros_like(x)}
        square = model.radius * ratio
        most = max((m for _, m, *_ in model.terms), default=0) + 1
        for m in range(most + 1):
            if m:
                before = V[m - 1, m - 1], W[m - 1, m - 1]
                step = (2 * m - 1) * _plain(m, m) / _plain(m - 1, m - 1)
                V[m, m] = step * ratio * (x * before[0] - y * before[1])
                W[m, m] = step * ratio * (x * before[1] + y * before[0])
            for n in range(m + 1, model.degree + 2):
                step = (2 * n - 1) / (n - m) * _plain(n, m) / _plain(n - 1, m)
                for of in (V, W):
                    of[n, m] = step * z * ratio * of[n - 1, m]
                    if n > m + 1:
                        back = (n + m - 1) / (n - m) * _plain(n, m) / _plain(n - 2, m)
                        of[n, m] = of[n, m] - back * square * of[n - 2, m]
        total = [jnp.zeros_like(x)] * 3
        for n, m, cosine, sine in ((0, 0, 1.0, 0.0), *model.terms):
            for i, part in enumerate(_parts(n, m, cosine, sine, V, W)):
                total[i] = total[i] + part
        return model.gm / model.radius**2 * jnp.stack(total)


def _plain(n: int, m: int) -> float:
    """The conversion factor from a fully normalised coefficient to an unnormalised one."""
    return math.sqrt((1 if m == 0 else 2) * (2 * n + 1) * math.factorial(n - m) / math.factorial(n + m))


def _parts(
    n: int, m: int, C: float, S: float, V: dict[tuple[int, int], Array], W: dict[tuple[int, int], Array]
) -> tuple[Array, Array, Array]:
    """The x, y and z components of a term, in GM / R^2."""
    level, up = (_plain(n, m) / _plain(n + 1, order) for order in (m, m + 1))
    z = -(n - m + 1) * level * (C * V[n + 1, m] + S * W[n + 1, m])
    if m == 0:
        return -up * C * V[n + 1, 1], -up * C * W[n + 1, 1], z
    up_v, up_w, low_v, low_w = V[n + 1, m + 1], W[n + 1, m + 1], V[n + 1, m - 1], W[n + 1, m - 1]
    low = (n - m + 2) * (n - m + 1) * _plain(n, m) / _plain(n + 1, m - 1)
    x = 0.5 * (low * (C * low_v + S * low_w) - up * (C * up_v + S * up_w))
    y = 0.5 * (low * (S * low_v - C * low_w) + up * (S * up_v - C * up_w))
    return x, y, z


def _read(file: str) -> Harmonics:
    data = json.loads(Path(__file__).with_name(file).read_text())
    return Harmonics(data["gm"], data["radius"], tuple(tuple(row) for row in data["rows"]))


#: The Earth to degree and order 8, without tides.
#: Source: Pavlis, Holmes, Kenyon and Factor, An Earth gravitational model to degree 2160: EGM2008 (2008); the numbers
#: are those of NGA.STND.0036, World Geodetic System 1984 (2014), table 5.1.
EGM2008 = _read("egm2008.json")
