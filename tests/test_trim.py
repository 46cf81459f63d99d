"""Steady motion: against closed forms, Lanchester's phugoid and finite differences."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.errors import InputError, ModelError
from twistax.mechanics import SpatialInertia, flight

# ---- a pendulum on SO(3) ---------------------------------------------------------------------------------------------

WEIGHT, J = 4.0, np.diag([2.0, 3.0, 4.0])


@functools.cache
def pendulum() -> tx.Dynamics:
    """A body on a ball joint, its weight below it along z; a motor turns it about y, a damper holds it."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    motor, drag = tx.Control("motor"), tx.Parameter("drag", value=0.5)
    weight = tx.linalg.Cross(np.array([0.0, 0.0, -1.0]), R.T @ np.array([0.0, 0.0, -WEIGHT]))
    torque = weight + motor * np.array([0.0, 1.0, 0.0]) - drag * w - tx.linalg.Cross(w, J @ w)
    return tx.compile(
        tx.System(
            rates={R: w, w: torque / np.diag(J)},
            outputs={"down": R @ np.array([0.0, 0.0, -1.0]), "up": R[2, 2], "power": motor * w[1]},
        )
    )


@functools.cache
def hanging() -> tx.LinearSystem:
    """About the rest."""
    rest = tx.trim(pendulum(), HANGING, {"motor": 0.0}, free=["R", "w"], zero=["R", "w"])
    return rest.linear(["down", "power"])


HANGING = {"R": np.asarray(tx.pose(euler=np.array([0.02, 0.1, 0.3]))[:3, :3]), "w": np.array([0.1, 0.0, -0.1])}


def test_a_motor_holds_a_pendulum() -> None:
    """sin(angle) = torque / weight moment, found from a start that moves."""
    held = tx.trim(pendulum(), HANGING, {"motor": 2.0}, free=["R", "w"], zero=["R", "w"])
    assert held.found
    assert not held.saturated
    down = held.x["R"] @ [0.0, 0.0, -1.0]
    assert np.hypot(down[0], down[1]) == pytest.approx(0.5, abs=1e-9)
    np.testing.assert_allclose(held.x["w"], np.zeros(3), atol=1e-9)
    np.testing.assert_allclose(held.x["R"] @ held.x["R"].T, np.eye(3), atol=1e-14)
    assert held.u["motor"] == 2.0


def test_a_fixed_output_asks_for_a_control() -> None:
    """up = cos(angle) at 0.8 takes a torque of 0.6 of the weight's; the sign is that of the start's."""
    held = tx.trim(
        pendulum(),
        {**HANGING, "R": np.asarray(tx.pose(euler=np.array([0.0, -0.3, 0.0]))[:3, :3])},
        {"motor": 0.0},
        free={"R": None, "w": None, "motor": (-3.0, 3.0)},
        fixed={"up": 0.8},
        zero=["down", "w"],
    )
    assert abs(held.u["motor"]) == pytest.approx(0.6 * WEIGHT, rel=1e-8)
    assert np.max(np.abs(held.residual["up"])) < 1e-9


def test_bounds_that_hold_it_back_are_said() -> None:
    ask: dict[str, Any] = {
        "free": {"R": None, "w": None, "motor": (-1.0, 1.0)},
        "fixed": {"up": 0.8},
        "zero": ["R", "w"],
    }
    with pytest.raises(InputError, match=r"NOT found .*; saturated: motor\).\n  fix: free more, widen the bounds"):
        tx.trim(pendulum(), HANGING, {"motor": 0.5}, **ask)
    nearest = tx.trim(pendulum(), HANGING, {"motor": 0.5}, **ask, throw=False)
    assert not nearest.found
    assert nearest.saturated == ("motor",)
    assert abs(nearest.u["motor"]) == 1.0


def test_modes_of_a_hanging_pendulum() -> None:
    """Two swings and a turn about the vertical that nothing holds; frequencies sqrt(weight / J)."""
    linear = hanging()
    assert linear.states == ("R[0]", "R[1]", "R[2]", "w[0]", "w[1]", "w[2]")
    assert linear.outputs == ("down[0]", "down[1]", "down[2]", "power")
    swings = [mode for mode in linear.modes() if mode.eigenvalue.imag > 0.0]
    np.testing.assert_allclose([mode.frequency for mode in swings], np.sqrt([WEIGHT / 2.0, WEIGHT / 3.0]), rtol=1e-6)
    np.testing.assert_allclose([2.0 * mode.damping * mode.frequency for mode in swings], [0.25, 0.5 / 3.0], rtol=1e-6)
    about_y = linear.only(["R[1]", "w[1]"])
    np.testing.assert_allclose(about_y.A, [[0.0, 1.0], [-WEIGHT / 3.0, -0.5 / 3.0]], atol=1e-9)
    np.testing.assert_allclose(about_y.B, [[0.0], [1.0 / 3.0]], atol=1e-15)
    assert swings[0].shares["R[0]"] > 10.0 * swings[0].shares["R[1]"]


def test_rows_are_derivatives_of_outputs() -> None:
    held = tx.trim(pendulum(), HANGING, {"motor": 1.0}, free=["R", "w"], zero=["R", "w"])
    linear, h = held.linear(["down", "power"]), 1e-6

    def outputs(d: np.ndarray, motor: float) -> np.ndarray:
        found = pendulum().outputs(0.0, pendulum().retract(held.x, d), {"motor": motor})
        return np.concatenate([np.ravel(found[name]) for name in ("down", "power")])

    for k, unit in enumerate(h * np.eye(6)):
        slope = (outputs(unit, 1.0) - outputs(-unit, 1.0)) / (2.0 * h)
        np.testing.assert_allclose(linear.C[:, k], slope, atol=1e-8)
    slope = (outputs(np.zeros(6), 1.0 + h) - outputs(np.zeros(6), 1.0 - h)) / (2.0 * h)
    np.testing.assert_allclose(linear.D[:, 0], slope, atol=1e-8)


