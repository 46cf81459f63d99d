"""The methods of the report."""

from __future__ import annotations

import twistax as tx

from .contender import Contender, Line, Side
from .own import Adaptive, FixedSteps
from .rivals import I_CONTROL, PI_CONTROL, AsShipped, Diffrax, OneSmallCall

__all__ = ["CONTENDERS", "IN_QUICK", "ONE_CALL", "OURS", "SHIPPED"]

OURS = Side("twistax", "`tx.integrate` with its defaults")
ONE_CALL = Side(
    "diffrax in one call",
    "diffrax on quaternions, compiled as one small function, which twistax does with its own flights",
    ready=False,
)
SHIPPED = Side("diffrax as shipped", "diffrax on quaternions with its defaults, inside `jax.jit`")


def _ours(title: str, code: str, style: str, drawn: bool = True) -> Line:
    colour, dash, marker = style.split(" ")
    return Line(title, f"tx.RKMK({code})", OURS, (f"tab:{colour}", dash, marker), drawn)


def _own() -> list[Contender]:
    T, charts = tx.tableaus, tx.charts
    rk4 = _ours("RK4, equal steps", "tx.tableaus.RK4", "gray - s")
    bs3 = _ours("Bogacki-Shampine 3", "tx.tableaus.BOGACKI_SHAMPINE3", "olive - v", drawn=False)
    dopri5 = _ours("Dormand-Prince 5", "tx.tableaus.DORMAND_PRINCE5", "pink - <", drawn=False)
    tsit5 = _ours("Tsit5", "tx.tableaus.TSIT5", "cyan - o")
    tsit5_quaternion = _ours("Tsit5, quaternion", "tx.tableaus.TSIT5, tx.charts.Ambient()", "cyan -- o")
    dop853 = _ours("DOP853", "tx.tableaus.DOP853", "blue - D")
    closed = _ours("DOP853, closed form", "tx.tableaus.DOP853, tx.charts.Exponential()", "purple - P", drawn=False)
    split = _ours("DOP853, split", "tx.tableaus.DOP853, tx.charts.SplitExponential(6)", "green - ^")
    quaternion = _ours("DOP853, quaternion", "tx.tableaus.DOP853, tx.charts.Ambient()", "blue -- D")
    dopri8 = _ours("Dormand-Prince 8", "tx.tableaus.DORMAND_PRINCE8", "brown - >", drawn=False)
    return [
        FixedSteps("rk4", rk4, tx.RKMK(T.RK4)),
        Adaptive("bs3", bs3, tx.RKMK(T.BOGACKI_SHAMPINE3)),
        Adaptive("dopri5", dopri5, tx.RKMK(T.DORMAND_PRINCE5)),
        Adaptive("tsit5", tsit5, tx.RKMK(T.TSIT5)),
        Adaptive("tsit5-quaternion", tsit5_quaternion, tx.RKMK(T.TSIT5, charts.Ambient())),
        Adaptive("dop853", dop853, tx.RKMK(T.DOP853)),
        Adaptive("dop853-closed", closed, tx.RKMK(T.DOP853, charts.Exponential())),
        Adaptive("dop853-split", split, tx.RKMK(T.DOP853, charts.SplitExponential(6))),
        Adaptive("dop853-quaternion", quaternion, tx.RKMK(T.DOP853, charts.Ambient())),
        Adaptive("dopri8", dopri8, tx.RKMK(T.DORMAND_PRINCE8)),
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
    return found


#: All of them, by name.
CONTENDERS: dict[str, Contender] = {contender.name: contender for contender in [*_own(), *_rivals()]}

#: Those of the quick run.
IN_QUICK = ("tsit5", "dop853", "dop853-quaternion", "diffrax-tsit5-call", "diffrax-dopri8-call-pi", "diffrax-tsit5")
