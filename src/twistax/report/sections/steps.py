"""What a step costs: ours in every chart, through diffrax, and beside the same loop in C."""

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
from ...lowering.backends import Backend
from ...lowering.small_call import small_call
from ..checks import Absent, Check, Section, agree, at_most, between
from ..timing import Repeats, Timed, compiled, in_turn, ratio

_REPEATS = Repeats(7, 5)

# ---- tableaus and charts --------------------------------------------------------------------------------------------


@functools.cache
def _body() -> tx.Dynamics:
    """A heavy asymmetric body: a pose and a twist, gravity in the body frame."""
    M = np.diag([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    weight = tx.lie.wrench(force=g[:3, :3].T @ np.array([0.0, 0.0, -19.62]), torque=np.array([0.0, 0.0, 0.1]))
    return tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, weight - tx.lie.AdjointDual(V, M @ V))}))


def _start() -> dict[str, jax.Array]:
    return {"g": jnp.eye(4), "V": jnp.array([0.1, 0.2, 0.3, 1.0, 0.5, -0.3])}


def apart(ends: Any, others: Any) -> float:
    """The largest difference of an entry; NaN if there is one."""
    # NumPy's maximum hands on NaN; Python's loses it.
    return float(np.max(jax.tree.leaves(jax.tree.map(lambda a, b: jnp.abs(a - b).max(), ends, others))))


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
    timed = {name: compiled(form, _start(), jnp.asarray(steps), evaluations=steps) for name, form in forms.items()}
    agree(apart(timed["small"].result(), timed["default"].result()), 1e-12)
    in_turn(list(timed.values()), _REPEATS)
    return timed


_LOOPS = {
    "a step": (between(unit="us"), lambda loops: 1e6 * loops["small"].seconds),
    "a step of the default loop": (between(unit="us"), lambda loops: 1e6 * loops["default"].seconds),
    "compiling": (at_most(2.0, "s"), lambda loops: loops["small"].compile_seconds),
}


def _charts(commutators: int) -> list[Chart]:
    c = tx.charts
    return [c.Exponential(commutators), c.Exponential(), c.SplitExponential(commutators), c.Ambient()]


STEPS: Section = [
    Check(
        f"{tableau.name}, {chart!r}",
        by,
        expected,
        lambda read, method: read(looped(method)),
        *(read, tx.RKMK(tableau, chart)),
        slow=True,
    )
    for tableau in (tx.tableaus.RK4, tx.tableaus.TSIT5, tx.tableaus.DOP853)
    for chart in _charts(tableau.order - 2)
    for by, (expected, read) in _LOOPS.items()
]

# ---- through diffrax ------------------------------------------------------------------------------------------------


def bridged(solver: Any, chart: Chart | None, adaptive: bool, steps: int = 2000) -> float:
    """The time of a step of `LieSolver` over that of the same solver on quaternions.

    Adaptive ones measure errors but may take one length only, so that both take the same steps.
    """
    dynamics, dt = _body(), 1e-3
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

        return compiled(solve, _start(), jnp.asarray(dt * steps), evaluations=steps)

    ours = run(bridge.lie_term(dynamics), lie, of_group, lambda y: y, lambda x: x)
    theirs = run(term, solver, plain, term.from_ambient, term.to_ambient)
    (ends, taken), (others, other_taken) = ours.result(), theirs.result()
    agree(float(abs(taken - other_taken)), 0.0)
    agree(apart(ends, others), 1e-9)
    in_turn([ours, theirs], _REPEATS)
    return ratio(ours, theirs)


BRIDGE: Section = [
    Check(
        f"{solver.__name__}, {repr(chart) if chart else 'default chart'}",
        "adaptive" if adaptive else "constant steps",
        at_most(1.5),
        lambda solver, *how: bridged(solver(), *how),
        *(solver, chart, adaptive),
        slow=True,
    )
    for solver in (diffrax.Tsit5, diffrax.Dopri8)
    for chart in (None, tx.charts.Exponential(), tx.charts.Ambient())
    for adaptive in (False, True)
]

# ---- beside C -------------------------------------------------------------------------------------------------------

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


def in_c(source: Path, *flags: str) -> ctypes.CDLL:
    """C compiled by gcc. Raises Absent without it."""
    if shutil.which("gcc") is None:
        raise Absent("not run: there is no gcc on this machine")
    # What is loaded stays when its file is gone.
    with tempfile.TemporaryDirectory() as folder:
        target = f"{folder}/{source.stem}.so"
        subprocess.run(["gcc", *flags, "-shared", "-fPIC", "-o", target, str(source)], check=True)
        return ctypes.CDLL(target)


def _in_c(flags: tuple[str, ...], dt: float, steps: int) -> Timed:
    """The loop of `rkmk4.c`."""
    loop = in_c(SOURCE, *flags).integrate
    loop.argtypes = [np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS"), ctypes.c_double, ctypes.c_long]
    loop.restype = None

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


BESIDE: Section = [
    Check(
        "a step: our time over that of C",
        f"gcc {' '.join(flags)}",
        expected,
        lambda number: ratio(beside_c()[0], beside_c()[number]),
        number,
        slow=True,
    )
    for number, flags, expected in ((1, FLAGS[0], at_most(2.0)), (2, FLAGS[1], between()))
]
