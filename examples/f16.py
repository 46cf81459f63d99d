"""NASA's F-16 from its DAVE-ML files, trimmed and simulated: check-cases 11 to 16 of NASA/TM-2015-218675.

    python examples/f16.py DIR                  every case
    python examples/f16.py DIR 11 13.2          these, by number

DIR holds the published files: f16/F16_*.dml, and of the trajectories <folder of the case>/sim_*.csv. They are not part
of twistax. A case without published trajectories is simulated, too.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
from pathlib import Path
from typing import Any

import jax
import numpy as np

import twistax as tx
from twistax.mechanics import SpatialInertia, flight, load_daveml
from twistax.mechanics.environment.atmosphere import US1976
from twistax.scenes.published import EARTH
from twistax.units import degrees, feet, knots, pounds_force, seconds, slugs

jax.config.update("jax_enable_x64", True)

CENTRE = 25.0  # of mass, in percent of the chord
PILOT = dict.fromkeys(("throttle", "longStk", "latStk", "pedal"), 0.0)

#: The air of simulation 05: these constants reproduce its density, pressure and speed of sound to 3e-13.
AIR_OF_05 = dataclasses.replace(
    US1976,
    pressure_at_base=float(2116.22 * pounds_force / feet**2),
    gravity=float(32.17405 * feet / seconds**2),
    gas_constant=US1976.gas_constant * (1.0 - 2.288255e-6),
)
PLANETS = {"standard": EARTH, "05": dataclasses.replace(EARTH, air=AIR_OF_05)}


@dataclasses.dataclass(frozen=True)
class Case:
    """A case: its start, and the commands of its autopilot before and after a time.

    Attributes:
        folder: of the published trajectories.
        place: latitude and longitude, deg, and altitude, ft.
        velocity: north and east, ft/s.
        commands: that change at `at`, before and after: altitude ft, airspeed kt, course deg, deviation ft, and
            course_kept, 1 where the deviation from the course is measured, 0 where it counts as zero.
        at: s.
        autopilot: whether it is on; `navigator` has the file with the circles, around the pole or the date line.
        own_design: the stability augmentation keeps the pitch of this trim, in place of that in the file.
    """

    folder: str
    duration: float
    place: tuple[float, float, float] = (36.019166667, -75.6744444444, 10_013.0)
    velocity: tuple[float, float] = (400.0, 400.0)
    commands: dict[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    at: float = 1.0
    autopilot: bool = True
    own_design: bool = True
    circle: str = ""

    @property
    def heading(self) -> float:
        """Deg."""
        return float(np.degrees(np.arctan2(self.velocity[1], self.velocity[0])))


_FAST = 1000.0 * 2.0**0.5
_CIRCLE: dict[str, Any] = {"duration": 180.0, "own_design": False, "commands": {"airspeed": (287.0, 287.0)}}
CASES = {
    "11": Case("11_f16_trimmed_subsonic", 180.0, autopilot=False),
    "12": Case(
        "12_f16_trimmed_supersonic",
        180.0,
        (36.019166667, -75.6744444444, 30_013.0),
        (_FAST, _FAST),
        autopilot=False,
    ),
    "13.1": Case("13p1_f16_altitude_change", 20.0, commands={"altitude": (10_013.0, 10_113.0)}, at=5.0),
    "13.2": Case("13p2_f16_airspeed_change", 20.0, commands={"airspeed": (287.98, 282.98)}, at=5.0),
    "13.3": Case("13p3_f16_heading_change", 30.0, commands={"course": (45.0, 60.0)}, at=15.0),
    "13.4": Case(
        "13p4_f16_lateral_sidestep", 60.0, commands={"deviation": (0.0, -2_000.0), "course_kept": (0.0, 1.0)}, at=20.0
    ),
    "15": Case(
        "15_f16_circle_pole", place=(89.95, -45.0, 10_000.0), velocity=(0.0, 563.642515374), circle="pole", **_CIRCLE
    ),
    "16": Case(
        "16_f16_circle_dateline", place=(0.0, -179.95, 10_000.0), velocity=(563.643, 0.0), circle="date line", **_CIRCLE
    ),
}


@functools.cache
def aircraft(folder: Path, planet: flight.Planet, navigator: bool = False) -> tuple[flight.Vehicle, tx.Dynamics]:
    """The aeroplane over the turning Earth; controls are the commands, parameters the trims and switches."""
    pilot = "gnc" if navigator else "control"
    files = {name: load_daveml(folder / f"F16_{name}.dml") for name in ("aero", "prop", "inertia", pilot)}
    for model in files.values():
        model.check()
    mass = files["inertia"].values(CG_PCT_MAC=CENTRE)
    size = files["aero"].values(outputs=["sref", "bspan", "cbar"])
    xx, yy, zz, zx = (mass[name] * slugs * feet**2 for name in ("XIXX", "XIYY", "XIZZ", "XIZX"))
    body = SpatialInertia(mass=mass["XMASS"] * slugs, inertia=np.array([[xx, 0, -zx], [0, yy, 0], [-zx, 0, zz]]))

    craft = flight.Vehicle(planet)
    air, place, on = craft.air, craft.place, tx.Parameter("on", value=0.0)
    p, q, r = (air.rate[i] for i in range(3))  # relative to the turning Earth, as simulation 05 takes them
    alpha, beta = air.alpha / degrees, air.beta / degrees
    euler = craft.euler / degrees
    known = dict(
        PILOT,
        sasOn=on,
        apOn=on,
        throttleTrim=tx.Parameter("throttle", value=0.14),
        longStkTrim=tx.Parameter("stick", value=0.13),
        trimmedAlpha=tx.Parameter("design_alpha", value=2.653813535191715),
        trimmedTheta=tx.Parameter("design_pitch", value=2.653813535191715),
        altMsl=place.altitude / feet,
        Vequiv=air.equivalent_airspeed / knots,
        keasCmd=tx.Control("airspeed_command"),
        altCmd=tx.Control("altitude_command"),
        alpha=alpha,
        beta=beta,
        phi=euler[0],
        theta=euler[1],
        psi=euler[2],
        pb=p,
        qb=q,
        rb=r,
    )
    rates = {}
    if navigator:
        over = {"ownshipN_deg": place.latitude / degrees, "ownshipE_deg": place.longitude / degrees}
        sticks = files[pilot](known, circlePoleSW=tx.Parameter("polar", value=1.0), **over)
    else:
        course, off = tx.Control("course_command"), tx.State("off_course")
        angle = float(degrees) * course
        across = craft.ned_velocity[1] * tx.Cos(angle) - craft.ned_velocity[0] * tx.Sin(angle)
        rates[off] = tx.Control("course_kept_command") * across
        sticks = files[pilot](known, baseChiCmd=course, latOffset=off / feet + tx.Control("deviation_command"))
    surfaces = {name: sticks[name] for name in ("el", "ail", "rdr")}
    c = files["aero"](vt=air.airspeed / (feet / seconds), alpha=alpha, beta=beta, p=p, q=q, r=r, **surfaces)
    thrust = files["prop"](PWR=sticks["PWR"], ALT=place.altitude / feet, RMACH=air.mach)
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
    return craft, tx.compile(craft.system(body, loads + push, rates=rates, outputs=more))


def commands(case: Case) -> dict[str, tuple[float, float]]:
    """The commands of the autopilot before and after the step: those of the start, but for the changes of the case."""
    names = {
        "altitude": case.place[2],
        "airspeed": 287.98,
        "course": case.heading,
        "deviation": 0.0,
        "course_kept": 0.0,
    }
    given = {name: case.commands.get(name, (value, value)) for name, value in names.items()}
    taken = ("altitude", "airspeed") if case.circle else tuple(names)
    return {f"{name}_command": given[name] for name in taken}


@functools.cache
def trimmed(folder: Path, number: str = "11", planet: flight.Planet = EARTH) -> tuple[tx.Dynamics, tx.Trim]:
    """A case's level straight flight, with the autopilot off."""
    case = CASES[number]
    craft, dynamics = aircraft(folder, planet, bool(case.circle))
    latitude, longitude, altitude = case.place
    velocity = [speed * (feet / seconds) for speed in (*case.velocity, 0.0)]
    euler = (0.0, 2.6 * degrees, case.heading * degrees)
    place = latitude * degrees, longitude * degrees, altitude * feet
    x = craft.start(*place, velocity, euler, relative_to=flight.local_axes)
    level = tx.trim(
        dynamics,
        x if case.circle else {**x, "off_course": 0.0},
        {name: before for name, (before, _) in commands(case).items()},
        free=["g[4]", "V", "throttle", "stick"],
        fixed=["ned_velocity", "turn"],  # as at the start
        zero=["V[4]"],
        steady=["ground_speed", "ned_velocity[2]"],
    )
    return dynamics, level


