"""A million steps."""

from __future__ import annotations

from collections.abc import Callable

import twistax as tx

from ...integrators import Method
from ...scenes import heavy_top
from ..checks import Check, Expected, Place, Section, at_most
from ..figures.keeping import Motion, changes, constant_twist, free_body, top
from ..rows import plain

__all__ = ["LONG_RUNS"]

_FEW, _MANY = (1_000, 10_000), (100_000, 1_000_000)
_RK4, _DOP853 = tx.RKMK(tx.tableaus.RK4), tx.RKMK(tx.tableaus.DOP853)
_SPLITTING = tx.Splitting(tx.compositions.KAHAN_LI8, tx.FreeBody("R", "w", inertia=heavy_top.INERTIA))
_BY = {_RK4: "RK4", _DOP853: "DOP853", _SPLITTING: "Kahan-Li 8 splitting"}
_TIGHT = at_most(1e-14)


def _checks(
    motion: Callable[[], Motion], name: str, method: Method, dt: float, bars: tuple[Expected, Expected], slow: bool
) -> list[Check]:
    """Changes after each number of steps; the bars are for up to 1e4 and up to 1e6 of them."""

    def check(counts: tuple[int, ...], i: int, bar: Expected) -> Check:
        what = f"{name}, {motion.__name__.replace('_', ' ').replace('top', 'heavy top')}"
        return Check(
            f"{what}, {plain(float(counts[i]))} steps",
            _BY[method],
            lambda: changes(motion(), method, dt, counts)[name].absolute[i],
            bar,
            slow=slow or counts is _MANY,
            place=Place(f"{what}, {_BY[method]}", float(counts[i])),
        )

    return [check(counts, i, bar) for counts, bar in zip((_FEW, _MANY), bars, strict=True) for i in range(2)]


LONG_RUNS = Section(
    "long",
    "A million steps",
    "A free body with an offset centre of mass in steps of 10 ms, and the heavy top, in steps of 1 ms with RK4 and of "
    "10 ms with the others. Norms of changes since the start: J, N s, N m s.",
    {
        "A quaternion put back to length one in every step cannot drift, even where every step rounds alike.": _checks(
            constant_twist, "R'R - I", _RK4, 1e-2, (_TIGHT, _TIGHT), slow=True
        ),
        "A method without structure loses energy in every step: the drift is linear, and that of its order.": _checks(
            free_body, "energy", _RK4, 1e-2, (at_most(5e-7, "J"), at_most(5e-5, "J")), slow=True
        ),
        "The same for momentum, which lives in the body's axes here.": _checks(
            free_body, "linear momentum", _RK4, 1e-2, (at_most(1e-5, "N s"), at_most(1e-3, "N s")), slow=True
        ),
        "Short steps lose little, in every one of them.": _checks(
            top, "energy", _RK4, 1e-3, (at_most(1e-11, "J"), at_most(1e-9, "J")), slow=False
        ),
        "At order eight the drift of a million steps is near round-off.": _checks(
            top, "energy", _DOP853, 1e-2, (at_most(5e-13, "J"), at_most(5e-11, "J")), slow=False
        ),
        "A symplectic method has no drift of its own; what grows is round-off, some 1e-16 J a step.": _checks(
            top, "energy", _SPLITTING, 1e-2, (at_most(2e-11, "J"), at_most(2e-9, "J")), slow=True
        ),
        "Momenta are stored in world axes: what no torque changes stays to the last bit or two.": _checks(
            top, "vertical momentum", _SPLITTING, 1e-2, (at_most(1e-14, "N m s"), at_most(1e-14, "N m s")), slow=True
        ),
        "The group is kept as by every method here.": _checks(
            top, "R'R - I", _SPLITTING, 1e-2, (_TIGHT, _TIGHT), slow=True
        ),
    },
    axes=("steps", "change since the start"),
)
