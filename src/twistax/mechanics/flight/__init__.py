"""Flight over a planet, as expressions: initial states, air data, winds, and forces.

from twistax import units
from twistax.mechanics import SpatialInertia, flight

craft = flight.Vehicle(flight.EARTH, wind=flight.Steady((0.0, 6.0, 0.0)))
ball = SpatialInertia(mass=14.6, inertia=4.9 * np.eye(3))
system = craft.system(ball, tx.lie.wrench(force=flight.drag(craft.air, 0.0018), torque=np.zeros(3)))
x0 = craft.start(45.0 * units.degrees, 7.0 * units.degrees, 30_000 * units.feet)
"""

from .air_data import Aerodynamics, AirAxes, AirData, body_axes, drag, stability_axes, wind_axes
from .nasa import NasaColumns
from .planets import EARTH, ROUND_EARTH, Air, Axes, Gravity, Planet, Reference, fixed_axes, inertial_axes, local_axes
from .propulsion import Engine, burning, rocket
from .sensors import Imu, ImuReading, probe
from .start import numbers, start
from .turbulence import Dryden, Gust, even_turbulence, low_altitude_turbulence
from .vehicle import Vehicle
from .wind import CALM, LogarithmicShear, Profile, Steady, Wind

# fmt: off
__all__ = [
    "CALM", "EARTH", "ROUND_EARTH", "Aerodynamics", "Air", "AirAxes", "AirData", "Axes", "Dryden", "Engine", "Gravity",
    "Gust", "Imu", "ImuReading", "LogarithmicShear", "NasaColumns", "Planet", "Profile", "Reference", "Steady",
    "Vehicle", "Wind",
    "body_axes", "burning", "drag", "even_turbulence", "fixed_axes", "inertial_axes", "local_axes",
    "low_altitude_turbulence", "numbers", "probe", "rocket", "stability_axes", "start", "wind_axes",
]
# fmt: on
