"""Solve times of controllers: closed loops with disturbances, in Python and in C."""

from __future__ import annotations

import dataclasses
import functools
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from shutil import which
from typing import Any

import numpy as np
from numpy import ndarray as Array

import twistax as tx

from ...jax_inside import in_double
from ...trajectory import Controller, Problem
from ..harness.expected import Absent, at_most, between
from ..harness.measurement import Section, slow

_CALLS, _KICKS = 1000, 50
#: Of an interval, s.
LENGTH = 0.05
#: Of the compiler of C.
FLAGS = ("-std=c99", "-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno")
_TIMED = """
#include <stdio.h>
#include <time.h>
#include "loop.h"
static loop_controller c;
int main(void)
{{
  static const double states[2][{size}] = {{{states}}};
  double u[16], iterations = 0;
  loop_report report;
  loop_init(&c);
  const clock_t begin = clock();
  for (int k = 0; k < {calls}; k++) {{
    const double *const x = states[k % 2];
    loop_feedback(&c{places}{controls}, NULL, NULL, &report);
    iterations += report.iterations;
  }}
  printf("%.17g %.17g\\n", 1e6 * (double)(clock() - begin) / CLOCKS_PER_SEC / {calls}, iterations);
  return 0;
}}
"""


@dataclasses.dataclass(frozen=True, eq=False)
class ControlLoop:
    """A system to control.

    Attributes:
        state: the problem, the state in which it rests, and the standard deviations of kicks by tangents.
    """

    problem: Problem
    rest: Mapping[str, Any]
    kick: Array

    @functools.cached_property
    def fly(self) -> Callable[..., Any]:
        """The system over one interval."""
        u = {control.name: np.zeros(control.shape) for control in self.problem.dynamics.controls}
        return tx.simulator(self.problem.dynamics, self.rest, t1=LENGTH, dt=LENGTH / 4, u=u)

    @functools.cache  # noqa: B019  as many as there are cases
    def flown(self, iterations: int, calls: int = _CALLS) -> tuple[Controller, float]:
        """The controller after a closed loop with kicks, and what the loop cost: the sum of squared tangents."""
        with in_double():
            x, group = dict(self.rest), self.problem.dynamics.group
            kicked = {name: np.asarray(a) for name, a in group.retract(x, self.kick).items()}
            controller = self.problem.controller(self.problem.solve(initial=kicked), max_iterations=iterations)
            rng, cost = np.random.default_rng(0), 0.0
            for k in range(calls):
                if k % _KICKS == _KICKS // 2:
                    kicked = group.retract(x, rng.normal(size=len(self.kick)) * self.kick)
                    x = {name: np.asarray(value) for name, value in kicked.items()}
                u = controller.feedback(x)
                cost += float(np.sum(np.square(np.asarray(group.difference(self.rest, x)))))
                x = {name: np.asarray(values[-1]) for name, values in self.fly(x, u=u).xs.items()}
                controller.shift()
        return controller, cost


@functools.cache
def cart_pole() -> ControlLoop:
    """A pole on a cart upright, 40 intervals. Masses and length as of Kelly, SIAM Review 59 (2017), section 6."""
    M, m, l, g = 1.0, 0.3, 0.5, 9.81
    x, a, xd, ad = (tx.State(name) for name in ("x", "a", "xd", "ad"))
    push = tx.Control("push", min=-20.0, max=20.0)
    s, c = -tx.Sin(a), -tx.Cos(a)  # of the angle from hanging, a from upright
    free = M + m * s**2
    rates: dict[Any, Any] = {x: xd, a: ad, xd: (l * m * s * ad**2 + push + m * g * c * s) / free}
    rates[ad] = -(l * m * c * s * ad**2 + push * c + (m + M) * g * s) / (l * free)
    stage = 10.0 * (x * x + a * a) + 0.1 * (xd * xd + ad * ad) + 0.01 * push**2
    rest = dict.fromkeys(("x", "a", "xd", "ad"), 0.0)
    end = 10.0 * (x * x + 10.0 * a * a + xd * xd + ad * ad)
    of_mesh: dict[str, Any] = {"nodes": 41, "substeps": 1, "final_time": 40 * LENGTH, "initial": rest}
    problem = Problem(tx.compile(tx.System(rates=rates)), tx.Minimize(end, running=stage), **of_mesh)
    return ControlLoop(problem, rest, np.array([0.0, 0.0, 0.3, 2.0]))


