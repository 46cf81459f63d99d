"""`python -m twistax demo`: land a rocket and report the result. An example that uses only public names.

A powered descent is compiled, its derivatives are checked, it is solved, simulated with the optimal controls, drawn and
written as a table.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import twistax as tx

from ..scenes import powered_descent as scene
from ..scenes.touchdown import ALLOWED, SAMPLES, Descent, Miss, Reach, planned, reaches, replayed
from . import tumbling
from .derivatives import BAR, check_derivatives
from .figure import ENLARGED, LENGTH, PLUME, RADIUS, save_figure, save_table

#: What an interval may miss by, and limits between nodes may be exceeded by, in scales of states and limits.
_REFINED, _BETWEEN = 1e-4, 1e-4
#: Statuses with which the simulated controls decide. COARSE and EXCEEDED are optima on meshes that are not good enough.
_SIMULATED = (tx.trajectory.Status.SOLVED, tx.trajectory.Status.COARSE, tx.trajectory.Status.EXCEEDED)


def run(arguments: argparse.Namespace) -> int:
    """Compile, check, solve, simulate, draw and write the table.

    Args:
        arguments: what `add_options` declares.
    Returns:
        the exit status: 0 landed, 1 no landing found, 2 the folder cannot be written.
    """
    begin = time.perf_counter()
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"twistax demo: cannot write to --out {arguments.out}: {error.strerror}", file=sys.stderr)
        return 2
    with tx.trajectory.Progress("body", stream=sys.stdout):
        drawn = tumbling.draw(arguments.out)
    _say("body", *drawn, f"in {time.perf_counter() - begin:.1f} s")
    begin = time.perf_counter()
    start, vehicle = arguments.initial or scene.Start(), scene.Lander()
    _say("start", *describe_start(start, vehicle))
    dynamics = tx.compile(scene.system(vehicle))
    with tx.trajectory.Progress("check", stream=sys.stdout):
        checked = _check(dynamics, vehicle)
    _say("check", *checked, f"compiled and checked in {time.perf_counter() - begin:.1f} s")
    result = _solved(dynamics, start, vehicle, arguments)

    lap = time.perf_counter()
    with tx.trajectory.Progress("rollouts", stream=sys.stdout):
        rollouts, failures = _rollouts(result)
    dense = next(iter(rollouts.values()), planned(result))
    misses = {name: Miss.of(descent) for name, descent in rollouts.items()}
    reached = reaches(dense, scene.limits(vehicle))
    seconds = f"simulated in {time.perf_counter() - lap:.1f} s"
    _say("rollouts", *failures, *describe_misses(misses), seconds)
    _say("limits", *describe_limits(reached))
    violated = [*failures, *describe_failure(misses, reached, dense.ts[-1], vehicle.flight_time)]
    landed = result.status in _SIMULATED and not violated
    table = arguments.out / ("landing.csv" if landed else "best_try.csv")
    lap = time.perf_counter()
    with tx.trajectory.Progress("files", stream=sys.stdout):
        files = _written(table, result, dense, start, vehicle, landed)
    _say("files", *files, f"in {time.perf_counter() - lap:.1f} s")
    _say("time", f"{time.perf_counter() - begin:.1f} s in all, imports aside")
    if landed:
        mass = dense.xs["m"]
        burnt = f"{mass[0] - mass[-1]:,.0f} kg of propellant burnt"
        _say("landed", f"after {dense.ts[-1]:.2f} s with {mass[-1]:,.0f} kg; {burnt}")
        return 0
    print("\nNo landing was found from this start; the best try was saved. It violates:")
    print(*(f"  - {line}" for line in (result.message, *violated)), sep="\n")
    print("Another guess (--guess-seed 1), more --nodes or --max-iterations, or an easier --initial may help.")
    return 1


def _say(word: str, *lines: str) -> None:
    for number, line in enumerate(lines):
        print(f"{'' if number else word:<9} {line}".rstrip(), flush=True)


def _check(dynamics: tx.Dynamics, vehicle: scene.Lander, points: int = 6) -> list[str]:
    """Check the derivatives at points scattered around a descent."""
    rng, final_time = np.random.default_rng(0), float(np.mean(vehicle.flight_time))
    guess = scene.guess(scene.Start(), vehicle, points + 1, final_time)
    xs = {name: guess[name][:-1] for name in ("g", "V", "m")}
    xs["V"] = xs["V"] + rng.normal(size=(points, 6)) * np.array([5.0, 5.0, 5.0, 0.5, 0.5, 0.5])
    us = {"T": guess["T"] + rng.normal(size=(points, 3)) * 0.05 * vehicle.max_thrust}
    check = check_derivatives(dynamics, xs, us, h=0.5)
    return [
        f"derivatives against finite differences, in the tangent space, at {check.points} points:",
        f"rates and limits differ by {check.rates:.1e}, the end of an interval by {check.interval:.1e}; "
        f"allowed {BAR:.0e}: {'they agree' if check.holds else 'THEY DO NOT AGREE'}",
    ]


def _solved(
    dynamics: tx.Dynamics, start: scene.Start, vehicle: scene.Lander, arguments: argparse.Namespace
) -> tx.trajectory.TrajectoryResult:
    problem = scene.problem(dynamics, start, vehicle, nodes=arguments.nodes)
    result = problem.solve(
        seed=arguments.guess_seed,
        progress=tx.trajectory.Progress("solve", cost="mass {:9,.0f} kg", stream=sys.stdout),
        max_iterations=arguments.max_iterations,
        refine=_REFINED,
        between=_BETWEEN,
    )
    meshes = [
        f"{mesh.nodes} nodes: an interval misses by {mesh.error:.1e} at most, allowed {_REFINED:.0e}; "
        f"mass {abs(mesh.cost):,.1f} kg"
        for mesh in result.meshes
    ]
    kept = [f"between nodes limits hold within {_BETWEEN:.0e} of their scales"] if result.solved else []
    seconds = f"compiled in {result.compile_seconds:.1f} s, solved in {result.solve_seconds:.1f} s"
    _say("solve", seconds, *meshes, f"{result.status}", *kept)
    return result


def _rollouts(result: tx.trajectory.TrajectoryResult) -> tuple[dict[str, Descent], list[str]]:
    """The controls simulated by two methods, and a line for each that gave up."""
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


def _written(
    table: Path, result: Any, dense: Descent, start: scene.Start, vehicle: scene.Lander, landed: bool
) -> list[str]:
    """The files of table, figure and animation; for the last two the reason where they are not written."""
    figure, animation = table.with_suffix(".png"), table.with_suffix(".html")
    what = f"landed after {dense.ts[-1]:.1f} s" if landed else "no landing found, the best try"
    title = f"6-DoF powered descent: {start.height:g} m up, tilted {np.rad2deg(start.tilt):g} deg, {what}"
    save_table(table, dense)
    files = [str(figure), str(animation), str(table)]
    try:
        save_figure(figure, title, dense, planned(result), scene.limits(vehicle), vehicle)
    except ImportError:
        files[0] = "no figure: it needs matplotlib; get it with pip install 'twistax[plot]'"
    try:
        result.show(
            animation,
            bodies={"g": tx.view.Cylinder(ENLARGED * RADIUS, ENLARGED * LENGTH)},
            arrows={
                "T": tx.view.Arrow(at=ENLARGED * np.array(vehicle.engine), scale=-ENLARGED * PLUME / vehicle.max_thrust)
            },
            shapes=[tx.view.Cone(4.0 * LENGTH, vehicle.glide_slope, color=(91, 154, 104))],
        )
    except tx.ModelError:
        files[1] = "no animation: it needs viser; get it with pip install 'twistax[view]'"
    return files


# ---- words -----------------------------------------------------------------------------------------------------------


def describe_start(start: scene.Start, vehicle: scene.Lander) -> list[str]:
    """A text about the start of the descent."""
    offset, speed = np.linalg.norm(start.offset), np.linalg.norm(start.velocity)
    return [
        f"{vehicle.mass / 1e3:g} t, {start.height:g} m up, {offset:.0f} m off the pad, at {speed:.0f} m/s "
        f"({-start.velocity[2]:g} down), tilted by {np.rad2deg(start.tilt):g} deg, "
        f"turning back at {np.rad2deg(start.righting):g} deg/s"
    ]


def describe_misses(misses: Mapping[str, Miss]) -> list[str]:
    """A line for every rollout, under a heading."""
    lines = [f"{'simulated, ends off the pad by':<44}{'position':>12}{'velocity':>14}{'upright':>13}"]
    for name, miss in misses.items():
        lines.append(f"{name:<44}{miss.position:>10.4f} m{miss.velocity:>10.4f} m/s{miss.angle:>9.4f} deg")
    return lines


def describe_limits(reached: Sequence[Reach]) -> list[str]:
    """A line for every limit, under a heading."""
    lines = [f"{'between the nodes':<18}{'limit':>15}{'nearest':>14}{'at':>10}{'margin':>15}"]
    for reach in reached:
        limit = reach.limit
        bound = f"{limit.relation} {limit.shown} {limit.unit}"
        # Adding zero turns a rounded -0.0 into 0.0.
        margin = f"{round(reach.margin, 2) + 0.0:+,.2f} {limit.unit}"
        lines.append(f"{limit.name:<18}{bound:>15}{reach.value:>14,.2f}{reach.time:>8.2f} s{margin:>15}")
    return lines


def describe_failure(
    misses: Mapping[str, Miss], reached: Sequence[Reach], time: float, times: tuple[float, float]
) -> list[str]:
    """A text about the limits that an unsuccessful try violates; empty if there are none.

    Args:
        time, times: the flight time and its limits, s.
    """
    missed = [
        f"it ends {miss.position:,.2f} m off the pad, at {miss.velocity:,.2f} m/s, {miss.angle:,.2f} deg from "
        f"upright (simulated with {name})"
        for name, miss in misses.items()
        if not miss.within(ALLOWED)
    ]
    exceeded = [
        f"{reach.limit.name}: {reach.value:,.2f} {reach.limit.unit} at {reach.time:.2f} s, but the limit is "
        f"{reach.limit.relation} {reach.limit.shown} {reach.limit.unit}"
        for reach in reached
        if not reach.holds
    ]
    in_time = times[0] - 0.01 <= time <= times[1] + 0.01
    late = f"flight time: {time:.2f} s, but it must be from {times[0]:g} to {times[1]:g} s"
    return [*missed[:1], *exceeded, *([] if in_time else [late])]
