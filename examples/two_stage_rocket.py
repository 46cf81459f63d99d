"""NASA's rocket of two stages from its DAVE-ML files: check-case 17 of NASA/TM-2015-218675, in four phases.

    python examples/two_stage_rocket.py DIR

DIR holds the published files, two_stage_rocket/twostage_*.dml and Atmos_17_sim_06.csv. They are not part of twistax.
docs/flight.md lists details of NASA's simulation that are inferred from its trajectory, because the files omit them.
"""

from __future__ import annotations

import argparse
import functools
from pathlib import Path
from typing import Any

import jax
import numpy as np

import twistax as tx
from twistax.mechanics import SpatialInertia, flight, load_daveml
from twistax.scenes.published import EARTH
from twistax.units import degrees, feet

jax.config.update("jax_enable_x64", True)

COAST = 96.79  # s between the stages
AREA = np.pi * 1.5**2  # m2, of the reference length of 3 m; the file rounds it to 7
CAPACITY = {"first": 180_000.0, "second": 80_000.0}  # kg of fuel
END = 200.0

burned = tx.State("burned")  # kg of fuel of the stage
firing = tx.Parameter("firing", shape=(2,), value=[0.0, 0.0])
staged, capacity = tx.Parameter("staged", value=0.0), tx.Parameter("capacity", value=CAPACITY["first"])
#: kg/s, times the inertia that a kilogram takes along: the rate of the inertia.
shrinking = tx.Parameter("shrinking", value=0.0)


@functools.cache
def rocket(folder: Path, area: float = AREA) -> tuple[flight.Vehicle, tx.Dynamics]:
    """The rocket over the turning Earth, as one system for both stages."""
    files = {name: load_daveml(folder / f"twostage_{name}.dml") for name in ("aero", "prop", "inertia")}
    craft = flight.Vehicle(EARTH)
    air = craft.air
    mass = files["inertia"](
        stagedFlag=staged,
        stg1fuelUsed=tx.Where(staged > 0.0, CAPACITY["first"], burned),
        stg2fuelUsed=tx.Where(staged > 0.0, burned, 0.0),
    )
    push = files["prop"](stg1firing=firing[0], stg2firing=firing[1])
    c = files["aero"](alpha=air.alpha / degrees, beta=air.beta / degrees)
    wing = flight.Aerodynamics(
        area, span=3.0, chord=3.0, reference=tx.Concat(-mass["DXCG"], 0.0, 0.0), axes=flight.stability_axes
    )
    force = (-c["totalCoefficientOfDrag"], c["aeroBodyForceCoefficient_Y"], -c["totalCoefficientOfLift"])
    moments = [c[f"aeroBodyMomentCoefficient_{axis}"] for axis in ("Roll", "Pitch", "Yaw")]
    # About the body's origin, its centre of mass; the coefficients of moments are in body axes.
    torque = air.dynamic_pressure * area * 3.0 * tx.Concat(*moments)
    inertia = tx.Concat(mass["XIXX"], mass["XIYY"], mass["XIZZ"])
    stages = [files["inertia"].values(stagedFlag=k, stg1fuelUsed=0.0, stg2fuelUsed=0.0) for k in (0.0, 1.0)]
    empty = [files["inertia"].values(stagedFlag=k, stg1fuelUsed=1.8e5, stg2fuelUsed=8e4) for k in (0.0, 1.0)]
    slopes = [
        np.array([(full[name] - end[name]) / own for name in ("XIXX", "XIYY", "XIZZ")])
        for full, end, own in zip(stages, empty, CAPACITY.values(), strict=True)
    ]
    torque = torque + shrinking * tx.Where(staged > 0.0, slopes[1], slopes[0]) * air.rate
    loads = wing.wrench(air, force) + tx.lie.wrench(force=tx.Concat(push["thrust"], 0.0, 0.0), torque=torque)
    body = SpatialInertia(mass=mass["XMASS"], inertia=tx.linalg.Diag(inertia))
    rates = {burned: push["mdot"]}
    return craft, tx.compile(
        craft.system(body, loads, rates=rates, outputs={"mass": mass["XMASS"], "left": capacity - burned})
    )


