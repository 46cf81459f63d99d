"""Conditions on the start and at named nodes, and poses of which half is given: known optima, and what is refused."""

from typing import Any

import numpy as np
import pytest
from trajectory_systems import EULER, HEUN, double_integrator, free_flyer

import twistax as tx
from twistax.errors import ModelError
from twistax.trajectory import Problem, Status, TrajectoryResult


def test_a_start_on_a_circle_is_the_nearest_point_of_it() -> None:
    """x' = u from a circle about the origin to (3, 4): |x(1)| - radius along a line."""
    x, u = tx.State("x", shape=(2,)), tx.Control("u", shape=(2,))
    problem = Problem(
        tx.compile(tx.System(rates={x: u})),
        tx.Minimize(running=u @ u),
        nodes=3,
        final_time=1.0,
        initial=[x @ x == 4.0, x[0] <= 1.5],
        **EULER,
        final={x: [3.0, 4.0]},
        guess={x: [1.0, 1.0]},
    )
    result = problem.solve()
    assert result.solved
    np.testing.assert_allclose(result.xs["x"][0], [1.2, 1.6], atol=1e-5)
    assert result.cost == pytest.approx(9.0, rel=1e-5)
    # d cost / d(radius^2) = -2 (5 - radius) / (2 radius), and the multiplier is its negative.
    assert result.multipliers[f"initial: {x @ x == 4.0!r}"] == pytest.approx([1.5], rel=1e-4)
    assert any(name.startswith("initial: ") for name in result.violations)
    assert max(value for name, value in result.replay(steps=2).final.items() if name.startswith("initial")) < 1e-6


def test_a_launch_angle_is_found() -> None:
    """How far a stone flies: v^2 / g at 45 deg."""
    p, v = tx.State("p", shape=(2,)), tx.State("v", shape=(2,))
    dynamics = tx.compile(tx.System(rates={p: v, v: np.array([0.0, -10.0])}))
    problem = Problem(
        dynamics,
        tx.Maximize(p[0]),
        nodes=4,
        final_time=(0.1, 5.0),
        initial=[{p: [0.0, 0.0]}, tx.linalg.Norm(v) <= 20.0],
        final=[p[1] == 0.0],
        guess={v: [5.0, 5.0]},
    )
    result = problem.solve()
    assert result.solved
    assert result.cost == pytest.approx(40.0, rel=1e-6)
    np.testing.assert_allclose(result.xs["v"][0], [np.sqrt(200.0)] * 2, rtol=1e-4)


def test_a_gate_at_a_named_node_is_passed() -> None:
    """Least energy through p = 1 at half time and back, which a spline of two cubics is; v there is free."""
    dynamics = tx.compile(double_integrator())
    p, v, u = *dynamics.states, *dynamics.controls
    problem = Problem(
        dynamics,
        tx.Minimize(running=u * u),
        nodes=41,
        final_time=2.0,
        initial={p: 0.0, v: 0.0},
        final={p: 0.0, v: 0.0},
        at={20: [p == 1.0, v <= 2.0], 10: p >= -1.0},
    )
    result = problem.solve()
    assert result.solved
    assert result.xs["p"][20] == pytest.approx(1.0, abs=1e-6)
    # Twice a rest-to-rest motion of 20 held controls, each 12 distance^2 / time^3 / (1 - 1 / 20^2).
    assert result.cost == pytest.approx(24.0 / (1.0 - 1.0 / 400.0), rel=1e-6)
    (gate,) = (name for name in result.multipliers if name.startswith("node 20") and "==" in name)
    assert abs(result.multipliers[gate][0]) == pytest.approx(48.0, rel=1e-2)
    assert result.replay(steps=3).final[gate] < 1e-5


ANGLE, SHIFT = 1.1, np.array([1.0, 2.0, -0.5])
POSE = tx.pose(position=SHIFT, rotation=np.asarray(tx.SO3.exp(ANGLE * np.array([0.6, 0.0, 0.8]))))


def flown(**ends: Any) -> TrajectoryResult:
    """Least |v|^2 + |w|^2 in a second."""
    dynamics = tx.compile(free_flyer())
    V = dynamics.controls[0]
    return Problem(dynamics, tx.Minimize(running=V @ V), nodes=4, final_time=1.0, **EULER, **ends).solve()


