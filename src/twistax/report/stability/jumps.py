"""Controls that jump."""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...groups import se3
from ..checks import Check, Section, at_most, simulated

__all__ = ["JUMPS"]

_DOP853, _TSIT5 = tx.RKMK(tx.tableaus.DOP853), tx.RKMK(tx.tableaus.TSIT5)
#: A twist that is held between jumps: times, s, and twists.
_TIMES = np.array([0.0, 0.3, 0.7, 0.7 + 1e-9, 1.6])
_TWISTS = np.array(
    [
        [1.0, 0.0, 0.0, 0.3, 2.0, 0.0],
        [0.0, -3.0, 0.0, -1.0, 0.0, 0.5],
        [1e6, 0.0, 0.0, 0.0, 0.0, 1e6],
        [0.5, 0.5, 0.5, 0.0, 0.0, -2.0],
        [0.0, 0.0, 1.0, 1.0, 1.0, 1.0],
    ]
)
_END = 2.0


@functools.cache
def _driven(group: Any) -> tx.Dynamics:
    """A pose that follows a twist, or a first-order lag that follows a command."""
    x, F = tx.State("x", group=group) if group else tx.State("x"), tx.Control("F", shape=(6,) if group else ())
    return tx.compile(tx.System(rates={x: F if group else F - x}))


def _poses(**options: Any) -> tuple[float, tx.Solution]:
    """The largest error of the pose, and the solution: the truth is a product of exponentials."""
    table = tx.ZeroOrderHold(ts=_TIMES, values=_TWISTS)
    sol = simulated(_driven(tx.SE3), {"x": np.eye(4)}, t1=_END, u={"F": table}, **options)
    truth = np.eye(4)
    for twist, length in zip(_TWISTS, np.diff([*_TIMES, _END]), strict=True):
        truth = truth @ np.asarray(se3.exp(jnp.asarray(length * twist)))
    return float(np.max(np.abs(np.asarray(sol.xs["x"][-1]) - truth))), sol


def _switch(t: Any) -> dict[str, Any]:
    return {"F": jnp.where(t < 0.4, 1.0, -1.0)}


def _switched(u: Any, **options: Any) -> float:
    """The error at 1 s of x' = F - x from 0 for the switch at 0.4 s."""
    sol = simulated(_driven(None), {"x": 0.0}, t1=1.0, u=u, **options)
    return abs(float(sol.xs["x"][-1]) - float((2.0 - np.exp(-0.4)) * np.exp(0.4 - 1.0) - 1.0))


_TABLE = {"F": tx.ZeroOrderHold(ts=[0.0, 0.4], values=[1.0, -1.0])}
_AT_ENDS = {"F": tx.ZeroOrderHold(ts=[0.0, 0.4, 1.0], values=[1.0, -1.0, 1e9])}

JUMPS = Section(
    "jumps",
    "Controls that jump",
    "A pose whose twist is held between jumps, one of them a kick of 1e6 for 1e-9 s: the truth is a product of "
    "exponentials. A first-order lag whose command switches at 0.4 s.",
    {
        "Steps end at every row of a table, also where two are 1e-9 s apart.": [
            Check("five twists, rtol 1e-9", "DOP853", lambda: _poses(rtol=1e-9, method=_DOP853)[0], at_most(1e-13)),
        ],
        "Nothing has to be found out by steps that fail.": [
            Check(
                "the same: steps taken back",
                "DOP853",
                lambda: _poses(rtol=1e-9, method=_DOP853)[1].stats.rejected,
                at_most(0.0, "steps"),
            ),
        ],
        "A step ends at the switch.": [
            Check("a table, rtol 1e-10", "Tsit5", lambda: _switched(_TABLE, rtol=1e-10, method=_TSIT5), at_most(1e-10)),
        ],
        "A function's jumps are not seen from outside; named, they are ends of steps.": [
            Check(
                "a function that switches at 0.4 s, named with jumps, rtol 1e-10",
                "Tsit5",
                lambda: _switched(_switch, rtol=1e-10, method=_TSIT5, jumps=[0.4]),
                at_most(1e-10),
            ),
        ],
        "The error control finds the jump, at many steps taken back, and to its tolerance only.": [
            Check("the same, not named", "Tsit5", lambda: _switched(_switch, rtol=1e-10, method=_TSIT5), at_most(1e-7)),
        ],
        "Where the switch falls between two equal steps, the order is kept.": [
            Check("a table, on the edge of a step of 0.1 s", "RK4", lambda: _switched(_TABLE, dt=0.1), at_most(1e-6)),
        ],
        "Equal steps do not see a switch inside of them: the order is lost.": [
            Check("a table, inside of a step of 1/6 s", "RK4", lambda: _switched(_TABLE, dt=1.0 / 6.0), at_most(0.3)),
        ],
        "What is commanded from the end on does not reach back.": [
            Check(
                "a table with a jump at the start and at the end, rtol 1e-10",
                "Tsit5",
                lambda: _switched(_AT_ENDS, rtol=1e-10, method=_TSIT5),
                at_most(1e-10),
            ),
        ],
    },
)
