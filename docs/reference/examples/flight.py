# tx.mechanics.environment.gravity.PointMass tx.mechanics.environment.gravity.J2 tx.mechanics.flight.Gravity
from twistax.mechanics.environment import gravity

p = tx.State("p", shape=(3,))
tx.lower(gravity.PointMass(gm=3.986004418e14).acceleration(p))(0.0, {"p": [7e6, 0.0, 0.0]}, {})  # m/s2

# tx.mechanics.environment.gravity.gradient_torque
p = tx.State("p", shape=(3,))
torque = tx.mechanics.environment.gravity.gradient_torque(3.986004418e14, p, np.diag([1.0, 2.0, 3.0]))
tx.lower(torque)(0.0, {"p": [7e6, 1e6, 0.0]}, {})  # N m

# tx.mechanics.environment.harmonics.Harmonics tx.mechanics.environment.harmonics.HarmonicPull
from twistax.mechanics.environment.harmonics import EGM2008

p = tx.State("p", shape=(3,))
tx.lower(EGM2008.up_to(4).acceleration(p))(0.0, {"p": [7e6, 0.0, 0.0]}, {})  # m/s2

# tx.mechanics.environment.atmosphere.LayeredAtmosphere
# tx.mechanics.environment.upper_atmosphere.UpperAtmosphere tx.mechanics.flight.Air
from twistax.mechanics.environment.atmosphere import US1976

h = tx.State("h")
tx.lower({"density": US1976.density(h), "sound": US1976.speed_of_sound(h)})(0.0, {"h": 5000.0}, {})

# tx.mechanics.environment.atmosphere.Pressure tx.mechanics.environment.atmosphere.Temperature
from twistax.mechanics.environment import atmosphere

h = tx.State("h")
tx.lower([atmosphere.Pressure(h), atmosphere.Temperature(h)])(0.0, {"h": 5000.0}, {})  # Pa, K

# tx.mechanics.environment.earth.Ellipsoid tx.mechanics.environment.earth.Geodetic
# tx.mechanics.environment.earth.Meridian
from twistax.mechanics.environment.earth import WGS84

p = tx.State("p", shape=(3,))
place = WGS84.geodetic(p)
tx.lower({"latitude": place.latitude, "altitude": place.altitude})(0.0, {"p": [6.4e6, 0.0, 1e6]}, {})

# tx.mechanics.environment.earth.north_east_down
R = tx.mechanics.environment.earth.north_east_down(tx.State("latitude"), tx.State("longitude"))
tx.lower(R)(0.0, {"latitude": 0.5, "longitude": 0.0}, {})

# tx.mechanics.flight.Planet
from twistax.mechanics.environment import earth, gravity

round_planet = tx.mechanics.flight.Planet(earth.Ellipsoid(6.4e6, 0.0, 7.3e-5), gravity.PointMass(3.986e14))
craft = tx.mechanics.flight.Vehicle(planet=round_planet)
sorted(craft.outputs())

# tx.mechanics.flight.AirData tx.mechanics.flight.probe
craft = tx.mechanics.flight.Vehicle()
vane = tx.mechanics.flight.probe(craft.air, [5.0, 0.0, 0.0])  # 5 m in front of the centre
outputs = {"alpha": craft.air.alpha, "alpha of the vane": vane.alpha}  # rad
list(outputs)

# tx.mechanics.flight.body_axes
from twistax.mechanics import flight

flight.Aerodynamics(16.0, 11.0, 1.5, axes=flight.body_axes)

# tx.mechanics.flight.Profile
wind = tx.mechanics.flight.Profile([0.0, 1000.0], [[0.0, 0.0, 0.0], [0.0, 20.0, 0.0]])  # m, and m/s north, east, down
craft = tx.mechanics.flight.Vehicle(wind=wind)
craft.air.airspeed.shape

# tx.mechanics.flight.Gust tx.mechanics.flight.even_turbulence
from twistax.mechanics import flight

scales = flight.even_turbulence(lengths=[533.0] * 3, intensities=[1.5] * 3)  # m, m/s
turbulence = flight.Dryden(scales, span=10.0)
turbulence.name, turbulence.span

# tx.mechanics.flight.start tx.mechanics.flight.fixed_axes tx.mechanics.flight.inertial_axes
from twistax.mechanics import flight

at_rest = flight.start(0.5, 0.0, 1000.0, ned_velocity=[100.0, 0.0, 0.0], relative_to=flight.fixed_axes)
{name: np.shape(value) for name, value in at_rest.items()}

# tx.mechanics.flight.ImuReading
V, acceleration = tx.State("V", shape=(6,)), tx.Control("acceleration", shape=(6,))
reading = tx.mechanics.flight.Imu(position=[0.1, 0.0, 0.0]).read(V, acceleration, [0.0, 0.0, -9.81])
at_rest = {"V": np.zeros(6)}, {"acceleration": np.zeros(6)}
tx.lower(reading.specific_force)(0.0, *at_rest)  # m/s2

# tx.mechanics.DaveModel tx.mechanics.load_daveml
from pathlib import Path

model = tx.mechanics.load_daveml(Path("examples").resolve().parent / "tests/mechanics/models/small.dml")
list(model.inputs), list(model.outputs)
