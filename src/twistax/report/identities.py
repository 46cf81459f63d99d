"""The identities that tie the Lie operators together, on random cases, in both orders of six-vectors.

`python -m twistax.report.identities` prints the table.

The references are 4x4 matrices, forces that act at points, and SciPy's `expm`: no formula of the package is its own
reference, and where a pairing is checked each side is transformed by itself. An error is the largest entry of the
difference, relative to the largest entry of the reference where that is above 1.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import numpy as np
from scipy.linalg import expm

from ..expr import Expr, State, lie
from ..expr.linalg import Dot
from ..groups import ANGULAR_FIRST, LINEAR_FIRST, Order
from ..lowering import lower
from .references import (
    Values,
    bracket_matrix,
    commutator,
    conjugate,
    hat,
    join,
    mean_exponential,
    total,
    total_in_a,
)

__all__ = ["BAR", "Row", "identities", "main"]

BAR = 1e-12
"""The largest error allowed."""

_SEED = 20240607
_POINTS = 4


@dataclass(frozen=True)
class Row:
    """One line of the table: the worst case of one identity in one order."""

    identity: str
    order: Order
    cases: int
    worst: float

    @property
    def holds(self) -> bool:
        return self.worst <= BAR


@dataclass(frozen=True)
class _Identity:
    """What the package computes, and the same computed without it from the values of one case."""

    name: str
    expression: Callable[[Order], Expr]
    reference: Callable[[Order, Values], np.ndarray]


# ---- the identities -----------------------------------------------------------------------------------------------

_xi, _eta, _F = (State(name, shape=(6,)) for name in ("xi", "eta", "F"))
_T = State("T", shape=(4, 4))


def _power(order: Order) -> Expr:
    return Dot(lie.SE3AdjointDual(_T, order=order) @ _F, lie.SE3Adjoint(_T, order=order) @ _eta)


def _pairing(order: Order) -> Expr:
    return Dot(lie.AdjointDual(_xi, _F, order=order), _eta) + Dot(_F, lie.Adjoint(_xi, _eta, order=order))


_IDENTITIES = (
    _Identity(
        "ad_xi eta = (X Y - Y X)^v",
        lambda o: lie.Adjoint(_xi, _eta, order=o),
        lambda o, z: commutator(o, z["xi"], z["eta"]),
    ),
    _Identity("<ad*_xi F, eta> + <F, ad_xi eta> = 0", _pairing, lambda o, z: np.zeros(())),
    _Identity(
        "Ad_T eta = (T Y T^-1)^v",
        lambda o: lie.SE3Adjoint(_T, order=o) @ _eta,
        lambda o, z: conjugate(o, z["T"], z["eta"]),
    ),
    _Identity(
        "Ad*_T F: forces at points, moved",
        lambda o: lie.SE3AdjointDual(_T, order=o) @ _F,
        lambda o, z: total_in_a(o, z["T"], z["points"], z["forces"]),
    ),
    _Identity("<Ad*_T F, Ad_T eta> = <F, eta>", _power, lambda o, z: np.asarray(z["F"] @ z["eta"])),
    _Identity("Exp xi = expm(X)", lambda o: lie.SE3Exp(_xi, order=o), lambda o, z: expm(hat(z["xi"], o))),
    _Identity("Log expm(X) = xi", lambda o: lie.SE3Log(_T, order=o), lambda o, z: z["log"]),
    _Identity(
        "Ad_Exp(xi) = expm(ad_xi)",
        lambda o: lie.SE3Adjoint(lie.SE3Exp(_xi, order=o), order=o),
        lambda o, z: expm(bracket_matrix(o, z["xi"])),
    ),
    _Identity(
        "Ad*_Exp(xi) = expm(-ad_xi^T)",
        lambda o: lie.SE3AdjointDual(lie.SE3Exp(_xi, order=o), order=o),
        lambda o, z: expm(-bracket_matrix(o, z["xi"]).T),
    ),
    _Identity(
        "J_l = integral of expm(s ad)",
        lambda o: lie.LeftJacobian(_xi, order=o),
        lambda o, z: mean_exponential(bracket_matrix(o, z["xi"])),
    ),
    _Identity(
        "J_r = integral of expm(-s ad)",
        lambda o: lie.RightJacobian(_xi, order=o),
        lambda o, z: mean_exponential(-bracket_matrix(o, z["xi"])),
    ),
    _Identity(
        "J_l^-1",
        lambda o: lie.LeftJacobianInverse(_xi, order=o),
        lambda o, z: np.linalg.inv(mean_exponential(bracket_matrix(o, z["xi"]))),
    ),
    _Identity(
        "J_r^-1",
        lambda o: lie.RightJacobianInverse(_xi, order=o),
        lambda o, z: np.linalg.inv(mean_exponential(-bracket_matrix(o, z["xi"]))),
    ),
)


def _cases(order: Order, cases: int) -> list[dict[str, np.ndarray]]:
    """Random values; the rotation of every twist is below a half turn, so that Log has one answer."""
    rng = np.random.default_rng(_SEED)
    found = []
    for _ in range(cases):
        axes = rng.normal(size=(2, 3))
        turns = axes / np.linalg.norm(axes, axis=1)[:, None] * rng.uniform(0.0, 3.1, size=(2, 1))
        xi, log = (join(v, w, order) for v, w in zip(2.0 * rng.normal(size=(2, 3)), turns, strict=True))
        points, forces = rng.normal(size=(2, _POINTS, 3))
        wrench = total(points, forces, order)
        eta, T = rng.normal(size=6), expm(hat(log, order))
        found.append({"xi": xi, "log": log, "T": T, "eta": eta, "F": wrench, "points": points, "forces": forces})
    return found


def identities(cases: int = 200) -> list[Row]:
    """The worst case of every identity in both orders, of the simplified expressions.

    Needs JAX's x64 switch; the command line turns it on.

    Raises:
        RuntimeError: x64 is off.
    """
    if jax.numpy.zeros(()).dtype != np.float64:
        raise RuntimeError("identities are measured in float64; fix: jax.config.update('jax_enable_x64', True) before")
    rows = []
    for order in (LINEAR_FIRST, ANGULAR_FIRST):
        values = _cases(order, cases)
        x = {leaf.name: np.stack([z[leaf.name] for z in values]) for leaf in (_xi, _eta, _F, _T)}
        function = lower([identity.expression(order).canonicalize() for identity in _IDENTITIES])
        computed = jax.jit(jax.vmap(partial(function, 0.0)))(x)
        for identity, results in zip(_IDENTITIES, computed, strict=True):
            worst = 0.0
            for z, got in zip(values, np.asarray(results), strict=True):
                exact = identity.reference(order, z)
                worst = max(worst, float(np.max(np.abs(got - exact))) / max(1.0, float(np.max(np.abs(exact)))))
            rows.append(Row(identity.name, order, cases, worst))
    return rows


def main() -> int:
    """Prints the table; exit status 1 if a figure is above the bar."""
    jax.config.update("jax_enable_x64", True)
    rows = identities()
    print(f"worst error of {rows[0].cases} random cases, relative to the reference where that is above 1; bar {BAR:g}")
    print(f"{'identity':<40}{'order':<16}{'worst':>9}")
    for row in rows:
        print(f"{row.identity:<40}{row.order!r:<16}{row.worst:>9.1e}{'' if row.holds else '  ABOVE THE BAR'}")
    return 0 if all(row.holds for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
