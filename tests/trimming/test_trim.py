"""Trim against SciPy's root of equations written by hand, against the flight that follows, and at its limits."""

from __future__ import annotations

import functools
from typing import Any

import jax
import numpy as np
import pytest
from aeroplanes import CHORD, DENSITY, GRAVITY, INERTIA, MASS, NEUTRAL, START, WING, aircraft, lift, pitching
from scipy.optimize import root

import twistax as tx
from twistax import Trim
from twistax.mechanics import SpatialInertia, flight
from twistax.trajectory import linearize


@functools.cache
def level() -> Trim:
    return tx.trim(aircraft(), START, NEUTRAL, free=["g[4]", "V[0]", "V[2]", "el", "thrust"], zero=["V[0:3]", "V[4]"],
                   fixed={"speed": 22.0, "climb": 0.0})  # fmt: skip


def test_level_flight_is_the_root_of_its_equations() -> None:
    def equations(z: np.ndarray) -> list[float]:
        alpha, el, thrust = z
        q, cl = 0.5 * DENSITY * 22.0**2 * WING, lift(alpha, el)
        cd = 0.03 + 0.06 * cl**2
        along = q * (cl * np.sin(alpha) - cd * np.cos(alpha)) + thrust - MASS * GRAVITY * np.sin(alpha)
        normal = -q * (cl * np.cos(alpha) + cd * np.sin(alpha)) + MASS * GRAVITY * np.cos(alpha)
        return [along, normal, pitching(alpha, el)]

    alpha, el, thrust = root(equations, [0.05, 0.0, 10.0], tol=1e-13).x
    found = level()
    assert found.trimmed
    assert (found.saturated, found.undetermined) == ({}, ())
    np.testing.assert_allclose([found.u["el"], found.u["thrust"]], [el, thrust], rtol=1e-10)
    np.testing.assert_allclose(found.unknowns["g[4]"], alpha, rtol=1e-10)  # it starts level, so the turn is the pitch
    np.testing.assert_allclose(found.x["V"][[0, 2]], 22.0 * np.array([np.cos(alpha), np.sin(alpha)]), rtol=1e-10)
    assert max(map(abs, found.residuals.values())) < 1e-11


def test_a_steady_turn_goes_on_as_it_was_trimmed() -> None:
    turn = tx.trim(
        aircraft(), level().x, level().u, free=["g[3:5]", "V", "el", "ail", "rud", "thrust"], zero=["V", "beta"],
        steady=["down"], fixed={"speed": 22.0, "climb": 0.0, "turn": 0.3},
    )  # fmt: skip
    assert turn.trimmed
    assert turn.undetermined == ()
    flown = tx.integrate(aircraft(), turn.x, t1=10.0, dt=0.01, u=turn.u)
    end = {name: value[-1] for name, value in flown.xs.items()}
    np.testing.assert_allclose(end["V"], turn.x["V"], atol=1e-9)
    np.testing.assert_allclose(end["g"][2, 3], -100.0, atol=1e-8)  # no height is lost
    heading = tx.SO3.log(turn.x["g"][:3, :3].T @ end["g"][:3, :3])
    np.testing.assert_allclose(turn.x["g"][:3, :3] @ heading, [0.0, 0.0, 3.0], atol=1e-8)  # 10 s of 0.3 rad/s
    # Lift carries the weight and turns the path: tan(bank) = V psi' / g without side force.
    down = np.asarray(aircraft().outputs(0.0, turn.x, turn.u)["down"])
    np.testing.assert_allclose(np.arctan2(down[1], down[2]), np.arctan(22.0 * 0.3 / GRAVITY), rtol=0.02)


def test_what_cannot_be_met_is_said() -> None:
    ask = functools.partial(tx.trim, aircraft(), level().x, level().u, free=["V[0]", "V[2]", "g[4]", "el", "thrust"])
    fast = {"zero": ["V[0:3]", "V[4]"], "fixed": {"speed": 60.0, "climb": 0.0}}
    with pytest.raises(tx.TrajectoryError, match=r"NOT TRIMMED: .*\n(.*\n)*  thrust stands at its bound 60\n"):
        ask(**fast)
    best = ask(**fast, throw=False)
    assert not best.trimmed
    assert best.saturated == {"thrust": 60.0}
    assert best.measure > 1e-3
    # Within wider bounds of its own it is met.
    unknowns = dict.fromkeys(["V[0]", "V[2]", "g[4]", "el"]) | {"thrust": (0.0, 500.0)}
    wider = tx.trim(aircraft(), level().x, level().u, free=unknowns, **fast)
    assert wider.u["thrust"] > 60.0
    # Where a place is free that nothing asks for, it is said to be left open.
    loose = tx.trim(aircraft(), level().x, level().u, free=["g[0]", "el", "thrust"], zero=["V[4]"])
    assert loose.undetermined == ("g[0]", "thrust")