def half(pose: np.ndarray, block: Any) -> np.ndarray:
    pose = np.array(pose)
    pose[block] = np.nan
    return pose


@pytest.mark.parametrize(
    ("side", "block"),
    [
        pytest.param("initial", np.s_[:3, :3], id="attitude free at the start"),
        pytest.param("final", np.s_[:3, 3], id="position free at the end"),
        pytest.param("final", np.s_[:3, :3], id="attitude free at the end", marks=pytest.mark.slow),
        pytest.param("initial", np.s_[:3, 3], id="position free at the start", marks=pytest.mark.slow),
    ],
)
def test_half_of_a_pose_is_free(side: str, block: Any) -> None:
    """What is free moves nothing: only the distance, or only the turn, is paid for."""
    other = {"initial": "final", "final": "initial"}[side]
    result = flown(**{side: {"g": half(POSE, block)}, other: {"g": np.eye(4)}})
    assert result.solved
    cost = ANGLE**2 if block == np.s_[:3, 3] else SHIFT @ SHIFT
    assert result.cost == pytest.approx(cost, rel=1e-3)
    given = np.s_[:3, :3] if block == np.s_[:3, 3] else np.s_[:3, 3]
    np.testing.assert_allclose(result.xs["g"][0 if side == "initial" else -1][given], POSE[given], atol=1e-6)


GROUNDED = tx.State("g", group=tx.SE3)


@pytest.mark.parametrize(
    "initial",
    [
        {GROUNDED: half(np.eye(4), np.s_[:3, :3])},
        # The end has its place by a constraint in either case.
        pytest.param([GROUNDED[:3, 3] == np.zeros(3)], marks=pytest.mark.slow),
    ],
    ids=["a half pose", "a constraint"],
)
def test_a_limit_that_the_given_half_decides_leaves_room(initial: Any) -> None:
    """A start on the ground with a free attitude, and one whose constraint says so."""
    g = GROUNDED
    V = tx.Control("V", shape=(6,))
    dynamics = tx.compile(tx.System(rates={g: V}, constraints={"ground": g[2, 3] >= 0.0}))
    options: dict[str, Any] = {"nodes": 3, "final_time": 1.0, "final": [g[:3, 3] == SHIFT * np.array([1, 1, -1])]}
    # A step of Euler's depends on the coordinates, which move with the nodes: where attitudes cost nothing, hundreds of
    # iterations go round in what that makes of second derivatives.
    problem = Problem(dynamics, tx.Minimize(running=V @ V), initial=initial, **options, **HEUN)
    result = problem.solve()
    assert result.solved
    assert result.iterations < 100
    assert result.cost == pytest.approx(SHIFT @ SHIFT, rel=1e-3)
    names = problem.shooting.names[problem.shooting.redundant]
    assert list(names) == ["ground", "ground"]


def test_a_limit_is_not_decided_by_the_values_of_parameters() -> None:
    """x[0] + k x[1] <= 1.5 says nothing beside x[0] == 1 where k = 0, and x[1] <= 0.5 where k = 1, solved next."""
    x, u, k = tx.State("x", shape=(2,)), tx.Control("u", shape=(2,)), tx.Parameter("k", value=0.0)
    problem = Problem(
        tx.compile(tx.System(rates={x: u})),
        tx.Minimize((x[1] - 2.0) ** 2, running=u @ u),
        nodes=3,
        final_time=1.0,
        initial={x: [0.0, 0.0]},
        final=[x[0] == 1.0, x[0] + k * x[1] <= 1.5],
        **EULER,
    )
    for given, cost in ((0.0, 3.0), (1.0, 3.5)):
        result = problem.solve(params={k: given})
        assert result.solved
        assert result.cost == pytest.approx(cost, rel=1e-6)


