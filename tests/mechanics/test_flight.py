"""The flight layer: frames, rates, starts, air data and forces, against closed forms and finite differences."""

from typing import Any

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import twistax as tx
from twistax.errors import InputError, ModelError, ShapeError
from twistax.mechanics import SpatialInertia, environment, flight
from twistax.units import degrees, feet, knots, seconds

earth, numbers = environment.earth, flight.numbers

PLACE = (48.0 * degrees, -123.0 * degrees, 11_000.0)
VELOCITY, EULER, RATE = np.array([80.0, -150.0, 12.0]), (0.3, -0.2, 2.5), np.array([0.03, -0.02, 0.05])
BALL = SpatialInertia(mass=2.0, inertia=np.eye(3))


def at(vehicle: flight.Vehicle, expression: Any, state: dict[str, Any], t: float = 0.0) -> np.ndarray:
    """An expression of a vehicle's states as numbers; nothing is compiled."""
    return numbers(expression, {vehicle.pose: state["g"], vehicle.twist: state["V"], vehicle.time: t})


def attitude(euler: Any) -> np.ndarray:
    return Rotation.from_euler("ZYX", euler[::-1]).as_matrix()


# ---- the start -----------------------------------------------------------------------------------------------------


def test_a_start_comes_back() -> None:
    """Place, velocity over the ground, attitude and rates are those it was made of, at another time too."""
    craft = flight.Vehicle()
    state = craft.start(*PLACE, VELOCITY, EULER, RATE, relative_to=flight.local_axes, t=5000.0)
    attitudes = [craft.attitude[:, i] for i in range(3)]
    rows = tx.Stack(tx.Concat(*craft.place), craft.ned_velocity, craft.rate(flight.local_axes), craft.euler, *attitudes)
    place, velocity, rate, euler, *columns = at(craft, rows, state, 5000.0)
    np.testing.assert_allclose(euler, EULER, atol=1e-14)
    np.testing.assert_allclose(place, PLACE, rtol=1e-14, atol=2e-9)
    np.testing.assert_allclose(velocity, VELOCITY, atol=1e-12)
    np.testing.assert_allclose(rate, RATE, atol=1e-15)
    np.testing.assert_allclose(np.stack(columns, axis=1), attitude(EULER), atol=1e-14)


@pytest.mark.parametrize("axes", [flight.inertial_axes, flight.fixed_axes, flight.local_axes])
def test_rates_are_those_of_turning_axes(axes: flight.Reference) -> None:
    """A body that stands still in axes is carried by them: a step of its pose, against these axes a moment later."""
    h = 1e-2
    craft = flight.Vehicle()
    state = craft.start(*PLACE, VELOCITY, EULER, relative_to=axes)
    position = state["g"][:3, 3]

    def turned(t: float) -> np.ndarray:
        """The attitude relative to the axes at the time t."""
        R = state["g"][:3, :3] @ Rotation.from_rotvec(state["V"][3:] * t).as_matrix()
        spin = Rotation.from_rotvec([0.0, 0.0, earth.WGS84.rate * t]).as_matrix()
        fixed = spin.T @ (position + state["g"][:3, :3] @ state["V"][:3] * t)
        if axes is flight.inertial_axes:
            return R
        if axes is flight.fixed_axes:
            return spin.T @ R
        place = [numbers(each) for each in earth.WGS84.geodetic(fixed)]
        return numbers(earth.north_east_down(*place[:2])).T @ spin.T @ R

    assert np.abs(turned(h) - turned(-h)).max() / (2.0 * h) < 1e-9


def test_a_start_stands_still_on_the_ground() -> None:
    state = flight.start(*PLACE)
    spin = np.array([0.0, 0.0, earth.WGS84.rate])
    R, p = state["g"][:3, :3], state["g"][:3, 3]
    np.testing.assert_allclose(R @ state["V"][:3], np.cross(spin, p), atol=1e-12)
    np.testing.assert_allclose(R @ state["V"][3:], spin, atol=1e-19)


