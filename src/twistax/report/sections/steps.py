"""What a step costs, ours in every chart, through diffrax, and in C; and how right and dear derivatives are."""

from __future__ import annotations

import ctypes
import functools
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ... import diffrax as bridge
from ...groups import quaternions, se3
from ...integrators import VectorField
from ...integrators.charts import Chart
from ...scalar.backends import Backend
from ...scalar.small_call import small_call
from ...scenes.powered_descent import Start, Vehicle, initial, system
from ...scenes.rocket import ROCKET
from ...trajectory import discretize
from ...trajectory.transcription.vectors import declared_scales
from ..checks import Absent, Check, Section, agree, apart, at_most, between, raced, slow
from ..timing import Repeats, Timed, compiled, in_turn
from .stiff import fourth_order, weighted_end

_REPEATS, _FEW = Repeats(7, 5), Repeats(5, 5)
_RK4 = tx.RKMK(tx.tableaus.RK4)


@functools.cache
def _body() -> tx.Dynamics:
    """A heavy asymmetric body: a pose and a twist, gravity in the body frame."""
    M = np.diag([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    weight = tx.lie.wrench(force=g[:3, :3].T @ np.array([0.0, 0.0, -19.62]), torque=np.array([0.0, 0.0, 0.1]))
    return tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, weight - tx.lie.AdjointDual(V, M @ V))}))


_START = {"g": np.eye(4), "V": np.array([0.1, 0.2, 0.3, 1.0, 0.5, -0.3])}


@functools.cache
def looped(method: tx.RKMK, steps: int = 20_000) -> dict[str, Timed]:
    """A loop of steps as one small function, as `tx.integrate` has it where no kernel runs, and as XLA does it."""
    dynamics, dt = _body(), 1e-5
    local = method.coordinates(dynamics)

    def loop(x: Any, count: jax.Array) -> Any:
        def advance(i: jax.Array, y: Any) -> Any:
            return method.advance(VectorField(dynamics, lambda t: {}, {}), i * dt, y, jnp.asarray(dt))

        return local.value(jax.lax.fori_loop(0, count, advance, local.enter(x)))

    forms = {"small": lambda x, count: small_call(loop, x, count), "default": loop}
    ways = {name: compiled(form, _START, jnp.asarray(steps), evaluations=steps) for name, form in forms.items()}
    return raced(ways, 1e-12, _REPEATS)


_LOOPS = {
    "a step": (between(unit="us"), lambda loops: 1e6 * loops["small"].seconds),
    "a step of the default loop": (between(unit="us"), lambda loops: 1e6 * loops["default"].seconds),
    "compiling": (at_most(2.0, "s"), lambda loops: loops["small"].compile_seconds),
}


def _charts(commutators: int) -> list[Chart]:
    c = tx.charts
    return [c.Exponential(commutators), c.Exponential(), c.SplitExponential(commutators), c.Ambient()]


_of_loops = lambda read, method: read(looped(method))  # noqa: E731

STEPS: Section = [
    Check(f"{tableau.name}, {chart!r}", by, expected, _of_loops, read, tx.RKMK(tableau, chart), slow=True)
    for tableau in (tx.tableaus.RK4, tx.tableaus.TSIT5, tx.tableaus.DOP853)
    for chart in _charts(tableau.order - 2)
    for by, (expected, read) in _LOOPS.items()
]


_ADAPTIVE = "adaptive"


def bridged(kind: Callable[[], Any], chart: Chart | None, adaptive: bool, steps: int = 2000) -> float:
    """The time of a step of `LieSolver` over that of the same solver on quaternions.

    Adaptive ones measure errors but may take one length only, so that both take the same steps.
    """
    dynamics, solver, dt = _body(), kind(), 1e-3
    term, lie = bridge.ambient_term(dynamics), bridge.LieSolver(solver, dynamics, chart)
    of_group: Any = diffrax.ConstantStepSize()
    plain: Any = of_group
    if adaptive:
        limits: dict[str, Any] = {"rtol": 1e-6, "atol": 1e-6, "dtmin": dt, "dtmax": dt}
        of_group, plain = bridge.controller(**limits), diffrax.PIDController(pcoeff=0.2, icoeff=0.6, **limits)

    def run(term: Any, own: Any, control: Any, read: Callable[[Any], Any], write: Callable[[Any], Any]) -> Timed:
        def solve(x: Any, end: jax.Array) -> Any:
            options: dict[str, Any] = {"stepsize_controller": control, "max_steps": steps + 16}
            sol = diffrax.diffeqsolve(term, own, jnp.zeros(()), end, dt, write(x), **options)
            return jax.vmap(read)(sol.ys), sol.stats["num_accepted_steps"]

        return compiled(solve, _START, jnp.asarray(dt * steps), evaluations=steps)

    ours = run(bridge.lie_term(dynamics), lie, of_group, lambda y: y, lambda x: x)
    theirs = run(term, solver, plain, term.from_ambient, term.to_ambient)
    # That of the numbers of steps too.
    raced({"ours": ours, "theirs": theirs}, 1e-9, _REPEATS)
    return ours.seconds / theirs.seconds


