"""Systems made of systems: other names, and connections between them."""

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import twistax as tx

p, v, F = (
    tx.State("p", shape=(2,)),
    tx.State("v", shape=(2,)),
    tx.Control("F", shape=(2,), min=[-2.0, None], max=[None, 5.0]),
)
m = tx.Parameter("m", value=2.0)
BODY = tx.System(
    rates={p: v, v: F / m},
    outputs={"energy": 0.5 * m * (v @ v)},
    constraints={"near": tx.linalg.Norm(p) <= 3.0, "slow": tx.Soft(v[0] <= 0.8, l1=10.0 * m)},
    labels={v: [("v_x", "m/s"), ("v_y", "m/s")]},
)
T, command = tx.State("T"), tx.Control("command")
MOTOR = tx.System(rates={T: (command - T) / 0.1}, outputs={"thrust": 3.0 * T, "feed": 2.0 * command})
AT = {"p": np.array([0.1, 0.2]), "v": np.array([1.0, -0.5])}


def along_x(force: Any) -> tx.Expr:
    return tx.Stack([force, 0.0])


def test_a_renamed_system_computes_the_same_under_other_names() -> None:
    left = BODY.renamed("left_", keep=["m"])
    assert [leaf.name for leaf in (*left.states, *left.controls)] == ["left_p", "left_v", "left_F"]
    assert left.parameters == BODY.parameters
    assert set(left.constraints) == {"left_near", "left_slow"}
    assert left.labels == {"left_v": BODY.labels["v"]}
    assert [leaf.name for leaf in BODY.renamed("b_").parameters] == ["b_m"]
    assert repr(BODY.renamed("b_").soft["b_slow"].l1) == "(10. * b_m)"
    np.testing.assert_array_equal(left.left_F.min, BODY.F.min)
    force = np.array([3.0, 4.0])
    got = tx.compile(left)(0.0, {f"left_{name}": value for name, value in AT.items()}, {"left_F": force})
    wanted = tx.compile(BODY)(0.0, AT, {"F": force})
    for name, value in wanted.items():
        np.testing.assert_array_equal(got[f"left_{name}"], value)


def test_groups_and_mechanisms_have_other_names_too() -> None:
    arm = tx.mechanics.chain_models.panda().system()
    other = arm.renamed("a_")
    start = {state.name: np.full(state.shape, 0.1) for state in arm.states}
    torque = {control.name: np.full(control.shape, 0.2) for control in arm.controls}
    wanted = tx.compile(arm)(0.0, start, torque)
    got = tx.compile(other)(
        0.0, {f"a_{n}": x for n, x in start.items()}, {f"a_{n}": value for n, value in torque.items()}
    )
    for name, value in wanted.items():
        np.testing.assert_allclose(got[f"a_{name}"], value, rtol=1e-12, atol=1e-12)
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    free = tx.System(rates={g: V, V: tx.lie.SE3Adjoint(tx.lie.Inverse(g)) @ V}).renamed("b_")
    assert free.b_g.group == tx.SE3
    assert free.rates["b_V"].shape == (6,)


def test_an_output_takes_the_place_of_a_control() -> None:
    whole = tx.join(MOTOR, BODY, connect={BODY.F: along_x(MOTOR.output("thrust"))})
    assert [leaf.name for leaf in whole.controls] == ["command"]
    start, cmd = {**AT, "T": 0.7}, {"command": 1.5}
    rates = tx.compile(whole)(0.0, start, cmd)
    np.testing.assert_allclose(rates["v"], [3.0 * 0.7 / 2.0, 0.0], rtol=1e-12)
    np.testing.assert_allclose(rates["T"], (1.5 - 0.7) / 0.1, rtol=1e-12)
    held = tx.compile(whole).constraints(0.0, start, cmd)["inequality"]
    assert {"near", "slow", "F min", "F max"} == set(whole.constraints)
    # F[0] >= -2, and F[1], which is zero, <= 5.
    np.testing.assert_allclose(held[2:], [-2.0 - 3.0 * 0.7, -5.0], rtol=1e-12)


def test_connections_read_connections() -> None:
    gain = tx.Control("gain")
    links = {"command": 4.0 * gain, BODY.F: along_x(MOTOR.output("feed"))}
    whole = tx.join(MOTOR, BODY, connect=links, outputs={"twice": 2.0 * command})
    dynamics = tx.compile(whole)
    assert [leaf.name for leaf in whole.controls] == ["gain"]
    np.testing.assert_allclose(dynamics(0.0, {**AT, "T": 0.0}, {"gain": 0.5})["v"], [2.0 * 4.0 * 0.5 / 2.0, 0.0])
    np.testing.assert_allclose(dynamics.outputs(0.0, {**AT, "T": 0.0}, {"gain": 0.5})["twice"], 4.0)