def test_starts_may_be_traced() -> None:
    """Drawn within vmap they are the starts of the same numbers."""
    craft = flight.Vehicle()

    def drawn(speed: Any, euler: Any) -> dict[str, Any]:
        return craft.start(*PLACE, (speed, 0.0, 0.1 * speed), euler, RATE, relative_to=flight.local_axes, t=5000.0)

    speeds, angles = np.array([70.0, 7000.0]), np.array([EULER, (0.3, -0.2, 2.0)])
    found = jax.vmap(drawn)(speeds, angles)
    for i, given in enumerate(zip(speeds, angles)):
        for name, value in drawn(*given).items():
            np.testing.assert_allclose(found[name][i], value, rtol=1e-13, atol=1e-13)
    with pytest.raises(InputError, match=r"ned_velocity expects shape \(3,\), got \(2,\)"):
        jax.jit(lambda v: craft.start(*PLACE, v))(np.zeros(2))
    with pytest.raises(InputError, match="altitude expects m, got"):
        jax.jit(lambda v: craft.start(0.0, 0.0, 3 * degrees, v))(np.zeros(3))


def test_units_at_the_door() -> None:
    feet_and_knots = flight.start(48 * degrees, -123 * degrees, 10_000 * feet, (100.0, 0.0, 0.0) * knots)
    plain = flight.start(np.deg2rad(48.0), np.deg2rad(-123.0), 3048.0, (100.0 * 1852.0 / 3600.0, 0.0, 0.0))
    for name in ("g", "V"):
        np.testing.assert_allclose(feet_and_knots[name], plain[name], rtol=1e-15)
    for arguments, words in (
        (
            (48.0, 0.0, 0.0),
            r"latitude expects an angle within 0.25 of a turn, got 48.0 rad.\n  fix: .*tx.units.degrees",
        ),
        ((0.0, 0.0, 3 * degrees), "start: altitude expects m, got .* rad"),
        ((0.0, 0.0, 0.0, (1 * feet, 0.0, 0.0)), "start: ned_velocity expects m s-1, got 0.3048 m"),
        ((0.0, 0.0, 0.0, (1.0, 0.0)), r"ned_velocity expects finite numbers of shape \(3,\)"),
        ((0.0, 0.0, 0.0, (1.0, 0.0, 0.0), (0.0, 0.0, 270.0)), r"euler\[2\] expects an angle .*, got 270.0 rad"),
    ):
        with pytest.raises(InputError, match=words):
            flight.start(*arguments)


# ---- frames ----------------------------------------------------------------------------------------------------------


def test_frames_as_poses() -> None:
    """As numbers: down is against the gradient of the altitude, east along the turn of the planet."""
    down = numbers(flight.EARTH.local_pose(*PLACE))
    up = numbers(flight.EARTH.local_pose(*PLACE, axes=earth.east_north_up))
    np.testing.assert_array_equal(up[:3, :3], down[:3, [1, 0, 2]] * [1.0, 1.0, -1.0])
    heights = [numbers(earth.WGS84.geodetic(down[:3, 3] + 1e3 * axis).altitude) for axis in np.eye(3)]
    lower = [numbers(earth.WGS84.geodetic(down[:3, 3] - 1e3 * axis).altitude) for axis in np.eye(3)]
    np.testing.assert_allclose((np.array(heights) - lower) / 2e3, -down[:3, 2], atol=1e-8)
    np.testing.assert_allclose(
        np.cross([0.0, 0.0, 1.0], down[:3, 3])[:2], down[:2, 1] * np.hypot(*down[:2, 3]), rtol=1e-14
    )
    turned = numbers(flight.EARTH.fixed_pose(1000.0)) @ down
    np.testing.assert_allclose(np.diff(np.arctan2([down[1, 3], turned[1, 3]], [down[0, 3], turned[0, 3]])), 0.07292115)


def test_numbers_need_values() -> None:
    with pytest.raises(ModelError, match=r"expects an expression with finite numbers .*\n  fix"):
        numbers(tx.State("x") + 1.0)


def test_radii_of_curvature() -> None:
    """dp / d(latitude) has the length M + h, dp / d(longitude) the length (N + h) cos(latitude)."""
    meridian, normal = (float(numbers(radius)) for radius in earth.WGS84.radii(PLACE[0]))
    h = 1e-4

    def moved(i: int) -> np.ndarray:
        step = h * np.eye(3)[i]
        ahead, behind = (numbers(earth.WGS84.position(*(PLACE + sign * step))) for sign in (1.0, -1.0))
        return (ahead - behind) / (2.0 * h)

    assert np.linalg.norm(moved(0)) == pytest.approx(meridian + PLACE[2], rel=1e-8)
    assert np.linalg.norm(moved(1)) == pytest.approx((normal + PLACE[2]) * np.cos(PLACE[0]), rel=1e-8)


