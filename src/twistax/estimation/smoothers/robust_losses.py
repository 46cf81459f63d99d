"""Robust losses: losses of residuals that give outliers less weight than squares."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping

import jax
import jax.numpy as jnp

from ...checks import listed, number
from ...errors import ModelError


class RobustLoss(ABC):
    """A loss rho(s) of the normalised residual squared $s = r^T R^-1 r$, with rho(s) = s near zero.

    Raises: nothing.
    """

    @abstractmethod
    def cost(self, s: jax.Array) -> jax.Array:
        """rho(s)."""

    @abstractmethod
    def weight(self, s: jax.Array) -> jax.Array:
        """The derivative $rho'(s)$, by which the information of the measurement is multiplied."""


def checked_losses(losses: Mapping[str, RobustLoss] | None, measurements: Iterable[str]) -> dict[str, RobustLoss]:
    """Losses by measurement. Raises ModelError for an object of another type, or an unknown measurement."""
    checked, known = dict(losses or {}), list(measurements)
    for name, loss in checked.items():
        if name not in known:
            raise ModelError(f"losses names {name!r}, but the measurements are {listed(known, name)}")
        if not isinstance(loss, RobustLoss):
            raise ModelError(f"losses[{name!r}] expects a RobustLoss such as HuberLoss(), got {loss!r}")
    return checked


def _check(loss: RobustLoss, width: float) -> None:
    number(f"{type(loss).__name__}: width", width, "a positive number", lambda w: w > 0.0, ModelError)


@dataclasses.dataclass(frozen=True)
class HuberLoss(RobustLoss):
    """The Huber loss: rho(s) = s up to a residual of w standard deviations, and $2 w s^(1/2) - w^2$ beyond, linear in
    the residual.

    Attributes:
        width: w, in standard deviations.
    Raises: ModelError for a width that is not positive.

    Source: Huber, Robust estimation of a location parameter, Ann. Math. Statist. 35 (1964).
    """

    width: float = 1.345

    def __post_init__(self) -> None:
        _check(self, self.width)

    def cost(self, s: jax.Array) -> jax.Array:
        return jnp.where(s <= self.width**2, s, 2.0 * self.width * jnp.sqrt(self._outside(s)) - self.width**2)

    def weight(self, s: jax.Array) -> jax.Array:
        return jnp.where(s <= self.width**2, jnp.ones_like(s), self.width / jnp.sqrt(self._outside(s)))

    def _outside(self, s: jax.Array) -> jax.Array:
        return jnp.maximum(s, self.width**2)


@dataclasses.dataclass(frozen=True)
class CauchyLoss(RobustLoss):
    """The Cauchy (Lorentzian) loss $rho(s) = w^2 log(1 + s / w^2)$: large outliers have almost no weight.

    Attributes:
        width: w, in standard deviations.
    Raises: ModelError for a width that is not positive.

    Source: Black, Anandan, The robust estimation of multiple motions, CVIU 63 (1996), for the Lorentzian.
    """

    width: float = 2.385

    def __post_init__(self) -> None:
        _check(self, self.width)

    def cost(self, s: jax.Array) -> jax.Array:
        return self.width**2 * jnp.log1p(s / self.width**2)

    def weight(self, s: jax.Array) -> jax.Array:
        return 1.0 / (1.0 + s / self.width**2)
