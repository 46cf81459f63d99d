"""The cost of a step: in every chart, through diffrax, and compared with C."""

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
from ..harness.expected import Absent, at_most, between
from ..harness.measurement import Section, slow, table
from ..harness.timing import Race, Timed, compiled


@functools.cache
def _body() -> tx.Dynamics:
    """A heavy asymmetric body: a pose and a twist, gravity in the body frame."""
    M = np.diag([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    weight = tx.lie.wrench(force=g[:3, :3].T @ np.array([0.0, 0.0, -19.62]), torque=np.array([0.0, 0.0, 0.1]))
    return tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, weight - tx.lie.AdjointDual(V, M @ V))}))


_START = {"g": np.eye(4), "V": np.array([0.1, 0.2, 0.3, 1.0, 0.5, -0.3])}


def looped(method: tx.RKMK, steps: int = 20_000) -> dict[str, Timed]:
    """A loop of steps as one small function, as `tx.integrate` has it where no kernel runs, and as XLA does it."""
    dynamics, dt = _body(), 1e-5
    local = method.coordinates(dynamics)

    def loop(x: Any, count: jax.Array) -> Any:
        def advance(i: jax.Array, y: Any) -> Any:
            return method.advance(VectorField(dynamics, lambda t: {}, {}), i * dt, y, jnp.asarray(dt))

        return local.value(jax.lax.fori_loop(0, count, advance, local.enter(x)))

    forms = {"small": lambda x, count: small_call(loop, x, count), "default": loop}
    return {name: compiled(form, _START, jnp.asarray(steps), evaluations=steps) for name, form in forms.items()}


def _charts(commutators: int) -> list[Chart]:
    c = tx.charts
    return [c.Exponential(commutators), c.Exponential(), c.SplitExponential(commutators), c.Ambient()]


STEPS: Section = table(
    {
        f"{tableau.name}, {chart!r}": Race(functools.partial(looped, tx.RKMK(tableau, chart)), 1e-12)
        for tableau in (tx.tableaus.RK4, tx.tableaus.TSIT5, tx.tableaus.DOP853)
        for chart in _charts(tableau.order - 2)
    },
    {
        "a step": (between(unit="us"), lambda race: race.seconds("small", 1e-6)),
        "a step of the default loop": (between(unit="us"), lambda race: race.seconds("default", 1e-6)),
        "compiling": (at_most(2.0, "s"), lambda race: race.compile_seconds("small")),
    },
)

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

    def run(term: Any, solver: Any, control: Any, read: Callable[[Any], Any], write: Callable[[Any], Any]) -> Timed:
        def solve(x: Any, end: jax.Array) -> Any:
            options: dict[str, Any] = {"stepsize_controller": control, "max_steps": steps + 16}
            sol = diffrax.diffeqsolve(term, solver, jnp.zeros(()), end, dt, write(x), **options)
            return jax.vmap(read)(sol.ys), sol.stats["num_accepted_steps"]

        return compiled(solve, _START, jnp.asarray(dt * steps), evaluations=steps)

    ours = run(bridge.lie_term(dynamics), lie, of_group, lambda y: y, lambda x: x)
    theirs = run(term, solver, plain, term.from_ambient, term.to_ambient)
    # The numbers of steps are compared too.
    return Race(lambda: {"ours": ours, "theirs": theirs}, 1e-9).ratio("ours", "theirs")


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


def beside_c(steps: int = 500_000) -> dict[str, Timed]:
    """RKMK4 by `tx.integrate` with its defaults, and by C with each of the flags. Raises Absent without gcc."""
    dt, dynamics, x0 = 1e-5, c_body(), {"g": np.eye(4), "V": _VELOCITY}

    def in_c(flags: tuple[str, ...]) -> Timed:
        loop = c_loop(SOURCE, "integrate", [C_ARRAY, ctypes.c_double, ctypes.c_long], *flags)

        def call() -> Any:
            y = np.concatenate([[1.0], np.zeros(6), _VELOCITY])
            loop(y, dt, steps)
            return y

        return Timed(call, steps)

    in_c_by_flags = {" ".join(flags): in_c(flags) for flags in FLAGS}
    ours = Timed(lambda: tx.integrate(dynamics, x0, t1=steps * dt, steps=steps).xs, steps)
    return {"ours": ours} | in_c_by_flags


def _end_in_matrices(end: Any) -> dict[str, Any]:
    """The end of a solution, or of C as [quaternion, position, velocity], as pose and velocity."""
    if isinstance(end, np.ndarray):
        q, p, V = np.split(end, (4, 7))
        return {"g": se3.transform(quaternions.to_rotation(jnp.asarray(q)), jnp.asarray(p)), "V": V}
    return {name: value[0] for name, value in end.items()}


BESIDE_C = Race(beside_c, 1e-10, read=_end_in_matrices)
BESIDE: Section = [
    slow("a step: our time over that of C", f"gcc {' '.join(flags)}", bar, BESIDE_C.ratio, "ours", " ".join(flags))
    for flags, bar in zip(FLAGS, (at_most(2.0), between()), strict=True)
]
