"""The control loops as CasADi states them: its SQP method in generated C, and Fatrop, compared with a controller in
C.
"""

from __future__ import annotations

import contextlib
import functools
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...jax_inside import in_double
from ..harness.expected import at_most, between, needed
from ..harness.measurement import Section, slow
from .latencies import FLAGS, LENGTH, ControlLoop, c_compiler, cart_pole, in_c, quadrotor

_CALLS, _ITERATIONS = 40, 5


class _Stated(NamedTuple):
    """A loop in CasADi: expressions of (x, u), limits of u, the state at rest, and both kicked states."""

    x: Any
    u: Any
    rate: Any
    running: Any
    final: Any
    limits: tuple[float, float]
    rest: list[float]
    kicked: list[list[float]]
    intervals: int


def _cart_pole() -> _Stated:
    ca = needed("casadi", "twistax[casadi]")
    M, m, l, g = 1.0, 0.3, 0.5, 9.81
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u")
    s, c = -ca.sin(x[1]), -ca.cos(x[1])
    free = M + m * s**2
    rate = ca.vertcat(
        *(x[2], x[3], (l * m * s * x[3] ** 2 + u + m * g * c * s) / free),
        -(l * m * c * s * x[3] ** 2 + u * c + (m + M) * g * s) / (l * free),
    )
    running = 10 * (x[0] ** 2 + x[1] ** 2) + 0.1 * (x[2] ** 2 + x[3] ** 2) + 0.01 * u**2
    final = 10 * (x[0] ** 2 + 10 * x[1] ** 2 + x[2] ** 2 + x[3] ** 2)
    kicked = [[0.0, 0.0, 0.3, 2.0], [0.0, 0.0, -0.3, -2.0]]
    return _Stated(x, u, rate, running, final, (-20.0, 20.0), [0.0] * 4, kicked, 40)


def _quadrotor() -> _Stated:
    """Position, quaternion, twist: 13 numbers, as users of CasADi and acados state it."""
    ca = needed("casadi", "twistax[casadi]")
    mass, J, arm, drag = 0.8, np.array([5e-3, 5e-3, 9e-3]), 0.17, 0.016
    mixer = np.array([[1, 1, 1, 1], [0, arm, 0, -arm], [-arm, 0, arm, 0], [drag, -drag, drag, -drag]], float)
    hover = mass * 9.81 / 4
    x, u = ca.SX.sym("x", 13), ca.SX.sym("u", 4)
    p, s, q, v, w = x[:3], x[3], x[4:7], x[7:10], x[10:]
    rotated = lambda r, sign: r + 2 * ca.cross(q, ca.cross(q, r) + sign * s * r)  # noqa: E731
    lift = ca.mtimes(mixer, u + hover)
    force = rotated(ca.DM([0.0, 0.0, -9.81 * mass]), -1) + ca.vertcat(0, 0, lift[0])
    turn = ca.vertcat(-ca.dot(q, w), s * w + ca.cross(q, w)) / 2
    rate = ca.vertcat(rotated(v, 1), turn, force / mass - ca.cross(w, v), (lift[1:] - ca.cross(w, J * w)) / J)
    squares = lambda *parts: sum(ca.dot(a, a) for a in parts)  # noqa: E731
    running, final = squares(p) + 0.2 * squares(v, w, u), 5 * squares(p) + squares(v, w)
    angle = 0.1 * np.sqrt(3.0)
    turned = [np.cos(angle / 2), *[np.sin(angle / 2) / np.sqrt(3.0)] * 3]
    kick = [*[0.05] * 3, *turned, *[0.1] * 3, *[0.3] * 3]
    kicked = [kick, [-a if k != 3 else a for k, a in enumerate(kick)]]
    rest = [0.0] * 3 + [1.0] + [0.0] * 9
    return _Stated(x, u, rate, running, final, (0.3 - hover, 4.5 - hover), rest, kicked, 20)


def _transcribed(loop_in_casadi: _Stated) -> tuple[dict[str, Any], dict[str, Any]]:
    """Multiple shooting by RK4: the program, and its arguments."""
    ca = needed("casadi")
    x, u, N = loop_in_casadi.x, loop_in_casadi.u, loop_in_casadi.intervals
    nx, nu = x.numel(), u.numel()
    f = ca.Function("f", [x, u], [ca.vertcat(loop_in_casadi.rate, loop_in_casadi.running)])
    k1 = f(x, u)
    k2 = f(x + LENGTH / 2 * k1[:nx], u)
    k3 = f(x + LENGTH / 2 * k2[:nx], u)
    k4 = f(x + LENGTH * k3[:nx], u)
    moved = LENGTH / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    step = ca.Function("step", [x, u], [x + moved[:nx], moved[nx]])
    xs, us = [ca.SX.sym(f"x{k}", nx) for k in range(N + 1)], [ca.SX.sym(f"u{k}", nu) for k in range(N)]
    start, gaps, cost = ca.SX.sym("start", nx), [], ca.Function("final", [x], [loop_in_casadi.final])(xs[N])
    for k in range(N):
        end, running = step(xs[k], us[k])
        cost += running
        gaps += [xs[k + 1] - end] + [xs[0] - start] * (k == 0)
    unknowns = ca.vertcat(*[a for pair in zip(xs, us) for a in pair], xs[N])
    bounds = [
        np.r_[np.tile(np.r_[np.full(nx, -side), np.full(nu, limit)], N), np.full(nx, -side)]
        for side, limit in zip((np.inf, -np.inf), loop_in_casadi.limits)
    ]
    guess = np.r_[np.tile(np.r_[loop_in_casadi.rest, np.zeros(nu)], N), loop_in_casadi.rest]
    program = {"x": unknowns, "f": cost, "g": ca.vertcat(*gaps), "p": start}
    return program, {"x0": guess, "lbx": bounds[0], "ubx": bounds[1], "lbg": 0.0, "ubg": 0.0}