# ---- air -------------------------------------------------------------------------------------------------------------


def test_air_data() -> None:
    wind = np.array([-3.0, 14.0, 1.0])
    craft = flight.Vehicle(wind=flight.Steady(wind.tolist()))
    state = craft.start(*PLACE, VELOCITY, EULER, RATE)
    air, v = craft.air, attitude(EULER).T @ (VELOCITY - wind)
    density = float(numbers(flight.EARTH.air.density(PLACE[2])))
    sound = float(numbers(flight.EARTH.air.speed_of_sound(PLACE[2])))
    speed = np.linalg.norm(v)
    pairs = (
        (air.airspeed, speed),
        (air.alpha, np.arctan2(v[2], v[0])),
        (air.beta, np.arcsin(v[1] / speed)),
        (air.mach, speed / sound),
        (air.dynamic_pressure, 0.5 * density * speed**2),
        (air.equivalent_airspeed, speed * np.sqrt(density * 8314.32 * 288.15 / (101325.0 * 28.9644))),
    )
    found = at(craft, tx.Concat(air.velocity, air.rate, *(each for each, _ in pairs)), state)
    np.testing.assert_allclose(found, [*v, *RATE, *(expected for _, expected in pairs)], rtol=1e-9)


def test_at_rest_nothing_is_infinite() -> None:
    craft = flight.Vehicle()
    state = craft.start(*PLACE) | {"V": np.zeros(6)}
    still = flight.Vehicle(flight.EARTH.still())
    assert [at(still, each, state) for each in (still.air.alpha, still.air.beta, still.air.mach)] == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(at(still, flight.drag(still.air, 1.0), state), np.zeros(3))
    wing = flight.Aerodynamics(1.0, 1.0, 1.0)
    damping = wing.wrench(still.air, np.zeros(3), -wing.reduced_rates(still.air))
    np.testing.assert_array_equal(at(still, damping, state | {"V": np.array([0.0, 0, 0, 1, 2, 3])}), np.zeros(6))


@pytest.mark.parametrize("axes", [flight.body_axes, flight.stability_axes, flight.wind_axes])
def test_axes_of_coefficients(axes: flight.AirAxes) -> None:
    """x of the wind axes is the direction of flight; stability axes turn about y alone; all are rotations."""
    craft = flight.Vehicle()
    state = craft.start(*PLACE, VELOCITY, EULER)
    R, v = at(craft, axes(craft.air), state), at(craft, craft.air.velocity, state)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)
    if axes is flight.wind_axes:
        np.testing.assert_allclose(R[:, 0], v / np.linalg.norm(v), atol=1e-15)
        assert abs(R[1, 2]) < 1e-16  # z stays in the plane of symmetry
    if axes is flight.stability_axes:
        np.testing.assert_array_equal(R[:, 1], [0.0, 1.0, 0.0])
        np.testing.assert_allclose(R[2, 0] / R[0, 0], v[2] / v[0], rtol=1e-14)


def test_an_aerodynamic_wrench() -> None:
    """Drag and lift along and across the flight path; the moment moves with the reference point."""
    craft = flight.Vehicle()
    state = craft.start(*PLACE, VELOCITY, EULER, RATE)
    point, area, span, chord = np.array([-0.4, 0.1, 0.2]), 27.0, 9.0, 3.4
    wing = flight.Aerodynamics(area, span, chord, point, axes=flight.wind_axes)
    found = at(craft, wing.wrench(craft.air, (-0.03, 0.01, -0.5), (0.02, -0.04, 0.01)), state)
    R, load = at(craft, flight.wind_axes(craft.air), state), at(craft, craft.air.dynamic_pressure, state) * area
    force = R @ [-0.03, 0.01, -0.5] * load
    np.testing.assert_allclose(found[:3], force, rtol=1e-14)
    moment = R @ [0.02 * span, -0.04 * chord, 0.01 * span] * load
    np.testing.assert_allclose(found[3:], moment + np.cross(point, force), rtol=1e-12)
    v = at(craft, craft.air.velocity, state)
    assert found[:3] @ v / np.linalg.norm(v) == pytest.approx(-0.03 * load, rel=1e-14)
    reduced = at(craft, wing.reduced_rates(craft.air), state)
    np.testing.assert_allclose(reduced, RATE * [span, chord, span] / (2.0 * np.linalg.norm(v)), rtol=1e-9)