BRIDGE: Section = [
    slow(f"{solver.__name__}, {chart or 'default chart'}", by, at_most(1.5), bridged, solver, chart, by == _ADAPTIVE)
    for solver in (diffrax.Tsit5, diffrax.Dopri8)
    for chart in (None, tx.charts.Exponential(), tx.charts.Ambient())
    for by in ("constant steps", _ADAPTIVE)
]

SOURCE = Path(__file__).with_name("rkmk4.c")
#: What C is compiled with: the usual, and what is faster where the compiler's vectors of scalars do not pay.
FLAGS = (("-O3", "-march=native"), ("-O3", "-march=native", "-fno-tree-vectorize"))
_VELOCITY = np.array([1.0, 0.5, -0.3, 0.4, 1.2, -0.7])  # m/s, rad/s


def c_body(backend: Backend | Literal["auto"] = "auto") -> tx.Dynamics:
    """The body of `rkmk4.c`: gravity, linear drag, principal moments of inertia 1, 2 and 3 kg m^2."""
    g, V, J = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,)), np.array([1.0, 2.0, 3.0])
    v, w = V[:3], V[3:]
    acceleration = g[:3, :3].T @ np.array([0.0, 0.0, -9.81]) - 0.1 * v - tx.linalg.Cross(w, v)
    turning = tx.linalg.Cross(J * w, w) / J
    return tx.compile(tx.System(rates={g: V, V: tx.Concat(acceleration, turning)}), backend=backend)


C_ARRAY = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")


def c_loop(source: Path, name: str, arguments: list[Any], *flags: str) -> Any:
    """A function of a C file, which returns nothing, compiled by gcc. Raises Absent without it."""
    if shutil.which("gcc") is None:
        raise Absent("not run: there is no gcc on this machine")
    # What is loaded stays when its file is gone.
    with tempfile.TemporaryDirectory() as folder:
        target = f"{folder}/{source.stem}.so"
        subprocess.run(["gcc", *flags, "-shared", "-fPIC", "-o", target, str(source)], check=True)
        loop = getattr(ctypes.CDLL(target), name)
    loop.argtypes, loop.restype = arguments, None
    return loop


def _in_c(flags: tuple[str, ...], dt: float, steps: int) -> Timed:
    loop = c_loop(SOURCE, "integrate", [C_ARRAY, ctypes.c_double, ctypes.c_long], *flags)

    def call() -> Any:
        y = np.concatenate([[1.0], np.zeros(6), _VELOCITY])
        loop(y, dt, steps)
        return y

    return Timed(call, steps)


@functools.cache
def beside_c(steps: int = 500_000) -> list[Timed]:
    """RKMK4 by `tx.integrate` with its defaults, and by C with each of the flags. Raises Absent without gcc."""
    dt, dynamics, x0 = 1e-5, c_body(), {"g": np.eye(4), "V": _VELOCITY}
    theirs = [_in_c(flags, dt, steps) for flags in FLAGS]
    ours = Timed(lambda: tx.integrate(dynamics, x0, t1=steps * dt, steps=steps).xs, steps)
    end = {name: value[0] for name, value in ours.result().items()}
    for each in theirs:
        q, p, V = np.split(each.result(), (4, 7))
        pose = se3.transform(quaternions.to_rotation(jnp.asarray(q)), jnp.asarray(p))
        agree(apart(end, {"g": pose, "V": V}), 1e-10)
    in_turn([ours, *theirs], _REPEATS)
    return [ours, *theirs]


_over_c = lambda number: beside_c()[0].seconds / beside_c()[number].seconds  # noqa: E731

BESIDE: Section = [
    Check("a step: our time over that of C", f"gcc {' '.join(flags)}", expected, _over_c, number, slow=True)
    for number, flags, expected in ((1, FLAGS[0], at_most(2.0)), (2, FLAGS[1], between()))
]

_STEP, _BATCH = 0.5, 24
_CLOSED, _LOGARITHM, _DIFFERENCES = "closed form", "jacfwd of the logarithm", "Richardson differences"