@functools.cache
def pushed() -> tx.Dynamics:
    x, push = tx.State("x"), tx.Control("push")
    return tx.compile(tx.System({x: push - 10.0 * x}, {"twice": 2.0 * x + push}))


def test_bounds_that_are_far_apart_hide_nothing() -> None:
    ask = functools.partial(tx.trim, pushed(), zero=["x"])
    for most in (1e3, 1e6, 1e12):
        for first in (0.0, 30.0):
            found = ask({"x": 1.0}, {"push": first}, free={"push": (0.0, most)})
            np.testing.assert_allclose(found.u["push"], 10.0, rtol=1e-9)
            assert found.saturated == {}
        off = ask({"x": 1.0}, {"push": 30.0}, free={"push": (20.0, most)}, throw=False)
        assert not off.trimmed
        assert off.saturated == {"push": 20.0}
    assert ask({"x": 1e6}, {"push": 0.0}, free={"push": (0.0, 2e7)}).u["push"] == pytest.approx(1e7, rel=1e-12)


def test_a_trim_may_lie_on_a_bound() -> None:
    for first in (0.0, 1.7):
        idle = tx.trim(pushed(), {"x": 0.5}, {"push": first}, free={"push": (0.0, 3.0), "x": None}, zero=["x"],
                       fixed={"twice": 0.0})  # fmt: skip
        assert idle.saturated == {"push": 0.0}
        np.testing.assert_allclose([idle.u["push"], idle.x["x"]], 0.0, atol=1e-9)


def test_a_start_beyond_its_bounds_is_moved_to_them() -> None:
    for most in np.linspace(0.05, 0.4, 8):  # 0.7 + (most - 0.7) is not most, but for round-off
        found = tx.trim(
            pushed(), {"x": 1.0}, {"push": 0.7}, free={"push": (-1.0, float(most))}, zero=["x"], throw=False
        )
        np.testing.assert_allclose(found.u["push"], most, rtol=1e-9)


def test_a_slope_that_is_huge_at_one_point_hides_nothing() -> None:
    """Of 1 + sqrt(push) the derivative at 1e-20 is 5e9: by it a step of 2e-10 would be enough, and none is."""
    x, y, push = tx.State("x"), tx.State("y"), tx.Control("push")
    steep = tx.compile(tx.System({x: 1.0 + tx.Sqrt(push), y: -y}, {"root": 1.0 + tx.Sqrt(y), "tilt": y + push}))
    for wanted in (["x"], ["root", "tilt"]):  # by what is free, and by a state that is not
        off = tx.trim(
            steep, {"x": 0.0, "y": 1e-20}, {"push": 0.5}, free={"push": (1e-20, 1.0)}, zero=wanted, throw=False
        )
        assert (off.measure > 1e-3, max(off.residuals.values())) == (True, pytest.approx(1.0))


def test_no_finite_derivatives_on_the_way_are_named() -> None:
    x, push = tx.State("x"), tx.Control("push")
    system = tx.compile(tx.System({x: tx.Abs(push) ** 0.5 + 1e-3 - 0.0 * x}))
    with pytest.raises(tx.TrajectoryError, match=r"on the way these are not finite, .*: rate of x"):
        tx.trim(system, {"x": 0.0}, {"push": 1.0}, free=["push"], zero=["x"])


def pendulum(unit: float) -> tx.Dynamics:
    """Lengths and torques in a unit of their own."""
    angle, rate, torque = tx.State("angle"), tx.State("rate"), tx.Control("torque", min=-4.0 * unit, max=4.0 * unit)
    height = tx.Parameter("length", value=unit) * -tx.Cos(angle)
    pull = torque / unit - 9.81 * tx.Sin(angle) - 0.3 * rate
    return tx.compile(tx.System({angle: rate, rate: pull}, {"height": height}))


