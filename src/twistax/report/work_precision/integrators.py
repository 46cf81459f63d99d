"""The integrators of the report: each builds a program for a scene; the programs of a scene are timed in turn."""

import dataclasses
import functools
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

import twistax as tx

from ...integrators import Method
from ...scalar.small_call import fits, small_call
from ...scenes import Scene
from ..harness.rows import ReportRow, first_line, now
from ..harness.store import Store
from ..harness.timing import ProgressCallback, Repeats, Timed, keep, quiet, seconds_of


def tolerances(coarsest: int, finest: int, per_decade: int) -> tuple[float, ...]:
    """Tolerances evenly spaced in decades; the ends are exponents of ten."""
    # Three digits, so that a setting reads the same in every table.
    return tuple(float(f"{t:.2e}") for t in np.logspace(coarsest, finest, (coarsest - finest) * per_decade + 1))


def equal_steps(first: int, factor: float, most: int = 2**21) -> tuple[float, ...]:
    """Numbers of steps, each `factor` times the one before."""
    settings = [float(first)]
    while (more := float(round(settings[-1] * factor))) <= most:
        settings.append(more)
    return tuple(settings)


@dataclasses.dataclass(frozen=True)
class Ladder:
    """Settings to run, from coarse to fine, and how often each run is repeated."""

    name: str  # for the page
    tolerances: tuple[float, ...]  # rtol = atol, of methods that choose their steps
    longest: float  # a method is not run finer once one of its runs takes longer, s
    repeats: Repeats  # of every run of a scene, in turn
    steps: tuple[float, ...] = equal_steps(32, 4.0)  # numbers of them, until the error is below `enough`
    enough: float = 1e-10


FULL = Ladder("full", tolerances(-3, -13, 2), 0.5, Repeats(21, 3, 0.1))
QUICK = Ladder("quick", tolerances(-4, -12, 1), 0.1, Repeats(9, 3, 0.05))


class Counts(NamedTuple):
    """What a run did, numbers or arrays of shape (): steps, evaluations, and whether it reached the end."""

    accepted: Any
    rejected: Any
    evaluations: Any
    good: Any


class SceneProgram(NamedTuple):
    """One scene by one method, as a function of the start and the setting."""

    start: Any  # a pytree of arrays
    solve: Callable[[Any, Any], tuple[Any, Counts]]  # (start, setting) -> (end, counts), traceable
    state: Callable[[Any], Any]  # the end as the scene names its states; not timed


class Provider(NamedTuple):
    """Who runs a method, and how."""

    name: str
    what: str
    ready: bool = True  # whether that can be had by calling what a library offers


OURS = Provider("twistax", "`tx.integrate` with its defaults")
ONE_CALL = Provider(
    "diffrax in one call",
    "the same compiled as one small function, as twistax compiles its own; diffrax itself does not offer that",
    ready=False,
)
SHIPPED = Provider("diffrax as shipped", "`diffeqsolve` on the quaternions with its defaults, inside `jax.jit`")


@dataclasses.dataclass(frozen=True, eq=False)
class Integrator:
    """A method of the report. Those of one title share a line in figures, whose best points count."""

    name: str  # on the command line
    build: Callable[[Scene], SceneProgram]  # its run of a scene. Raises TwistaxError where it cannot do it
    title: str = ""  # how tables and figures call it
    code: str = ""  # how a program writes it
    provider: Provider = OURS
    style: tuple[str, str, str] = ("tab:blue", "-", "o")  # colour, dash and marker, as matplotlib names them
    drawn: bool = True  # or in the tables alone
    equal: bool = False  # whether the setting is a number of equal steps, each compiled for itself, or rtol = atol


#: More steps than any run here takes; diffrax's own limit is 4096.
_MOST_STEPS = 10**7