@functools.cache
def linearised() -> tuple[dict[str, Timed], dict[str, float]]:
    """A, B and dx/dh of a batch of intervals three ways, timed, and how far two are from the closed form.

    A rocket stage: a pose, a body twist and a mass under thrust, 0.5 s. Differences are of the largest entry, with the
    unknowns in their scales. Needs JAX's x64 switch.
    """
    dynamics, rng, vehicle = tx.compile(system()), np.random.default_rng(0), Vehicle()
    scale = np.append(declared_scales((*dynamics.states, *dynamics.controls)), _STEP)
    n = dynamics.dimension
    # States around the start of the descent and thrusts around 60 %, leading axis the batch.
    moves = 0.3 * rng.normal(size=(_BATCH, n)) * scale[:n]
    xs = jax.jit(jax.vmap(dynamics.retract, (None, 0)))(initial(Start(), vehicle), moves)
    thrusts = vehicle.max_thrust * (np.array([0.0, 0.0, 0.6]) + 0.1 * rng.normal(size=(_BATCH, 3)))

    def end(x: Any, u: Any, z: jax.Array) -> Any:
        """The end of the step that starts at x (+) d under u + du, h + dh."""
        inputs = dynamics._functions.prepare(0.0, dynamics.retract(x, z[:n]), {"T": u["T"] + z[n : n + 3]})
        control, length = dict(inputs.u), _STEP + z[n + 3]
        field = VectorField(dynamics, lambda _: control, dict(inputs.params))
        return _RK4.step(field, inputs.t, dict(inputs.x), length)

    def moved(x: Any, u: Any, z: jax.Array) -> jax.Array:
        """The tangent from the planned end to that one."""
        return dynamics.difference(end(x, u, jnp.zeros(n + 4)), end(x, u, z))

    def closed(x: Any, u: Any) -> jax.Array:
        step = discretize(dynamics, 0.0, x, u, _STEP)
        return jnp.concatenate([step.A, step.B, step.h_derivative[:, None]], axis=1)

    def by_differences(x: Any, u: Any) -> jax.Array:
        ends = jax.vmap(functools.partial(moved, x, u))

        def central(size: float) -> jax.Array:
            steps = size * jnp.diag(jnp.asarray(scale))
            return (ends(steps) - ends(-steps)).T / (2.0 * size * scale[None, :])

        return (4.0 * central(5e-4) - central(1e-3)) / 3.0

    by_logarithm = lambda x, u: jax.jacfwd(functools.partial(moved, x, u))(jnp.zeros(n + 4))  # noqa: E731
    ways = {_CLOSED: closed, _LOGARITHM: by_logarithm, _DIFFERENCES: by_differences}
    arguments = xs, {"T": jnp.asarray(thrusts)}
    timed = {name: compiled(jax.vmap(way), *arguments, evaluations=_BATCH) for name, way in ways.items()}
    results = {name: np.asarray(each.result()) for name, each in timed.items()}
    in_turn([timed[_CLOSED], timed[_LOGARITHM]], _FEW)
    off = {name: np.abs(results[_CLOSED] - each) * scale / scale[:n, None] for name, each in results.items()}
    return timed, {name: float(np.max(each)) for name, each in off.items()}


LINEARISATION: Section = [
    Check("closed form against", _LOGARITHM, at_most(1e-12), lambda: linearised()[1][_LOGARITHM]),
    Check("closed form against", _DIFFERENCES, at_most(1e-8), lambda: linearised()[1][_DIFFERENCES]),
    *(
        Check(what, way, between(unit=unit), lambda way, read: read(linearised()[0][way]), way, read)
        for way in (_CLOSED, _LOGARITHM)
        for what, unit, read in (
            ("compiling", "s", lambda timed: timed.compile_seconds),
            ("an interval", "us", lambda timed: 1e6 * timed.seconds),
        )
    ),
]

#: Fixed and chosen steps; the tolerances are tight, since differences see how steps are chosen.
_WAYS: dict[str, dict[str, Any]] = {
    "RK4, 200 steps": {"steps": 200, "method": _RK4},
    "RK4, 20,000 steps": {"steps": 20_000, "method": _RK4},
    "TSIT5, 1e-11": {"rtol": 1e-11, "atol": 1e-11, "method": tx.RKMK(tx.tableaus.TSIT5)},
    "DOP853, 1e-11": {"rtol": 1e-11, "atol": 1e-11, "method": tx.RKMK(tx.tableaus.DOP853)},
}
#: Step of the differences, in rad, m, m/s, kg and s.
_H = 2e-3


@functools.cache
def _gradient(way: str) -> dict[str, float]:
    """The gradient of a weighted sum of the rocket scene's end by the start, in the tangent space, and the end time."""
    n = ROCKET.dynamics.dimension
    z, function = jnp.zeros(n + 1), lambda z: weighted_end(ROCKET, z[:n], t1=ROCKET.duration + z[n], **_WAYS[way])
    run = jax.jit(function)
    gradient, solution = compiled(jax.grad(function), z), Timed(lambda: run(z))
    reverse, forward = gradient.result(), jax.jit(jax.jacfwd(function))(z)
    others = {"to forward mode": forward, "to differences": fourth_order(run, n + 1, _H)}
    size = float(jnp.abs(reverse).max())
    found = {name: float(jnp.abs(reverse - other).max()) / size for name, other in others.items()}
    agree(max(found.values()), 1e-6)
    in_turn([gradient, solution], _FEW)
    found |= {"compiling": gradient.compile_seconds, "memory": gradient.memory / 1e6}
    return found | {"gradient": 1e3 * gradient.seconds, "solution": 1e3 * solution.seconds}


_COLUMNS = {
    "to forward mode": at_most(1e-8),
    "to differences": at_most(1e-8),
    "compiling": at_most(10.0, "s"),
    "gradient": between(unit="ms"),
    "solution": between(unit="ms"),
    "memory": between(unit="MB"),
}

GRADIENTS: Section = [
    Check(way, name, expected, lambda way, name: _gradient(way)[name], way, name, slow=True)
    for way in _WAYS
    for name, expected in _COLUMNS.items()
]