def test_the_measure_has_no_unit_and_other_values_compile_nothing() -> None:
    measures = []
    for unit in (1.0, 1000.0):
        system = pendulum(unit)
        found = tx.trim(
            system, {"angle": 0.9, "rate": 0.0}, {"torque": 0.0}, free=["torque"], zero=["rate"], throw=False
        )
        assert found.saturated == {"torque": 4.0 * unit}
        np.testing.assert_allclose(found.residuals["rate of rate"], 4.0 - 9.81 * np.sin(0.9), rtol=1e-6)
        measures.append(found.measure)
        # A length that is free is found too, and a target is data.
        for height in (-0.95, -0.9):
            high = tx.trim(system, {"angle": 0.3, "rate": 0.0}, {"torque": 0.0}, free=["torque", "length"],
                           zero=["rate"], fixed={"height": height * unit})  # fmt: skip
            np.testing.assert_allclose(high.params["length"], -height * unit / np.cos(0.3), rtol=1e-12)
    np.testing.assert_allclose(measures[0], measures[1], rtol=1e-6)
    kept = system.functions.loops.values()
    assert len(kept) == 2  # of rates, and of rates and outputs
    assert [function._cache_size() for function in kept] == [1, 1]


def test_a_trim_is_linearised_with_names_and_modes() -> None:
    x = {"angle": 0.3, "rate": 0.0}
    hanging = tx.trim(pendulum(1.0), x, {"torque": 0.0}, free=["angle"], zero=["rate"])
    found = hanging.linearize(outputs=["height"])
    assert (found.states, found.controls, found.outputs) == (("angle", "rate"), ("torque",), ("height",))
    np.testing.assert_allclose(found.A, [[0.0, 1.0], [-9.81, -0.3]], atol=1e-12)
    np.testing.assert_allclose(np.hstack([found.B.T, found.C, found.D]), [[0.0, 1.0, 0.0, 0.0, 0.0]], atol=1e-12)
    (mode,) = found.modes()
    np.testing.assert_allclose(mode.frequency, np.sqrt(9.81), rtol=1e-12)
    np.testing.assert_allclose(mode.damping, 0.3 / (2.0 * np.sqrt(9.81)), rtol=1e-12)
    np.testing.assert_allclose([mode.time_constant, mode.period], [2.0 / 0.3, 2 * np.pi / mode.eigenvalue.imag])
    np.testing.assert_allclose([mode.participation[name] for name in ("angle", "rate")], 0.5, rtol=1e-12)
    assert str(mode).startswith("-0.15+3.128j: 3.132 rad/s, damping 0.0479, time constant 6.667 s; ")
    part = level().linearize(outputs=["alpha"]).keep(states=["V[0:3]", "V[4]", "g[4]"], controls="el")
    assert part.states == ("V[0]", "V[1]", "V[2]", "V[4]", "g[4]")
    assert part.keep(states=["V[2:]"]).states == ("V[2]", "V[4]")
    # The short period of two equations: omega^2 = -M_alpha + M_q Z_alpha / V, to a hundredth.
    (fast, *_) = part.modes()
    q, speed = 0.5 * DENSITY * 22.0**2 * WING, 22.0
    stiffness, damping = q * CHORD / INERTIA[1, 1] * np.array([0.9, 8.0 * CHORD / (2.0 * speed)])
    np.testing.assert_allclose(fast.frequency, np.sqrt(stiffness + damping * 4.5 * q / (MASS * speed)), rtol=0.01)
    assert {"V[2]", "V[4]"} == set(sorted(fast.participation, key=fast.participation.get)[-2:])


def test_outputs_are_linearised_by_states_and_controls() -> None:
    point = level()
    names = ["alpha", "down", "climb"]
    found = point.linearize(outputs=names)

    def seen(z: np.ndarray) -> np.ndarray:
        x = aircraft().retract(point.x, z[:12])
        u = {name: point.u[name] + dz for name, dz in zip(("el", "ail", "rud", "thrust"), z[12:])}
        outputs = aircraft().outputs(0.0, x, u)
        return np.concatenate([np.ravel(outputs[name]) for name in names])

    eye = 1e-6 * np.eye(16)
    differences = np.stack([(seen(e) - seen(-e)) / 2e-6 for e in eye], axis=1)
    np.testing.assert_allclose(np.hstack([found.C, found.D]), differences, atol=1e-7)
    assert found.outputs == ("alpha", "down[0]", "down[1]", "down[2]", "climb")
    part = point.linearize(outputs=["climb", "down[1]"])
    assert part.outputs == ("climb", "down[1]")
    np.testing.assert_array_equal(part.C, found.C[np.array([4, 2])])
    mapped = jax.vmap(lambda t: linearize(aircraft(), t, point.x, point.u).A)(np.zeros(2))
    np.testing.assert_allclose(mapped[1], found.A, atol=1e-12)


