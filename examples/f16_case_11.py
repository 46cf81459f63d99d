"""Check-case 11 of NASA/TM-2015-218675: the F-16 from its DAVE-ML files, trimmed and simulated for 180 s.

python examples/f16_case_11.py DIR        DIR/f16/F16_*.dml are NASA's files
"""

import sys
from pathlib import Path

import jax
import numpy as np

import twistax as tx
from twistax.mechanics import SpatialInertia, flight, load_daveml
from twistax.units import degrees, feet, knots, pounds_force, seconds, slugs

jax.config.update("jax_enable_x64", True)
if len(sys.argv) < 2:
    sys.exit(print("Name the folder with the published files: python examples/f16_case_11.py DIR"))
folder = Path(sys.argv[1]) / "f16"
aero, prop, inertia, control = (load_daveml(folder / f"F16_{n}.dml") for n in ("aero", "prop", "inertia", "control"))

# ---- the aeroplane: mass, pilot, aerodynamics, engine ---------------------------------------------------------------
mass, size = inertia.values(CG_PCT_MAC=25.0), aero.values(outputs=["sref", "bspan", "cbar"])
xx, yy, zz, zx = (mass[name] * slugs * feet**2 for name in ("XIXX", "XIYY", "XIZZ", "XIZX"))
body = SpatialInertia(mass=mass["XMASS"] * slugs, inertia=np.array([[xx, 0, -zx], [0, yy, 0], [-zx, 0, zz]]))
craft = flight.Vehicle()
air, angles, height = craft.air, craft.euler / degrees, craft.place.altitude / feet
alpha, beta, (p, q, r) = air.alpha / degrees, air.beta / degrees, (air.rate[i] for i in range(3))
off = dict.fromkeys(
    ("throttle", "longStk", "latStk", "pedal", "sasOn", "apOn", "keasCmd", "altCmd", "baseChiCmd", "latOffset",
     "trimmedAlpha", "trimmedTheta"), 0.0,
)  # fmt: skip
throttle, stick = tx.Parameter("throttle", value=0.14), tx.Parameter("stick", value=0.13)
sticks = control(
    off, throttleTrim=throttle, longStkTrim=stick, altMsl=height, Vequiv=air.equivalent_airspeed / knots,
    alpha=alpha, beta=beta, phi=angles[0], theta=angles[1], psi=angles[2], pb=p, qb=q, rb=r,
)  # fmt: skip
surfaces = {name: sticks[name] for name in ("el", "ail", "rdr")}
c = aero(vt=air.airspeed / (feet / seconds), alpha=alpha, beta=beta, p=p, q=q, r=r, **surfaces)
push = prop(PWR=sticks["PWR"], ALT=height, RMACH=air.mach)["FEX"] * float(pounds_force)
arm = [-mass[name] * feet for name in ("DXCG", "DYCG", "DZCG")]
wing = flight.Aerodynamics(size["sref"] * feet**2, size["bspan"] * feet, size["cbar"] * feet, arm)
loads = wing.wrench(air, (c["cx"], c["cy"], c["cz"]), (c["cl"], c["cm"], c["cn"])) + flight.Engine(push).wrench
outputs = {"ground_speed": tx.linalg.Norm(craft.ned_velocity[:2]), "turn": craft.rate(flight.local_axes)}
dynamics = tx.compile(craft.system(body, loads, outputs=outputs))

# ---- level flight to the north-east, and the flight -----------------------------------------------------------------
place = 36.019166667 * degrees, -75.6744444444 * degrees, 10_013 * feet
velocity = np.array([400.0, 400.0, 0.0]) * (feet / seconds)
x0 = craft.start(*place, velocity, (0.0, 2.6 * degrees, 45 * degrees), relative_to=flight.local_axes)
level = tx.trim(
    dynamics, x0, free=["g[4]", "V", "throttle", "stick"], fixed=["ned_velocity", "turn"], zero=["V[4]"],
    steady=["ground_speed", "ned_velocity[2]"])  # fmt: skip
flown = tx.integrate(dynamics, level.x, t1=180.0, dt=0.005, params=level.params, save_at=np.arange(0.0, 180.1, 0.1))
print(level, flown.outputs["latitude"][-1] / degrees, flown.outputs["altitude"][-1] / feet)
file = Path(sys.argv[1]) / "11_f16_trimmed_subsonic" / "sim_05.csv"
if file.is_file():
    rows = np.genfromtxt(file, delimiter=",", names=True)
    theirs = np.stack([rows[f"eiPosition_ft_{axis}"] for axis in "XYZ"], axis=1) * float(feet)
    print("from simulation 05, m:", np.linalg.norm(np.asarray(flown.xs["g"])[:, :3, 3] - theirs, axis=1).max())
