"""Turbulence, engines, burning and sensors: against their spectra, the balance of momentum and finite differences."""

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.spatial.transform import Rotation

import twistax as tx
from twistax.errors import InputError, ModelError, ShapeError
from twistax.mechanics import SpatialInertia, environment, flight
from twistax.scenes import published
from twistax.units import feet, knots, seconds

gravity, numbers = environment.gravity, flight.numbers

# ---- Dryden turbulence -----------------------------------------------------------------------------------------------

SPEED, SPAN = 70.0, 12.0
LENGTHS, SIGMA = (500.0, 300.0, 60.0), (1.5, 1.1, 0.8)
STEADY = flight.Dryden(flight.even_turbulence(LENGTHS, SIGMA), SPAN)


@functools.cache
def filters() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A, B of the state and C, D of (u, v, w, p, q, r): columns of what is linear."""
    gust = STEADY.gust(tx.to_expr(800.0), tx.to_expr(SPEED))
    out = tx.Concat(gust.state_rate, gust.velocity, gust.rate)

    def column(k: int) -> np.ndarray:
        unit = np.eye(12)[k]
        return numbers(out, {STEADY.state: unit[:8], STEADY.noise: unit[8:]})

    whole = np.stack([column(k) for k in range(12)], axis=1)
    return whole[:8, :8], whole[:8, 8:], whole[8:, :8], whole[8:, 8:]


def test_variances_of_gusts() -> None:
    """Those of the velocities are the intensities; that of p is the integral of its spectrum."""
    A, B, C, D = filters()
    assert not D[:4].any()
    X = solve_continuous_lyapunov(A, -B @ B.T)
    variances = np.diag(C @ X @ C.T)
    np.testing.assert_allclose(variances[:3], np.square(SIGMA), rtol=1e-12)
    roll = 0.8 * (np.pi * LENGTHS[2] / (4.0 * SPAN)) ** (1.0 / 3.0) * SIGMA[2] ** 2 / LENGTHS[2]
    # integral over W of roll / (1 + (4 b W / pi)^2)
    np.testing.assert_allclose(variances[3], roll * np.pi**2 / (8.0 * SPAN), rtol=1e-12)


@pytest.mark.parametrize("omega", [0.01, 0.3, 4.0, 60.0])
def test_spectra_of_gusts(omega: float) -> None:
    """MIL-F-8785C: one-sided spectra over the spatial frequency W = omega / V; noise of unit intensity has 1 / pi."""
    A, B, C, D = filters()
    H = C @ np.linalg.solve(1j * omega * np.eye(8) - A, B) + D
    found = (np.abs(H) ** 2).sum(axis=1) / np.pi * SPEED
    W, (Lu, Lv, Lw), (su, sv, sw) = omega / SPEED, LENGTHS, SIGMA

    def across(L: float, sigma: float) -> float:
        return sigma**2 * L / np.pi * (1 + 3 * (L * W) ** 2) / (1 + (L * W) ** 2) ** 2

    tail = 1 + (4 * SPAN * W / np.pi) ** 2
    expected = [
        su**2 * 2 * Lu / np.pi / (1 + (Lu * W) ** 2),
        across(Lv, sv),
        across(Lw, sw),
        sw**2 / Lw * 0.8 * (np.pi * Lw / (4 * SPAN)) ** (1 / 3) / tail,
        W**2 / tail * across(Lw, sw),
        W**2 / (1 + (3 * SPAN * W / np.pi) ** 2) * across(Lv, sv),
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-11)


def test_rates_of_gusts_are_gradients_of_their_velocity() -> None:
    """Slow gusts turn like rigid air: w falls along x where q is positive, v grows where r is."""
    A, B, C, D = filters()
    s = 1e-3j
    H = C @ np.linalg.solve(s * np.eye(8) - A, B) + D
    np.testing.assert_allclose(H[4, 2], -s / SPEED * H[2, 2], rtol=1e-3)
    np.testing.assert_allclose(H[5, 1], s / SPEED * H[1, 1], rtol=1e-3)


@pytest.mark.parametrize(("height", "used"), [(500.0, 500.0), (2.0, 10.0), (5000.0, 1000.0)])
def test_turbulence_near_the_ground(height: float, used: float) -> None:
    lengths, sigma = flight.low_altitude_turbulence(30 * knots)(tx.to_expr(height * 0.3048))
    along, up = used / (0.177 + 0.000823 * used) ** 1.2 * 0.3048, 3.0 * 1852.0 / 3600.0
    np.testing.assert_allclose([numbers(L) for L in lengths], [along, along, used * 0.3048], rtol=1e-13)
    ratio = (0.177 + 0.000823 * used) ** -0.4
    np.testing.assert_allclose([numbers(each) for each in sigma], [up * ratio, up * ratio, up], rtol=1e-13)


def test_turbulence_of_a_vehicle() -> None:
    """It is air that moves: what the vehicle meets is less by the gust, and the system has its state."""
    calm, craft = flight.Vehicle(), flight.Vehicle(turbulence=STEADY)
    start = craft.start(0.4, 0.1, 900.0, (SPEED, 0.0, 0.0), rate=(0.01, 0.02, 0.03))
    x = np.arange(1.0, 9.0)
    state = {craft.pose: start["g"], craft.twist: start["V"], STEADY.state: x, STEADY.noise: np.ones(4)}
    gust = STEADY.gust(tx.to_expr(900.0), tx.to_expr(SPEED))
    less = [a - b for a, b in ((calm.air.velocity, craft.air.velocity), (calm.air.rate, craft.air.rate))]
    apart = numbers(tx.Concat(*less, -gust.velocity, -gust.rate), state)
    np.testing.assert_allclose(apart[:6] + apart[6:], np.zeros(6), atol=1e-10)
    system = craft.system(SpatialInertia(mass=1.0, inertia=np.eye(3)))
    assert [control.name for control in system.controls] == ["turbulence_noise"]
    found = numbers(system.rates["turbulence"], state)
    np.testing.assert_allclose(found, numbers(gust.state_rate, state), rtol=1e-9)


# ---- engines and burning ---------------------------------------------------------------------------------------------


def test_an_engine_in_its_place() -> None:
    engine = flight.Engine(1000.0, 0.3, position=(-2.0, 0.5, 0.1), direction=(0.6, 0.0, -0.8))
    found = numbers(engine.wrench)
    np.testing.assert_allclose(found[:3], [600.0, 0.0, -800.0])
    np.testing.assert_allclose(found[3:], np.cross([-2.0, 0.5, 0.1], found[:3]))
    merlin = flight.rocket(0.5, 101325.0, vacuum_thrust=914e3, specific_impulse=311.0, exit_area=0.7)
    np.testing.assert_allclose(numbers(merlin.thrust), 457e3 - 101325.0 * 0.7)
    np.testing.assert_allclose(numbers(merlin.mass_flow), 457e3 / (9.80665 * 311.0))


def test_jet_damping() -> None:
    """-(I' + f l^2) w across the axis, about the centre of mass: Thomson, Introduction to Space Dynamics, 7.4."""
    f, gyration, away, w = 3.0, np.diag([0.2, 1.5, 1.5]), 4.0, np.array([0.7, 0.3, -0.2])
    kilogram = SpatialInertia(mass=1.0, inertia=gyration)
    V = np.concatenate([[10.0, -3.0, 2.0], w])
    found = numbers(flight.burning(V, f, kilogram, (-away, 0.0, 0.0)))
    across = (f * 1.5 - f * away**2) * w[1:]
    np.testing.assert_allclose(found[3:], [f * 0.2 * w[0], *across], rtol=1e-14)


def test_momentum_of_a_burning_body_and_its_exhaust() -> None:
    """Of body, fuel on its way and gas that has left, in inertial axes: constant in free space."""
    flow, exhaust = 2.0, np.array([-9.0, 0.4, 0.3])  # kg/s; m/s relative to the body
    tank_at, outlet, gyration = np.array([0.8, 0.1, -0.2]), np.array([-2.0, 0.2, 0.1]), np.diag([0.3, 0.5, 0.4])
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    fuel, left = tx.State("fuel"), tx.State("left", shape=(6,))
    kilogram = SpatialInertia(mass=1.0, center_of_mass=tank_at, inertia=gyration)
    dry = SpatialInertia(mass=30.0, center_of_mass=(0.1, 0.0, 0.05), inertia=np.diag([5.0, 20.0, 18.0]))
    body = dry + SpatialInertia(mass=fuel, center_of_mass=tank_at, inertia=fuel * gyration)
    thrust = flight.Engine(flow * np.linalg.norm(exhaust), flow, outlet, -exhaust / np.linalg.norm(exhaust))
    w = tx.lie.angular(V)
    gas = tx.lie.linear(V) + tx.linalg.Cross(w, outlet) + exhaust
    gone = flow * tx.lie.wrench(force=gas, torque=tx.linalg.Cross(outlet, gas))
    on_its_way = np.concatenate([flow * (outlet - tank_at), flow * np.cross(tank_at, outlet)])
    wrench = thrust.wrench + flight.burning(V, thrust.mass_flow, kilogram, thrust.position)
    turn = tx.lie.SE3AdjointDual(g)
    system = tx.System(
        rates={g: V, V: body.acceleration(V, wrench), fuel: -thrust.mass_flow, left: turn @ gone},
        outputs={"momentum": turn @ (body.momentum(V) + on_its_way) + left},
    )
    dynamics = tx.compile(system)
    start = {"g": np.eye(4), "V": np.array([3.0, -1.0, 2.0, 0.5, 0.9, -0.4]), "fuel": 25.0, "left": np.zeros(6)}
    end = tx.integrate(dynamics, start, t1=10.0, dt=5e-3)
    before, after = (dynamics.outputs(0.0, x)["momentum"] for x in (start, {k: v[-1] for k, v in end.xs.items()}))
    assert np.linalg.norm(end.xs["left"][-1]) > 100.0
    np.testing.assert_allclose(after, before, rtol=0.0, atol=1e-8)


# ---- sensors ---------------------------------------------------------------------------------------------------------


def test_an_imu_feels_the_motion_of_its_place() -> None:
    """The second derivative of its place by differences of a motion with these velocities and accelerations."""
    rng = np.random.default_rng(1)
    V, dV, r, pull = rng.normal(size=6), rng.normal(size=6), rng.normal(size=3), rng.normal(size=3)
    mounting = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    mounting *= np.linalg.det(mounting)

    def hat(xi: np.ndarray) -> np.ndarray:
        v, w = xi[:3], xi[3:]
        turn = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
        return np.vstack([np.column_stack([turn, v]), np.zeros(4)])

    h = 1e-3

    def place(t: float) -> np.ndarray:
        return (expm(hat(V * t + 0.5 * dV * t * t)) @ [*r, 1.0])[:3]

    acceleration = (place(h) - 2.0 * place(0.0) + place(-h)) / h**2
    imu = flight.Imu(r, mounting, accelerometer_bias=(0.1, 0.2, 0.3), gyro_bias=(0.01, 0.02, 0.03))
    found = imu.read(V, dV, pull)
    expected = mounting.T @ (acceleration - pull) + [0.1, 0.2, 0.3]
    np.testing.assert_allclose(numbers(found.specific_force), expected, atol=2e-6)
    np.testing.assert_allclose(numbers(found.rate), mounting.T @ V[3:] + [0.01, 0.02, 0.03], atol=1e-15)


def test_an_imu_in_free_fall_reads_nothing_at_the_centre_of_mass() -> None:
    craft = flight.Vehicle()
    body = SpatialInertia(mass=2.0, center_of_mass=(0.3, 0.1, 0.0), inertia=np.diag([1.0, 2.0, 2.5]))
    start = craft.start(0.5, 1.0, 2e5, (7000.0, 10.0, 3.0), rate=(0.2, -0.1, 0.3))
    state = {craft.pose: start["g"], craft.twist: start["V"], craft.time: 0.0}
    pull = craft.pose[:3, :3].T @ craft.gravitation
    found = flight.Imu(position=(0.3, 0.1, 0.0)).read(craft.twist, craft.acceleration(body), pull)
    np.testing.assert_allclose(numbers(found.specific_force, state), np.zeros(3), atol=1e-11)
    moment = gravity.gradient_torque(
        gravity.EARTH_J2.gm, start["g"][:3, :3].T @ start["g"][:3, 3] + [0.3, 0.1, 0.0], np.diag([1.0, 2.0, 2.5])
    )
    # Two entries are what is left of ones that cancel.
    size = np.abs(numbers(moment)).max()
    np.testing.assert_allclose(
        numbers(craft.gradient_torque(body), state), numbers(moment), rtol=0.0, atol=1e-12 * size
    )


def test_air_data_at_a_boom() -> None:
    craft = flight.Vehicle()
    start = craft.start(0.5, 1.0, 5e3, (150.0, 0.0, 0.0), rate=(0.2, -0.1, 0.3))
    state = {craft.pose: start["g"], craft.twist: start["V"], craft.time: 0.0}
    boom = flight.probe(craft.air, (6.0, 1.0, 0.0))
    v = np.array([150.0, 0.0, 0.0]) + np.cross([0.2, -0.1, 0.3], [6.0, 1.0, 0.0])
    np.testing.assert_allclose(numbers(boom.velocity, state), v, atol=1e-12)
    np.testing.assert_allclose(numbers(boom.alpha, state), np.arctan2(v[2], v[0]), rtol=1e-11)


@pytest.mark.parametrize("mach", [0.0, 0.3, 0.999999, 1.000001, 2.4])
def test_impact_pressure(mach: float) -> None:
    """Isentropic below Mach 1; above it behind a normal shock, by the shock's own relations."""
    air = flight.EARTH.air
    sound, pressure = float(numbers(air.speed_of_sound(9e3))), float(numbers(air.pressure(9e3)))
    data = flight.AirData(tx.to_expr([mach * sound, 0.0, 0.0]), tx.to_expr(9e3), air, tx.to_expr(np.zeros(3)))
    stagnation, at = 1.0, mach
    if mach > 1.0:
        stagnation = 1.0 + 2.8 / 2.4 * (mach**2 - 1.0)  # static pressure behind the shock
        at = np.sqrt((1.0 + 0.2 * mach**2) / (1.4 * mach**2 - 0.2))
    expected = pressure * (stagnation * (1.0 + 0.2 * at**2) ** 3.5 - 1.0)
    np.testing.assert_allclose(numbers(data.impact_pressure), expected, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: flight.Dryden(flight.low_altitude_turbulence(5.0), 0.0), ModelError, "positive span in m, got 0.0"),
        (lambda: flight.low_altitude_turbulence(5 * feet), InputError, "wind expects m s-1, got 1.524 m"),
        (lambda: flight.even_turbulence(1 * seconds, SIGMA), InputError, "lengths expects m, got 1.0 s"),
        (lambda: flight.Vehicle(turbulence=3.0), ModelError, "turbulence to be of Dryden, got 3.0"),
        (lambda: flight.Engine(np.ones(2)), ShapeError, r"Engine expects thrust with shape \(\), got \(2,\)"),
        (lambda: flight.Imu(mounting=np.ones(3)), ShapeError, r"mounting with shape \(3, 3\), got \(3,\)"),
        (lambda: flight.Imu(mounting=2.0 * np.eye(3)), ModelError, "mounting to be a rotation"),
        (lambda: flight.Engine(1.0, direction=(0.0, 0.0, -2.0)), ModelError, "direction of length 1, .* of 2"),
        (lambda: flight.even_turbulence((0.0, 1.0, 1.0), SIGMA), ModelError, "positive lengths"),
        (lambda: flight.burning(np.ones(3), 1.0, None, np.ones(3)), ShapeError, r"V with shape \(6,\)"),
    ],
)
def test_what_is_refused_here(call: Any, error: type[Exception], words: str, unchecked: None) -> None:
    with pytest.raises(error, match=words):
        call()


