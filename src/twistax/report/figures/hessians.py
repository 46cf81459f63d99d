"""The Hessian of the weighted forward dynamics of a Panda compared with CasADi's: operations, and a batch compared with
C.
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import numpy as np

import twistax as tx

from ...mechanics import chain_models, forward_dynamics
from ..harness.expected import Absent, at_most, between, needed
from ..harness.measurement import Section, quick, slow
from ..harness.timing import Race, Repeats, Timed, batch, repeated
from ..speed.cases import EvaluatedFunction
from ..speed.contenders import VALUE
from ..speed.peers import CASADI

#: Points at once, and batches in a row, so that each program finds in the processor's memory what it wrote itself.
_BATCH, _ROW = 4096, 4


@functools.cache
def dynamics() -> tx.Dynamics:
    """The forward dynamics of the Panda, compiled for one thread."""
    q, qd, tau = tx.State("q", shape=(7,)), tx.State("qd", shape=(7,)), tx.Control("tau", shape=(7,))
    system = tx.System(rates={q: qd, qd: forward_dynamics(chain_models.panda(), q, qd, tau)})
    return tx.compile(system, backend=tx.Native(threads=1))


def _by_casadi(xp: Any, x: Any, u: Any, w: Any) -> list[Any]:
    ca = needed("casadi", "casadi")
    rate = dynamics().to_casadi()(t=0, q=x[:7], qd=x[7:], tau=u)["rate_qd"]
    return [ca.vec(ca.hessian(ca.dot(w, rate), ca.vertcat(x, u))[0])]


@functools.cache
def in_casadi() -> Any:
    """The Hessian as a CasADi function of states, torques and weights."""
    ca = needed("casadi", "casadi")
    symbols = [ca.SX.sym(name, size) for name, size in (("x", 14), ("u", 7), ("w", 7))]
    return ca.Function("hessian", symbols, _by_casadi(ca, *symbols))


def operations() -> tuple[int, int]:
    """How many operations the Hessian takes, ours and CasADi's."""
    ca, theirs = needed("casadi", "casadi"), in_casadi()
    dynamics().hessian_pattern("qd")
    no_operations = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST)
    count = sum(theirs.instruction_id(k) not in no_operations for k in range(theirs.n_instructions()))
    return dynamics().functions.hessians.values()[-1].program.operations, count


_CASE = EvaluatedFunction(
    "hessian",
    "Hessian of ABA, 7 links",
    *((14, 7, 7), 441, (), ()),
    lambda: dynamics().system,
    lambda x, u, w: ({"q": x[:7], "qd": x[7:]}, {"tau": u}, {"qd": w}),
    _by_casadi,
    chain_models.panda,
)


def _programs() -> dict[str, Timed]:
    if why := CASADI.absent():
        raise Absent(f"not run: {why}")

    def one(*point: Any) -> jax.Array:
        x, u, w = _CASE.inputs(*point)
        return dynamics().hessian(0.0, x, u, None, w).reshape(-1)

    programs = {"C": CASADI.task(_CASE, VALUE).batch(_BATCH), "ours": batch(one, *_CASE.points(_BATCH))}
    return {name: Timed(functools.partial(repeated, _ROW, it.call), _ROW) for name, it in programs.items()}


#: Entries are compared relative to the largest.
_RACE = Race(_programs, 1e-11, Repeats(31, 15), lambda matrices: np.asarray(matrices) / np.abs(matrices).max())
_WHAT = "Hessian of a Panda's weighted ABA"

HESSIANS: Section = [
    quick(f"{_WHAT}: operations", "dynamics.hessian", between(), lambda: operations()[0]),
    quick(f"{_WHAT}: operations", "over CasADi's", at_most(1), lambda: operations()[0] / operations()[1]),
    slow(f"{_WHAT}: batch of 4,096", "over CasADi's C", at_most(0.2), _RACE.ratio, "ours", "C"),
]
