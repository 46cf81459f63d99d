"""The atmosphere above 86 km compared with published tables, and local axes at a pole."""

from typing import Any

import numpy as np

import twistax as tx

from ...mechanics import SpatialInertia, flight
from ...mechanics.flight import numbers
from ...units import degrees
from ..harness.expected import at_most, between, refused
from ..harness.measurement import Section, quick

#: Altitude, km, temperature, K, pressure, Pa, density, kg/m3. Source: U.S. Standard Atmosphere, 1976, table I.
_PRINTED = np.array(
    [
        [100.0, 195.08, 3.2011e-2, 5.604e-7],
        [150.0, 634.39, 4.5422e-4, 2.076e-9],
        [200.0, 854.56, 8.4736e-5, 2.541e-10],
        [300.0, 976.01, 8.7704e-6, 1.916e-11],
        [500.0, 999.24, 3.0236e-7, 5.215e-13],
        [1000.0, 1000.00, 7.5138e-9, 3.561e-15],
    ]
)
_AIR = flight.EARTH.air


def _off(column: int) -> float:
    """The largest relative difference of the Earth's air from a column of the published table."""
    function = (_AIR.temperature, _AIR.pressure, _AIR.density)[column - 1]
    return float(np.max(np.abs(numbers(function(1e3 * _PRINTED[:, 0])) / _PRINTED[:, column] - 1.0)))


def _jump(slope: bool) -> float:
    """The relative jump at 1000 km of the density, or of the slope of its logarithm as differences over 1 m show it."""
    below, at, above = np.log(numbers(_AIR.density(np.array([1e6 - 1.0, 1e6, 1e6 + 1.0]))))
    return abs((above - at) / (at - below) - 1.0) if slope else abs(float(np.expm1(above - at)))


def _pushed() -> tx.Dynamics:
    """A body pushed by a control, with its rate relative to local axes as an output."""
    craft, push = flight.Vehicle(), tx.Control("push", shape=(3,))
    body = SpatialInertia(mass=2.0, inertia=np.eye(3))
    turn = {"turn": craft.rate(flight.local_axes)}
    return tx.compile(craft.system(body, tx.lie.wrench(force=push, torque=np.zeros(3)), outputs=turn))


def _placed(latitude: float, relative_to: flight.Reference = flight.fixed_axes) -> dict[str, Any]:
    return flight.start(latitude, 0.3, 3e3, (0.0, 50.0, 0.0), relative_to=relative_to)


def _trimmed() -> float:
    """The measure of a trim at the pole whose condition is the rate of local axes."""
    roles: dict[str, Any] = {"free": ["V", "push"], "fixed": ["turn"], "zero": ["V[0:3]"]}
    return tx.trim(_pushed(), _placed(90.0 * degrees), {"push": np.zeros(3)}, **roles).measure


def _without_a_root() -> float:
    """The measure of a trim of 1 + sqrt(push), push at least 1e-20, which nothing makes zero."""
    x, push = tx.State("x"), tx.Control("push")
    dynamics = tx.compile(tx.System(rates={x: 1.0 + tx.Sqrt(push)}))
    return tx.trim(
        dynamics, {"x": 0.0}, {"push": 0.5}, free={"push": (1e-20, 1.0)}, zero=["x"], throw=False
    ).measure  # fmt: skip


_NORTH = refused(tx.InputError, "at a pole there is no north")
_LOST = refused(tx.TrajectoryError, "at the start these are not finite")

FLIGHT: Section = [
    "At 100, 150, 200, 300, 500, 1000 km; the printed table is itself 1e-3 off its equations above 700 km.",
    quick("temperature of the Earth's air, relative to the table", "flight.EARTH", at_most(1.1e-3), _off, 1),
    quick("its pressure", "flight.EARTH", at_most(1.1e-3), _off, 2),
    quick("its density", "flight.EARTH", at_most(1.1e-3), _off, 3),
    "Beyond, every gas falls by its own weight from what it is at 1000 km.",
    quick("the density at 1000 km and 1 m above it, relative", "flight.EARTH", at_most(1e-5), _jump, False),
    quick("the slope of its logarithm below and above", "flight.EARTH", at_most(2e-4), _jump, True),
    "Of 1 m/s eastward local axes turn without end at a pole.",
    quick(
        "a rate relative to local axes at a pole",
        "flight.start",
        _NORTH,
        lambda: _placed(90.0 * degrees, flight.local_axes)["V"][5],
    ),
    "A rate that does not exist is no target.",
    quick("a trim to the rate of local axes at a pole", "tx.trim", _LOST, _trimmed),
    "By its derivative at the bound, 5e9, a step of 2e-10 would do; at points around the derivative is another.",
    quick("what is left of 1 + sqrt(push)", "tx.trim", between(1e-3), _without_a_root),
]
