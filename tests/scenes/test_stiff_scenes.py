"""The stiff scenes: their ends found again, by SciPy's Radau, by short explicit steps, and by what stiffness leaves."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from scene_oracles import scipy_solution
from scene_references import REFERENCES, collocated, main, radau
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import twistax as tx
from oracles import skew
from twistax.scenes import SCENES, Scene, actuator_lag, stiff_attitude, stiff_joint

EXTENDED = np.finfo(np.longdouble).eps < 1e-18
JOINT = stiff_joint.STIFF_JOINT


# ---- the stored ends -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "steps", "bar"),
    [
        ("stiff-attitude", 25, 1e-15),
        ("actuator-lag", 25, 1e-15),
        # The joint's stiffness makes more of round-off.
        ("stiff-joint", 200, 5e-14),
    ],
)
@pytest.mark.slow
def test_the_stored_end_is_what_the_command_finds(name: str, steps: int, bar: float) -> None:
    """With fewer steps than those the stored digits were found with."""
    assert SCENES[name].error(REFERENCES[name].end(SCENES[name], steps)) < (bar if EXTENDED else 1e3 * bar)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stiff-attitude", "actuator-lag"])
def test_so_are_those_of_other_rates(name: str) -> None:
    for scene in REFERENCES[name].scenes:
        assert scene.error(REFERENCES[name].end(scene)) < (1e-15 if EXTENDED else 1e-12)


def by_radau(scene: Scene, rtol: float) -> dict[str, Any]:
    rate, start, unpack = REFERENCES[scene.name].flat(scene)
    found = solve_ivp(rate, (0.0, scene.duration), start, method="Radau", rtol=rtol, atol=1e-2 * rtol)
    assert found.success
    return unpack(found.y[:, -1])


@pytest.mark.parametrize(
    ("scene", "rtol", "bar"),
    [
        (stiff_attitude.scene(1e5), 1e-10, 1e-10),
        (stiff_attitude.scene(1e8), 1e-10, 1e-10),
        (actuator_lag.scene(1e-6), 1e-10, 1e-9),
        pytest.param(JOINT, 1e-6, 1e-4, marks=pytest.mark.slow),
    ],
)
def test_scipys_radau_ends_there_too(scene: Scene, rtol: float, bar: float) -> None:
    assert scene.error(by_radau(scene, rtol)) < bar


@pytest.mark.parametrize(
    ("scene", "bar"),
    [
        (stiff_attitude.scene(1e4), 1e-12),
        (actuator_lag.scene(1e-4), 1e-11),
        pytest.param(JOINT, 1e-10, marks=pytest.mark.slow),
    ],
)
def test_short_explicit_steps_of_the_system_end_there_too(scene: Scene, bar: float) -> None:
    """The expressions of the scene, not the equations written out in NumPy."""
    solution = scene.integrate(rtol=1e-11, method=tx.RKMK(tx.tableaus.DOP853), control=tx.StepControl(max_steps=10**6))
    end = {name: np.asarray(value[-1]) for name, value in solution.xs.items()}
    assert scene.error(end) < bar
    before, after = (scene.dynamics.outputs(0.0, x, None, scene.params) for x in (scene.start, end))
    for name in scene.invariants:
        np.testing.assert_allclose(after[name], before[name], rtol=0.0, atol=1e-11)


# ---- what stiffness leaves: as the rate grows the fast part vanishes, in proportion ----------------------------------


def close_and_closer(near: Scene, nearer: Scene, limit: Mapping[str, Any]) -> None:
    """The limit is missed in proportion to the fast time, which is ten times shorter in the second scene."""
    far, close = near.error({**near.end, **limit}), nearer.error({**nearer.end, **limit})
    assert far / close == pytest.approx(10.0, rel=0.05)
    assert close < 1e-4


def test_a_very_stiff_damper_leaves_first_order_motion() -> None:
    """w = -e: the attitude alone, with SciPy's rotations."""

    def error(t: float, R: Any) -> Any:
        D = Rotation.from_rotvec(stiff_attitude.SWING * np.sin(t) * np.array(stiff_attitude.AXIS)).as_matrix()
        skew = 0.5 * (D.T @ R - R.T @ D)
        return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])

    def rates(t: float, y: Mapping[str, Any]) -> dict[str, Any]:
        return {"R": y["R"] @ skew(-error(t, y["R"]))}

    scenes = stiff_attitude.scene(1e6), stiff_attitude.scene(1e7)
    R = scipy_solution(rates, {"R": scenes[0].start["R"]}, 0.0, 5.0)["R"]
    close_and_closer(*scenes, {"R": R, "w": -error(5.0, R)})


