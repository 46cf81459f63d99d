"""`python -m twistax demo`: land a rocket and say how well."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import twistax as tx

from ..scenes import powered_descent as scene
from ..scenes.touchdown import SAMPLES, Descent, Miss, planned, reaches, replayed
from .derivatives import BAR, DerivativeCheck, check_derivatives
from .figure import save_figure
from .progress import Progress
from .table import describe_failure, describe_limits, describe_misses, save_table

__all__ = ["run"]

#: Points at which the derivatives are checked.
_POINTS = 6


class _Report:
    """Lines of what was done, each part under a word, and the time it took."""

    def __init__(self) -> None:
        self.begin = self._clock = time.perf_counter()

    def lap(self) -> float:
        """Seconds since the last lap."""
        before, self._clock = self._clock, time.perf_counter()
        return self._clock - before

    def say(self, word: str, *lines: str) -> None:
        for number, line in enumerate(lines):
            print(f"{'' if number else word:<9} {line}".rstrip(), flush=True)


def run(arguments: argparse.Namespace) -> int:
    """Compile, check, solve, simulate, draw and table.

    Args:
        arguments: what `add_options` declares.
    Returns:
        the exit status: 0 landed, 1 no landing found, 2 the folder cannot be written.
    """
    report = _Report()
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"twistax demo: cannot write to --out {arguments.out}: {error.strerror}", file=sys.stderr)
        return 2
    start, vehicle = arguments.initial, scene.Vehicle()
    report.say("start", _describe_start(start, vehicle))

    dynamics = tx.compile(scene.system(vehicle))
    problem = scene.problem(dynamics, start, vehicle, nodes=arguments.nodes)
    check = _check(dynamics, vehicle)
    report.say("check", *_describe_check(check), f"compiled and checked in {report.lap():.1f} s")

    progress = Progress(sys.stdout, "solve")
    progress.note("compiling ...")
    result = problem.solve(seed=arguments.guess_seed, callback=progress.update, max_iterations=arguments.max_iterations)
    progress.close()
    report.lap()
    report.say(
        "solve",
        f"compiled in {result.compile_seconds:.1f} s, solved in {result.solve_seconds:.1f} s, "
        f"{result.iterations} iterations",
        f"{result.status}",
    )

    rollouts, failures = _rollouts(result)
    nodes = planned(result)
    dense = next(iter(rollouts.values()), nodes)
    misses = {name: Miss.of(descent) for name, descent in rollouts.items()}
    limits = scene.limits(vehicle)
    found = reaches(dense, limits)
    report.say("rollouts", *failures, *describe_misses(misses), f"simulated in {report.lap():.1f} s")
    report.say("limits", *describe_limits(found))

    violated = [*failures, *describe_failure(misses, found, dense.ts[-1], vehicle.flight_time)]
    landed = result.solved and not violated
    report.say("files", *_save(arguments.out, start, dense, nodes, limits, vehicle, landed), f"in {report.lap():.1f} s")
    report.say("time", f"{time.perf_counter() - report.begin:.1f} s in all, imports aside")
    if landed:
        report.say("landed", _describe_landing(dense))
        return 0
    print("\nNo landing was found from this start; the best try was saved. What is wrong with it:")
    print(*(f"  - {line}" for line in (result.message, *violated)), sep="\n")
    print("Another guess (--guess-seed 1), more --nodes or --max-iterations, or an easier --initial may help.")
    return 1


def _describe_start(start: scene.Start, vehicle: scene.Vehicle) -> str:
    offset, velocity = np.linalg.norm(start.offset), np.linalg.norm(start.velocity)
    return (
        f"{vehicle.mass / 1e3:g} t, {start.height:g} m up, {offset:.0f} m off the pad, at {velocity:.0f} m/s "
        f"({-start.velocity[2]:g} down), tilted by {np.rad2deg(start.tilt):g} deg, "
        f"turning back at {np.rad2deg(start.righting):g} deg/s"
    )


def _describe_landing(descent: Descent) -> str:
    mass = descent.xs["m"]
    return f"after {descent.ts[-1]:.2f} s with {mass[-1]:,.0f} kg; {mass[0] - mass[-1]:,.0f} kg of propellant burnt"


def _check(dynamics: tx.Dynamics, vehicle: scene.Vehicle) -> DerivativeCheck:
    """Check the derivatives at points scattered around a descent."""
    rng, final_time = np.random.default_rng(0), float(np.mean(vehicle.flight_time))
    guess = scene.guess(scene.Start(), vehicle, _POINTS + 1, final_time)
    xs = {name: guess[name][:-1] for name in ("g", "V", "m")}
    xs["V"] = xs["V"] + rng.normal(size=(_POINTS, 6)) * np.array([5.0, 5.0, 5.0, 0.5, 0.5, 0.5])
    us = {"T": guess["T"] + rng.normal(size=(_POINTS, 3)) * 0.05 * vehicle.max_thrust}
    return check_derivatives(dynamics, xs, us, h=0.5)


def _describe_check(check: DerivativeCheck) -> list[str]:
    verdict = "they agree" if check.holds else "THEY DO NOT AGREE"
    return [
        f"derivatives against finite differences, in the tangent space, at {check.points} points:",
        f"rates and limits differ by {check.rates:.1e}, the end of an interval by {check.interval:.1e}; "
        f"allowed {BAR:.0e}: {verdict}",
    ]


def _rollouts(result: tx.trajectory.TrajectoryResult) -> tuple[dict[str, Descent], list[str]]:
    """The found controls simulated by two methods, and a line for each that gave up."""
    import diffrax

    methods: dict[str, Any] = {
        f"RKMK4, {SAMPLES} steps an interval": tx.RKMK(tx.tableaus.RK4),
        "diffrax Dopri8 on quaternions, 1e-10": diffrax.Dopri8(),
    }
    rollouts, failures = {}, []
    for name, method in methods.items():
        try:
            rollouts[name] = replayed(result, method)
        except tx.IntegrationError as error:
            failures.append(f"{name}: {str(error).splitlines()[0]}")
    return rollouts, failures


def _save(
    folder: Path,
    start: scene.Start,
    dense: Descent,
    nodes: Descent,
    limits: list[scene.Limit],
    vehicle: scene.Vehicle,
    landed: bool,
) -> list[str]:
    """Write table and figure; a line for each."""
    stem = folder / ("landing" if landed else "best_try")
    what = f"landed after {dense.ts[-1]:.1f} s" if landed else "no landing found, the best try"
    title = f"6-DoF powered descent: {start.height:g} m up, tilted {np.rad2deg(start.tilt):g} deg, {what}"
    table, figure = stem.with_suffix(".csv"), stem.with_suffix(".png")
    save_table(table, dense)
    try:
        save_figure(figure, title, dense, nodes, limits, vehicle)
    except ImportError:
        return [f"{table}", "no figure: it needs matplotlib; get it with pip install 'twistax[plot]'"]
    return [f"{figure}", f"{table}"]