def test_python_control_gets_the_names() -> None:
    linear = hanging()
    try:
        import control  # noqa: F401
    except ImportError:
        with pytest.raises(ModelError, match=r"needs python-control.\n  fix: pip install control"):
            linear.to_control()
        return
    assert linear.to_control().state_labels[:2] == ["R_0", "R_1"]


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"free": ["S"]}, InputError, "trim: free expects names among .*; got 'S'"),
        ({"zero": ["up", "up"]}, InputError, "trim: zero has 'up' twice"),
        ({"fixed": {"up": [1.0, 2.0]}}, InputError, r"fixed\['up'\] expects finite numbers of shape \(\), got"),
        ({"fixed": ["R"]}, InputError, "trim: fixed expects names among"),
        ({"free": {"R": (0.0, 1.0)}}, InputError, r"free\['R'\] has no limits, as a state on SO3"),
        ({"free": {"motor": 3.0}}, InputError, r"free\['motor'\] expects \(low, high\) or None, got 3.0"),
        ({"free": {"motor": (3.0, 4.0)}}, InputError, "start of 'motor' is outside of its limits"),
        ({"tolerance": -1.0}, InputError, "tolerance must be a positive number, got -1.0"),
        ({"dynamics": 3}, ModelError, "trim expects a compiled system, got int"),
    ],
)
def test_what_trim_refuses(change: dict[str, Any], error: type[Exception], words: str, unchecked: None) -> None:
    ask: dict[str, Any] = {"dynamics": pendulum(), "free": ["R"], "zero": ["w"], **change}
    with pytest.raises(error, match=words):
        tx.trim(ask.pop("dynamics"), HANGING, {"motor": 2.0}, **ask)


# ---- an aeroplane ----------------------------------------------------------------------------------------------------


@functools.cache
def glider() -> tuple[flight.Vehicle, tx.Dynamics]:
    """A light aeroplane with linear coefficients, over the turning Earth."""
    craft = flight.Vehicle()
    body = SpatialInertia(mass=1000.0, inertia=np.diag([1300.0, 1800.0, 2700.0]))
    elevator, throttle, aileron, rudder = (tx.Control(n) for n in ("elevator", "throttle", "aileron", "rudder"))
    air = craft.air
    wing = flight.Aerodynamics(16.0, 11.0, 1.5, axes=flight.stability_axes)
    rates = wing.reduced_rates(air)
    lift = 0.3 + 5.0 * air.alpha + 0.4 * elevator
    force = (-(0.03 + 0.05 * lift * lift), -0.4 * air.beta, -lift)
    moment = (
        -0.1 * air.beta - 0.45 * rates[0] + 0.1 * rates[2] + 0.2 * aileron,
        0.02 - 1.0 * air.alpha - 1.2 * elevator - 12.0 * rates[1],
        0.07 * air.beta - 0.03 * rates[0] - 0.1 * rates[2] + 0.06 * rudder,
    )
    thrust = flight.Engine(3000.0 * throttle, position=(1.0, 0.0, 0.0))
    system = craft.system(
        body, wing.wrench(air, force, moment) + thrust.wrench, outputs={"alpha": air.alpha, "beta": air.beta}
    )
    return craft, tx.compile(system)


@pytest.mark.slow
def test_level_flight_over_the_turning_earth() -> None:
    craft, dynamics = glider()
    x = craft.start(
        0.7, 0.2, 1500.0, (50.0, 40.0, 0.0), (0.0, 0.03, np.arctan2(40.0, 50.0)), relative_to=flight.local_axes
    )
    level = tx.trim(
        dynamics,
        x,
        {"elevator": 0.0, "throttle": 0.3, "aileron": 0.0, "rudder": 0.0},
        free={"g": None, "V": None, "elevator": (-0.4, 0.4), "throttle": (0.0, 1.0), "aileron": None, "rudder": None},
        fixed={"latitude": 0.7, "longitude": 0.2, "altitude": 1500.0, "ned_velocity": (50.0, 40.0, 0.0), "beta": 0.0},
        zero=["ned_velocity", "attitude", "rate"],
        tolerance=1e-7,
    )
    assert not level.saturated
    # forces balance: lift carries the weight less what the motion over the turning Earth takes
    weight = 1000.0 * 9.8
    q = 0.5 * float(dynamics.outputs(0.0, level.x, level.u)["density"]) * (50.0**2 + 40.0**2)
    alpha = float(dynamics.outputs(0.0, level.x, level.u)["alpha"])
    lift = q * 16.0 * (0.3 + 5.0 * alpha + 0.4 * float(level.u["elevator"]))
    assert lift + 3000.0 * float(level.u["throttle"]) * np.sin(alpha) == pytest.approx(weight, rel=5e-3)
    modes = [mode for mode in level.linear().modes() if mode.eigenvalue.imag > 1e-2]
    # Lanchester: sqrt(2) g / V for the phugoid, the slowest of three oscillations
    assert len(modes) == 3
    assert modes[-1].frequency == pytest.approx(np.sqrt(2.0) * 9.8 / np.hypot(50.0, 40.0), rel=0.15)
    sol = tx.integrate(dynamics, level.x, t1=20.0, dt=0.02, u=level.u)
    end = dynamics.outputs(20.0, {k: v[-1] for k, v in sol.xs.items()}, level.u)
    assert float(end["altitude"]) == pytest.approx(1500.0, abs=0.2)
