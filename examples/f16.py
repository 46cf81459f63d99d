"""NASA's F-16 from its DAVE-ML files, trimmed and flown: case 11 of NASA/TM-2015-218675.

    python examples/f16.py DIR

DIR holds the published files: f16/F16_*.dml and 11_f16_trimmed_subsonic/sim_*.csv. They are not part of twistax.
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
from twistax.units import degrees, feet, knots, pounds_force, seconds, slugs

jax.config.update("jax_enable_x64", True)

CENTRE = 25.0  # of mass, in percent of the chord
OFF = dict.fromkeys(("throttle", "longStk", "latStk", "pedal", "sasOn", "apOn", "latOffset", "baseChiCmd"), 0.0)


def aircraft(folder: Path) -> tuple[flight.Vehicle, tx.Dynamics]:
    """The aeroplane over the turning Earth, its autopilot off; parameters are the trims of throttle and stick."""
    files = {name: load_daveml(folder / f"F16_{name}.dml") for name in ("aero", "prop", "inertia", "control")}
    for model in files.values():
        model.check()
    mass = files["inertia"].values(CG_PCT_MAC=CENTRE)
    size = files["aero"].values(outputs=["sref", "bspan", "cbar"])
    xx, yy, zz, zx = (mass[name] * slugs * feet**2 for name in ("XIXX", "XIYY", "XIZZ", "XIZX"))
    body = SpatialInertia(mass=mass["XMASS"] * slugs, inertia=np.array([[xx, 0, -zx], [0, yy, 0], [-zx, 0, zz]]))

    craft = flight.Vehicle()
    air = craft.air
    p, q, r = (air.rate[i] for i in range(3))  # relative to the turning Earth, as simulation 05 takes them
    alpha, beta = air.alpha / degrees, air.beta / degrees
    euler = craft.euler / degrees
    sticks = files["control"](
        OFF,
        throttleTrim=tx.Parameter("throttle", value=0.14),
        longStkTrim=tx.Parameter("stick", value=0.13),
        altMsl=craft.place.altitude / feet,
        Vequiv=air.equivalent_airspeed / knots,
        keasCmd=0.0,
        altCmd=0.0,
        alpha=alpha,
        beta=beta,
        phi=euler[0],
        theta=euler[1],
        psi=euler[2],
        pb=p,
        qb=q,
        rb=r,
    )
    surfaces = {name: sticks[name] for name in ("el", "ail", "rdr")}
    c = files["aero"](vt=air.airspeed / (feet / seconds), alpha=alpha, beta=beta, p=p, q=q, r=r, **surfaces)
    thrust = files["prop"](PWR=sticks["PWR"], ALT=craft.place.altitude / feet, RMACH=air.mach)
    wing = flight.Aerodynamics(
        area=size["sref"] * feet**2,
        span=size["bspan"] * feet,
        chord=size["cbar"] * feet,
        reference=[-mass[name] * feet for name in ("DXCG", "DYCG", "DZCG")],
    )
    push = tx.lie.wrench(force=float(pounds_force) * tx.Concat(thrust["FEX"], 0.0, 0.0), torque=np.zeros(3))
    loads = wing.wrench(air, (c["cx"], c["cy"], c["cz"]), (c["cl"], c["cm"], c["cn"]))
    over_ground = tx.linalg.Norm(craft.ned_velocity[:2])
    more = {"alpha": air.alpha, "ground_speed": over_ground, "turn": craft.rate(flight.local_axes)}
    return craft, tx.compile(craft.system(body, loads + push, outputs=more))


@functools.cache
def trimmed(folder: Path) -> tuple[tx.Dynamics, tx.Trim]:
    """Case 11: 400 ft/s north and east each at 10,013 ft, level and straight."""
    craft, dynamics = aircraft(folder)
    place = 36.01916667 * degrees, -75.67444444 * degrees, 10_013 * feet
    velocity = [400.0 * (feet / seconds), 400.0 * (feet / seconds), 0.0]
    x = craft.start(*place, velocity, (0.0, 2.6 * degrees, 45.0 * degrees), relative_to=flight.local_axes)
    level = tx.trim(
        dynamics,
        x,
        free=["g[4]", "V", "throttle", "stick"],
        fixed=["ned_velocity", "turn"],  # as at the start
        zero=["V[4]"],
        steady=["ground_speed", "ned_velocity[2]"],
    )
    return dynamics, level


def apart(folder: Path, number: str, duration: float = 180.0, **options: Any) -> np.ndarray:
    """The distance from a published simulation, m, at its times."""
    rows = np.genfromtxt(folder / "11_f16_trimmed_subsonic" / f"sim_{number}.csv", delimiter=",", names=True)
    times = np.round(rows["time"], 4)  # of simulation 05 they were single precision
    kept = rows[(times <= duration) & np.isclose(10.0 * times, np.round(10.0 * times), atol=1e-3)]
    times = np.round(kept["time"], 1)
    theirs = np.stack([kept[f"eiPosition_ft_{axis}"] for axis in "XYZ"], axis=1) * float(feet)
    dynamics, level = trimmed(folder / "f16")
    flown = tx.integrate(dynamics, level.x, t1=duration, params=level.params, save_at=times, **{"dt": 0.01, **options})
    return np.linalg.norm(np.asarray(flown.xs["g"])[:, :3, 3] - theirs, axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    folder = parser.parse_args().folder
    if folder is None:
        print("Name the folder with the published files: python examples/f16.py DIR")
        return
    _, level = trimmed(folder / "f16")
    print(level)
    for mode in level.linearize().keep(states=["g[4]", "V[0]", "V[2]", "V[4]"]).modes():
        print(mode)
    for number in ("04", "05"):
        distance = apart(folder, number)
        print(f"simulation {number}: {distance.max():.1e} m at most, {distance[-1]:.1e} m at the end")


if __name__ == "__main__":
    main()
