"""The environment of a body as expressions of its position: gravity, atmosphere and the rotating Earth.

from twistax.mechanics.environment import atmosphere, earth, gravity

p = g[:3, 3]                                               # Earth-centred inertial, m
place = earth.WGS84.geodetic(p)                            # longitude from the inertial x axis
weight = mass * g[:3, :3].T @ gravity.EARTH_J2.acceleration(p)
density = atmosphere.US1976.density(place.altitude)
"""

from . import atmosphere as atmosphere
from . import earth as earth
from . import gravity as gravity
from . import harmonics as harmonics
from . import upper_atmosphere as upper_atmosphere

__all__ = ["atmosphere", "earth", "gravity", "harmonics", "upper_atmosphere"]
