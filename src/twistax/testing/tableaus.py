"""The order conditions of a tableau, and the order of convergence of its method.

Source: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I (1993), section II.2.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator
from typing import Any, TypeAlias

import jax
import numpy as np

from ..errors import InputError
from ..expr import Cos, Sin, Stack, State, Time
from ..groups import SO3, so3
from ..integrators import RKMK, CommutatorFree, ImplicitRKMK, Method, integrate
from ..integrators.methods.commutator_free import CommutatorFreeTableau
from ..integrators.tableaus import ButcherTableau, CollocationTableau
from ..progress import watching
from ..system import System
from ..system.dynamics import Dynamics, compile
from .laws import Check

#: A rooted tree is the sorted tuple of the trees that hang from its root.
Tree: TypeAlias = tuple[Any, ...]

_EXACT = 2e-14
#: The largest order whose conditions are checked: 286 trees have nine nodes.
_LARGEST = 9


@watching("check_tableau")
def check_tableau(tableau: ButcherTableau | CollocationTableau | CommutatorFreeTableau) -> None:
    """Check that a tableau has its declared order, by its order conditions and by an integration on a group.

    For a Runge-Kutta tableau with $c = A 1$, every rooted tree t with at most `order` nodes must satisfy $sum_i b_i
    Phi_i(t) = 1/gamma(t)$; so must the embedded solution. For a commutator-free tableau this applies to its underlying
    tableau. Orders above 9 are checked up to 9. Then the method integrates a rotating body, R' = R hat(w(t, R)) in
    rad/s, with successively halved steps, and must converge with that order, up to 0.25, while errors are above
    round-off.

    Args:
        tableau: a `ButcherTableau`, a `CollocationTableau` or a `CommutatorFreeTableau` with coefficients a (s, s).
    Raises:
        LawError: a condition does not hold, or the fitted order is too low.
        InputError: `tableau` is not a tableau.
    Source: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I (1993), section II.2.
    Example: `tx.testing.check_tableau(tx.tableaus.RK4)`.
    """
    kinds = {ButcherTableau: RKMK, CollocationTableau: ImplicitRKMK, CommutatorFreeTableau: CommutatorFree}
    method = next((make for kind, make in kinds.items() if isinstance(tableau, kind)), None)
    if method is None:
        raise InputError(f"check_tableau expects a tableau such as tx.tableaus.RK4, got {tableau!r}")
    check = Check(f"the tableau {tableau.name!r}")
    for name, b, a, order in claims(tableau):
        for size in range(1, min(order, _LARGEST) + 1):
            message = f"they are off by {{:.3g}}, where {_EXACT:g} is allowed"
            off = defect(a, b, size)
            fix = "look for a wrong digit in a or b, or say a lower order"
            check.holds(f"the conditions of order {size} of {name}", off <= _EXACT, message.format(off), fix)
    with jax.enable_x64(True):
        fitted = fitted_order(method(tableau), tableau.order)
    check.holds(
        "the order can be measured",
        np.isfinite(fitted),
        f"errors of steps for the order {tableau.order} are round-off, or not finite",
        "say the order that the tableau has: a higher one, where it is exact to round-off",
    )
    message = f"halved steps say {fitted:.2f} for {tableau.order}"
    fix = "say the order of the conditions on a group: those of a commutator-free tableau are more than of its sums"
    check.holds("the method converges with the order of the tableau", fitted > tableau.order - 0.25, message, fix)


def claims(tableau: Any) -> Iterator[tuple[str, Any, Any, int]]:
    """The solutions of a tableau: name, weights b, coefficients a, order."""
    table = getattr(tableau, "underlying", tableau)
    yield "the solution", table.b, table.a, tableau.order
    for name in ("embedded", "second_embedded"):
        b = getattr(table, f"b_{name}", None)
        if b is not None:
            yield f"b_{name}", b, table.a, getattr(table, f"{name}_order")


@functools.cache
def trees(size: int) -> tuple[Tree, ...]:
    """All rooted trees with `size` nodes."""
    return tuple(sorted({tuple(sorted(forest)) for forest in _forests(size - 1, size - 1)}, key=repr))


def _forests(size: int, largest: int) -> list[Tree]:
    """Collections of trees with `size` nodes in all, none larger than `largest`."""
    if size == 0:
        return [()]
    return [
        (tree, *rest)
        for first in range(1, min(size, largest) + 1)
        for tree in trees(first)
        for rest in _forests(size - first, first)
    ]


def _nodes(tree: Tree) -> int:
    return 1 + sum(_nodes(branch) for branch in tree)


def _density(tree: Tree) -> int:
    """gamma: the product over all nodes of the size of the subtree above it."""
    return _nodes(tree) * int(np.prod([_density(branch) for branch in tree], dtype=np.int64))


def _weight(tree: Tree, a: np.ndarray) -> np.ndarray:
    """Phi, by stage."""
    return functools.reduce(np.multiply, [a @ _weight(branch, a) for branch in tree], np.ones(len(a)))


def defect(a: np.ndarray, b: np.ndarray, order: int) -> float:
    """The largest violation of the conditions of exactly this order."""
    return float(max(abs(b @ _weight(tree, a) - 1.0 / _density(tree)) for tree in trees(order)))


@functools.cache
def _turning() -> Dynamics:
    """A rotation whose rate depends on time and attitude, so that no two steps commute."""
    R, t = State("R", group=SO3), Time()
    w = Stack(1.0 + R[0, 1], Sin(2.0 * t) - R[2, 0], 0.5 * Cos(t) + R[1, 2] * R[0, 0])
    return compile(System(rates={R: w}))


def fitted_order(method: Method, order: int) -> float:
    """The order of convergence of a method, from the last errors above round-off; NaN if there are none."""
    start = {"R": so3.exp(np.array([0.3, -0.4, 0.2]))}

    def end(steps: int) -> np.ndarray:
        return np.asarray(integrate(_turning(), start, t1=1.0, steps=steps, method=method).last["R"])

    first = max(2, round((1e-6 if order > 4 else 1e-4) ** (-1.0 / order) / 2.0))
    ends = [end(first * 2**k) for k in range(4)]
    distances = [np.linalg.norm(a - b) for a, b in itertools.pairwise(ends)]
    orders = [np.log2(a / b) for a, b in itertools.pairwise(distances) if b > 1e-13]
    return float(orders[-1]) if orders else np.nan
