"""Sounding rocket of two stages over a round, rotating Earth: burn, separation, coast, burn, coast, descent.

One system with parameters is compiled once for all phases. The origin of body axes is the nose, and x points forward,
so a separation does not change pose and twist. It changes mass, centre of mass, inertia and engine.
"""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import SpatialInertia, flight
from twistax.units import degrees

jax.config.update("jax_enable_x64", True)


# ---- a stage, by parameters: what is above it is part of its dry mass ------------------------------------------------
craft, fuel = flight.Vehicle(flight.ROUND_EARTH), tx.State("fuel", unit="kg")
dry, center = tx.Parameter("dry", unit="kg"), tx.Parameter("center", unit="m")  # mass, and its place on the axis
moments = tx.Parameter("moments", shape=(3,), unit="kg m2")  # about the centre of the dry mass
tank, per_mass = tx.Parameter("tank", unit="m"), tx.Parameter("per_mass", shape=(3,), unit="m2")  # inertia per kg
thrust, flow = tx.Parameter("thrust", value=0.0, unit="N"), tx.Parameter("flow", value=0.0, unit="kg/s")
nozzle = tx.Parameter("nozzle", unit="m")
fins, fin_area = tx.Parameter("fins", unit="m"), tx.Parameter("fin_area", unit="m2")  # place; area with lift slope
drag_area = tx.Parameter("drag_area", unit="m2")  # with the drag coefficient


def inertia_of(mass, place, moments):
    """A body about the axis."""
    return SpatialInertia(mass=mass, center_of_mass=tx.Concat(place, 0.0, 0.0), inertia=tx.linalg.Diag(moments))


engine = flight.Engine(thrust, flow, position=tx.Concat(nozzle, 0.0, 0.0))
kilogram = inertia_of(1.0, tank, per_mass)
body = inertia_of(dry, center, moments) + inertia_of(fuel, tank, fuel * per_mass)
at = tx.Concat(fins, 0.0, 0.0)
wind = craft.air.velocity + tx.linalg.Cross(craft.air.rate, at)  # where the fins are
lift = -0.5 * craft.air.density * craft.air.airspeed * fin_area * wind * np.array([0.0, 1.0, 1.0])
pull = flight.drag(craft.air, drag_area)
# Drag acts at the centre of mass: no moment about it.
where = tx.Concat((dry * center + fuel * tank) / (dry + fuel), 0.0, 0.0)
loads = engine.wrench + flight.burning(craft.twist, flow, kilogram, engine.position)
loads = loads + tx.lie.wrench(force=pull + lift, torque=tx.linalg.Cross(where, pull) + tx.linalg.Cross(at, lift))
rocket = tx.compile(craft.system(body, loads, rates={fuel: -flow}))

# ---- the phases ------------------------------------------------------------------------------------------------------
upper = {
    "dry": 100.0, "center": -1.6, "moments": np.array([1.5, 60.0, 60.0]),
    "tank": -2.0, "per_mass": np.array([0.02, 0.3, 0.3]), "nozzle": -3.2,
    "fins": -3.1, "fin_area": 0.5, "drag_area": 0.03,
}  # fmt: skip
# Under the upper stage with its 130 kg of fuel: 180 kg of booster.
both = {
    "dry": 410.0, "center": -3.1, "moments": np.array([12.0, 1300.0, 1300.0]),
    "tank": -5.0, "per_mass": np.array([0.04, 0.5, 0.5]), "nozzle": -6.6,
    "fins": -6.4, "fin_area": 1.4, "drag_area": 0.06,
}  # fmt: skip
# One list for all phases compiles once. In each phase one comes first; those that hold as it begins do not count.
conditions = fuel <= 0.0, craft.ned_velocity[2] >= 0.0, craft.place.altitude <= 20e3
events = [tx.Event(condition, at_start=tx.AtStart.IGNORE) for condition in conditions]
phases = [
    tx.Phase(rocket, name="boost", duration=60.0, event=events, params={**both, "thrust": 90e3, "flow": 38.0}),
    tx.Phase(rocket, name="staging", duration=4.0, params=upper),
    tx.Phase(rocket, name="sustain", duration=60.0, event=events, params={**upper, "thrust": 30e3, "flow": 11.5}),
    tx.Phase(rocket, name="coast", duration=900.0, event=events, params=upper),
    tx.Phase(rocket, name="fall", duration=900.0, event=events, params=upper),
]
links = [{fuel: 130.0}, None, {fuel: 0.0}, None]  # the booster falls off with what it holds

tilt = 84.0 * degrees
start = craft.start(
    37.94 * degrees, -75.47 * degrees, 0.0,
    60.0 * np.array([0.0, np.cos(tilt), -np.sin(tilt)]), (0.0, tilt, 90.0 * degrees),
)  # fmt: skip
times = np.arange(0.0, 900.0, 6.0)  # fewer than 64 in each phase compile once
sol = tx.integrate_phases(phases, {**start, "fuel": 450.0}, links, rtol=1e-8, save_at=times)

for name, phase in zip(sol.names, sol.phases):
    found, end = phase.outputs, float(phase.ts[-1])
    speed = np.linalg.norm(found["ned_velocity"][-1])
    print(f"{name:8s} ends at {end:6.1f} s, {found['altitude'][-1] / 1e3:6.1f} km up, at {speed:6.0f} m/s")

if [phase.event for phase in sol.phases] != [0, None, 0, 1, 2]:
    raise SystemExit("a stage does not burn out, or the rocket misses its apogee")

figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.2), layout="constrained")
for name, phase in zip(sol.names, sol.phases):
    left.plot(phase.ts, phase.outputs["altitude"] / 1e3, label=name)
    right.plot(phase.ts, np.linalg.norm(phase.outputs["ned_velocity"], axis=1))
left.set(xlabel="t (s)", ylabel="altitude (km)")
left.legend()
right.set(xlabel="t (s)", ylabel="speed over the ground (m/s)")
figure.savefig("staged_rocket.png", dpi=100)
