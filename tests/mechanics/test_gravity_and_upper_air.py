"""Harmonics, the gravity gradient and the air above 86 km, against 40 digits, point masses and the standard."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from us1976_oracle import MASSES, gases
from us1976_oracle import atmosphere as standard

import twistax as tx
from twistax.mechanics import environment, flight

atmosphere, earth, gravity = environment.atmosphere, environment.earth, environment.gravity
EGM2008, Harmonics = environment.harmonics.EGM2008, environment.harmonics.Harmonics
numbers = flight.numbers

PLACES = [[4.1e6, -3.3e6, 3.9e6], [1e-3, 0.0, -6.6e6]]


def slope_of_potential(model: Harmonics, place: list[float]) -> list[float]:
    """The gradient of the series by differences in 40 digits, with Legendre functions from Rodrigues' formula."""
    with mp.workdps(40):

        def legendre(n: int, m: int) -> list[Any]:
            """The m-th derivative of P_n, by powers."""
            row = mp.taylor(lambda s: mp.legendre(n, s), 0, n)
            for _ in range(m):
                row = [k * row[k] for k in range(1, len(row))]
            scale = mp.sqrt((2 - (m == 0)) * (2 * n + 1) * mp.factorial(n - m) / mp.factorial(n + m))
            return [scale * each for each in row]

        rows = [(n, m, C, S, legendre(n, m)) for n, m, C, S in model.terms]

        def potential(x: Any, y: Any, z: Any) -> Any:
            r = mp.sqrt(x * x + y * y + z * z)
            s, c, longitude = z / r, mp.sqrt(x * x + y * y) / r, mp.atan2(y, x)
            total = mp.mpf(1)
            for n, m, C, S, row in rows:
                wave = C * mp.cos(m * longitude) + S * mp.sin(m * longitude)
                total += (model.radius / r) ** n * c**m * sum(a * s**k for k, a in enumerate(row)) * wave
            return mp.mpf(model.gm) / r * total

        at = [mp.mpf(q) for q in place]
        h = mp.mpf("1e-8")
        found = []
        for i in range(3):
            ahead, behind = ([q + sign * h * (i == j) for j, q in enumerate(at)] for sign in (1, -1))
            found.append(float((potential(*ahead) - potential(*behind)) / (2 * h)))
        return found


@pytest.mark.parametrize("place", PLACES)
def test_harmonics_are_the_gradient_of_their_potential(place: list[float]) -> None:
    found = numbers(EGM2008.acceleration(place))
    np.testing.assert_allclose(found, slope_of_potential(EGM2008, place), rtol=1e-14, atol=1e-13)


def test_high_orders_in_single_precision() -> None:
    """Without normalisation they overflow there."""
    place, model = np.array([0.7, 0.7, 0.2]), Harmonics(1.0, 1.0, ((32, 32, 1e-3, 2e-3),))
    expected = slope_of_potential(model, place.tolist())
    pull = environment.harmonics.HarmonicPull(place, model)
    for kind, close in (jnp.float32, 1e-5), (jnp.float64, 1e-13):
        np.testing.assert_allclose(pull.evaluate(jnp.asarray(place, kind)), expected, rtol=close)


def test_j2_is_the_second_zonal_harmonic() -> None:
    j2 = gravity.EARTH_J2
    same = Harmonics(j2.gm, j2.radius, ((2, 0, -j2.j2 / np.sqrt(5.0), 0.0),))
    assert same.axisymmetric
    np.testing.assert_allclose(numbers(same.acceleration(PLACES[0])), numbers(j2.acceleration(PLACES[0])), rtol=4e-16)
    # The dynamic J2 of EGM2008 and that of the ellipsoid's normal field differ by 3e-6 of it.
    assert -np.sqrt(5.0) * EGM2008.terms[0][2] == pytest.approx(j2.j2, rel=4e-6)


def test_a_planet_turns_its_bulges() -> None:
    """With tesseral terms the pull in inertial axes changes as the planet turns; a turn of a place turns it."""
    planet = flight.Planet(earth.WGS84, EGM2008.up_to(3))
    turn = numbers(earth.WGS84.to_inertial(7000.0))
    p = np.array(PLACES[0])
    pull = numbers(planet.gravitation(p, 0.0))
    np.testing.assert_allclose(numbers(planet.gravitation(turn @ p, 7000.0)), turn @ pull, rtol=1e-13)
    assert np.abs(numbers(planet.gravitation(p, 7000.0)) - pull).max() > 1e-6
    assert not EGM2008.axisymmetric
    assert EGM2008.up_to(8, 0).axisymmetric
    assert len(EGM2008.up_to(2).terms) == 3


def test_gravity_gradient_of_a_cloud_of_points() -> None:
    """The moment about the centre of the pulls on its points, which are 1e-6 of the distance away."""
    masses = np.array([2.0, 1.0, 3.0, 1.5])
    points = np.random.default_rng(0).normal(size=(4, 3))
    points -= masses @ points / masses.sum()
    place = np.array([0.6e6, -0.5e6, 0.7e6])
    tensor = sum(m * (q @ q * np.eye(3) - np.outer(q, q)) for m, q in zip(masses, points))
    gm = 3.986e14
    with mp.workdps(40):
        moment = mp.zeros(3, 1)
        for m, q in zip(masses, points):
            away = [mp.mpf(a) + mp.mpf(b) for a, b in zip(place, q)]
            pull = [-gm * m * a / mp.sqrt(sum(b * b for b in away)) ** 3 for a in away]
            for i in range(3):
                moment[i] += q[i - 2] * pull[i - 1] - q[i - 1] * pull[i - 2]
        expected = [float(each) for each in moment]
    np.testing.assert_allclose(numbers(gravity.gradient_torque(gm, place, tensor)), expected, rtol=2e-5)