def test_a_limit_on_a_control_is_not_decided_by_the_start() -> None:
    """u^2 <= x, x = 1 + t, has no slope by u at u = 0, where the guess is. The limit is narrowest at the start."""
    x, y, u = tx.State("x"), tx.State("y"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={x: 1.0, y: u}, constraints={"narrow": u * u <= x}))
    problem = Problem(dynamics, tx.Maximize(y), nodes=3, final_time=2.0, initial={x: 1.0, y: 0.0}, **EULER)
    result = problem.solve()
    assert result.solved
    np.testing.assert_allclose(result.us["u"], np.sqrt([1.0, 2.0]), atol=1e-5)


p, v = tx.State("p"), tx.State("v")
BAD: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"at": {0: p == 1.0}}, tx.TrajectoryError, r"(?s)node 0.*1 to 6.*initial="),
    ({"at": {7: p == 1.0}}, tx.TrajectoryError, "node 7"),
    ({"at": {3: {"p": 1.0}}}, tx.ModelError, r"at\[3\] expects constraints"),
    ({"at": [p == 1.0]}, tx.ModelError, "at must be a dict"),
    ({"at": {3: tx.State("stranger") == 1.0}}, tx.ModelError, "stranger"),
    ({"initial": [3.0]}, tx.ModelError, "initial expects values"),
    ({"initial": [tx.Control("u") == 1.0]}, tx.ModelError, "no value at a node"),
]


@pytest.mark.parametrize(("changes", "error", "text"), BAD, ids=[str(number) for number in range(len(BAD))])
def test_conditions_that_cannot_be_are_refused(changes: dict[str, Any], error: type[Exception], text: str) -> None:
    dynamics = tx.compile(double_integrator())
    with pytest.raises(error, match=text):
        Problem(dynamics, tx.Minimize(dynamics.states[0]), nodes=8, final_time=1.0, **changes)


def test_single_entries_of_a_pose_are_constraints() -> None:
    with pytest.raises(tx.ModelError, match=r"(?s)whole position or the whole attitude.*use constraints"):
        flown(final={"g": half(POSE, np.s_[0, 3])})


def test_a_limit_at_infinity_is_none() -> None:
    """As in a box: along the path, at a node and at the end, of vectors, magnitudes, norms, and of all entries."""
    x, u = tx.State("x", shape=(2,)), tx.Control("u", shape=(2,))
    path = {
        "high": x <= np.array([1.5, np.inf]),
        "low": x >= np.array([-np.inf, -0.5]),
        "size": tx.Abs(u) <= np.array([np.inf, 1.0]),
        "norm": tx.linalg.Norm(x) <= np.inf,
    }
    problem = Problem(
        tx.compile(tx.System(rates={x: u}, constraints=path)),
        tx.Maximize(x[0] + x[1]),
        nodes=5,
        final_time=2.0,
        initial={x: [0.0, 0.0]},
        final=[x <= np.array([np.inf, 1.25]), x[0] <= np.inf],
        at={2: x <= np.array([0.5, np.inf])},
        **EULER,
    )
    result = problem.solve()
    assert result.solved
    np.testing.assert_allclose(result.xs["x"][-1], [1.5, 1.25], atol=1e-6)
    assert result.xs["x"][2, 0] <= 0.5 + 1e-6
    asked = {"high[0]", "low[1]", "size[1]", "node 2: x <= [0.5, inf][0]", "final: x <= [ inf, 1.25][1]"}
    assert set(problem.shooting.names) - {""} == asked


@pytest.mark.parametrize("kind", ["alone", "beside a number", "size", "norm", "final"])
def test_a_limit_that_a_parameter_puts_at_infinity_is_none(kind: str) -> None:
    """The least of u.u with 1 between the ends is 1/2 where the limit is far, and where it is nowhere."""
    x, u, p = tx.State("x"), tx.Control("u", shape=(2,)), tx.Parameter("p", value=1.0)
    path = {
        "alone": u <= p * np.inf,
        "beside a number": u <= p * np.array([np.inf, 0.25]),
        "size": tx.Abs(u) <= p * np.inf,
        "norm": tx.linalg.Norm(u) <= p * np.inf,
    }
    problem = Problem(
        tx.compile(tx.System(rates={x: u[0] + u[1]}, constraints={"far": path[kind]} if kind in path else {})),
        tx.Minimize(running=u @ u),
        nodes=3,
        final_time=1.0,
        initial={x: 0.0},
        final=[{x: 1.0}, *([x <= p * np.inf] if kind == "final" else [])],
        **EULER,
    )
    result = problem.solve()
    assert result.solved
    assert result.cost == pytest.approx(0.625 if kind == "beside a number" else 0.5, rel=1e-6)
    beyond = problem.solve(params={p: -1.0})
    assert beyond.status is Status.NON_FINITE
    assert "is inf" in beyond.message


