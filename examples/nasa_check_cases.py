"""Check-cases 1, 2 and 3 of NASA/TM-2015-218675, beside the published simulations.

    python examples/nasa_check_cases.py                          where each case ends, beside the published ends
    python examples/nasa_check_cases.py DIR [--plot FILE]        differences from every trajectory in DIR over 30 s

DIR holds the published trajectories as <case>/sim_<number>[_si].csv, in the folders named in FOLDERS.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import functools
import itertools
import re
from pathlib import Path
from typing import Any

import jax
import numpy as np

import twistax as tx
from twistax.mechanics.environment import earth
from twistax.scenes.check_cases import CASES, DURATION, CheckCase, system

jax.config.update("jax_enable_x64", True)

FOLDERS = {1: "01_dragless_sphere", 2: "02_tumbling_brick", 3: "03_tumbling_brick_damped"}
SIMULATIONS = ("01", "02", "04", "06")
UNITS = {"m": 1.0, "ft": 0.3048, "rad": 1.0, "rad_s": 1.0, "deg": np.pi / 180.0, "deg_s": np.pi / 180.0}
UNITS |= {"kg_m3": 1.0, "slug_ft3": 515.3788184}
TIMES = np.linspace(0.0, DURATION, 301)
STEP = 2.5e-3  # s

Array = np.ndarray


@dataclasses.dataclass(frozen=True)
class Track:
    """A trajectory at TIMES, in SI.

    Attributes:
        position: inertial, (n, 3).
        attitude: rotations from body axes to north, east, down, (n, 3, 3).
        rate: body rate with respect to inertial axes, (n, 3).
        altitude: above the ellipsoid, (n,).
        density: of the air at that altitude, (n,).
    """

    position: Array
    attitude: Array
    rate: Array
    altitude: Array
    density: Array


# ---- flying ------------------------------------------------------------------------------------------------------

dynamics = tx.compile(system())


@functools.partial(jax.jit, static_argnums=0)
def outputs(dynamics: tx.Dynamics, ts: Any, xs: Any, params: Any) -> dict[str, jax.Array]:
    """The system's outputs along a solution."""
    return jax.vmap(lambda t, x: dynamics.outputs(t, x, None, params))(ts, xs)


def solve(case: CheckCase, step: float = STEP, dynamics: tx.Dynamics = dynamics) -> Track:
    """A case by RKMK of order 4 with fixed steps."""
    params = case.parameters()
    method = tx.RKMK(tx.tableaus.RK4)
    solution = tx.integrate(dynamics, case.start(), t1=DURATION, dt=step, method=method, params=params, save_at=TIMES)
    found = outputs(dynamics, solution.ts, solution.xs, params)
    return Track(**{field.name: np.asarray(found[field.name]) for field in dataclasses.fields(Track)})


@dataclasses.dataclass(frozen=True)
class Tabulated:
    """Air whose density is that of a trajectory, by a cubic spline over altitude."""

    track: Track

    def density(self, altitude: tx.Expr) -> tx.Expr:
        upwards = np.argsort(self.track.altitude)
        return tx.Cinterp(altitude, self.track.altitude[upwards], self.track.density[upwards])


# ---- reading -----------------------------------------------------------------------------------------------------

place, t = tx.State("place", shape=(3,)), tx.Time()
_fixed_position = tx.lower(earth.WGS84.position(place[0], place[1], place[2]))
_to_inertial = tx.lower(earth.WGS84.to_inertial(t))
_attitude = jax.jit(jax.vmap(lambda angles: tx.pose(euler=angles)[:3, :3]))
_euler = jax.jit(jax.vmap(tx.lie.euler))