def ours(name: str, method: Method, equal: bool = False, **look: Any) -> Integrator:
    """`tx.integrate` as a function of one flat array, as diffrax has it: each array in or out costs a microsecond."""

    def build(scene: Scene) -> SceneProgram:
        method.check(scene.dynamics)
        start, read = ravel_pytree({name: jnp.asarray(value) for name, value in scene.start.items()})
        options: dict[str, Any] = {"u": scene.u, "params": scene.params, "method": method, "throw": False}

        def solve(start: jax.Array, setting: Any) -> tuple[jax.Array, Counts]:
            chosen = {"rtol": setting, "atol": setting, "control": tx.StepControl(max_steps=_MOST_STEPS)}
            steps = {"steps": int(setting)} if equal else chosen
            sol = tx.integrate(scene.dynamics, read(start), t1=scene.duration, **options, **steps)
            stats, good = sol.stats, sol.result == tx.Result.SUCCESS
            counts = map(jnp.asarray, (stats.accepted, stats.rejected, stats.rhs_evaluations, good))
            return ravel_pytree({name: value[0] for name, value in sol.xs.items()})[0], Counts(*counts)

        return SceneProgram(start, solve, read)

    return Integrator(name, build, equal=equal, **look)


def _diffrax(
    name: str, provider: Provider, solver: str, gains: tuple[float, float], most_steps: int = _MOST_STEPS, **look: Any
) -> Integrator:
    """diffrax on the same system in quaternions: PIDController, the first step chosen by it, rtol = atol = the setting.

    The state is one flat vector, which diffrax runs faster than a dict. In one call the whole solve is compiled as one
    small function, as our own integrations are: without diffrax's error check, a callback, which does not compile that
    way, and with ForwardMode, the cheapest way to plain numbers. The solver is the name of a class: a
    first-same-as-last Runge-Kutta method, or an implicit one. The gains are pcoeff and icoeff.
    """

    def build(scene: Scene) -> SceneProgram:
        import diffrax

        term = tx.diffrax.ambient_term(scene.dynamics)
        start, unravel = ravel_pytree(term.to_ambient(scene.start))
        u, params = scene.u, {name: jnp.asarray(value) for name, value in scene.params.items()}
        one_call = {"throw": False, "adjoint": diffrax.ForwardMode()} if provider == ONE_CALL else {}
        method = getattr(diffrax, solver)()

        def rate(t: Any, y: jax.Array, args: Any) -> jax.Array:
            return ravel_pytree(term.vector_field(t, unravel(y), (u, params)))[0]

        if not fits(lambda y: rate(jnp.zeros(()), y, None), start):
            raise tx.ModelError(f"the rates of {scene.name} calls a library: no small call")

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

        # diffrax's loops are built on operations of equinox, all of which compile inside of one function.
        run = functools.partial(small_call, solve, trusted=True) if one_call else solve
        return SceneProgram(start, run, lambda y: term.from_ambient(unravel(y)))

    title = provider.name.replace("diffrax", f"diffrax {solver}")
    return Integrator(name, build, title, f"diffrax.{solver}()", provider, **look)


#: Ours: name, title, how a program writes it, style, whether it is drawn.
_OURS = json.loads(Path(__file__).with_name("ours.json").read_text())
_PI = (0.4, 0.3)


def _all() -> list[Integrator]:
    integrators = []
    for choice in _OURS:
        # What the page shows is what is run.
        method, style = eval(choice["code"], {"tx": tx}), tuple(f"tab:{choice['style']}".split())
        integrators.append(ours(method=method, equal="equal steps" in choice["title"], **choice | {"style": style}))
    looks = {"Tsit5": ("tab:orange", "o"), "Dopri5": ("goldenrod", "<"), "Dopri8": ("tab:red", "D")}
    # Two controllers on one line: diffrax's default, and proportional-integral control, which rejects fewer steps on
    # some scenes.
    for provider, suffix, dash in ((ONE_CALL, "-call", "-"), (SHIPPED, "", ":")):
        for solver, (colour, marker) in looks.items():
            look: dict[str, Any] = {"style": (colour, dash, marker), "drawn": solver != "Dopri5"}
            for end, gains in (("", (0.0, 1.0)), ("-pi", _PI)):
                integrators.append(_diffrax(f"diffrax-{solver.lower()}{suffix}{end}", provider, solver, gains, **look))
    # Its default controller is no match for stiff systems, and its linear algebra calls a library: no small call. Near
    # round-off its steps may become so short that a run takes hours.
    dotted = ("tab:red", ":", "X")
    return [*integrators, _diffrax("diffrax-kvaerno5-pi", SHIPPED, "Kvaerno5", _PI, most_steps=20_000, style=dotted)]