def fly(
    folder: Path,
    number: str,
    planet: flight.Planet = EARTH,
    times: Any = None,
    early: float = 0.0,
    **options: Any,
) -> tx.Solution:
    """A case, its commands by `early` s before their time; options are those of `tx.integrate`."""
    case = CASES[number]
    dynamics, level = trimmed(folder, number, planet)
    params = {**level.params, "on": float(case.autopilot)}
    if case.circle:
        params["polar"] = float(case.circle == "pole")
    if case.own_design:
        start = dynamics.outputs(0.0, level.x, level.u, level.params)
        params["design_alpha"] = float(start["alpha"]) / degrees
        params["design_pitch"] = float(start["euler"][1]) / degrees
    times = np.linspace(0.0, case.duration, 1 + round(10 * case.duration)) if times is None else times
    steps = np.array([0.0, case.at - early])
    u = {name: tx.ZeroOrderHold(ts=steps, values=np.array(both)) for name, both in commands(case).items()}
    options = {"dt": 0.005, **options}
    return tx.integrate(dynamics, level.x, t1=times[-1], u=u, params=params, save_at=times, **options)


def apart(
    folder: Path, simulation: str, number: str = "11", planet: flight.Planet = EARTH, **options: Any
) -> np.ndarray:
    """The distance from a published simulation, m, at its times."""
    case = CASES[number]
    rows = np.genfromtxt(folder / case.folder / f"sim_{simulation}.csv", delimiter=",", names=True)
    times = np.round(rows["time"], 4)  # of simulation 05 they were single precision
    kept = rows[(times <= case.duration) & np.isclose(10.0 * times, np.round(10.0 * times), atol=1e-3)]
    theirs = np.stack([kept[f"eiPosition_ft_{axis}"] for axis in "XYZ"], axis=1) * float(feet)
    flown = fly(folder / "f16", number, planet, np.round(kept["time"], 1), **options)
    return np.linalg.norm(np.asarray(flown.xs["g"])[:, :3, 3] - theirs, axis=1)


