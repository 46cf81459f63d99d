"""Check-cases 1 to 10 of NASA/TM-2015-218675, compared with the published simulations.

    python examples/nasa_check_cases.py                          final states, compared with the published ones
    python examples/nasa_check_cases.py DIR [--plot FILE]        differences from every trajectory in DIR over 30 s

DIR holds the published trajectories as <case>/sim_<number>[_si].csv, in the folders of `twistax.scenes.published`.
Cases without a folder are omitted.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import itertools
from pathlib import Path
from typing import Any

import jax
import numpy as np

import twistax as tx
from twistax.mechanics import flight
from twistax.mechanics.environment import atmosphere, earth
from twistax.scenes.check_cases import CASES, CheckCase, system
from twistax.scenes.published import DURATION, EARTH, FOLDERS, TIMES, Array, Track, read
from twistax.scenes.spheres import SPHERES, SphereCase

jax.config.update("jax_enable_x64", True)

STEP = 2.5e-3  # s, of cases 1 to 3
SPHERE_STEP = 1e-2  # s


# ---- flying ------------------------------------------------------------------------------------------------------

dynamics = tx.compile(system())
_euler = jax.jit(jax.vmap(tx.lie.euler))


@functools.partial(jax.jit, static_argnums=0)
def outputs(dynamics: tx.Dynamics, ts: Any, xs: Any, params: Any) -> dict[str, jax.Array]:
    """The system's outputs along a solution."""
    return jax.vmap(lambda t, x: dynamics.outputs(t, x, None, params))(ts, xs)


def solve(case: CheckCase, step: float = STEP, dynamics: tx.Dynamics = dynamics) -> Track:
    """A case by RKMK of order 4 with fixed steps."""
    params = case.parameters()
    method = tx.RKMK(tx.tableaus.RK4)
    solution = tx.integrate(dynamics, case.start(), t1=DURATION, dt=step, method=method, params=params, save_at=TIMES)
    return track_of(dynamics, solution, params)


def track_of(dynamics: tx.Dynamics, solution: tx.Solution, params: Any = None) -> Track:
    """What of a solution is compared."""
    found = outputs(dynamics, solution.ts, solution.xs, params)
    return Track(*(np.asarray(found[field.name]) for field in dataclasses.fields(Track)))


class Tabulated:
    """The standard atmosphere with the density of a trajectory, by a cubic spline over altitude."""

    def __init__(self, track: Track) -> None:
        self.altitudes, places = np.unique(track.altitude, return_index=True)
        self.densities = track.density[places]

    def density(self, altitude: tx.Expr) -> tx.Expr:
        return tx.Cinterp(altitude, self.altitudes, self.densities)

    def __getattr__(self, name: str) -> Any:
        return getattr(atmosphere.US1976, name)


@functools.cache
def sphere_dynamics(planet: flight.Planet, wind: flight.Wind) -> tx.Dynamics:
    """Cases in the same surroundings are one compiled system."""
    return tx.compile(SphereCase(0, "", planet, wind).system())


def fly_sphere(case: SphereCase, step: float = SPHERE_STEP) -> Track:
    """Cases 4 to 10, by the same method."""
    dynamics = sphere_dynamics(case.planet, case.wind)
    solution = tx.integrate(dynamics, case.start(), t1=DURATION, dt=step, save_at=TIMES)
    return track_of(dynamics, solution)


# ---- comparing ---------------------------------------------------------------------------------------------------


def spread(tracks: dict[str, Track]) -> dict[str, Array]:
    """The largest difference between any two simulations, at each time."""
    pairs = [a.apart(b) for a, b in itertools.combinations(tracks.values(), 2)]
    return {name: np.max([pair[name] for pair in pairs], axis=0) for name in pairs[0]}


def row(name: str, difference: dict[str, Array]) -> None:
    cells = "   ".join(f"{values.max():9.2e} {values[-1]:9.2e}" for values in difference.values())
    print(f"  {name:32s} {cells}")


def beyond(differences: Array) -> Array:
    """How far zero lies outside the simulations' differences from us (simulation, time, component), at each time."""
    return np.maximum(differences.min(axis=0), -differences.max(axis=0)).max(axis=-1)