def test_python_control_takes_a_linearisation() -> None:
    pytest.importorskip("control", reason="python-control is not installed")
    reference = level().linearize(outputs=["climb"])
    system = reference.keep(states=["V[0]", "V[2]", "V[4]", "g[4]"], controls=["el"]).to_control()
    assert (system.state_labels[1], system.input_labels, system.output_labels) == ("V[2]", ["el"], ["climb"])
    frequencies = [mode.frequency for mode in reference.keep(states=["V[0]", "V[2]", "V[4]", "g[4]"]).modes()]
    np.testing.assert_allclose(sorted(set(np.abs(system.poles()).round(12))), np.round(frequencies[::-1], 12))


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"free": ["ele"], "zero": ["V"]}, r"free names 'ele', .*did you mean 'el'"),
        ({"free": [], "zero": ["V"]}, "at least one free state"),
        ({"free": ["el"]}, "expects at least one condition"),
        ({"free": ["el"], "zero": ["V[6]"]}, "entries 0 to 5 of 'V'"),
        ({"free": ["V", "V[2]"], "zero": ["V"]}, "twice"),
        ({"free": ["el"], "fixed": {"speed": [1.0, 2.0]}}, r"fixed\['speed'\] expects 1 finite"),
        ({"free": ["el"], "steady": ["V"]}, "steady names 'V'"),
        ({"free": {"el": (1.0, -1.0)}, "zero": ["V"]}, "coincide or contradict"),
        ({"free": {"g[4]": (-1.0, 1.0)}, "zero": ["V"]}, "no bounds"),
        ({"free": {"el": 3.0}, "zero": ["V"]}, r"expects \(least, most\)"),
        ({"free": [3], "zero": ["V"]}, "names such as"),
        ({"free": ["el"], "zero": ["V"], "tolerance": 0.0}, "tolerance must be a positive"),
        ({"free": ["el"], "zero": ["V"], "tolerance": np.inf}, "tolerance must be a positive"),
        ({"free": {"V[0:2]": ([0.0, 1.0, 2.0], None)}, "zero": ["V"]}, "expects a bound or 2 of them"),
        ({"free": [["el"]], "zero": ["V"]}, "names such as"),
    ],
)  # fmt: skip
def test_what_trim_refuses(asked: dict[str, Any], words: str, unchecked: None) -> None:
    with pytest.raises(tx.InputError, match="(?s)" + words):
        tx.trim(aircraft(), START, NEUTRAL, **asked)


def test_a_start_without_finite_derivatives_is_named() -> None:
    still = START | {"V": np.zeros(6)}
    with pytest.raises(tx.TrajectoryError, match=r"not finite, or have no finite derivatives: .*beta"):
        tx.trim(aircraft(), still, NEUTRAL, free=["V"], zero=["V", "beta"])


# ---- a pendulum on SO(3) ---------------------------------------------------------------------------------------------

WEIGHT, J = 4.0, np.diag([2.0, 3.0, 4.0])