# ---- air above 86 km -------------------------------------------------------------------------------------------------

#: U.S. Standard Atmosphere, 1976, table I: km, K, Pa, kg/m3.
PRINTED = [
    (90.0, 186.87, 1.8359e-1, 3.416e-6),
    (100.0, 195.08, 3.2011e-2, 5.604e-7),
    (120.0, 360.00, 2.5382e-3, 2.222e-8),
    (150.0, 634.39, 4.5422e-4, 2.076e-9),
    (200.0, 854.56, 8.4736e-5, 2.541e-10),
    (300.0, 976.01, 8.7704e-6, 1.916e-11),
    (500.0, 999.24, 3.0236e-7, 5.215e-13),
    (1000.0, 1000.00, 7.5138e-9, 3.561e-15),
]
AIR = environment.upper_atmosphere.US1976_TO_1000_KM


def test_the_printed_table() -> None:
    z = 1e3 * np.array([row[0] for row in PRINTED])
    for i, function in enumerate((AIR.temperature, AIR.pressure, AIR.density), start=1):
        np.testing.assert_allclose(numbers(function(z)), [row[i] for row in PRINTED], rtol=1.1e-3)


def test_the_standards_own_equations() -> None:
    z = np.linspace(86.0, 1000.0, 91401)
    T, p, rho = standard(z)
    some = slice(7, None, 911)
    np.testing.assert_allclose(numbers(AIR.temperature(1e3 * z[some])), T[some], rtol=0.0, atol=0.1)
    np.testing.assert_allclose(numbers(AIR.pressure(1e3 * z[some])), p[some], rtol=5e-4)
    np.testing.assert_allclose(numbers(AIR.density(1e3 * z[some])), rho[some], rtol=5e-4)


def test_it_joins_the_layers() -> None:
    below, above, low = 86e3 - 1e-6, 86e3 + 1e-6, np.array([0.0, 3e4, 8e4])
    for name, jump in (("temperature", 5e-4), ("speed_of_sound", 3e-4)):
        function = getattr(AIR, name)
        np.testing.assert_allclose(numbers(function(above)), numbers(function(below)), rtol=jump)
        np.testing.assert_allclose(numbers(function(low)), numbers(getattr(atmosphere.US1976, name)(low)), rtol=1e-15)


def test_beyond_1000_km_every_gas_falls_by_its_own_weight() -> None:
    """The balance of each gas, integrated outward by SciPy from what the standard's equations have at 1000 km."""
    T, n = gases(np.linspace(86.0, 1000.0, 91401))
    names = list(n)
    start, masses = np.array([n[k][-1] for k in names]), np.array([MASSES[k] for k in names])
    ends = np.array([1.0, 1.2, 2.0, 10.0, 100.0]) * 1e6
    fallen = solve_ivp(
        lambda z, logs: -masses * 9.80665 * (6356766.0 / (6356766.0 + z)) ** 2 / (8314.32 * T[-1]),
        (1e6, ends[-1]), np.log(np.maximum(start, 1e-300)), t_eval=ends, rtol=1e-10, atol=1e-10,
    )  # fmt: skip
    number = np.exp(fallen.y)
    np.testing.assert_allclose(numbers(AIR.pressure(ends)), 1.380622e-23 * T[-1] * number.sum(0), rtol=2e-4)
    np.testing.assert_allclose(numbers(AIR.density(ends)), masses @ number / 6.022169e26, rtol=2e-4)
    np.testing.assert_allclose(numbers(AIR.temperature(ends)), T[-1], rtol=1e-6)


def test_value_and_slope_go_on_at_1000_km() -> None:
    z = tx.State("z")
    of = tx.lower(tx.Log(tx.Stack([AIR.pressure(z), AIR.density(z)])))
    with jax.disable_jit():
        found = [jax.jvp(lambda z: of(0.0, {"z": z}), (jnp.asarray(1e6 + off),), (1.0,)) for off in (-1e-6, 1e-6)]
    (low, falls), (high, goes_on) = found
    np.testing.assert_allclose(low, high, rtol=1e-12)
    np.testing.assert_allclose(falls, goes_on, rtol=2e-4)


def test_one_gas_is_that_of_the_tables_end() -> None:
    """Without gases the air of the table's end is one: p / rho stays, and dp/dz = -rho g."""
    plain = dataclasses.replace(AIR, gases=())
    z = np.array([1e6, 1.5e6, 4e6])
    p, rho = numbers(plain.pressure(z)), numbers(plain.density(z))
    np.testing.assert_allclose(p / rho, p[0] / rho[0], rtol=1e-12)
    slope = (numbers(plain.pressure(z + 10.0)) - numbers(plain.pressure(z - 10.0))) / 20.0
    g = 9.80665 * (6356766.0 / (6356766.0 + z)) ** 2
    np.testing.assert_allclose(slope[1:], (-rho * g)[1:], rtol=1e-6)


def test_planets_have_it() -> None:
    craft = flight.Vehicle()
    assert flight.Planet(earth.WGS84, gravity.EARTH_J2).air is flight.ROUND_EARTH.air is AIR
    state = craft.start(0.1, 0.2, 400e3, (7600.0, 0.0, 0.0))
    found = numbers(craft.air.density, {craft.pose: state["g"], craft.twist: state["V"], tx.Time(): 0.0})
    assert found == pytest.approx(2.803e-12, rel=1e-3)