def inside(ours: Track, tracks: dict[str, Track]) -> None:
    """Print whether we lie among the simulations, and by how much we do not."""
    rates = np.stack([track.rate - ours.rate for track in tracks.values()])
    angles = np.stack([np.asarray(_euler(track.attitude)) - _euler(ours.attitude) for track in tracks.values()])
    farthest = np.max([ours.apart(track)["attitude"] for track in tracks.values()], axis=0)
    for text, outside, unit in [
        ("each body rate between the least and the greatest of the simulations", beyond(rates), "rad/s"),
        ("attitude no farther from any than some two are apart", farthest - spread(tracks)["attitude"], "rad"),
        ("each Euler angle between the least and the greatest", beyond(np.angle(np.exp(1j * angles))), "rad"),
    ]:
        count = int((outside <= 0.0).sum())
        by = "" if count == len(TIMES) else f", elsewhere outside by at most {outside.max():.0e} {unit}"
        print(f"  {text}: {count} of {len(TIMES)} times{by}")


def explain(case: CheckCase, tracks: dict[str, Track]) -> None:
    """Print what becomes of the differences where damping or air are changed to what a simulation seems to use."""
    assert case.damping is not None
    turning = dataclasses.replace(case.damping, frame_rate=earth.WGS84.rate)
    rounded = dataclasses.replace(case.damping, chord=0.67 * 0.3048)
    relative = solve(dataclasses.replace(case, damping=turning))
    print("  with damping by the rates relative to the turning Earth:")
    for number, track in tracks.items():
        row(f"twistax - sim {number}", relative.apart(track))
    print("  with the density of the simulation, and for 01 a chord of 0.67 ft for 2/3 ft:")
    for number, damping in {"01": rounded, "04": case.damping}.items():
        if number not in tracks:
            continue
        theirs = tx.compile(system(dataclasses.replace(EARTH, air=Tabulated(tracks[number]))))
        solved = solve(dataclasses.replace(case, damping=damping), dynamics=theirs)
        row(f"twistax - sim {number}", solved.apart(tracks[number]))


def compare(directory: Path) -> dict[str, dict[str, dict[str, Array]]]:
    """Print the differences of every case; return them by case and by what is compared."""
    present = [number for number, folder in FOLDERS.items() if (directory / folder).is_dir()]
    if not present:
        raise tx.InputError(f"none of the folders {', '.join(FOLDERS.values())} is in {directory}")
    shown = {}
    for case in (CASES[number] for number in present if number in CASES):
        tracks, ours = read(directory, case.number), solve(case)
        print(f"\nCase {case.number}, {case.title}: largest over {DURATION:g} s, and at the end")
        print(f"  {'':32s} {'position, m':^19s}   {'attitude, rad':^19s}   {'body rate, rad/s':^19s}")
        lines = {f"sim {number}": ours.apart(track) for number, track in tracks.items()}
        lines["most between two simulations"] = spread(tracks)
        for name, line in lines.items():
            row(f"twistax - {name}" if name.startswith("sim") else name, line)
        row("twistax, step halved", ours.apart(solve(case, STEP / 2.0)))
        inside(ours, tracks)
        off = {number: np.max(np.abs(track.density / ours.density - 1.0)) for number, track in tracks.items()}
        print("  density, relative difference: " + ", ".join(f"sim {n} {x:.0e}" for n, x in off.items()))
        if case.damping:
            explain(case, tracks)
        shown[f"case {case.number}, {case.title}"] = lines
    for sphere in (SPHERES[number] for number in present if number in SPHERES):
        compare_sphere(sphere, read(directory, sphere.number, sphere.planet.figure))
    return shown


