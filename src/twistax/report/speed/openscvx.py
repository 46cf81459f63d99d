"""OpenSCvx's lowering of its own expressions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .case import Case, FreeBody
from .contender import Contender
from .programs import JaxTask, Lacks, Quantity, Task

__all__ = ["OpenScvx"]

#: Its coadjoint operator is right for a momentum ordered [L; p].
_SWAP = [3, 4, 5, 0, 1, 2]


class OpenScvx(Contender):
    name, colour = "OpenSCvx", "C2"
    how = "`openscvx.symbolic.lower.lower_to_jax` of its own nodes. Derivatives by JAX."
    packages = (("openscvx", "openscvx"),)

    def task(self, case: Case, quantity: Quantity) -> Task:
        if not isinstance(case, FreeBody):
            raise Lacks("its lowering writes a shared part out again at each use, so a recursion grows with each link")
        return JaxTask(case, lambda: quantity.by_jax(_free_body(case)))


def _free_body(case: FreeBody) -> Callable[..., Any]:
    import jax.numpy as jnp
    import openscvx as ox
    from openscvx.symbolic.lower import lower_to_jax

    p, q, V = ox.State("p", shape=(3,)), ox.State("q", shape=(4,)), ox.State("V", shape=(6,))
    F = ox.Control("F", shape=(6,))
    for leaf, place in ((p, slice(0, 3)), (q, slice(3, 7)), (V, slice(7, 13)), (F, slice(0, 6))):
        leaf._slice = place
    mass, moment = case.mass_moment
    x, y, z = moment
    arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R = ox.spatial.QDCM(q)
    down = R.T @ np.array([0.0, 0.0, -9.81])
    momentum = case.inertia[_SWAP] @ V
    coriolis = ox.lie.AdjointDual(V, momentum)
    wrench = ox.Concat(F[:3] + mass * down - coriolis[3:], F[3:] + arm @ down - coriolis[:3])
    rates = ox.Concat(R @ V[:3], 0.5 * ox.spatial.SSMP(V[3:]) @ q, np.linalg.inv(case.inertia) @ wrench)
    lowered = lower_to_jax(rates)
    return lambda a, b, c: [lowered(jnp.concatenate([a, b]), c, 0, {})]
