"""Integrations and solves that fail in every way there is, in processes of their own: how many end the process.

`python tests/failing_runs.py` runs all: 30 structures, each with 33 sets of numbers, one half with x64 and one half
without. `--structures` and `--sets` choose some; `test_failing_runs.py` runs a sample.

All 990 runs end in a result or an error of twistax, and no process dies: 491 succeed (SUCCESS 441, EVENT 33, SOLVED 17)
and 499 fail (NON_FINITE 215, MAX_STEPS 120, NEWTON_FAILED 67, STEP_TOO_SMALL 58, MAX_ITERATIONS 30, COARSE 9). That
takes seven minutes of one core, nearly all of them for compiling: each structure compiles once for each precision, the
tank by Radau with an event for 60 s. After that a run takes milliseconds, or a second for 400 steps of the tank.

A worker prints a line before each run and one after it, so that a process that dies names its run.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

import twistax as tx
from twistax.mechanics import Drive, Link, Mechanism, SpatialInertia, joints
from twistax.trajectory import Collocation, Problem

SETS = 33
#: A process has this many structures, so that what they share is compiled once, and so much time, s.
_TOGETHER, _PATIENCE = 5, 1500


@dataclasses.dataclass(frozen=True)
class Numbers:
    """One set of numbers: a rate, a start, an end and levels of a table, of all magnitudes."""

    rate: float
    start: float
    end: float
    levels: np.ndarray

    @classmethod
    def of(cls, number: int) -> Numbers:
        rng = np.random.default_rng(number)
        signs = rng.choice([-1.0, 1.0], 2)
        levels = rng.choice([0.0, 1.0, -1e3, 1e12, 1e30], 3)
        rate, start = signs * 10.0 ** rng.uniform([-2.0, -2.0], [10.0, 6.0])
        return cls(float(rate), float(start), float(10.0 ** rng.uniform(-2.0, 2.0)), levels)


# ---- systems -------------------------------------------------------------------------------------------------------

a, F = tx.Parameter("a", value=1.0), tx.Control("F")


def scalar(rate: Callable[[Any], Any]) -> tx.Dynamics:
    x = tx.State("x")
    return tx.compile(tx.System(rates={x: rate(x)}, outputs={"double": 2.0 * x}))


def spun() -> tx.Dynamics:
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    return tx.compile(tx.System(rates={R: w, w: a * tx.linalg.Norm(w) * w}))


def falling() -> tx.Dynamics:
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    p = g[:3, 3]
    pull = g[:3, :3].T @ (-tx.Sign(a) * p / tx.linalg.Norm(p) ** 3)
    return tx.compile(tx.System(rates={g: V, V: tx.Concat(pull, a * V[3:])}))


def singular() -> tx.Dynamics:
    x = tx.State("x", shape=(3,))
    M = tx.linalg.Outer(x, x) + a * np.diag([1.0, 0.0, 1e-12])
    return tx.compile(tx.System(rates={x: tx.linalg.Solve(M, x)}))


def tank() -> tx.Dynamics:
    bob = SpatialInertia(mass=20.0, center_of_mass=(0, 0, -0.3), inertia=1e-6 * np.eye(3))
    hub = SpatialInertia(mass=750.0, inertia=np.diag([900.0, 800.0, 600.0]))
    place = tx.pose(position=[0.1, 0.1, -0.2])
    damped = Drive(damping=tx.Parameter("a", value=1.0))
    links = [
        Link(joints.Free("hub"), hub, tx.pose()),
        Link(joints.Spherical("tank"), bob, place, parent="hub", drive=damped),
    ]
    return tx.compile(Mechanism(links, gravity=(0.0, 0.0, 0.0)).system(controls=[]))


SYSTEMS: dict[str, Callable[[], tx.Dynamics]] = {
    "pole": lambda: scalar(lambda x: a * x * x),
    "root": lambda: scalar(lambda x: tx.Sqrt(a - x) + F),
    "wall": lambda: scalar(lambda x: tx.Where(x >= 0.5, -a, a) + F),
    "lag": lambda: scalar(lambda x: a * (tx.Cos(tx.Time()) - x) + F),
    "logarithm": lambda: scalar(lambda x: a * tx.Log(x)),
    "spun": spun,
    "falling": falling,
    "singular": singular,
    "tank": tank,
}
RADAU = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)
HOW: dict[str, dict[str, Any]] = {
    "fixed": {"steps": 40},
    "chosen": {"rtol": 1e-5, "dense": True, "control": tx.StepControl(max_steps=400)},
    "Radau": {"rtol": 1e-4, "method": RADAU, "saved": True, "control": tx.StepControl(max_steps=400)},
    "Radau, fixed": {"steps": 12, "method": RADAU},
    "Radau, event": {"rtol": 1e-4, "method": RADAU, "event": True, "control": tx.StepControl(max_steps=400)},
}


def start_of(dynamics: tx.Dynamics, value: float) -> dict[str, Any]:
    """A start of this size in every number that has one."""
    found: dict[str, Any] = {}
    for state in dynamics.states:
        shape = dynamics.group.factors[state.name].shape
        if shape == (4, 4):
            found[state.name] = tx.pose(position=[min(abs(value), 1e3), 0.1, 0.0])
        elif shape == (3, 3):
            found[state.name] = np.eye(3)
        else:
            found[state.name] = np.full(shape, value) * np.linspace(1.0, 0.3, max(int(np.prod(shape)), 1)).reshape(
                shape
            )
    return found


def integrated(system: str, how: str) -> Callable[[Numbers, bool], str]:
    dynamics = SYSTEMS[system]()
    options = dict(HOW[how])
    saved, event = options.pop("saved", False), options.pop("event", False)
    if event:
        first = dynamics.states[0]
        shape = dynamics.group.factors[first.name].shape
        options["event"] = tx.Event((first if not shape else first[(0,) * len(shape)]) - 7.0)
    driven = bool(dynamics.controls)

    def call(numbers: Numbers, throw: bool, **changed: Any) -> tx.Solution:
        start = start_of(dynamics, numbers.start)
        u = (
            {"F": tx.ZeroOrderHold(ts=numbers.end * np.array([0.0, 0.4, 1.0]), values=numbers.levels)}
            if driven
            else None
        )
        times = np.linspace(0.0, numbers.end, 7) if saved else None
        params = {"a": numbers.rate, **changed}
        return tx.integrate(dynamics, start, t1=numbers.end, u=u, params=params, save_at=times, throw=throw, **options)

    def run(numbers: Numbers, slopes: bool) -> str:
        found = call(numbers, False)
        np.asarray([np.asarray(v).sum() for v in found.outputs.values()])
        failed = found.result not in (tx.Result.SUCCESS, tx.Result.EVENT)
        message = ""
        try:
            call(numbers, True)
        except tx.IntegrationError as error:
            message = str(error)
        assert failed == ("fix: " in message), message
        if slopes and failed:

            def of(rate: Any) -> Any:
                return sum(v[-1].sum() for v in call(numbers, False, a=rate).xs.values())

            for slope in (jax.jit(jax.grad(of)), jax.jit(jax.jacfwd(of))):
                assert np.isnan(slope(numbers.rate)), "the derivative of a failure is a number"
        return found.result.name

    return run


def solved(cost: str) -> Callable[[Numbers, bool], str]:
    x, u = tx.State("x"), tx.Control("u", min=-10.0, max=10.0)
    rates = {"root": tx.Sqrt(a - x) + u, "lag": a * (u - x), "pole": a * x * x + u}
    dynamics = tx.compile(tx.System(rates={x: rates[cost]}))
    problem = Problem(
        dynamics,
        tx.Minimize(running=u**2),
        nodes=5,
        transcription=Collocation(tx.tableaus.RADAU_IIA5),
        initial={"x": 1.0},
        final={"x": 0.0},
        final_time=1.0,
    )

    def run(numbers: Numbers, slopes: bool) -> str:
        ends: dict[str, Any] = {"initial": {"x": numbers.start}, "final_time": numbers.end}
        result = problem.solve(params={"a": numbers.rate}, max_iterations=20, **ends)
        try:
            str(result.mesh_error)
        except tx.TwistaxError as error:
            return f"{result.status.name}, {type(error).__name__}"
        return str(result.status.name)

    return run


_MADE = [(f"{system}, {how}", system, how) for system in SYSTEMS for how in HOW]
#: Every system in three ways, each way about as often as the others; and three solves.
STRUCTURES: dict[str, Callable[[], Callable[[Numbers, bool], str]]] = {
    name: lambda system=system, how=how: integrated(system, how)  # type: ignore[misc]
    for k, (name, system, how) in enumerate(_MADE)
    if (k % 5 + k // 5) % 5 < 3
}
STRUCTURES |= {f"solve, {cost}": lambda cost=cost: solved(cost) for cost in ("root", "lag", "pole")}  # type: ignore[misc]


# ---- running them --------------------------------------------------------------------------------------------------


def work(structures: list[str], sets: list[int], slopes: bool) -> None:
    """Run all in this process."""
    for name in structures:
        print(f"begin {name}", flush=True)
        run = STRUCTURES[name]()
        for number in sets:
            print(f"begin {name} {number}", flush=True)
            try:
                said = run(Numbers.of(number), slopes and number == sets[0])
            except tx.TwistaxError as error:
                said = type(error).__name__
            except Exception as error:
                said = f"WRONG {type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"
            print(f"end {name} {number}: {said}", flush=True)


def worker(structures: list[str], sets: list[int], x64: bool, slopes: bool, patience: float) -> tuple[list[str], str]:
    """The ends that a process told of, and the run in which it died, if it did."""
    command = [sys.executable, __file__, "--work", "--structures", ";".join(structures)]
    command += ["--sets", ",".join(map(str, sets)), *(["--slopes"] if slopes else [])]
    settings = {**os.environ, "JAX_ENABLE_X64": str(int(x64)), "JAX_PLATFORMS": "cpu"}
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=settings, timeout=patience)
        output, code, errors = done.stdout, done.returncode, done.stderr
    except subprocess.TimeoutExpired as error:
        output, code, errors = (error.stdout or b"").decode(), None, "it took too long"
    lines = output.splitlines()
    if code == 0:
        return lines, ""
    begun = [line for line in lines if line.startswith("begin")]
    where = begun[-1] if begun else "the start"
    return lines, f"{where} (x64 {x64}): code {code}: {errors.strip().splitlines()[-1:]}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--structures", help="names, separated by semicolons; all if left out")
    parser.add_argument("--sets", help="numbers of sets, separated by commas; all if left out")
    parser.add_argument("--slopes", action="store_true", help="derivatives of the first set too")
    parser.add_argument("--work", action="store_true", help="in this process")
    given = parser.parse_args()
    structures = given.structures.split(";") if given.structures else list(STRUCTURES)
    sets = [int(k) for k in given.sets.split(",")] if given.sets else list(range(SETS))
    if given.work:
        work(structures, sets, given.slopes)
        return
    ends: collections.Counter[str] = collections.Counter()
    died, wrong = [], []
    for first in range(0, len(structures), _TOGETHER):
        for x64 in (True, False):
            part, numbers = structures[first : first + _TOGETHER], sets[x64::2]
            lines, death = worker(part, numbers, x64, given.slopes, _PATIENCE)
            said = [line for line in lines if line.startswith("end")]
            ends.update(line.split(": ", 1)[1].split(":")[0] for line in said)
            wrong += [f"{line} (x64 {x64})" for line in said if "WRONG" in line]
            died += [death] if death else []
            print(f"{part} x64 {x64}: {len(said)} runs{', DIED: ' + death if death else ''}", flush=True)
    print(f"{sum(ends.values())} runs: {dict(ends.most_common())}")
    print(f"{len(died)} processes died", *died, f"{len(wrong)} runs ended wrongly", *wrong, sep="\n  ")
    sys.exit(bool(died or wrong))


if __name__ == "__main__":
    main()