# ---- winds -----------------------------------------------------------------------------------------------------------


def blown(wind: flight.Wind, altitude: float) -> np.ndarray:
    place = earth.Geodetic(tx.to_expr(0.1), tx.to_expr(0.2), tx.to_expr(altitude))
    return numbers(wind(place, tx.to_expr(0.0)))


def test_winds() -> None:
    fps = feet / seconds
    shear = flight.Profile((0.0, 30_000 * feet), ((0.0, -20.0, 0.0) * fps, (0.0, 70.0, 0.0) * fps))
    for altitude, east in ((0.0, -20.0), (30_000.0, 70.0), (10_000.0, 10.0), (40_000.0, 70.0)):
        np.testing.assert_allclose(blown(shear, altitude * 0.3048), [0.0, east * 0.3048, 0.0], atol=1e-14)
    ground = flight.LogarithmicShear(15 * knots, towards=90 * degrees, ground=100.0)
    speed = 15.0 * 1852.0 / 3600.0
    for height, east in ((20.0, 1.0), (0.15, 0.0), (-5.0, 0.0), (200.0, np.log(200 / 0.15) / np.log(20 / 0.15))):
        np.testing.assert_allclose(blown(ground, 100.0 + height * 0.3048), [0.0, east * speed, 0.0], atol=1e-13)


def test_a_wind_may_be_any_function_of_place_and_time() -> None:
    craft = flight.Vehicle(wind=lambda place, t: tx.Concat(t, 0.0, place.longitude))
    state = craft.start(*PLACE, VELOCITY, t=7.0)
    np.testing.assert_allclose(at(craft, craft.air.velocity, state, 7.0), VELOCITY - [7.0, 0.0, PLACE[1]], atol=1e-12)


# ---- the poles -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pole", [90.0, -90.0])
def test_at_a_pole_local_axes_have_no_rate(pole: float) -> None:
    craft, east = flight.Vehicle(), (0.0, 50.0, 0.0)
    with pytest.raises(InputError, match=r"local_axes expects axes that turn at a finite rate; .* no north.*\n  fix: "):
        craft.start(pole * degrees, 0.3, 3e3, east, relative_to=flight.local_axes)
    with pytest.raises(InputError, match="no north"):
        craft.start(pole * degrees, 0.3, 3e3, relative_to=flight.local_axes)
    traced = jax.jit(lambda north: craft.start(north, 0.3, 3e3, east, relative_to=flight.local_axes))
    assert np.isnan(traced(pole * degrees)["V"][3:]).all()
    assert np.isfinite(traced(pole * degrees)["g"]).all()
    # North-east-down of the meridian stated, and rates relative to other axes, are there.
    state = craft.start(pole * degrees, 0.3, 3e3, east, EULER)
    np.testing.assert_allclose(at(craft, craft.ned_velocity, state), east, atol=1e-9)
    np.testing.assert_allclose(at(craft, craft.euler, state), EULER, atol=1e-12)
    np.testing.assert_allclose(at(craft, craft.rate(flight.fixed_axes), state), np.zeros(3), atol=1e-18)
    rate = tx.lower(craft.rate(flight.local_axes))
    assert np.isnan(rate(0.0, state)).any()
    assert np.isnan(jax.jacfwd(lambda g: rate(0.0, {**state, "g": g}))(state["g"])).any()
    assert np.isnan(rate(0.0, {name: value.astype(np.float32) for name, value in state.items()})).any()
    # A micrometre off, at 50 m/s eastward, they turn once in 1.3e-7 s.
    rho = float(craft.start(np.sign(pole) * (np.pi / 2 - 1e-6 / 6.4e6), 0.3, 3e3)["g"][0, 3]) / np.cos(0.3)
    off = craft.start(np.sign(pole) * (np.pi / 2 - 1e-6 / 6.4e6), 0.3, 3e3, east, relative_to=flight.local_axes)
    assert abs(off["V"][5]) == pytest.approx(50.0 / rho, rel=1e-3)