def compare_sphere(case: SphereCase, tracks: dict[str, Track]) -> None:
    """Print the differences of one of the cases 4 to 10."""
    ours = fly_sphere(case)
    print(f"\nCase {case.number}, {case.title}: largest over {DURATION:g} s, and at the end")
    for number, track in tracks.items():
        row(f"twistax - sim {number}", ours.apart(track))
    row("twistax, step halved", ours.apart(fly_sphere(case, SPHERE_STEP / 2.0)))
    off = {number: np.nanmax(np.abs(track.density / ours.density - 1.0)) for number, track in tracks.items()}
    print("  density, relative difference: " + ", ".join(f"sim {n} {x:.0e}" for n, x in off.items()))
    nearest = min(off, key=lambda number: off[number])
    theirs = dataclasses.replace(case.planet, air=Tabulated(tracks[nearest]))
    flown = fly_sphere(dataclasses.replace(case, planet=theirs))
    row(f"with the density of sim {nearest}", flown.apart(tracks[nearest]))


def show_ends() -> None:
    """Print where each case ends, beside the published ends."""
    for case in CASES.values():
        ours = solve(case)
        euler = np.round(_euler(ours.attitude)[-1], 12) + 0.0  # no minus before a zero
        print(f"\nCase {case.number}, {case.title}, at {DURATION:g} s")
        print(f"  {'':8s} {'inertial x, y, m':^31s}   {'roll, pitch, yaw, rad':^37s}   {'body rate, rad/s':^44s}")
        ends = [("twistax", ours.position[-1], euler, ours.rate[-1])]
        ends += [(f"sim {end.simulation}", end.position, end.euler, end.rate) for end in case.published]
        for name, position, angles, rate in ends:
            place = "not given" if position is None else " ".join(f"{x:15.6f}" for x in position[:2])
            print(
                f"  {name:8s} {place:>31s}   {' '.join(f'{x:12.9f}' for x in angles)}   "
                f"{' '.join(f'{x:14.7e}' for x in rate)}"
            )
        halved = ours.apart(solve(case, STEP / 2.0))
        print("  largest change when the step is halved: " + ", ".join(f"{k} {v.max():.0e}" for k, v in halved.items()))
    for number in (6, 9, 10):
        place = " ".join(f"{x:.6f}" for x in fly_sphere(SPHERES[number]).position[-1])
        print(f"\nCase {number}, {SPHERES[number].title}, at {DURATION:g} s: inertial position {place} m")


def plot(shown: dict[str, dict[str, dict[str, Array]]], file: Path) -> None:
    """Differences over time, a column a case."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(3, len(shown), figsize=(10.5, 7.0), sharex=True, layout="constrained")
    labels = {"position": "position, m", "attitude": "attitude, rad", "rate": "body rate, rad/s"}
    for column, (title, lines) in zip(axes.T, shown.items()):
        column[0].set_title(title, fontsize=10)
        column[-1].set_xlabel("time, s")
        for axis, quantity in zip(column, labels):
            for name, line in lines.items():
                style: dict[str, Any] = (
                    {"lw": 1.2} if name.startswith("sim") else {"color": "0.6", "lw": 4.0, "zorder": 0}
                )
                values = np.where(line[quantity] > 0.0, line[quantity], np.nan)
                axis.semilogy(TIMES, values, label=f"twistax - {name}" if name.startswith("sim") else name, **style)
            axis.grid(alpha=0.3)
    for axis, label in zip(axes[:, 0], labels.values()):
        axis.set_ylabel(label)
    figure.legend(*axes[0, 1].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=9)
    figure.savefig(file, dpi=72)
    print(f"\nplot written to {file}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("directory", nargs="?", type=Path, metavar="DIR", help="folder of the published trajectories")
    parser.add_argument(
        "--plot", type=Path, metavar="FILE", help="write the differences over time as a figure; needs DIR"
    )
    arguments = parser.parse_args()
    if arguments.directory is None:
        if arguments.plot:
            parser.error("--plot shows differences from the published trajectories: give their folder DIR too")
        show_ends()
        return
    if not arguments.directory.is_dir():
        parser.error(f"DIR must be a folder with the published trajectories; there is none at {arguments.directory}")
    try:
        shown = compare(arguments.directory)
    except tx.InputError as error:
        parser.error(str(error))
    if arguments.plot:
        plot(shown, arguments.plot)


if __name__ == "__main__":
    main()
