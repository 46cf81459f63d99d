"""The methods of the report: each with a name, the settings it is run with, and its run of a scene as a program."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

import twistax as tx

from ...integrators import Method
from ...lowering.small_call import fits, small_call
from ...scenes import Scene
from ..timing import Repeats

# ---- settings -------------------------------------------------------------------------------------------------------


def tolerances(coarsest: int, finest: int, per_decade: int) -> tuple[float, ...]:
    """Evenly spaced in decades; the ends are exponents of ten."""
    count = (coarsest - finest) * per_decade + 1
    # Three digits, so that a setting reads the same in every table.
    return tuple(float(f"{10.0 ** (coarsest - i / per_decade):.2e}") for i in range(count))


def equal_steps(first: int, factor: float, most: int = 2**21) -> tuple[float, ...]:
    """Each number of steps is `factor` times the one before."""
    settings = [float(first)]
    while (more := float(round(settings[-1] * factor))) <= most:
        settings.append(more)
    return tuple(settings)


@dataclasses.dataclass(frozen=True)
class Effort:
    """Settings to run, from coarse to fine, and how often each run is repeated.

    Attributes:
        name: for the page.
        tolerances: rtol = atol, of methods that choose their steps.
        longest: a method is not run finer once one of its runs takes longer, s.
        repeats: of every run of a scene, in turn.
        steps: numbers of them, of methods with equal steps, until the error is below `enough`.
    """

    name: str
    tolerances: tuple[float, ...]
    longest: float
    repeats: Repeats
    steps: tuple[float, ...] = equal_steps(32, 4.0)
    enough: float = 1e-10


FULL = Effort("full", tolerances(-3, -13, 2), 0.5, Repeats(31, 5, 0.2))
QUICK = Effort("quick", tolerances(-4, -12, 1), 0.1, Repeats(9, 3, 0.05))

# ---- contenders -----------------------------------------------------------------------------------------------------


class Counts(NamedTuple):
    """What a run did, numbers or arrays of shape (): steps, evaluations, and whether it reached the end."""

    accepted: Any
    rejected: Any
    evaluations: Any
    good: Any


class Program(NamedTuple):
    """One scene by one method, as a function of the start and the setting.

    Attributes:
        start: a pytree of arrays.
        solve: (start, setting) -> (end, Counts), traceable.
        state: the end as the scene names its states; not timed.
    """

    start: Any
    solve: Callable[[Any, Any], tuple[Any, Counts]]
    state: Callable[[Any], Any]


@dataclasses.dataclass(frozen=True)
class Side:
    """Who runs a method, how, and whether that can be had by calling what a library offers."""

    name: str
    what: str
    ready: bool = True


@dataclasses.dataclass(frozen=True)
class Line:
    """One line in the figures. Several contenders may share one: its best points count.

    Attributes:
        title: how tables call it.
        code: how a program writes it.
        side: who runs it.
        style: colour, dash and marker, as matplotlib names them.
        drawn: whether it is drawn, or is in the tables alone.
    """

    title: str
    code: str
    side: Side
    style: tuple[str, str, str]
    drawn: bool = True


@dataclasses.dataclass(frozen=True, eq=False)
class Contender:
    """A method. A new one is one more in `CONTENDERS`.

    Attributes:
        name: on the command line.
        line: of the figures.
        build: its run of a scene. Raises TwistaxError where it cannot do it.
        equal: whether the setting is a number of equal steps, for each of which it is compiled, or rtol = atol.
    """

    name: str
    line: Line
    build: Callable[[Scene], Program]
    equal: bool = False


#: More steps than any run here takes; diffrax's own limit is 4096.
_MOST_STEPS = 10**7


def ours(name: str, line: Line, method: Method, equal: bool = False) -> Contender:
    """`tx.integrate` as a function of one flat array, as diffrax has it: each array in or out costs a microsecond."""

    def build(scene: Scene) -> Program:
        method.check(scene.dynamics)
        start, read = ravel_pytree({name: jnp.asarray(value) for name, value in scene.start.items()})
        given: dict[str, Any] = {"u": scene.u, "params": scene.params, "method": method, "throw": False}

        def solve(start: jax.Array, setting: Any) -> tuple[jax.Array, Counts]:
            chosen = {"rtol": setting, "atol": setting, "control": tx.StepControl(max_steps=_MOST_STEPS)}
            steps = {"steps": int(setting)} if equal else chosen
            sol = tx.integrate(scene.dynamics, read(start), t1=scene.duration, **given, **steps)
            stats, good = sol.stats, sol.result == tx.Result.SUCCESS
            counts = map(jnp.asarray, (stats.accepted, stats.rejected, stats.rhs_evaluations, good))
            return ravel_pytree({name: value[0] for name, value in sol.xs.items()})[0], Counts(*counts)

        return Program(start, solve, read)

    return Contender(name, line, build, equal)


def _diffrax(
    name: str, line: Line, solver: str, gains: tuple[float, float], most_steps: int = _MOST_STEPS
) -> Contender:
    """diffrax on the same system in quaternions: PIDController, the first step chosen by it, rtol = atol = the setting.

    The state is one flat vector, which diffrax runs faster than a dict. In one call the whole solve is compiled as one
    small function, as our own integrations are: without diffrax's error check, a callback, which does not compile that
    way, and with ForwardMode, the cheapest way to plain numbers.

    Args:
        solver: name of its class in diffrax; a first-same-as-last Runge-Kutta method, or an implicit one.
        gains: of the controller, pcoeff and icoeff.
    """

    def build(scene: Scene) -> Program:
        import diffrax

        term = tx.diffrax.ambient_term(scene.dynamics)
        start, unravel = ravel_pytree(term.to_ambient(scene.start))
        u, params = scene.u, {name: jnp.asarray(value) for name, value in scene.params.items()}
        one_call = {"throw": False, "adjoint": diffrax.ForwardMode()} if line.side == ONE_CALL else {}
        method = getattr(diffrax, solver)()

        def rate(t: Any, y: jax.Array, args: Any) -> jax.Array:
            return ravel_pytree(term.vector_field(t, unravel(y), (u, params)))[0]

        if not fits(lambda y: rate(jnp.zeros(()), y, None), start):
            raise tx.ModelError(f"the right-hand side of {scene.name} calls a library: no small call")

        def solve(y: jax.Array, tolerance: jax.Array) -> tuple[Any, Counts]:
            control = diffrax.PIDController(tolerance, tolerance, pcoeff=gains[0], icoeff=gains[1])
            options: dict[str, Any] = {"stepsize_controller": control, "max_steps": most_steps} | one_call
            sol = diffrax.diffeqsolve(diffrax.ODETerm(rate), method, 0.0, scene.duration, None, y, **options)
            accepted, rejected = sol.stats["num_accepted_steps"], sol.stats["num_rejected_steps"]
            # The last stage of a step is the first of the next; the choice of the first step is left out.
            evaluations = (method.tableau.num_stages - 1) * (accepted + rejected) + 1
            if isinstance(method, diffrax.AbstractImplicitSolver):
                evaluations = jnp.zeros_like(accepted)  # it does not say
            return sol.ys[0], Counts(accepted, rejected, evaluations, jnp.isfinite(sol.ys[0]).all())

        def in_one_call(start: Any, tolerance: Any) -> tuple[Any, Counts]:
            # diffrax's loops are built on operations of equinox, all of which compile inside of one function.
            return small_call(solve, start, tolerance, trusted=True)

        return Program(start, in_one_call if one_call else solve, lambda y: term.from_ambient(unravel(y)))

    return Contender(name, line, build)


# ---- all of them ----------------------------------------------------------------------------------------------------

OURS = Side("twistax", "`tx.integrate` with its defaults")
ONE_CALL = Side(
    "diffrax in one call",
    "the same compiled as one small function, as twistax compiles its own; diffrax itself does not offer that",
    ready=False,
)
SHIPPED = Side("diffrax as shipped", "`diffeqsolve` on the quaternions with its defaults, inside `jax.jit`")

#: Ours: name, title, how a program writes it, style, whether it is drawn.
_OURS = (
    ("rk4", "RK4, equal steps", "tx.RKMK(tx.tableaus.RK4)", "gray - s", True),
    ("cf4", "CF4, equal steps", "tx.CommutatorFree()", "gray -- s", False),
    ("magnus6", "Magnus 6, equal steps", "tx.Magnus(6)", "gray : s", False),
    ("bs3", "Bogacki-Shampine 3", "tx.RKMK(tx.tableaus.BOGACKI_SHAMPINE3)", "olive - v", False),
    ("dopri5", "Dormand-Prince 5", "tx.RKMK(tx.tableaus.DORMAND_PRINCE5)", "pink - <", False),
    ("tsit5", "Tsit5", "tx.RKMK(tx.tableaus.TSIT5)", "cyan - o", True),
    ("tsit5-quaternion", "Tsit5, quaternion", "tx.RKMK(tx.tableaus.TSIT5, tx.charts.Ambient())", "cyan -- o", True),
    ("dop853", "DOP853", "tx.RKMK(tx.tableaus.DOP853)", "blue - D", True),
    (
        "dop853-closed",
        "DOP853, closed form",
        "tx.RKMK(tx.tableaus.DOP853, tx.charts.Exponential())",
        "purple - P",
        False,
    ),
    ("dop853-split", "DOP853, split", "tx.RKMK(tx.tableaus.DOP853, tx.charts.SplitExponential(6))", "green - ^", True),
    ("dop853-quaternion", "DOP853, quaternion", "tx.RKMK(tx.tableaus.DOP853, tx.charts.Ambient())", "blue -- D", True),
    ("dopri8", "Dormand-Prince 8", "tx.RKMK(tx.tableaus.DORMAND_PRINCE8)", "brown - >", False),
    ("radau5", "Radau IIA 5", "tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)", "blue - X", True),
    (
        *("radau5-quaternion", "Radau IIA 5, quaternion"),
        *("tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5, tx.charts.Ambient())", "blue -- X", True),
    ),
)


def _all() -> list[Contender]:
    found = []
    for name, title, code, style, drawn in _OURS:
        colour, dash, marker = style.split()
        line = Line(title, code, OURS, (f"tab:{colour}", dash, marker), drawn)
        # What the page shows is what is run.
        found.append(ours(name, line, eval(code, {"tx": tx}), "equal steps" in title))
    # diffrax's default, and proportional-integral control, which rejects fewer steps on some scenes.
    default, pi = (0.0, 1.0), (0.4, 0.3)
    looks = {"Tsit5": ("tab:orange", "o"), "Dopri5": ("goldenrod", "<"), "Dopri8": ("tab:red", "D")}
    for side, suffix, dash in ((ONE_CALL, "-call", "-"), (SHIPPED, "", ":")):
        for solver, (colour, marker) in looks.items():
            title = side.name.replace("diffrax", f"diffrax {solver}")
            line = Line(title, f"diffrax.{solver}()", side, (colour, dash, marker), drawn=solver != "Dopri5")
            name = f"diffrax-{solver.lower()}{suffix}"
            # Two controllers on one line: the better counts.
            found += [_diffrax(name, line, solver, default), _diffrax(f"{name}-pi", line, solver, pi)]
    # Its default controller is no match for stiff systems, and its linear algebra calls a library: no small call. Near
    # round-off its steps may become so short that a run takes hours.
    stiff = Line("diffrax Kvaerno5 as shipped", "diffrax.Kvaerno5()", SHIPPED, ("tab:red", ":", "X"))
    return [*found, _diffrax("diffrax-kvaerno5-pi", stiff, "Kvaerno5", pi, most_steps=20_000)]


#: All of them, by name.
CONTENDERS: dict[str, Contender] = {contender.name: contender for contender in _all()}
