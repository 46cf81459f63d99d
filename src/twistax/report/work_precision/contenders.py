"""The methods of the report."""

from __future__ import annotations

from collections.abc import Iterable

import twistax as tx

from .contender import Contender, Line, Side
from .own import Adaptive, EqualSteps
from .rivals import I_CONTROL, PI_CONTROL, AsShipped, Diffrax, DiffraxImplicit, OneSmallCall

__all__ = ["CONTENDERS", "IN_QUICK", "LONG", "ONE_CALL", "OURS", "SHIPPED", "STIFF", "TOO_LONG_FOR_QUICK", "suited"]

OURS = Side("twistax", "`tx.integrate` with its defaults")
ONE_CALL = Side(
    "diffrax in one call",
    "the same compiled as one small function, as twistax compiles its own; diffrax itself does not offer that",
    ready=False,
)
SHIPPED = Side("diffrax as shipped", "`diffeqsolve` on the quaternions with its defaults, inside `jax.jit`")


def _ours(title: str, code: str, style: str, drawn: bool = True) -> Line:
    colour, dash, marker = style.split(" ")
    return Line(title, code, OURS, (f"tab:{colour}", dash, marker), drawn)


def _rkmk(title: str, tableau: str, style: str, chart: str = "", drawn: bool = True) -> Line:
    return _ours(title, f"tx.RKMK(tx.tableaus.{tableau}{chart and f', tx.charts.{chart}'})", style, drawn)


def _own() -> list[Contender]:
    T, C = tx.tableaus, tx.charts
    rk4 = _rkmk("RK4, equal steps", "RK4", "gray - s")
    cf4 = _ours("CF4, equal steps", "tx.CommutatorFree()", "gray -- s", drawn=False)
    magnus = _ours("Magnus 6, equal steps", "tx.Magnus(6)", "gray : s", drawn=False)
    bs3 = _rkmk("Bogacki-Shampine 3", "BOGACKI_SHAMPINE3", "olive - v", drawn=False)
    dopri5 = _rkmk("Dormand-Prince 5", "DORMAND_PRINCE5", "pink - <", drawn=False)
    tsit5 = _rkmk("Tsit5", "TSIT5", "cyan - o")
    tsit5_quaternion = _rkmk("Tsit5, quaternion", "TSIT5", "cyan -- o", "Ambient()")
    dop853 = _rkmk("DOP853", "DOP853", "blue - D")
    closed = _rkmk("DOP853, closed form", "DOP853", "purple - P", "Exponential()", drawn=False)
    split = _rkmk("DOP853, split", "DOP853", "green - ^", "SplitExponential(6)")
    quaternion = _rkmk("DOP853, quaternion", "DOP853", "blue -- D", "Ambient()")
    radau5 = _ours("Radau IIA 5", "tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)", "blue - X")
    radau5_quaternion = _ours(
        "Radau IIA 5, quaternion", "tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5, tx.charts.Ambient())", "blue -- X"
    )
    dopri8 = _rkmk("Dormand-Prince 8", "DORMAND_PRINCE8", "brown - >", drawn=False)
    return [
        EqualSteps("rk4", rk4, tx.RKMK(T.RK4)),
        EqualSteps("cf4", cf4, tx.CommutatorFree()),
        EqualSteps("magnus6", magnus, tx.Magnus(6)),
        Adaptive("bs3", bs3, tx.RKMK(T.BOGACKI_SHAMPINE3)),
        Adaptive("dopri5", dopri5, tx.RKMK(T.DORMAND_PRINCE5)),
        Adaptive("tsit5", tsit5, tx.RKMK(T.TSIT5)),
        Adaptive("tsit5-quaternion", tsit5_quaternion, tx.RKMK(T.TSIT5, C.Ambient())),
        Adaptive("dop853", dop853, tx.RKMK(T.DOP853)),
        Adaptive("dop853-closed", closed, tx.RKMK(T.DOP853, C.Exponential())),
        Adaptive("dop853-split", split, tx.RKMK(T.DOP853, C.SplitExponential(6))),
        Adaptive("dop853-quaternion", quaternion, tx.RKMK(T.DOP853, C.Ambient())),
        Adaptive("dopri8", dopri8, tx.RKMK(T.DORMAND_PRINCE8)),
        Adaptive("radau5", radau5, tx.ImplicitRKMK(T.RADAU_IIA5)),
        Adaptive("radau5-quaternion", radau5_quaternion, tx.ImplicitRKMK(T.RADAU_IIA5, C.Ambient())),
    ]


def _rivals() -> list[Contender]:
    found: list[Contender] = []
    looks = {"Tsit5": ("tab:orange", "o"), "Dopri5": ("goldenrod", "<"), "Dopri8": ("tab:red", "D")}
    for form, side, suffix, dash in ((OneSmallCall(), ONE_CALL, "-call", "-"), (AsShipped(), SHIPPED, "", ":")):
        for solver, (colour, marker) in looks.items():
            title = side.name.replace("diffrax", f"diffrax {solver}")
            line = Line(title, f"diffrax.{solver}()", side, (colour, dash, marker), drawn=solver != "Dopri5")
            name = f"diffrax-{solver.lower()}{suffix}"
            # Two controllers on one line: the better counts.
            found.append(Diffrax(name, line, solver, I_CONTROL, form))
            found.append(Diffrax(f"{name}-pi", line, solver, PI_CONTROL, form))
    # Its default controller is no match for stiff systems, and its linear algebra calls a library: no small call.
    stiff = Line("diffrax Kvaerno5 as shipped", "diffrax.Kvaerno5()", SHIPPED, ("tab:red", ":", "X"))
    found.append(DiffraxImplicit("diffrax-kvaerno5-pi", stiff, "Kvaerno5", PI_CONTROL, AsShipped()))
    return found


#: All of them, by name.
CONTENDERS: dict[str, Contender] = {contender.name: contender for contender in [*_own(), *_rivals()]}

#: Scenes with a part so fast that it has died out: for implicit methods alone, as explicit ones cannot take a step.
STIFF = ("stiff-attitude", "actuator-lag", "stiff-joint")
_IMPLICIT = ("radau5", "radau5-quaternion", "diffrax-kvaerno5-pi")

#: Scenes so long that a run takes up to seconds: for a few methods of high order.
LONG = ("long-heavy-top", "spinning-satellite")
_HIGH_ORDER = ("dop853", "dop853-quaternion", "dopri8", "diffrax-dopri8-call-pi", "diffrax-dopri8-pi")

#: Those of the quick run.
_QUICK = ("tsit5", "dop853", "dop853-quaternion", "diffrax-tsit5-call", "diffrax-dopri8-call-pi", "diffrax-tsit5")
IN_QUICK = (*_QUICK, "radau5", "diffrax-kvaerno5-pi")

#: Scenes of the full run only: they take long to compile or to run.
TOO_LONG_FOR_QUICK = ("spring-bodies", "actuator-lag", "stiff-joint", *LONG)


def suited(contenders: Iterable[str], scene: str) -> list[str]:
    """Which of the methods, by name, are worth running a scene with, where nobody asked for others."""
    if scene in STIFF:
        return [name for name in contenders if name in _IMPLICIT]
    if scene in LONG:
        return [name for name in contenders if name in _HIGH_ORDER]
    return [name for name in contenders if name not in _IMPLICIT]