def _compiled(name: str, program: dict[str, Any]) -> Any:
    """CasADi's SQP method with its QP solver qrqp as generated C, and the Hessian of the cost alone."""
    ca, compiler = needed("casadi"), c_compiler()
    x, p, weight, rows = program["x"], program["p"], ca.SX.sym("weight"), ca.SX.sym("rows", program["g"].numel())
    hessian = ca.hessian(weight * program["f"], x)[0]
    names = ["x", "p", "lam_f", "lam_g"], ["hess_gamma_x_x"]
    silent = {f"print_{what}": False for what in ("header", "iteration", "status", "time")}
    of_qp = {f"print_{what}": False for what in ("header", "iter", "info")} | {"error_on_fail": False}
    options: dict[str, Any] = {
        **silent,
        "error_on_fail": False,
        "max_iter": _ITERATIONS,
        "tol_pr": 1e-16,
        "tol_du": 1e-16,
        "min_step_size": 0.0,
    }
    options |= {
        "qpsol": "qrqp",
        "qpsol_options": of_qp,
        "hess_lag": ca.Function("hessian", [x, p, weight, rows], [hessian], *names),
    }
    method = ca.nlpsol(name, "sqpmethod", program, options)
    with contextlib.chdir(tempfile.mkdtemp()):
        source = Path(method.generate(f"{name}.c")).resolve()
    library = source.with_suffix(".so")
    subprocess.run([compiler, *FLAGS, "-shared", "-fPIC", str(source), "-lm", "-o", str(library)], check=True)
    return ca.external(name, str(library))


def _fatrop(name: str, program: dict[str, Any], iterations: int = _ITERATIONS) -> Any:
    """Fatrop in CasADi with the same functions, which CasADi evaluates."""
    quiet = {"print_time": False, "error_on_fail": False, "equality": [True] * program["g"].numel()}
    of_fatrop = {"max_iter": iterations, "print_level": 0}
    return needed("casadi").nlpsol(
        name, "fatrop", program, {**quiet, "structure_detection": "auto", "fatrop": of_fatrop}
    )


@functools.cache
def _microseconds(state: Callable[[], _Stated], make: Callable[..., Any]) -> float:
    """Processor time of an iteration: calls of five, each from the plan of the last one, from both kicks in turn."""
    loop_in_casadi = state()
    program, arguments = _transcribed(loop_in_casadi)
    method, seconds = make(f"loop{loop_in_casadi.intervals}", program), []
    for k in range(_CALLS):
        begin = time.process_time()  # as `clock` in the program of ours
        result = method(p=loop_in_casadi.kicked[k % 2], **arguments)
        seconds.append(time.process_time() - begin)
        arguments |= {"x0": result["x"], "lam_x0": result["lam_x"], "lam_g0": result["lam_g"]}
    return 1e6 * float(np.median(seconds)) / _ITERATIONS


def _difference_of_costs(state: Callable[[], _Stated], case: Callable[[], ControlLoop]) -> float:
    """Optimal cost from the kick, there and here, relative."""
    loop_in_casadi, loop = state(), case()
    program, arguments = _transcribed(loop_in_casadi)
    there = float(_fatrop("full", program, 100)(p=loop_in_casadi.kicked[0], **arguments)["f"])
    with in_double():
        kicked = {name: np.asarray(a) for name, a in loop.problem.dynamics.group.retract(loop.rest, loop.kick).items()}
        controller = loop.problem.controller(loop.problem.solve(initial=kicked), max_iterations=100)
        controller.feedback(kicked)
    return abs(controller.log.costs[-1] / there - 1.0)


def _rows(
    name: str, largest_difference: float, state: Callable[[], _Stated], case: Callable[[], ControlLoop]
) -> Section:
    best = lambda: min(_microseconds(state, make) for make in (_compiled, _fatrop))  # noqa: E731
    return [
        slow(
            name, "optimal costs are apart by, relative", at_most(largest_difference), _difference_of_costs, state, case
        ),
        slow(
            name, "CasADi's SQP with qrqp in generated C, an iteration, us", between(), _microseconds, state, _compiled
        ),
        slow(name, "Fatrop in CasADi, an iteration, us", between(), _microseconds, state, _fatrop),
        slow(name, "ours in C over the faster of both", at_most(1.0), lambda: in_c(case)[0] / best()),
    ]


OTHER_CONTROLLERS: Section = [
    f"Calls of {_ITERATIONS} iterations from the last plan, from a kick and its reverse in turn.",
    *_rows("cart-pole, 40 intervals", 1e-6, _cart_pole, cart_pole),
    *_rows("quadrotor, 20 intervals", 1e-4, _quadrotor, quadrotor),
]