@functools.cache
def quadrotor() -> ControlLoop:
    """A quadrotor that hovers, 20 intervals."""
    mass, J, arm, drag = 0.8, np.diag([5e-3, 5e-3, 9e-3]), 0.17, 0.016
    mixer = np.array([[1, 1, 1, 1], [0, arm, 0, -arm], [-arm, 0, arm, 0], [drag, -drag, drag, -drag]], float)
    hover = mass * 9.81 / 4
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    rotors = tx.Control("rotors", shape=(4,), min=0.3 - hover, max=4.5 - hover)  # thrusts above those that hover
    lift = mixer @ (rotors + hover)
    force = g[:3, :3].T @ np.array([0.0, 0.0, -9.81 * mass]) + tx.Concat(0.0, 0.0, lift[0])
    M = np.block([[mass * np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), J]])
    rate = tx.linalg.Solve(M, tx.lie.wrench(force=force, torque=lift[1:]) - tx.lie.AdjointDual(V, M @ V))
    away = g[:3, 3]
    running = away @ away + 0.2 * (V @ V + rotors @ rotors)
    rest = {"g": np.eye(4), "V": np.zeros(6)}
    of_mesh: dict[str, Any] = {"nodes": 21, "substeps": 1, "final_time": 20 * LENGTH, "initial": rest}
    cost = tx.Minimize(5.0 * (away @ away) + V @ V, running=running)
    problem = Problem(tx.compile(tx.System(rates={g: V, V: rate})), cost, **of_mesh)
    return ControlLoop(problem, rest, np.array([*[0.05] * 3, *[0.1] * 3, *[0.1] * 3, *[0.3] * 3]))


def _milliseconds(case: Callable[[], ControlLoop], iterations: int) -> float:
    return 1e3 * float(np.median(case().flown(iterations)[0].log.seconds))


def _late(case: Callable[[], ControlLoop]) -> float:
    seconds = case().flown(2)[0].log.seconds
    return float(np.quantile(seconds, 0.99) / np.median(seconds))


def _cost(case: Callable[[], ControlLoop], iterations: int) -> float:
    return case().flown(iterations)[1] / case().flown(100)[1]


def c_compiler() -> str:
    """Its path. Raises Absent where there is none."""
    compiler = which("cc")
    if compiler is None:
        raise Absent("no C compiler")
    return compiler


@functools.cache
def in_c(case: Callable[[], ControlLoop]) -> tuple[float, float]:
    """Time of an iteration, us, and workspace, KiB, of its C file: calls of five, from a kick and its reverse."""
    compiler = c_compiler()
    problem, rest, folder = case().problem, case().rest, Path(tempfile.mkdtemp())
    files = problem.to_c(folder, name="loop", max_iterations=5, tolerance=1e-9)
    sizes = [np.size(rest[state.name]) for state in problem.dynamics.states]
    with in_double():
        kicked = [problem.dynamics.group.retract(rest, kick) for kick in (case().kick, -case().kick)]
    rows = [", ".join(repr(float(v)) for s in problem.dynamics.states for v in np.ravel(x[s.name])) for x in kicked]
    states = ", ".join(f"{{{row}}}" for row in rows)
    places = "".join(f", x + {before}" for before in np.cumsum([0, *sizes[:-1]]))
    controls = "".join(f", u + {4 * k}" for k in range(len(problem.dynamics.controls)))
    main = folder / "main.c"
    main.write_text(_TIMED.format(states=states, size=sum(sizes), calls=200, places=places, controls=controls))
    target = folder / "main"
    subprocess.run([compiler, *FLAGS, str(files.source), str(main), "-lm", "-o", str(target)], check=True)
    done = subprocess.run([str(target)], check=True, capture_output=True, text=True)
    microseconds, iterations = map(float, done.stdout.split())
    size = next(line for line in files.header.read_text().splitlines() if "Workspace" in line)
    return 200 * microseconds / max(iterations, 1.0), int(size.split(":")[1].split()[0]) / 1024.0


def _rows(name: str, case: Callable[[], ControlLoop], bar: float, bar_in_c: float) -> Section:
    of_cost = "cost of the loop with two iterations over that with full solves"
    return [
        slow(name, "two iterations, median, ms", at_most(bar), _milliseconds, case, 2),
        slow(name, "two iterations, the slowest hundredth over the median", at_most(5.0), _late, case),
        slow(name, "full solves, median, ms", between(), _milliseconds, case, 100),
        slow(name, of_cost, between(), _cost, case, 2),
        slow(name, "in C, an iteration, us", at_most(bar_in_c), lambda: in_c(case)[0]),
        slow(name, "in C, workspace, KiB", at_most(256.0), lambda: in_c(case)[1]),
    ]


LATENCIES: Section = [
    f"{_CALLS} calls of a controller in a closed loop, with a kick every {_KICKS} calls.",
    *_rows("cart-pole, 40 intervals", cart_pole, 0.2, 50.0),
    *_rows("quadrotor, 20 intervals", quadrotor, 1.0, 300.0),
]