def test_two_bodies_on_a_spring_keep_their_momentum() -> None:
    left, right = BODY.renamed("l_", keep="m"), BODY.renamed("r_", keep="m")
    pull = 5.0 * (right.r_p - left.l_p)
    pair = tx.join(left, right, connect={left.l_F: pull, right.r_F: -pull}, outputs={"gap": right.r_p - left.l_p})
    assert [leaf.name for leaf in pair.parameters] == ["m"]
    start = {"l_p": np.zeros(2), "l_v": np.array([1.0, 0.0]), "r_p": np.ones(2), "r_v": np.array([-0.2, 0.4])}
    end = tx.integrate(tx.compile(pair), start, t1=1.0, rtol=1e-10, atol=1e-10).last
    total = start["l_v"] + start["r_v"]
    np.testing.assert_allclose(end["l_v"] + end["r_v"], total, atol=1e-9)
    # The gap oscillates with the reduced mass of 1 kg: 5 N/m, sqrt(5) rad/s.
    gap, speed, rate = start["r_p"] - start["l_p"], start["r_v"] - start["l_v"], np.sqrt(5.0)
    np.testing.assert_allclose(end["r_p"] - end["l_p"], gap * np.cos(rate) + speed / rate * np.sin(rate), atol=1e-8)
    assert pickle.loads(pickle.dumps(pair)).rates.keys() == pair.rates.keys()


def test_a_joined_system_has_a_plan() -> None:
    whole = tx.join(MOTOR, BODY, connect={BODY.F: along_x(MOTOR.output("thrust"))})
    far = tx.trajectory.Problem(
        tx.compile(whole),
        tx.Minimize(running=command**2),
        nodes=9,
        final_time=2.0,
        initial={"p": np.zeros(2), "v": np.zeros(2), "T": 0.0},
        final={"p": np.array([0.4, 0.0])},
    ).solve()
    assert far.status is tx.trajectory.Status.SOLVED
    np.testing.assert_allclose(far.xs["p"][-1], [0.4, 0.0], atol=1e-6)


def test_known_slopes_stay_right_where_a_parameter_becomes_an_expression() -> None:
    x, k, u = tx.State("x"), tx.Parameter("k", value=1.0), tx.Control("u")
    known = tx.System(rates={x: k * u}, slopes={x: [(x, [[0.0]]), (tx.Stack([u]), tx.Stack([tx.Stack([k])]))]})
    y = tx.State("y")
    whole = tx.compile(tx.join(known, tx.System(rates={y: -y}), connect={k: 2.0 * x * y}))
    got = whole.jacobian(0.0, {"x": 0.5, "y": 3.0}, {"u": 7.0})
    np.testing.assert_allclose(got["x"], [[2.0 * 3.0 * 7.0, 2.0 * 0.5 * 7.0], [0.0, -1.0]])


@pytest.mark.parametrize(
    ("build", "error", "match"),
    [
        (lambda: tx.join(), tx.ModelError, "at least one system"),
        (lambda: tx.join(BODY, 3.0), tx.ModelError, "expects systems, got 3.0"),
        (lambda: tx.join(BODY, BODY), tx.ModelError, r"both have the State 'p'.\n  fix: rename.*renamed"),
        (lambda: tx.join(BODY, MOTOR, connect={"G": 1.0}), tx.ModelError, "connect names 'G'"),
        (lambda: tx.join(BODY, MOTOR, connect={p: v}), tx.ModelError, "the State 'p', which has a rate"),
        (lambda: tx.join(BODY, MOTOR, connect={F: T}), tx.ShapeError, r"'F'\] expects shape \(2,\), got \(\)"),
        (
            lambda: tx.join(BODY, MOTOR, connect={F: along_x(MOTOR.output("feed")), command: F[0]}),
            tx.ModelError,
            r"closes an algebraic loop:\n  '(F|command)' = .*, which reads '(F|command)'\n  '(F|command)'",
        ),
        (lambda: tx.join(BODY, MOTOR, outputs={"energy": T}), tx.ModelError, "outputs has 'energy' twice"),
        (lambda: BODY.output("height"), tx.ModelError, "output names 'height'"),
        (lambda: BODY.Ff, AttributeError, "did you mean 'F'"),
        (lambda: BODY.renamed(""), tx.ModelError, "expects a prefix"),
        (lambda: BODY.renamed("a", keep="p"), tx.ModelError, "keep names 'p'"),
    ],
)
def test_errors(build: Callable[[], Any], error: type[Exception], match: str) -> None:
    with pytest.raises(error, match=match):
        build()


def test_parameters_that_are_two_objects_are_refused() -> None:
    other = tx.System(rates={tx.State("q"): tx.Parameter("m", value=2.0) * 1.0})
    with pytest.raises(tx.ModelError, match=r"both have the Parameter 'm'.*\n.*one object in both"):
        tx.join(BODY, other)
