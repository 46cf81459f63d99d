"""Bad uses of units, of the flight layer, and of trim."""

import dataclasses

import numpy as np
from table import bad

import twistax as tx
from twistax import units
from twistax.mechanics import SpatialInertia, environment, flight, load_daveml

EGM2008, Harmonics = environment.harmonics.EGM2008, environment.harmonics.Harmonics

craft, wing = flight.Vehicle(), flight.Aerodynamics(1.0, 1.0, 1.0)
ball = SpatialInertia(mass=1.0, inertia=np.eye(3))
w = tx.State("w")
dynamics = tx.compile(tx.System({w: -w + tx.Control("c")}, {"y": 2 * w}))


def rocket(impulse):
    return flight.rocket(1.0, 0.0, vacuum_thrust=1.0, specific_impulse=impulse)


def trim(x=None, u=None, free=("w",), zero=("w",), **other):
    return tx.trim(
        dynamics, {"w": 1.0} if x is None else x, {"c": 0.0} if u is None else u, free=free, zero=zero, **other
    )


ROWS = [
    bad("a mass in feet", lambda: SpatialInertia(mass=1 * units.feet, inertia=np.eye(3)), "mass", "0.3048 m"),
    bad("a span in knots", lambda: flight.Aerodynamics(1.0, 1 * units.knots, 1.0), "span", "m s-1"),
    bad("an area in feet", lambda: flight.drag(craft.air, 2 * units.feet), "area", "0.6096 m"),
    bad("a thrust in pounds", lambda: flight.Engine(100 * units.pounds), "thrust", "kg m s-2", "kg"),
    bad("an impulse in metres", lambda: rocket(300 * units.metres), "specific_impulse", "300.0 m"),
    bad("a sensor in seconds", lambda: flight.Imu((1 * units.seconds, 0.0, 0.0)), "position", "1.0 s"),
    bad("a wind of places alone", lambda: flight.Vehicle(wind=lambda place: (0.0, 0.0, 0.0)), "wind", "(place, t)"),
    bad(
        "a motion of one's own",
        lambda: craft.system(ball, rates={craft.twist: tx.Constant(np.zeros(6))}),
        "rates",
        "'V'",
    ),
    bad(
        "a motion of one's own by name",
        lambda: craft.system(ball, rates={"V": tx.Constant(np.zeros(6))}),
        "rates",
        "'V'",
    ),
    bad("a profile of numbers", lambda: flight.Profile(5.0, 3.0), "Profile"),
    bad("a profile with one velocity", lambda: flight.Profile((0.0, 1.0), 3.0), "Profile"),
    bad("a strong wind", lambda: flight.LogarithmicShear("strong", 0.0), "speed", "'strong'"),
    bad("a start nowhere", lambda: flight.start(None, 0.0, 0.0), "latitude"),
    bad("a start in the north", lambda: flight.start("north", 0.0, 0.0), "latitude", "'north'"),
    bad("a start on 3", lambda: flight.start(0.0, 0.0, 0.0, planet=3), "planet", "3"),
    bad("a rate relative to 3", lambda: flight.start(0.0, 0.0, 0.0, relative_to=3), "relative_to", "3"),
    bad("a vehicle's pose without a name", lambda: flight.Vehicle(pose=3), "3"),
    bad("a big wing", lambda: flight.Aerodynamics("big", 1.0, 1.0), "area"),
    bad("two coefficients", lambda: wing.wrench(craft.air, (1.0, 2.0)), "force", "(2,)"),
    bad("coefficients in no air", lambda: wing.wrench(3, (1.0, 2.0, 3.0)), "air", "3"),
    bad("drag in no air", lambda: flight.drag(None, 1.0), "air", "None"),
    bad("axes by name", lambda: flight.Aerodynamics(1.0, 1.0, 1.0, axes="wind"), "axes", "'wind'"),
    bad("turbulence of 3", lambda: flight.Dryden(3, 10.0), "scales", "3"),
    bad("burning nothing", lambda: flight.burning(np.ones(6), 1.0, None, np.ones(3)), "kilogram", "None"),
    bad("numbers of text", lambda: flight.numbers("x"), "'x'"),
    bad("values by name", lambda: flight.numbers(w, {"w": 3.0}), "'w'"),
    bad("a term without coefficients", lambda: Harmonics(1.0, 1.0, ((2, 0),)), "(2, 0)"),
    bad("an order beyond its degree", lambda: Harmonics(1.0, 1.0, ((2, 3, 0.0, 0.0),)), "orders", "(2, 3)"),
    bad("a term twice", lambda: Harmonics(1.0, 1.0, ((2, 0, 0.0, 0.0),) * 2), "once", "(2, 0), (2, 0)"),
    bad("an infinite coefficient", lambda: Harmonics(1.0, 1.0, ((2, 0, np.inf, 0.0),)), "(2, 0)", "inf"),
    bad("harmonics without a GM", lambda: Harmonics(0.0, 1.0, ()), "Harmonics", "gm", "0.0"),
    bad("more degrees than there are", lambda: EGM2008.up_to(9), "up_to", "up to 8", "9"),
    bad("harmonics of 3", lambda: Harmonics(1.0, 1.0, 3), "terms", "3"),
    bad("a coefficient of text", lambda: Harmonics(1.0, 1.0, ((2, 0, "a", 0.0),)), "'a'"),
    bad("a degree of text", lambda: EGM2008.up_to("8"), "'8'"),
    bad("a boom in no air", lambda: flight.probe(3, np.ones(3)), "air", "3"),
    bad("a rate relative to the earth by name", lambda: craft.rate("earth"), "relative_to", "'earth'"),
    bad(
        "a rate relative to local axes at a pole",
        lambda: craft.start(np.pi / 2, 0.0, 0.0, relative_to=flight.local_axes),
        "local_axes",
        "1.5707963267948966",
        "fixed_axes",
    ),
    bad(
        "gases of which less than none is there",
        lambda: dataclasses.replace(flight.EARTH.air, gases=((4.0, -1.0),)),
        "gases",
        "-1.0",
    ),
    bad("gases of no mass", lambda: dataclasses.replace(flight.EARTH.air, gases=((0.0, 1.0),)), "gases", "0.0"),
    bad("turbulence of text", lambda: flight.even_turbulence("a", (1.0, 1.0, 1.0)), "lengths", "'a'"),
    bad(
        "a big thrust",
        lambda: flight.rocket(1.0, 0.0, vacuum_thrust="big", specific_impulse=300.0),
        "vacuum_thrust",
        "'big'",
    ),
    bad(
        "no specific impulse",
        lambda: flight.rocket(1.0, 0.0, vacuum_thrust=1.0, specific_impulse=0.0),
        "specific_impulse",
        "0",
    ),
    bad("free as a number", lambda: trim(free=3), "free", "3"),
    bad("zero as a number", lambda: trim(zero=3), "zero", "3"),
    bad("zero as text", lambda: trim(zero="wind"), "zero", "'wind'"),
    bad("fixed as a number", lambda: trim(fixed=3), "fixed", "3"),
    bad("a trim of a number", lambda: trim(x=3), "x", "int"),
    bad("a trim now", lambda: trim(t="now"), "t", "'now'"),
    bad("a trim for nothing", lambda: trim(zero=[]), "zero"),
    bad("a trim from NaN", lambda: trim({"w": np.nan}), "w", "nan"),
    bad("a trim without controls", lambda: trim(u={}), "'c'"),
    bad("a trim of an entry that is not there", lambda: trim(free=["w[3]"]), "free", "'w[3]'"),
    bad("a limit of one number", lambda: trim(free={"w": 3.0}), "free['w']", "3.0"),
    bad("a value of text", lambda: trim(fixed={"y": "high"}), "fixed['y']", "'high'"),
    bad("a file of a model by number", lambda: load_daveml(3), "load_daveml", "3"),
    bad("no file of a model", lambda: load_daveml("nowhere.dml"), "nowhere.dml"),
    bad("feet to the a", lambda: tx.units.feet ** "a", "'a'"),
    bad("columns in some units", lambda: flight.NasaColumns(si="metric"), "si", "'metric'"),
    bad("an inertia in feet", lambda: SpatialInertia(mass=1.0, inertia=[[units.feet] * 3] * 3), "inertia", "kg m2"),
    bad("a planet of 3", lambda: flight.Planet(3, environment.gravity.EARTH_J2), "figure", "3"),
    bad("a push", lambda: craft.system(ball, "push"), "wrench", "'push'"),
    bad("a reading of 3", lambda: flight.Imu().read(3, np.ones(6), np.ones(3)), "V"),
    bad("a gradient on 3", lambda: craft.gradient_torque(3), "body", "3"),
]
