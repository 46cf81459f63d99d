"""The trajectories of NASA/TM-2015-218675, read in SI units, and the difference of two trajectories.

The files are not part of this package; users pass their folder. Their paths are <folder of the case>/sim_<number>.csv
or sim_<number>_si.csv. Columns are named quantity_unit or quantity_unit_component.
"""

from __future__ import annotations

import csv
import dataclasses
import functools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

import twistax as tx
from twistax.mechanics import flight
from twistax.mechanics.environment import earth
from twistax.mechanics.environment.atmosphere import US1976
from twistax.mechanics.flight.nasa import UNITS

from .scene import about

Array = NDArray[Any]

#: The planets of the report, with the air of the layers up to 86 km, below which most cases stay.
EARTH, ROUND_EARTH = (dataclasses.replace(planet, air=US1976) for planet in (flight.EARTH, flight.ROUND_EARTH))

#: Length of the trajectories, s, and the times at which they are compared.
DURATION = 30.0
TIMES = np.linspace(0.0, DURATION, 301)

#: By the number of the case.
FOLDERS = {
    1: "01_dragless_sphere",
    2: "02_tumbling_brick",
    3: "03_tumbling_brick_damped",
    4: "04_sphere_round_still",
    5: "05_sphere_round_turning",
    6: "06_sphere_drag",
    7: "07_sphere_steady_wind",
    8: "08_sphere_wind_shear",
    9: "09_cannonball_east",
    10: "10_cannonball_north",
}


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

    def apart(self, other: Track) -> dict[str, Array]:
        """Differences over time: distance, m; angle of the relative rotation, rad; size of the difference of rates."""
        chord = np.linalg.norm(self.attitude - other.attitude, axis=(1, 2)) / np.sqrt(8.0)
        return {
            "position": np.linalg.norm(self.position - other.position, axis=1),
            "attitude": 2.0 * np.arcsin(np.minimum(chord, 1.0)),
            "rate": np.linalg.norm(self.rate - other.rate, axis=1),
        }


@functools.cache
def _fixed_positions(figure: earth.Ellipsoid) -> Callable[..., Array]:
    """Planet-fixed positions (n, 3) of latitudes, longitudes and altitudes, (n,) each."""
    place = [tx.State(name) for name in ("latitude", "longitude", "altitude")]
    one = tx.lower(figure.position(*place))
    vectorized = jax.jit(jax.vmap(lambda *values: one(0.0, dict(zip(("latitude", "longitude", "altitude"), values)))))
    return lambda *values: np.asarray(vectorized(*values))


class PublishedTable:
    """A published trajectory at TIMES; rows in between are omitted. Raises InputError for a file of another form."""

    def __init__(self, path: Path, figure: earth.Ellipsoid = earth.WGS84) -> None:
        with path.open(newline="") as file:
            self.names, *rows = list(csv.reader(file)) or [[]]
        self.path, self.figure = path, figure
        try:
            self.values = np.array(rows, dtype=float)
        except ValueError as error:
            raise tx.InputError(
                f"{path}: expected the same number of entries in each row as there are columns: {error}"
            ) from None
        skip = max(1, (len(self.values) - 1) // (len(TIMES) - 1))
        self.values = self.values[::skip]
        if self.values.shape[0] != len(TIMES) or not np.allclose(self["time"], TIMES, rtol=0.0, atol=1e-6):
            raise tx.InputError(
                f"{path}: expected {len(TIMES)} rows from 0 to {DURATION:g} s, or a multiple of this number"
            )

    def __getitem__(self, name: str) -> Array:
        if name not in self.names:
            raise tx.InputError(f"{self.path}: no column {name}")
        return self.values[:, self.names.index(name)]

    def __contains__(self, quantity: str) -> bool:
        return any(name.startswith(quantity + "_") for name in self.names)

    def column(self, quantity: str, component: str = "") -> Array:
        """A quantity in SI, and of a vector a component."""
        ending = f"_{component}" if component else ""
        for name in self.names:
            unit = re.fullmatch(rf"{quantity}_(\w+?){ending}", name)
            if unit and unit[1] in UNITS:
                return float(UNITS[unit[1]]) * self[name]
        known = ", ".join(UNITS)
        raise tx.InputError(f"{self.path}: no column {quantity}_<unit>{ending} with a unit among {known}")

    def columns(self, quantity: str, components: str) -> Array:
        """Components of a vector side by side."""
        return np.stack([self.column(quantity, component) for component in components.split()], axis=1)

    def position(self) -> Array:
        """Inertial position, converted from planet-fixed or geodetic coordinates where it is not given."""
        if "eiPosition" in self:
            return self.columns("eiPosition", "X Y Z")
        if "gePosition" in self:
            x, y, z = self.columns("gePosition", "X Y Z").T
            longitude = np.arctan2(y, x)
            distance = np.hypot(x, y)
        else:
            longitude = self.column("longitude")
            over = self.column("latitude"), np.zeros_like(longitude), self.column("altitudeMsl")
            distance, _, z = _fixed_positions(self.figure)(*over).T
        angle = longitude + self.figure.rate * TIMES
        return np.stack([distance * np.cos(angle), distance * np.sin(angle), z], axis=1)

    def track(self) -> Track:
        """The trajectory to compare; NaN where a simulation has no data."""
        blank = np.full((len(TIMES), 3), np.nan)
        angles = self.columns("eulerAngle", "Roll Pitch Yaw") if "eulerAngle" in self else blank
        rates = "bodyAngularRateWrtEi"
        rate = self.columns(rates, "Roll Pitch Yaw") if rates in self else blank
        x, y, z = np.eye(3)
        attitude = np.stack([about(z, yaw) @ about(y, pitch) @ about(x, roll) for roll, pitch, yaw in angles])
        density = self.column("airDensity") if "airDensity" in self else blank[:, 0]
        return Track(self.position(), attitude, rate, self.column("altitudeMsl"), density)


def read(directory: Path, number: int, figure: earth.Ellipsoid = earth.WGS84) -> dict[str, Track]:
    """The published simulations of a case, by number. Raises InputError if there are none."""
    folder = directory / FOLDERS[number]
    files = {file.stem.split("_")[1]: file for file in sorted(folder.glob("sim_*.csv"), reverse=True)}
    if not files:
        raise tx.InputError(
            f"case {number}: no file sim_<number>.csv in {folder}\n  fix: pass the folder that contains {folder.name}"
        )
    return {name: PublishedTable(file, figure).track() for name, file in sorted(files.items())}
