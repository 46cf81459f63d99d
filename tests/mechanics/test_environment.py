"""Gravity, air and the Earth's figure against potentials, published tables, quadrature and 50-digit arithmetic."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import quad

import twistax as tx
from twistax.errors import ModelError
from twistax.mechanics import environment

atmosphere, earth, gravity = environment.atmosphere, environment.earth, environment.gravity

mp.mp.dps = 50

p, z = tx.State("p", shape=(3,)), tx.State("z")


def function(expr: Any, leaf: tx.Leaf) -> Callable[[Any], Any]:
    """An expression, or several, of one leaf as a function of that leaf."""
    lowered = tx.lower(expr)
    return lambda value: lowered(0.0, {leaf.name: value})


# ---- gravity -----------------------------------------------------------------------------------------------------

PLACES = [[6387281.0, 0.0, 0.0], [0.0, 0.0, -6.4e6], [4.1e6, -3.3e6, 3.9e6], [-2.0e7, 3.1e7, -1.2e6]]


def slope_of_potential(model: gravity.J2, place: list[float]) -> list[float]:
    """The gradient of the potential by differences in 50 digits."""
    gm, radius, j2 = mp.mpf(model.gm), mp.mpf(model.radius), mp.mpf(model.j2)

    def potential(x: Any, y: Any, h: Any) -> Any:
        r = mp.sqrt(x * x + y * y + h * h)
        return gm / r * (1 - j2 * (radius / r) ** 2 * mp.legendre(2, h / r))

    return [float(mp.diff(potential, tuple(place), tuple(int(i == j) for j in range(3)))) for i in range(3)]


@pytest.mark.parametrize(
    ("model", "as_j2"),
    [
        (gravity.EARTH_J2, gravity.EARTH_J2),
        (gravity.EARTH_POINT_MASS, gravity.J2(gravity.EARTH_J2.gm, 1.0, 0.0)),
    ],
    ids=["J2", "point mass"],
)
def test_acceleration_is_the_gradient_of_the_potential(model: Any, as_j2: gravity.J2) -> None:
    found = jax.vmap(function(model.acceleration(p), p))(jnp.array(PLACES))
    expected = np.array([slope_of_potential(as_j2, place) for place in PLACES])
    np.testing.assert_allclose(found, expected, rtol=2e-15, atol=1e-18)


def test_j2_belongs_to_the_ellipsoid() -> None:
    """J2 of an equipotential ellipsoid follows from its figure, mass and rate (Heiskanen and Moritz, section 2-9)."""
    e2 = mp.mpf(earth.WGS84.eccentricity_squared)
    a, b, e = mp.mpf(earth.WGS84.radius), mp.mpf(earth.WGS84.polar_radius), mp.sqrt(e2 / (1 - e2))
    m = mp.mpf(earth.WGS84.rate) ** 2 * a**2 * b / mp.mpf(gravity.EARTH_J2.gm)
    q = ((1 + 3 / e**2) * mp.atan(e) - 3 / e) / 2
    assert abs(e2 / 3 * (1 - 2 * m * e / (15 * q)) - gravity.EARTH_J2.j2) < 5e-12


def test_gravity_follows_the_precision_and_stays_small() -> None:
    acceleration = function(gravity.EARTH_J2.acceleration(p), p)
    single = acceleration(jnp.array(PLACES[2], jnp.float32))
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, acceleration(jnp.array(PLACES[2])), rtol=1e-6)


# ---- air ---------------------------------------------------------------------------------------------------------

AIR = atmosphere.US1976
#: U.S. Standard Atmosphere, 1976, NOAA-S/T 76-1562, table I: geometric altitude m, temperature K, pressure Pa,
#: density kg/m3, speed of sound m/s, to the digits printed there. Above 80 km the temperature is the kinetic one.
TABLE = [
    (-5000.0, 320.676, 1.7776e5, 1.9311, 358.99),
    (0.0, 288.150, 1.01325e5, 1.2250, 340.29),
    (1000.0, 281.651, 8.9876e4, 1.1117, 336.43),
    (5000.0, 255.676, 5.4048e4, 7.3643e-1, 320.55),
    (10000.0, 223.252, 2.6500e4, 4.1351e-1, 299.53),
    (20000.0, 216.650, 5.5293e3, 8.8910e-2, 295.07),
    (30000.0, 226.509, 1.1970e3, 1.8410e-2, 301.71),
    (50000.0, 270.650, 7.9779e1, 1.0269e-3, 329.80),
    (70000.0, 219.585, 5.2209e0, 8.2829e-5, 297.06),
    (80000.0, 198.639, 1.0525e0, 1.8458e-5, 282.54),
]
#: The same standard, defined layers: geopotential altitude m, molecular-scale temperature K, pressure Pa.
LAYERS = [
    (0.0, 288.15, 101325.0),
    (11e3, 216.65, 22632.06),
    (20e3, 216.65, 5474.889),
    (32e3, 228.65, 868.0187),
    (47e3, 270.65, 110.9063),
    (51e3, 270.65, 66.93887),
    (71e3, 214.65, 3.956420),
    (84852.0, 186.946, 0.37338),
]


def geometric(H: Any) -> Any:
    return H * 6356766.0 / (6356766.0 - H)


@pytest.fixture(scope="module")
def air() -> Callable[[Any], Any]:
    """(temperature, pressure, density, speed of sound) at one altitude."""
    return function((AIR.temperature(z), AIR.pressure(z), AIR.density(z), AIR.speed_of_sound(z)), z)


def test_published_tables(air: Callable[[Any], Any]) -> None:
    table = np.array(TABLE)
    for column, (found, half_digit) in enumerate(zip(jax.vmap(air)(jnp.array(table[:, 0])), [5.1e-4, 0, 0, 5.1e-3]), 1):
        np.testing.assert_allclose(found, table[:, column], rtol=0.0 if half_digit else 5e-5, atol=half_digit)
    layers = np.array(LAYERS)
    temperature, pressure, _, _ = jax.vmap(air)(jnp.array(geometric(layers[:, 0])))
    np.testing.assert_allclose(temperature, layers[:, 1], rtol=1e-12)
    np.testing.assert_allclose(pressure[:-1], layers[:-1, 2], rtol=1e-6)
    np.testing.assert_allclose(pressure[-1], layers[-1, 2], rtol=1.5e-5)


def test_hydrostatic_balance_by_quadrature(air: Callable[[Any], Any]) -> None:
    """ln p falls by the integral of M g / (R* T) over geometric altitude; the temperature here is interpolated anew."""
    bases, temperatures = np.array(LAYERS)[:, 0], np.array(LAYERS)[:, 1]

    def fall(height: float) -> float:
        H = 6356766.0 * height / (6356766.0 + height)
        g = 9.80665 * (6356766.0 / (6356766.0 + height)) ** 2
        return 28.9644 * g / (8314.32 * float(np.interp(H, bases, temperatures)))

    heights = np.concatenate([geometric(bases), [4e3, 15e3, 26e3, 40e3, 49e3, 60e3, 80e3]])
    edges = geometric(bases[1:-1])
    expected = [101325.0 * np.exp(-quad(fall, 0.0, h, points=edges, epsabs=1e-13, limit=200)[0]) for h in heights]
    np.testing.assert_allclose(jax.vmap(air)(jnp.array(heights))[1], expected, rtol=1e-12)


def test_air_is_smooth_within_layers_and_continuous_between(air: Callable[[Any], Any]) -> None:
    edges = geometric(np.array(LAYERS)[:, 0])
    heights = np.concatenate([edges - 1e-6, edges, edges + 1e-6, [-2e3, 5e3, 15e3, 86e3, 1e5, 1e6]])
    values, slopes = jax.jit(jax.vmap(lambda h: (air(h), jax.jacrev(air)(h))))(jnp.array(heights))
    for below, at, above in (np.split(np.asarray(v)[:24], 3) for v in values):
        np.testing.assert_allclose(below, at, rtol=3e-10)
        np.testing.assert_allclose(above, at, rtol=3e-10)
    assert all(np.isfinite(slope).all() for slope in slopes)
    # dp/dz = -rho g everywhere, at the edges too
    g = 9.80665 * (6356766.0 / (6356766.0 + heights)) ** 2
    np.testing.assert_allclose(slopes[1], -np.asarray(values[2]) * g, rtol=1e-13)
    # at an edge the temperature has the slope of the layer above
    lapses = np.array([-6.5, 0.0, 1.0, 2.8, 0.0, -2.8, -2.0, 0.0]) * 1e-3
    np.testing.assert_allclose(slopes[0][8:16], lapses * g[8:16] / 9.80665, rtol=1e-12, atol=1e-18)
    # the first layer goes on below zero, the top is extended at even temperature
    np.testing.assert_allclose(values[0][24], 288.15 + 6.5e-3 * 2e3 * 6356766.0 / (6356766.0 - 2e3), rtol=1e-14)
    np.testing.assert_allclose(values[0][-2:], 186.946, rtol=1e-12)


def test_air_follows_shape_and_precision() -> None:
    heights = tx.State("h", shape=(2, 2))
    density = tx.lower(AIR.density(heights))
    values = np.array([[0.0, 9e3], [2e4, 8e4]])
    found = density(0.0, {"h": values.astype(np.float32)})
    assert found.shape == (2, 2)
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, density(0.0, {"h": values}), rtol=3e-5)


def test_another_atmosphere_and_what_makes_none() -> None:
    import dataclasses

    hot = dataclasses.replace(AIR, temperature_at_base=308.15)
    assert float(tx.lower(hot.temperature(z))(0.0, {"z": jnp.array(0.0)})) == 308.15
    with pytest.raises(ModelError, match="got 8 bases and 1 lapses"):
        dataclasses.replace(AIR, lapses=(0.0,))
    with pytest.raises(ModelError, match="bases that increase"):
        dataclasses.replace(AIR, bases=AIR.bases[::-1])
    with pytest.raises(ModelError, match="temperatures above 0 K"):
        dataclasses.replace(AIR, temperature_at_base=50.0)
    with pytest.raises(ModelError, match="LayeredAtmosphere expects pressure_at_base to be a positive number, got -1"):
        dataclasses.replace(AIR, pressure_at_base=-1.0)
    with pytest.raises(ModelError, match="gas_constant to be a positive number, got 0"):
        dataclasses.replace(AIR, gas_constant=0.0)
    with pytest.raises(ModelError, match="no decrease above the last base"):
        dataclasses.replace(AIR, lapses=(*AIR.lapses[:-1], -1e-3))


# ---- the Earth's figure ------------------------------------------------------------------------------------------

LATITUDES = np.concatenate([[-np.pi / 2, 0.0, np.pi / 2], np.linspace(-1.57, 1.57, 37), [1e-9, -1e-9, 1.5707]])
ALTITUDES = np.array([-1e5, -1e3, 0.0, 10.0, 9144.0, 86e3, 4e5, 1e6, 3.6e7])
A, E2 = mp.mpf(6378137), (2 - 1 / mp.mpf("298.257223563")) / mp.mpf("298.257223563")


def exact_position(latitude: Any, longitude: Any, altitude: Any) -> list[Any]:
    """Earth-fixed position in 50 digits."""
    latitude, longitude, altitude = mp.mpf(latitude), mp.mpf(longitude), mp.mpf(altitude)
    normal = A / mp.sqrt(1 - E2 * mp.sin(latitude) ** 2)
    out = (normal + altitude) * mp.cos(latitude)
    return [out * mp.cos(longitude), out * mp.sin(longitude), (normal * (1 - E2) + altitude) * mp.sin(latitude)]


def test_latitude_and_altitude_against_fifty_digits() -> None:
    """The exact answer for the rounded position: that of the exact position, moved along and across the vertical."""
    given, expected = [], []
    for latitude in LATITUDES:
        s, c = mp.sin(mp.mpf(latitude)), mp.cos(mp.mpf(latitude))
        for altitude in ALTITUDES:
            x, _, y = exact_position(latitude, 0, altitude)
            rho, height = abs(float(x)), float(y)
            dx, dy = rho - x, height - y
            curvature = A * (1 - E2) / (1 - E2 * s**2) ** mp.mpf("1.5")
            turned = (c * dy - s * dx) / (curvature + mp.mpf(altitude))
            given.append([rho, height])
            expected.append([float(mp.mpf(latitude) + turned), float(mp.mpf(altitude) + c * dx + s * dy), altitude])
    expected = np.array(expected)
    rho, height = tx.State("rho"), tx.State("height")
    meridian = tx.lower(earth.Meridian(rho, height))
    values = np.array(given)
    found = jax.vmap(lambda r, h: meridian(0.0, {"rho": r, "height": h}))(*values.T)
    # Round-off alone: one unit in the last place of the distance from the centre is 0.93e-9 m up to 2000 km.
    unit = np.spacing(6.4e6 + expected[:, 2])
    across = (np.asarray(found[:, 0]) - expected[:, 0]) * (6.4e6 + expected[:, 2])
    along = np.asarray(found[:, 1]) - expected[:, 1]
    assert np.max(np.abs(across) / unit) < 2.0
    assert np.max(np.abs(along) / unit) < 4.0
    assert np.max(np.abs(along[expected[:, 2] < 2e6])) < 2e-9


@pytest.fixture(scope="module")
def geodetic() -> Callable[[Any], jax.Array]:
    return function(tx.Concat(*earth.WGS84.geodetic(p)), p)


PLACED = [(0.3, -2.0, 9144.0), (-1.2, 3.0, -500.0), (0.0, 0.0, 0.0), (1.5, 1.0, 1e6), (-1e-7, 0.5, 2e4)]


def test_position_and_back(geodetic: Callable[[Any], jax.Array]) -> None:
    place = tx.State("place", shape=(3,))
    forward = function(earth.WGS84.position(place[0], place[1], place[2]), place)
    positions = jax.vmap(forward)(jnp.array(PLACED))
    expected = np.array([[float(c) for c in exact_position(*place)] for place in PLACED])
    np.testing.assert_allclose(positions, expected, rtol=0.0, atol=3e-9)
    back = np.asarray(jax.vmap(geodetic)(positions))
    np.testing.assert_allclose(back[:, 0], np.array(PLACED)[:, 0], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(back[:, 1], np.array(PLACED)[:, 1], rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(back[:, 2], np.array(PLACED)[:, 2], rtol=0.0, atol=5e-9)


def test_derivatives_of_geodetic_coordinates(geodetic: Callable[[Any], jax.Array]) -> None:
    """The inverse of the Jacobian of the way back, which is differentiated in 50 digits."""
    places = np.array([[float(c) for c in exact_position(*place)] for place in PLACED])
    ends = np.array([[0.0, 0.0, 6.4e6], [0.0, 0.0, -6.3e6]])

    @jax.jit
    @jax.vmap
    def slopes(place: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        return jax.jacfwd(geodetic)(place), jax.jacrev(geodetic)(place), jax.jacfwd(jax.jacrev(geodetic))(place)

    forward, reverse, second = slopes(jnp.concatenate([jnp.array(places), jnp.array(ends)]))
    np.testing.assert_allclose(forward, reverse, rtol=1e-12, atol=1e-20)
    assert np.isfinite(second).all()
    for found, place in zip(forward, PLACED):
        rows = [
            [
                mp.diff(lambda *q, i=i: exact_position(*q)[i], place, tuple(int(k == j) for k in range(3)))
                for j in range(3)
            ]
            for i in range(3)
        ]
        expected = np.array((mp.matrix(rows) ** -1).tolist(), dtype=float)
        scale = np.array([6.4e6, 6.4e6 * np.cos(place[0]), 1.0])[:, None]  # so that all entries are of order one
        np.testing.assert_allclose(found * scale, expected * scale, rtol=0.0, atol=1e-14)
    # on the axis the altitude grows along it and, by symmetry, not across
    np.testing.assert_allclose(forward[-2:, 2], [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(forward[-2:, 1], 0.0, atol=0.0)


def test_local_axes_point_where_their_names_say() -> None:
    place = tx.State("place", shape=(3,))
    axes = jax.vmap(function(earth.north_east_down(place[0], place[1]), place))(jnp.array(PLACED))
    np.testing.assert_allclose(np.linalg.det(axes), 1.0, rtol=1e-14)
    for R, place in zip(np.asarray(axes), PLACED):
        for column, (index, sign) in enumerate([(0, 1.0), (1, 1.0), (2, -1.0)]):
            along = [
                mp.diff(lambda *q, i=i: exact_position(*q)[i], place, tuple(int(k == index) for k in range(3)))
                for i in range(3)
            ]
            direction = np.array([float(c) for c in along])
            np.testing.assert_allclose(R[:, column], sign * direction / np.linalg.norm(direction), rtol=0.0, atol=1e-14)


def test_a_point_at_rest_on_the_earth_feels_no_wind() -> None:
    t, v = tx.Time(), tx.State("v", shape=(3,))
    turn = tx.lower(earth.WGS84.to_inertial(t))
    wind = tx.lower(earth.WGS84.air_velocity(p, v))
    fixed = jnp.array([4.1e6, -3.3e6, 3.9e6])
    position, velocity = jax.jvp(lambda now: turn(now, {}) @ fixed, (jnp.array(500.0),), (jnp.array(1.0),))
    assert np.linalg.norm(velocity) > 300.0
    np.testing.assert_allclose(wind(0.0, {"p": position, "v": velocity}), 0.0, atol=1e-12)
    # the Earth turns towards the east
    np.testing.assert_allclose(turn(1.0, {})[:, 0], [1.0, 7.292115e-5, 0.0], rtol=0.0, atol=3e-9)


def test_geodetic_coordinates_follow_the_precision(geodetic: Callable[[Any], jax.Array]) -> None:
    single = geodetic(jnp.array([4.1e6, -3.3e6, 3.9e6], jnp.float32))
    assert single.dtype == jnp.float32
    double = geodetic(jnp.array([4.1e6, -3.3e6, 3.9e6]))
    np.testing.assert_allclose(single[:2], double[:2], rtol=1e-6)
    np.testing.assert_allclose(single[2], double[2], rtol=0.0, atol=4.0)