class Table:
    """A published trajectory: columns named quantity_unit or quantity_unit_component, read in SI."""

    def __init__(self, path: Path) -> None:
        with path.open(newline="") as file:
            self.names, *rows = list(csv.reader(file)) or [[]]
        self.path = path
        try:
            self.values = np.array(rows, dtype=float)
        except ValueError as error:
            raise SystemExit(f"{path}: expected as many numbers in each row as there are columns: {error}") from None
        if self.values.shape[0] != len(TIMES) or not np.allclose(self["time"], TIMES, rtol=0.0, atol=1e-6):
            raise SystemExit(f"{path}: expected {len(TIMES)} rows from 0 to {DURATION:g} s at 10 Hz")

    def __getitem__(self, name: str) -> Array:
        if name not in self.names:
            raise SystemExit(f"{self.path}: no column {name}")
        return self.values[:, self.names.index(name)]

    def __contains__(self, quantity: str) -> bool:
        return any(name.startswith(quantity + "_") for name in self.names)

    def column(self, quantity: str, component: str = "") -> Array:
        ending = f"_{component}" if component else ""
        for name in self.names:
            unit = re.fullmatch(rf"{quantity}_(\w+?){ending}", name)
            if unit and unit[1] in UNITS:
                return UNITS[unit[1]] * self[name]
        raise SystemExit(f"{self.path}: no column {quantity}_<unit>{ending} with a unit among {', '.join(UNITS)}")

    def columns(self, quantity: str, components: str) -> Array:
        return np.stack([self.column(quantity, component) for component in components.split()], axis=1)

    def position(self) -> Array:
        """Inertial position, converted from Earth-fixed or geodetic coordinates where it is not given."""
        if "eiPosition" in self:
            return self.columns("eiPosition", "X Y Z")
        if "gePosition" in self:
            fixed = self.columns("gePosition", "X Y Z")
        else:
            places = [self.column("latitude"), self.column("longitude"), self.column("altitudeMsl")]
            fixed = jax.vmap(lambda p: _fixed_position(0.0, {"place": p}))(np.stack(places, axis=1))
        turns = jax.vmap(lambda now: _to_inertial(now, {}))(TIMES)
        return np.einsum("nij,nj->ni", turns, fixed)

    def track(self) -> Track:
        euler = self.columns("eulerAngle", "Roll Pitch Yaw")
        rate = self.columns("bodyAngularRateWrtEi", "Roll Pitch Yaw")
        air = self.column("altitudeMsl"), self.column("airDensity")
        return Track(self.position(), np.asarray(_attitude(euler)), rate, *air)


def read(directory: Path, case: CheckCase) -> dict[str, Track]:
    """The published simulations of a case."""
    folder = directory / FOLDERS[case.number]
    if not folder.is_dir():
        raise SystemExit(f"case {case.number}: no folder {folder}\n  fix: DIR must hold {', '.join(FOLDERS.values())}")
    found = {}
    for number in SIMULATIONS:
        files = [folder / f"sim_{number}{ending}.csv" for ending in ("_si", "")]
        path = next((file for file in files if file.is_file()), None)
        if path is None:
            raise SystemExit(f"case {case.number}: neither {files[0].name} nor {files[1].name} in {folder}")
        found[number] = Table(path).track()
    return found


# ---- comparing ---------------------------------------------------------------------------------------------------


def apart(a: Track, b: Track) -> dict[str, Array]:
    """Differences over time: distance in m, angle of the relative rotation in rad, size of the rate's difference."""
    chord = np.linalg.norm(a.attitude - b.attitude, axis=(1, 2)) / np.sqrt(8.0)
    return {
        "position": np.linalg.norm(a.position - b.position, axis=1),
        "attitude": 2.0 * np.arcsin(np.minimum(chord, 1.0)),
        "rate": np.linalg.norm(a.rate - b.rate, axis=1),
    }


def spread(tracks: dict[str, Track]) -> dict[str, Array]:
    """The largest difference between any two simulations, at each time."""
    pairs = [apart(a, b) for a, b in itertools.combinations(tracks.values(), 2)]
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
    farthest = np.max([apart(ours, track)["attitude"] for track in tracks.values()], axis=0)
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
        row(f"twistax - sim {number}", apart(relative, track))
    print("  with the density of the simulation, and for 01 a chord of 0.67 ft for 2/3 ft:")
    for number, damping in {"01": rounded, "04": case.damping}.items():
        theirs = tx.compile(system(Tabulated(tracks[number])))
        solved = solve(dataclasses.replace(case, damping=damping), dynamics=theirs)
        row(f"twistax - sim {number}", apart(solved, tracks[number]))


def compare(directory: Path) -> dict[str, dict[str, dict[str, Array]]]:
    """Print the differences of every case; return them by case and by what is compared."""
    shown = {}
    for case in CASES.values():
        tracks, ours = read(directory, case), solve(case)
        print(f"\nCase {case.number}, {case.title}: largest over {DURATION:g} s, and at the end")
        print(f"  {'':32s} {'position, m':^19s}   {'attitude, rad':^19s}   {'body rate, rad/s':^19s}")
        lines = {f"sim {number}": apart(ours, track) for number, track in tracks.items()}
        lines["most between two simulations"] = spread(tracks)
        for name, line in lines.items():
            row(f"twistax - {name}" if name.startswith("sim") else name, line)
        row("twistax, step halved", apart(ours, solve(case, STEP / 2.0)))
        inside(ours, tracks)
        off = {number: np.max(np.abs(track.density / ours.density - 1.0)) for number, track in tracks.items()}
        print("  density, relative difference: " + ", ".join(f"sim {n} {x:.0e}" for n, x in off.items()))
        if case.damping:
            explain(case, tracks)
        shown[f"case {case.number}, {case.title}"] = lines
    return shown


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
        halved = apart(ours, solve(case, STEP / 2.0))
        print("  largest change when the step is halved: " + ", ".join(f"{k} {v.max():.0e}" for k, v in halved.items()))


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
    shown = compare(arguments.directory)
    if arguments.plot:
        plot(shown, arguments.plot)


if __name__ == "__main__":
    main()
