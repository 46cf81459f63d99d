"""The recursions in plain matrices, with which ours are compared: against each other and ours."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx
from twistax.report.speed.case import CASES
from twistax.report.speed.peers.algebra import Algebra


class Numpy(Algebra):
    def constant(self, value: Any) -> Any:
        return np.asarray(value, float)

    def sin(self, x: Any) -> Any:
        return np.sin(x)

    def cos(self, x: Any) -> Any:
        return np.cos(x)

    def matrix(self, rows: Sequence[Sequence[Any]]) -> Any:
        return np.array(rows)

    def block(self, rows: Sequence[Sequence[Any]]) -> Any:
        return np.block([list(row) for row in rows])

    def vector(self, entries: Sequence[Any]) -> Any:
        return np.array(entries)

    def joined(self, parts: Sequence[Any]) -> Any:
        return np.concatenate(parts)

    def dot(self, a: Any, b: Any) -> Any:
        return a @ b

    def outer(self, a: Any, b: Any) -> Any:
        return np.outer(a, b)


def by_hand(name: str, *arguments: Any) -> Any:
    return np.concatenate(CASES[name].by_hand(Numpy(), *arguments))


def test_forces_and_accelerations_are_inverse_to_each_other() -> None:
    q, qd, tau = (points[0] for points in CASES["aba-7"].points(1))
    accelerations = by_hand("aba-7", q, qd, tau)
    assert np.allclose(by_hand("rnea-7", q, qd, accelerations), tau, rtol=0.0, atol=1e-10)


def test_they_agree_with_ours() -> None:
    for name in ("free-body", "rnea-7"):
        case = CASES[name]
        dynamics = tx.compile(case.system(), backend=tx.XLA())
        # A quaternion of another length too: else derivatives by its entries would differ.
        point = [jnp.asarray(1.3 * points[0]) for points in case.points(1)]
        rates = jax.jit(lambda *point, case=case, dynamics=dynamics: dynamics(0.0, *case.inputs(*point)))(*point)
        ours = np.concatenate([rates[name] for name in case.rates])
        assert np.max(np.abs(by_hand(name, *map(np.asarray, point)) - ours)) < 1e-13 * np.max(np.abs(ours))