def show(folder: Path, number: str) -> None:
    """Print a case's trim, where it ends, and how far it is from the simulations."""
    case = CASES[number]
    print(f"\nCase {number}")
    if case.autopilot:
        end = {name: np.asarray(values)[-1] for name, values in fly(folder / "f16", number).outputs.items()}
        place = end["latitude"] / degrees, end["longitude"] / degrees, end["altitude"] / feet
        print("  ends at {:.7f} deg north, {:.7f} deg east, {:.4f} ft".format(*place))
    else:
        _, level = trimmed(folder / "f16", number)
        print(level)
        for mode in level.linearize().keep(states=["g[4]", "V[0]", "V[2]", "V[4]"]).modes():
            print(mode)
    ways = [("", "04", "standard", 0.0), ("", "05", "standard", 0.0), (", in its air", "05", "05", 0.0)]
    if case.at != 1.0:
        ways.append((", in its air, commands 5 ms earlier", "05", "05", 0.005))
    for text, simulation, air, early in ways:
        if (folder / case.folder / f"sim_{simulation}.csv").is_file():
            distance = apart(folder, simulation, number, PLANETS[air], early=early)
            print(f"  simulation {simulation}{text}: {distance.max():.1e} m at most, {distance[-1]:.1e} m at the end")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}")
    arguments = parser.parse_args()
    unknown = [number for number in arguments.cases if number not in CASES]
    if unknown:
        parser.error(f"no case {', '.join(unknown)}: there are {', '.join(CASES)}")
    if arguments.folder is None:
        print("Name the folder with the published files: python examples/f16.py DIR")
        return
    for number in arguments.cases or CASES:
        show(arguments.folder, number)


if __name__ == "__main__":
    main()