def test_very_quick_actuators_are_their_commands() -> None:
    m, J, arm = actuator_lag.MASS, np.array(actuator_lag.INERTIA), actuator_lag.ARM

    def commands(t: float, y: Mapping[str, Any]) -> tuple[float, Any]:
        n, v, w = y["g"][2, :3], y["V"][:3], y["V"][3:]
        swing = 0.02 * np.array([np.sin(t), np.cos(2 * t)])
        return 9.81 * m * (1 + 0.1 * np.cos(0.7 * t)) - 2 * v[2], swing - 0.3 * n[:2] + 0.15 * np.array([w[1], -w[0]])

    def rates(t: float, y: Mapping[str, Any]) -> dict[str, Any]:
        F, a = commands(t, y)
        thrust, V = F * np.array([*a, 1.0]), y["V"]
        twist = np.zeros((4, 4))
        twist[:3, :3], twist[:3, 3] = skew(V[3:]), V[:3]
        v = (thrust - 9.81 * m * y["g"][2, :3]) / m - np.cross(V[3:], V[:3])
        w = (np.cross([0, 0, -arm], thrust) - np.cross(V[3:], J * V[3:])) / J
        return {"g": y["g"] @ twist, "V": np.concatenate([v, w])}

    scenes = actuator_lag.scene(1e-5), actuator_lag.scene(1e-6)
    end = scipy_solution(rates, {name: scenes[0].start[name] for name in ("g", "V")}, 0.0, 5.0)
    F, a = commands(5.0, end)
    close_and_closer(*scenes, {**end, "F": F, "a": a})


def test_the_joint_holds_and_momenta_balance() -> None:
    """Summed up body by body in NumPy. The gap left is what the force that holds it takes, and no more."""

    def kept(x: Mapping[str, Any]) -> Any:
        linear, angular = np.zeros(3), np.zeros(3)
        for i in range(2):
            g, V, m, J = x[f"g{i + 1}"], x[f"V{i + 1}"], stiff_joint.MASSES[i], np.array(stiff_joint.MOMENTS[i])
            p = m * g[:3, :3] @ V[:3]
            linear, angular = linear + p, angular + np.cross(g[:3, 3], p) + g[:3, :3] @ (J * V[3:])
        return np.concatenate([linear, angular])

    def gap(x: Mapping[str, Any]) -> float:
        ends = [x[f"g{i + 1}"][:3, :3] @ stiff_joint.POINTS[i] + x[f"g{i + 1}"][:3, 3] for i in range(2)]
        return float(np.linalg.norm(ends[1] - ends[0]))

    np.testing.assert_allclose(kept(JOINT.end), kept(JOINT.start), rtol=0.0, atol=1e-13)
    assert gap(JOINT.start) == pytest.approx(1e-4)
    assert 1e-9 < gap(JOINT.end) < 1e-7


# ---- the method and the command --------------------------------------------------------------------------------------


def test_radau_of_two_stages_is_the_published_one() -> None:
    """Hairer and Wanner, Solving Ordinary Differential Equations II, table IV.5.5."""
    c, a = radau(2)
    np.testing.assert_allclose(c.astype(float), [1 / 3, 1], rtol=1e-15)
    np.testing.assert_allclose(a.astype(float), [[5 / 12, -1 / 12], [3 / 4, 1 / 4]], rtol=1e-15)


def test_nine_stages_integrate_polynomials() -> None:
    c, a = radau(9)
    for power in range(9):
        np.testing.assert_allclose(
            (a @ c**power).astype(float), (c ** (power + 1) / (power + 1)).astype(float), atol=1e-18
        )
    for power in range(9, 17):
        assert float(a[-1] @ c**power) == pytest.approx(1.0 / (power + 1), rel=1e-15)


def test_collocation_of_a_stiff_line() -> None:
    """y' = -k (y - cos t): the particular solution, once the transient has died out."""
    k = 1e8
    end = collocated(lambda t, y: -k * (y - np.cos(t)), np.zeros(1, np.longdouble), 3.0, 30, k)
    assert float(end[0]) == pytest.approx((k**2 * np.cos(3.0) + k * np.sin(3.0)) / (k**2 + 1), rel=1e-15)
    with pytest.raises(ArithmeticError, match="does not converge"):
        collocated(lambda t, y: 50 * np.cos(50 * y), np.zeros(1), 5.0, 5, 1.0)


@pytest.mark.slow
def test_the_command_prints_a_scene(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    short = dataclasses.replace(REFERENCES["stiff-attitude"], scenes=(stiff_attitude.scene(1e3),), steps=20)
    monkeypatch.setitem(REFERENCES, "stiff-attitude", short)
    assert main(["stiff-attitude"]) == 0
    said = capsys.readouterr().out
    assert "# stiff-attitude, k = 1000: 20 and 30 steps are" in said
    assert '"w": [-0.00435573083' in said
    with pytest.raises(SystemExit):
        main(["moon"])