#: All of them, by name.
INTEGRATORS: dict[str, Integrator] = {it.name: it for it in _all()}


# ---- runs of a scene, timed in turn ---------------------------------------------------------------------------------

#: What is measured of a scene.
WHAT = "one call"


def measure_scene(
    scene: Scene, integrators: Sequence[Integrator], ladder: Ladder, store: Store, progress: ProgressCallback = quiet
) -> dict[str, str]:
    """Run what is not in the store yet, time it in turn, keep the rows; gives the methods that cannot, and why."""
    refused: dict[str, str] = {}
    runs: list[tuple[ReportRow, Timed | None]] = []
    sitting = now()
    for number, integrator in enumerate(integrators):
        progress(f"compiling {integrator.name}", 0.5 * number / len(integrators))
        unit, enough = ("steps", ladder.enough) if integrator.equal else ("tolerance", 0.0)
        first: Any = None
        # From coarse to fine, one run each, except for rows that are there.
        for setting in ladder.steps if integrator.equal else ladder.tolerances:
            row = ReportRow(scene.name, WHAT, integrator.name, f"{unit} {setting:g}", unit="s", sitting=sitting)
            if known := store.get(*row.key):
                row, seconds = known, known.value
            else:
                try:
                    first = first or _first_run(scene, integrator)
                    row, timed = first(dataclasses.replace(row, numbers={"setting": setting}))
                except tx.TwistaxError as error:
                    refused[integrator.name] = first_line(error)
                    break
                runs.append((row, timed))
                seconds = timed.rough if timed else 0.0
            if seconds > ladder.longest or row.numbers.get("error", math.nan) < enough:
                break
    keep(runs, ladder.repeats, store, progress)
    return refused


def _first_run(scene: Scene, integrator: Integrator) -> Callable[[ReportRow], tuple[ReportRow, Timed | None]]:
    """What runs a scene for the setting of a row: the row of that run, and what is timed."""
    program = integrator.build(scene)
    run = jax.jit(program.solve, static_argnums=1 if integrator.equal else ())
    compile_seconds = math.nan

    def first(row: ReportRow) -> tuple[ReportRow, Timed | None]:
        nonlocal compile_seconds
        setting = row.numbers["setting"]
        arguments = program.start, setting if integrator.equal else jnp.asarray(setting)
        try:
            if integrator.equal or math.isnan(compile_seconds):
                compile_seconds = seconds_of(lambda: run.lower(*arguments).compile())
            timed = Timed(functools.partial(run, *arguments))
            end, counts = timed.result()
        except (RuntimeError, ValueError) as error:  # diffrax raises where it gives up, from a callback
            if isinstance(error, ValueError) and "callback" not in str(error):
                raise
            lines = [line for line in str(error).splitlines() if "RuntimeError" in line]
            return dataclasses.replace(row, note=first_line(lines[0] if lines else error)[:80]), None
        good = bool(counts.good)
        state = {name: np.asarray(value) for name, value in program.state(end).items()}
        numbers = {"error": float(scene.error(state)) if good else math.nan, "compile_seconds": compile_seconds}
        numbers |= {name: float(getattr(counts, name)) for name in ("evaluations", "accepted", "rejected")}
        note = row.note if good else "did not reach the end"
        return dataclasses.replace(row, note=note, numbers={**row.numbers, **numbers}), timed

    return first