@functools.cache
def ball_joint() -> tx.Dynamics:
    """A body on a ball joint, its weight below it along z; a motor turns it about y, a damper holds it."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    motor, drag = tx.Control("motor"), tx.Parameter("drag", value=0.5)
    weight = tx.linalg.Cross(np.array([0.0, 0.0, -1.0]), R.T @ np.array([0.0, 0.0, -WEIGHT]))
    torque = weight + motor * np.array([0.0, 1.0, 0.0]) - drag * w - tx.linalg.Cross(w, J @ w)
    return tx.compile(
        tx.System(
            rates={R: w, w: torque / np.diag(J)},
            outputs={"up": R[2, 2]},
        )
    )


HANGING = {"R": np.asarray(tx.pose(euler=np.array([0.02, 0.1, 0.3]))[:3, :3]), "w": np.array([0.1, 0.0, -0.1])}


def test_a_motor_holds_a_pendulum() -> None:
    """sin(angle) = torque / weight moment, found from a start that moves."""
    held = tx.trim(ball_joint(), HANGING, {"motor": 2.0}, free=["R", "w"], zero=["R", "w"])
    assert not held.saturated
    assert held.undetermined  # the turn about the vertical
    down = held.x["R"] @ [0.0, 0.0, -1.0]
    assert np.hypot(down[0], down[1]) == pytest.approx(0.5, abs=1e-9)
    np.testing.assert_allclose(held.x["w"], np.zeros(3), atol=1e-9)
    np.testing.assert_allclose(held.x["R"] @ held.x["R"].T, np.eye(3), atol=1e-14)
    assert held.u["motor"] == 2.0


def test_modes_of_a_hanging_pendulum() -> None:
    """Two swings and a turn about the vertical that nothing holds; frequencies sqrt(weight / J)."""
    held = tx.trim(ball_joint(), HANGING, {"motor": 0.0}, free=["R", "w"], zero=["R", "w"])
    swings = [mode for mode in held.linearize().modes() if mode.eigenvalue.imag > 0.0]
    np.testing.assert_allclose([mode.frequency for mode in swings], np.sqrt([WEIGHT / 2.0, WEIGHT / 3.0]), rtol=1e-6)
    np.testing.assert_allclose([2.0 * mode.damping * mode.frequency for mode in swings], [0.25, 0.5 / 3.0], rtol=1e-6)
    assert swings[0].participation["R[0]"] > 10.0 * swings[0].participation["R[1]"]


def test_a_fixed_output_asks_for_a_control() -> None:
    """up = cos(angle) at 0.8 takes a torque of 0.6 of the weight's; no more than 1 N m is there in the second."""
    ask = {"zero": ["R", "w"], "fixed": {"up": 0.8}}
    leaning = HANGING | {"R": np.asarray(tx.pose(euler=np.array([0.0, -0.3, 0.0]))[:3, :3])}
    held = tx.trim(ball_joint(), leaning, {"motor": 0.0}, free={"R": None, "w": None, "motor": (-3.0, 3.0)}, **ask)
    assert abs(held.u["motor"]) == pytest.approx(0.6 * WEIGHT, rel=1e-8)
    with pytest.raises(tx.TrajectoryError, match="motor stands at its bound"):
        tx.trim(ball_joint(), leaning, {"motor": 0.0}, free={"R": None, "w": None, "motor": (-1.0, 1.0)}, **ask)


# ---- over the turning Earth ------------------------------------------------------------------------------------------


@functools.cache
def light_aeroplane() -> tuple[flight.Vehicle, tx.Dynamics]:
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
    craft, dynamics = light_aeroplane()
    x = craft.start(
        0.7, 0.2, 1500.0, (50.0, 40.0, 0.0), (0.0, 0.03, np.arctan2(40.0, 50.0)), relative_to=flight.local_axes
    )
    level = tx.trim(
        dynamics,
        x,
        {"elevator": 0.0, "throttle": 0.3, "aileron": 0.0, "rudder": 0.0},
        free={"g": None, "V": None, "elevator": (-0.4, 0.4), "throttle": (0.0, 1.0), "aileron": None, "rudder": None},
        fixed=["latitude", "longitude", "altitude", "ned_velocity", "beta"],
        steady=["ned_velocity", "attitude", "rate"],
        tolerance=1e-7,
    )
    assert not level.saturated
    # forces balance: lift carries the weight less what the motion over the turning Earth takes
    weight = 1000.0 * 9.8
    q = 0.5 * float(dynamics.outputs(0.0, level.x, level.u)["density"]) * (50.0**2 + 40.0**2)
    alpha = float(dynamics.outputs(0.0, level.x, level.u)["alpha"])
    lift = q * 16.0 * (0.3 + 5.0 * alpha + 0.4 * float(level.u["elevator"]))
    assert lift + 3000.0 * float(level.u["throttle"]) * np.sin(alpha) == pytest.approx(weight, rel=5e-3)
    modes = [mode for mode in level.linearize().modes() if mode.eigenvalue.imag > 1e-2]
    # Lanchester: sqrt(2) g / V for the phugoid, the slowest of three oscillations
    assert len(modes) == 3
    assert modes[-1].frequency == pytest.approx(np.sqrt(2.0) * 9.8 / np.hypot(50.0, 40.0), rel=0.15)
    sol = tx.integrate(dynamics, level.x, t1=20.0, dt=0.02, u=level.u)
    end = dynamics.outputs(20.0, {k: v[-1] for k, v in sol.xs.items()}, level.u)
    assert float(end["altitude"]) == pytest.approx(1500.0, abs=0.2)