@pytest.mark.parametrize("end", [False, True])
@pytest.mark.parametrize("beyond", [lambda x: x >= np.inf, lambda x: x <= -np.inf, lambda x: x == np.inf])
def test_what_no_value_can_meet_is_refused(beyond: Any, end: bool) -> None:
    x, u = tx.State("x"), tx.Control("u")
    rates, asked = {x: u}, [beyond(x)]
    dynamics = tx.compile(tx.System(rates=rates, constraints=[] if end else asked))
    with pytest.raises(ModelError, match="expects a limit that a value can satisfy, got an infinite one"):
        Problem(dynamics, tx.Minimize(running=u**2), nodes=3, final_time=1.0, final=asked if end else None, **EULER)


def test_a_guess_goes_through_what_conditions_say() -> None:
    """Of a state that no value fixes; what is guessed, and what a value fixes, counts more."""
    g, x = tx.State("g", group=tx.SE3), tx.State("x", shape=(2,))
    V, u, goal = tx.Control("V", shape=(6,)), tx.Control("u", shape=(2,)), tx.Parameter("goal", value=3.0)
    dynamics = tx.compile(tx.System(rates={g: V, x: u}))
    here, there = np.array([1.0, 2.0, 3.0]), np.asarray(tx.pose(position=[2.0, 0.0, 1.0], euler=[0.0, 0.0, 0.0]))
    ends: dict[str, Any] = {
        "initial": [g[:3, 3] == here, 2.0 * x[0] == 1.0 + goal],
        "final": [g == there, x[1] == 8.0, g[:2, 2] == 0.0],
    }

    def guessed(**options: Any) -> dict[str, np.ndarray]:
        problem = Problem(dynamics, tx.Minimize(running=V @ V + u @ u), nodes=3, final_time=1.0, **ends, **options)
        xs: dict[str, np.ndarray] = problem.started().point.xs
        return xs

    xs = guessed()
    np.testing.assert_allclose(xs["g"][:, :3, 3], np.linspace(here, there[:3, 3], 3), atol=1e-12)
    np.testing.assert_allclose(xs["g"][:, :3, :3], [np.eye(3)] * 3, atol=1e-12)
    np.testing.assert_allclose(xs["x"], [[2.0, 8.0]] * 3)
    np.testing.assert_allclose(guessed(params={goal: 5.0})["x"][0], [3.0, 8.0])
    np.testing.assert_allclose(guessed(guess={x: [1.0, 1.0]})["x"], [[1.0, 1.0]] * 3)
    phase = tx.trajectory.Phase(dynamics, tx.Minimize(running=V @ V + u @ u), nodes=3, final_time=1.0, **ends)
    first, second = Problem([phase, phase]).started().point.xs
    np.testing.assert_allclose(first["x"][0], [2.0, 8.0])
    np.testing.assert_allclose(second["g"][-1], there, atol=1e-12)


@pytest.mark.parametrize("linear", [False, True])
def test_a_state_with_equal_limits_is_refused(linear: bool) -> None:
    """A continuous control is a state, too; one that is held may have one value."""
    x, u = tx.State("x", shape=(2,), max=[1.0, 0.0], min=0.0), tx.Control("u", min=0.5, max=0.5)
    if linear:
        x = tx.State("x", shape=(2,))
    dynamics = tx.compile(tx.System(rates={x: tx.Concat(u, 0.0 * u)}))
    controls = tx.trajectory.Linear() if linear else None
    with pytest.raises(tx.ModelError, match=r"'u' has equal limits" if linear else r"'x\[1\]' has equal limits"):
        Problem(dynamics, tx.Minimize(running=u * u), nodes=3, final_time=1.0, controls=controls)