def test_on_the_axis_nothing_points_north() -> None:
    windy = flight.Vehicle(wind=flight.Steady((5.0, 0.0, 0.0)))
    state = {"g": tx.pose(position=[0.0, 0.0, 6.4e6]), "V": np.array([100.0, 0.0, 0.0, 0.0, 0.0, 0.0])}
    dynamics = tx.compile(windy.system(BALL, tx.lie.wrench(force=flight.drag(windy.air, 1.0), torque=np.zeros(3))))
    outputs = dynamics.outputs(0.0, state)
    for name in ("attitude", "euler", "ned_velocity"):
        assert np.isnan(outputs[name]).any()
    for name in ("latitude", "altitude", "position"):
        assert np.isfinite(outputs[name]).all()
    with pytest.raises(tx.IntegrationError):
        tx.integrate(dynamics, state, t1=1.0, dt=0.1)
    calm = tx.compile(flight.Vehicle().system(BALL))
    assert np.isfinite(tx.integrate(calm, state, t1=1.0, dt=0.1).xs["g"]).all()


def test_a_trim_at_a_pole_is_refused() -> None:
    """The rate of local axes was 1e11 rad/s there, kept as a target, and called trimmed."""
    craft, push = flight.Vehicle(), tx.Control("push", shape=(3,))
    turn = {"turn": craft.rate(flight.local_axes)}
    dynamics = tx.compile(craft.system(BALL, tx.lie.wrench(force=push, torque=np.zeros(3)), outputs=turn))
    state = craft.start(90.0 * degrees, 0.3, 3e3, (0.0, 50.0, 0.0))
    for wanted in ({"turn": None}, {"turn[2]": 0.0}):
        with pytest.raises(tx.TrajectoryError, match=r"at the start these are not finite, .*: turn\["):
            tx.trim(dynamics, state, {"push": np.zeros(3)}, free=["V", "push"], fixed=wanted, zero=["V[0:3]"])


# ---- what is refused -------------------------------------------------------------------------------------------------


def test_what_is_refused(unchecked: None) -> None:
    craft = flight.Vehicle()
    for call, error, words in (
        (lambda: flight.Vehicle(earth.WGS84), ModelError, "planet to be of Planet, got Ellipsoid"),
        (
            lambda: flight.Vehicle(wind=(1.0, 0.0, 0.0)),
            ModelError,
            "wind to be a function of .*\n  fix: for a constant wind use flight.Steady",
        ),
        (lambda: flight.Planet(earth.WGS84, 9.81), ModelError, "gravity to be an instance of Gravity, got 9.81"),
        (lambda: craft.system(2.0), ModelError, "body to be of SpatialInertia, got 2.0"),
        (lambda: craft.system(BALL, np.zeros(3)), ShapeError, r"wrench with shape \(6,\), got \(3,\)"),
        (lambda: flight.Steady((1.0, 2.0)), InputError, r"Steady: velocity expects finite numbers of shape \(3,\)"),
        (lambda: flight.Profile((0.0, 0.0), ((0.0,) * 3,) * 2), ModelError, "altitudes that increase"),
        (lambda: flight.LogarithmicShear(1.0, 0.0, 30.0), ModelError, "roughness between 0 and 20 ft, got 30.0 m"),
        (lambda: flight.LogarithmicShear(1.0, 0.0, 0.0), ModelError, "roughness between 0 and 20 ft, got 0.0 m"),
        (lambda: flight.Aerodynamics(1.0, 1.0, (1.0, 2.0)), ShapeError, r"chord with shape \(\), got \(2,\)"),
        (lambda: flight.drag(craft.air, np.zeros(3)), ShapeError, r"area with shape \(\), got \(3,\)"),
    ):
        with pytest.raises(error, match=words):
            call()


def test_names_and_sizes_that_are_refused() -> None:
    craft = flight.Vehicle()
    body = SpatialInertia(mass=1.0, inertia=np.eye(3))
    with pytest.raises(ModelError, match="additional outputs, got 'altitude'"):
        craft.system(body, outputs={"altitude": craft.place.altitude / feet})
    with pytest.raises(ModelError, match="area must be 0 or more"):
        flight.drag(craft.air, -0.1)
    for size in [(-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, -1.0)]:
        with pytest.raises(ModelError, match="must be 0 or more"):
            flight.Aerodynamics(*size)
    flight.Aerodynamics(tx.Parameter("S", value=1.0), 1.0, 1.0)