def fly(folder: Path, area: float = AREA, share: float = 0.5, times: Any = None) -> tx.PhasedSolution:
    """The flight of 200 s.

    Args:
        share: of the moment -I' w by which an inertia that shrinks with the fuel turns the body faster: 0 leaves it
            out, 1 is what I w' + I' w = M says, 0.5 what the published simulation has.
    """
    craft, dynamics = rocket(folder, area)
    flows = 17e6 / (360.0 * 9.8066), 5e6 / (390.0 * 9.8066)
    first = {"firing": np.array([1.0, 0.0]), "shrinking": share * flows[0]}
    second = {"staged": 1.0, "capacity": CAPACITY["second"], "shrinking": share * flows[1]}
    burnt = tx.Event(burned >= capacity)
    phases = [
        tx.Phase(dynamics, name="first stage", duration=60.0, event=burnt, params=first),
        tx.Phase(dynamics, name="coast", duration=COAST),
        tx.Phase(
            dynamics, name="second stage", duration=80.0, event=burnt, params={**second, "firing": np.array([0.0, 1.0])}
        ),
        tx.Phase(dynamics, name="orbit", t1=END, params=second),
    ]
    start = craft.start(0.0, 0.0, 0.0, (0.0, 0.0, -0.1), (0.0, 55.22 * degrees, 90.0 * degrees))
    times = np.arange(0.0, END + 0.5) if times is None else times
    links = [None, {burned: 0.0}, None]
    return tx.integrate_phases(phases, {**start, "burned": 0.0}, links, rtol=1e-10, save_at=times)


def apart(folder: Path, **options: Any) -> dict[str, np.ndarray]:
    """Differences from simulation 06 every second: position m, attitude rad, pitch rate rad/s."""
    rows = np.genfromtxt(folder / "Atmos_17_sim_06.csv", delimiter=",", names=True)[::10]
    flown = fly(folder, times=np.round(rows["time"], 6), **options)
    there = np.isin(np.round(np.asarray(flown.ts), 6), np.round(rows["time"], 6))
    found = {name: np.asarray(values)[there] for name, values in flown.outputs.items()}
    position = np.stack([rows[f"eiPosition_ft_{axis}"] for axis in "XYZ"], axis=1) * float(feet)
    pitch = rows["eulerAngle_deg_Pitch"] * float(degrees)
    rate = rows["bodyAngularRateWrtEi_deg_s_Pitch"] * float(degrees)
    return {
        "time": rows["time"],
        "position": np.linalg.norm(found["position"] - position, axis=1),
        "attitude": np.abs(found["euler"][:, 1] - pitch),
        "rate": np.abs(found["rate"][:, 1] - rate),
        "density": np.abs(found["density"] / (rows["airDensity_slug_ft3"] * 14.593902937 / 0.3048**3) - 1.0),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    folder = parser.parse_args().folder
    if folder is None:
        print("Name the folder with the published files: python examples/two_stage_rocket.py DIR")
        return
    folder = folder / "two_stage_rocket"
    flown = fly(folder)
    for name, phase in zip(flown.names, flown.phases, strict=True):
        found = phase.outputs
        height, speed = float(found["altitude"][-1]), float(np.linalg.norm(found["velocity"][-1]))
        print(f"{name:12s} ends at {float(phase.ts[-1]):8.3f} s, {height:9.1f} m up, at {speed:8.2f} m/s inertial")
    cases = {
        "the file's area, inertia that only is": {"area": 7.0, "share": 0.0},
        "inertia that only is": {"share": 0.0},
        "half of -I' w": {"share": 0.5},
        "the whole of -I' w": {"share": 1.0},
    }
    for text, options in cases.items():
        off = apart(folder, **options)
        print(f"  {text}: " + ", ".join(f"{name} {off[name].max():.2e}" for name in ("position", "attitude", "rate")))


if __name__ == "__main__":
    main()