# ---- a flight as a table ---------------------------------------------------------------------------------------------


def test_columns_of_nasa_come_back_as_they_are_read(tmp_path: Path) -> None:
    """Written with NASA's names and units, and read again by what reads NASA's files."""
    s = tx.State("s")
    exact = {
        "position": lambda s: [6.4e6 - s, 30.0 * s, 2.0 * s],
        "euler": lambda s: [0.01 * s, -0.02 * s, 0.03 * s],
        "rate": lambda s: [0.1, 0.2 * s, -0.3],
        "ned_velocity": lambda s: [1.0 * s, 2.0, 3.0 * s],
        "altitude": lambda s: 9144.0 - s,
        "density": lambda s: 0.4 + 1e-3 * s,
        "mach": lambda s: 0.01 * s,
    }
    outputs = {name: tx.Concat(*own(s)) if isinstance(own(s), list) else own(s) for name, own in exact.items()}
    flown = tx.integrate(tx.compile(tx.System({s: 1.0}, outputs)), {"s": 0.0}, t1=30.0, dt=0.5, save_at=published.TIMES)
    for si in (False, True):
        flown.to_csv(tmp_path / "sim.csv", flight.NasaColumns(si=si))
        table = published.PublishedTable(tmp_path / "sim.csv")
        track = table.track()
        wanted = {name: np.array([own(t) for t in published.TIMES]) for name, own in exact.items()}
        assert ("eiPosition_m_X" in table.names) == si
        for name in ("position", "rate", "altitude", "density"):
            np.testing.assert_allclose(getattr(track, name), wanted[name], rtol=1e-13, atol=1e-14)
        turns = Rotation.from_euler("xyz", wanted["euler"]).as_matrix()
        np.testing.assert_allclose(track.attitude, turns, atol=1e-14)
        np.testing.assert_allclose(table["mach"], wanted["mach"], atol=1e-15)
        np.testing.assert_allclose(table.column("altitudeRateWrtMsl"), -wanted["ned_velocity"][:, 2], atol=1e-12)
        assert not any(name.startswith("ambient") for name in table.names)


def test_columns_of_nasa_refuse_what_is_no_flight() -> None:
    s = tx.State("s")
    for outputs, error, words in [
        ({"size": s}, InputError, "expects outputs of a flight"),
        ({"euler": s}, ShapeError, r"'euler' with shape \(3,\), got \(\)"),
    ]:
        flown = tx.integrate(tx.compile(tx.System({s: 1.0}, outputs)), {"s": 0.0}, t1=1.0, dt=0.5, save_at=[0.0, 1.0])
        with pytest.raises(error, match=words):
            flown.to_csv("never.csv", flight.NasaColumns())
