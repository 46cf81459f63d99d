"""Who takes part: this package with each of its backends, plain jax.numpy, and peers."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import shutil
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...lowering.backends import Backend
from ...lowering.scalar.graph import TooLarge
from ...mechanics import Chain
from ..timing import Timed, repeated
from .case import Case, FreeBody, OfChain, numbers
from .programs import CALLS, JACOBIAN, TINY, VALUE, JaxTask, Lacks, Quantity, Task


@dataclasses.dataclass(frozen=True, eq=False)
class Contender:
    """A way to have dynamics evaluated.

    Attributes:
        name: in tables.
        colour: in figures.
        how: what is done, a sentence for the page.
        task: makes a task; raises `Lacks` where there is none.
        packages: needed, as pip and as Python call them.
        tools: needed, as the command line calls them.
    """

    name: str
    colour: str
    how: str
    task: Callable[[Case, Quantity], Task]
    packages: Sequence[tuple[str, str]] = ()
    tools: Sequence[str] = ()

    def absent(self) -> str | None:
        """Why it cannot take part on this machine; None if it can."""
        for package, module in self.packages:
            if importlib.util.find_spec(module) is None:
                return f"{package} is not installed"
        return next((f"there is no {tool}" for tool in self.tools if shutil.which(tool) is None), None)


# ---- in JAX ---------------------------------------------------------------------------------------------------------


def _twistax(backend: Backend, case: Case, quantity: Quantity) -> Task:
    """This package with a backend; derivatives by JAX where it does not unroll them itself."""
    system = case.system()

    def make() -> Callable[..., Any]:
        dynamics = tx.compile(system, backend=backend)
        if quantity is JACOBIAN and not isinstance(backend, tx.JAX) and _unrolls(dynamics, case):

            def slopes(a: Any, b: Any, c: Any) -> list[jax.Array]:
                blocks = dynamics.jacobian(0.0, *case.inputs(a, b, c), wrt=case.by)
                return [blocks[kind] for kind in case.by]

            return slopes
        return quantity.by_jax(lambda a, b, c: case.read(dynamics(0.0, *case.inputs(a, b, c))))

    return JaxTask(case, make)


def _unrolls(dynamics: tx.Dynamics, case: Case) -> bool:
    """Whether `dynamics.jacobian` is of use: it unrolls all scalars, which takes a compiler long beyond some."""
    arguments, inside = [points[0] for points in case.points(1)], dynamics._functions
    try:
        found, _ = inside.rate_jacobian(inside.prepare(0.0, *case.inputs(*arguments)), case.by)
    except TooLarge:
        return False
    return found.program.operations <= tx.XLA().largest


def _own(name: str, colour: str, backend: Backend, how: str, **needs: Any) -> Contender:
    how = f"`tx.compile(system, backend=tx.{type(backend).__name__}())`: {how}"
    return Contender(name, colour, how, functools.partial(_twistax, backend), **needs)


SCALARS = _own(
    "twistax XLA",
    "C0",
    tx.XLA(),
    "scalars where it unrolls functions, arrays below. Jacobians by `dynamics.jacobian` up to 30,000 operations, by "
    "`jax.jacfwd` beyond; gradients by `jax.grad`.",
)
_IN_PROCESS = "kernels compiled in process. Derivatives as with XLA."
NATIVE = _own("twistax native", "C3", tx.Native(), _IN_PROCESS, packages=(("llvmlite", "llvmlite"),))
ARRAYS = _own("twistax arrays", "C9", tx.JAX(), "small arrays as they are written. Derivatives by JAX.")


def _plain(case: Case, quantity: Quantity) -> Task:
    return JaxTask(case, lambda: quantity.by_jax(functools.partial(case.by_hand, jnp)))


PLAIN = Contender(
    "plain JAX",
    "C7",
    "jax.numpy as one writes it by hand, in 6x6 matrices, lists and Python loops (`by_hand.py`). Derivatives by "
    "`jax.jacfwd` and `jax.grad`.",
    _plain,
)


def _openscvx(case: Case, quantity: Quantity) -> Task:
    if not isinstance(case, FreeBody):
        raise Lacks("its lowering writes a shared part out again at each use, so a recursion grows with each link")
    return JaxTask(case, lambda: quantity.by_jax(_openscvx_body(case)))


def _openscvx_body(case: FreeBody) -> Callable[..., Any]:
    import openscvx as ox
    from openscvx.symbolic.lower import lower_to_jax

    p, q, V = ox.State("p", shape=(3,)), ox.State("q", shape=(4,)), ox.State("V", shape=(6,))
    F = ox.Control("F", shape=(6,))
    for leaf, place in ((p, slice(0, 3)), (q, slice(3, 7)), (V, slice(7, 13)), (F, slice(0, 6))):
        leaf._slice = place
    mass, (x, y, z) = case.mass_moment
    arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R = ox.spatial.QDCM(q)
    down = R.T @ np.array([0.0, 0.0, -9.81])
    # Its coadjoint operator is right for a momentum ordered [L; p].
    coriolis = ox.lie.AdjointDual(V, np.roll(case.inertia, 3, axis=0) @ V)
    wrench = ox.Concat(F[:3] + mass * down - coriolis[3:], F[3:] + arm @ down - coriolis[:3])
    rates = ox.Concat(R @ V[:3], 0.5 * ox.spatial.SSMP(V[3:]) @ q, np.linalg.inv(case.inertia) @ wrench)
    lowered = lower_to_jax(rates)
    return lambda a, b, c: [lowered(jnp.concatenate([a, b]), c, 0, {})]


OPENSCVX = Contender(
    "OpenSCvx",
    "C2",
    "`openscvx.symbolic.lower.lower_to_jax` of its own nodes. Derivatives by JAX.",
    _openscvx,
    packages=(("openscvx", "openscvx"),),
)

# ---- Pinocchio ------------------------------------------------------------------------------------------------------


class _PinocchioTask(Task):
    def __init__(self, case: Case, quantity: Quantity) -> None:
        import pinocchio as pin

        if not isinstance(case, OfChain):
            raise Lacks("it has no function with quaternion rates")
        if quantity not in (VALUE, JACOBIAN):
            raise Lacks("it has Jacobians only")
        begin = time.perf_counter()
        model = _model(pin, case.chain)
        self._case, self._shape, self._call = case, quantity.shape(case), _call(pin, model, case.inverse, quantity)
        self._seconds = time.perf_counter() - begin

    def single(self) -> Timed:
        arguments = [points[0] for points in self._case.points(1)]
        return Timed(lambda: repeated(CALLS, self._call, *arguments), CALLS, self._seconds)

    def loop(self, steps: int) -> Timed:
        call, start = self._call, [points[0] for points in self._case.points(1)]

        def steps_in_turn() -> Any:
            arguments = [each.copy() for each in start]
            for _ in range(steps):
                result = call(*arguments)
                fed = result.reshape(-1)
                for each in arguments:
                    each += TINY * fed[: each.size]
            return result

        return Timed(steps_in_turn, steps, self._seconds)

    def batch(self, count: int) -> Timed:
        call, points, out = self._call, self._case.points(count), np.zeros((count, *self._shape))

        def each_in_turn() -> Any:
            for i, arguments in enumerate(zip(*points, strict=True)):
                out[i] = call(*arguments)
            return out

        return Timed(each_in_turn, count, self._seconds)


def _call(pin: Any, model: Any, inverse: bool, quantity: Quantity) -> Callable[[Any, Any, Any], Any]:
    """Three vectors to an array."""
    data = model.createData()

    def slopes_of_rnea(q: Any, qd: Any, qdd: Any) -> Any:
        pin.computeRNEADerivatives(model, data, q, qd, qdd)
        return np.concatenate([data.dtau_dq, data.dtau_dv], axis=1)

    def slopes_of_aba(q: Any, qd: Any, tau: Any) -> Any:
        pin.computeABADerivatives(model, data, q, qd, tau)
        return np.concatenate([data.ddq_dq, data.ddq_dv], axis=1)

    if quantity is JACOBIAN:
        return slopes_of_rnea if inverse else slopes_of_aba
    algorithm = pin.rnea if inverse else pin.aba
    return lambda q, qd, third: algorithm(model, data, q, qd, third)


def _model(pin: Any, chain: Chain) -> Any:
    """The chain as a model of Pinocchio; all joints turn about z."""
    model, before = pin.Model(), 0
    for number, link in enumerate(chain.links):
        mount, body = numbers(link.mount), link.body
        before = model.addJoint(before, pin.JointModelRZ(), pin.SE3(mount[:3, :3], mount[:3, 3]), f"joint{number}")
        inertia = pin.Inertia(float(numbers(body.mass)), numbers(body.center_of_mass), numbers(body.inertia))
        model.appendBodyToJoint(before, inertia, pin.SE3.Identity())
    return model


PINOCCHIO = Contender(
    "Pinocchio",
    "C4",
    "`pin.rnea`, `pin.aba` and their analytic derivatives, called from Python in a loop, point by point, also for "
    "loops and batches: what a call costs is part of every time and is not subtracted. A loop in C++ is faster.",
    _PinocchioTask,
    packages=(("pin", "pinocchio"),),
)
