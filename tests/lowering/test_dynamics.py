"""`tx.compile`: rates, outputs, constraints, the tangent space of a state, and what is left out."""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import twistax as tx
from oracles import hat

INERTIA = np.diag([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
V, mass = tx.State("V", (6,)), tx.State("mass")
g, a = tx.State("g", group=tx.SE3), tx.State("a", group=tx.SO3)
grid = tx.State("grid", (2, 2))
F, spare = tx.Control("F", (6,)), tx.Control("spare")
M, k = tx.Parameter("M", value=INERTIA), tx.Parameter("k", value=0.5)
idle = tx.Parameter("idle", (2,))

#: Declared in an order that sorting by name would change.
SYSTEM = tx.System(
    rates={
        V: tx.linalg.Solve(M, F - tx.lie.AdjointDual(V, M @ V)),
        g: V,
        mass: -k * tx.linalg.Norm(F),
        grid: grid @ grid,
        a: V[3:],
    },
    outputs={"speed": tx.linalg.Norm(tx.lie.linear(V)), "spare": spare * mass, "height": g[2, 3]},
    constraints={"thrust": F[:2] <= 10.0, "still": V[:2] == 0.0, "dry": mass >= 1.0},
    controls=[F, spare],
    parameters=[M, k, idle],
)
DYNAMICS = tx.compile(SYSTEM)
POSE = tx.pose(position=[1.0, 2.0, 3.0], euler=[0.1, -0.2, 0.3])
POINT = {
    "V": np.array([1.0, 2.0, 3.0, 0.4, -0.5, 0.6]),
    "g": POSE,
    "mass": 4.0,
    "grid": np.array([[1.0, 2.0], [0.5, -1.0]]),
    "a": POSE[:3, :3],
}
CONTROLS = {"F": np.arange(6.0)}


# ---- values --------------------------------------------------------------------------------------------------------


def test_rates() -> None:
    """Newton and Euler by hand, with a diagonal inertia."""
    found = DYNAMICS(0.0, POINT, CONTROLS)
    v, w, f, tau = POINT["V"][:3], POINT["V"][3:], CONTROLS["F"][:3], CONTROLS["F"][3:]
    J = np.array([1.0, 2.0, 3.0])
    wanted = np.concatenate([f / 2.0 - np.cross(w, v), (tau - np.cross(w, J * w)) / J])
    np.testing.assert_allclose(found["V"], wanted, rtol=1e-14)
    np.testing.assert_array_equal(found["g"], POINT["V"])
    np.testing.assert_array_equal(found["a"], w)
    np.testing.assert_allclose(found["mass"], -0.5 * np.sqrt(55.0), rtol=1e-15)
    np.testing.assert_allclose(found["grid"], POINT["grid"] @ POINT["grid"], rtol=1e-15)
    assert {name: value.shape for name, value in found.items()} == {
        "V": (6,),
        "g": (6,),
        "mass": (),
        "grid": (2, 2),
        "a": (3,),
    }


def test_outputs_and_constraints() -> None:
    found = DYNAMICS.outputs(0.0, POINT, {"spare": 2.0})
    assert list(found) == ["height", "spare", "speed"]
    assert {name: float(value) for name, value in found.items()} == pytest.approx(
        {"speed": np.sqrt(14.0), "spare": 8.0, "height": 3.0}
    )
    limits = DYNAMICS.constraints(0.0, POINT, CONTROLS)
    np.testing.assert_allclose(limits["inequality"], [-10.0, -9.0, -3.0])
    np.testing.assert_allclose(limits["equality"], [1.0, 2.0])
    assert DYNAMICS.functions.constraint_names == {
        "inequality": ["thrust[0]", "thrust[1]", "dry"],
        "equality": ["still[0]", "still[1]"],
    }


def test_a_system_without_outputs_or_constraints() -> None:
    bare = tx.compile(tx.System(rates={mass: -mass}))
    assert bare.outputs(0.0, {"mass": 1.0}) == {}
    limits = bare.constraints(0.0, {"mass": np.float32(1.0)})
    assert {name: (value.shape, value.dtype) for name, value in limits.items()} == {
        "inequality": ((0,), np.float32),
        "equality": ((0,), np.float32),
    }


# ---- what is computed ----------------------------------------------------------------------------------------------


def test_only_what_is_asked_for_must_be_given() -> None:
    """A rate does not read the spare control; outputs do not read F."""
    DYNAMICS(0.0, POINT, CONTROLS)
    with pytest.raises(tx.InputError, match="Control 'spare' is missing"):
        DYNAMICS.outputs(0.0, POINT, CONTROLS)
    with pytest.raises(tx.InputError, match="Control 'F' is missing"):
        DYNAMICS(0.0, POINT, {"spare": 1.0})


def test_outputs_are_narrowed() -> None:
    narrow = tx.compile(SYSTEM, outputs=["height"])
    assert list(narrow.outputs(0.0, POINT)) == ["height"]
    assert list(tx.compile(SYSTEM, outputs="height").outputs(0.0, POINT)) == ["height"]
    assert tx.compile(SYSTEM, outputs=[]).outputs(0.0, POINT) == {}
    assert "Control 'spare' is not used: nothing depends on it" in narrow.explain().unused


def test_outputs_cost_nothing_where_rates_are_asked_for() -> None:
    costly = tx.System(rates={mass: -mass}, outputs={"y": tx.Sin(tx.Cos(tx.Exp(mass)))})
    dynamics = tx.compile(costly)
    jaxpr = jax.make_jaxpr(lambda x: dynamics.functions.vector_field(jnp.zeros(()), {"mass": x}, {}, {}))(1.0)
    assert [e.primitive.name for e in jaxpr.jaxpr.eqns] == ["neg"]


def test_explain() -> None:
    explanation = DYNAMICS.explain()
    assert explanation.leaves["states"] == ["V", "g", "mass", "grid", "a"]
    assert explanation.unused == [
        "Control 'spare' is not used by any rate",
        "Parameter 'idle' is not used: nothing depends on it",
    ]
    lines = str(explanation).splitlines()
    assert set(explanation.unused) <= set(lines)
    assert any(line.startswith("equations of the rates: ") for line in lines)
    assert explanation.as_dict()["unused"] == explanation.unused
    baked = tx.compile(SYSTEM, bake={"M": INERTIA}).explain()
    assert "baked in: M" in str(baked)
    assert "M" not in baked.leaves["parameters"]


def test_explain_counts_what_simplification_saves() -> None:
    y = tx.State("y")
    wasteful = (y + 0.0) * 1.0 + tx.Sin(y) - tx.Sin(y)
    explanation = tx.compile(tx.System(rates={y: wasteful})).explain()
    before, after = explanation.equations
    assert before == 5
    assert after < before
    assert explanation.nodes[0] > explanation.nodes[1]
    # A tree that shares its parts again and again stands for more nodes than a float can hold.
    assert "7.6e+2508 as written" in str(dataclasses.replace(explanation, nodes=(76 * 10**2507, 5)))


# ---- parameters ----------------------------------------------------------------------------------------------------


def traces_of(dynamics: tx.Dynamics) -> list[str]:
    """Every family traced from now on."""
    seen: list[str] = []
    evaluate = dynamics.functions.evaluate

    def counted(family: str, *arguments: Any) -> Any:
        seen.append(family)
        return evaluate(family, *arguments)

    dynamics.functions.jitted = jax.jit(counted, static_argnums=0)
    return seen


def test_new_values_never_trace_again() -> None:
    dynamics = tx.compile(SYSTEM)
    seen = traces_of(dynamics)
    first = dynamics(0.0, POINT, CONTROLS)
    calls = [
        (1.0, POINT, CONTROLS, None),
        (2, POINT, CONTROLS, {}),
        (np.float64(0.5), POINT | {"mass": np.float64(2.0)}, {"F": [0.0] * 6}, {"k": 1.0}),
        (jnp.zeros(()), POINT | {"mass": jnp.ones(())}, CONTROLS, {"k": 2, "M": 2.0 * INERTIA}),
        (0.0, {name: jnp.asarray(value) for name, value in reversed(POINT.items())}, CONTROLS, {"M": INERTIA}),
    ]
    for arguments in calls:
        found = dynamics(*arguments)
    assert seen == ["rates"]
    np.testing.assert_array_equal(found["V"], first["V"])
    dynamics(0.0, jax.tree.map(np.float32, POINT), CONTROLS)
    assert seen == ["rates", "rates"], "another precision is another program"


def test_parameters_are_inputs_and_have_defaults() -> None:
    heavier = DYNAMICS(0.0, POINT, CONTROLS, {"M": 2.0 * INERTIA, "k": 1.0})
    still = POINT | {"V": np.zeros(6)}
    once, twice = (DYNAMICS(0.0, still, CONTROLS, {"M": s * INERTIA})["V"] for s in (1.0, 2.0))
    np.testing.assert_allclose(once, 2.0 * twice, rtol=1e-14)
    assert float(heavier["mass"]) == 2.0 * float(DYNAMICS(0.0, POINT, CONTROLS)["mass"])


def test_baked_parameters_are_code() -> None:
    baked = tx.compile(SYSTEM, bake={"M": 2.0 * INERTIA})
    wanted = DYNAMICS(0.0, POINT, CONTROLS, {"M": 2.0 * INERTIA})
    found = baked(0.0, POINT, CONTROLS)
    for name in wanted:
        np.testing.assert_allclose(found[name], wanted[name], rtol=1e-14)
    assert [p.name for p in baked.parameters] == ["k", "idle"]
    with pytest.raises(tx.InputError, match=r"unknown key 'M' in params; expected: 'k', 'idle'"):
        baked(0.0, POINT, CONTROLS, {"M": INERTIA})
    assert [p.name for p in SYSTEM.parameters] == ["M", "k", "idle"], "the system stays as it is"


def test_a_traced_value_is_not_baked() -> None:
    with pytest.raises(tx.ModelError, match=r"bake\['M'\] is traced"):
        jax.jit(lambda M: tx.compile(SYSTEM, bake={"M": M})(0.0, POINT, CONTROLS))(INERTIA)


def test_a_jacobian_by_one_kind_alone() -> None:
    dynamics = tx.compile(SYSTEM, bake={"M": INERTIA})  # as a parameter its 36 columns take long
    one = dynamics.jacobian(0.0, POINT, CONTROLS, wrt="params")
    np.testing.assert_array_equal(one["params"], dynamics.jacobian(0.0, POINT, CONTROLS, wrt=["params"])["params"])


def test_a_parameter_is_baked_into_the_body_of_a_vmap() -> None:
    points = np.array([1.0, 2.0, 3.0])
    system = tx.System(rates={mass: tx.linalg.Sum(tx.Vmap(lambda z: k * z * mass, points))})
    assert float(tx.compile(system, bake={"k": 2.0})(0.0, {"mass": 1.0})["mass"]) == 12.0


# ---- precision -----------------------------------------------------------------------------------------------------


def test_single_precision_in_single_precision_out() -> None:
    x = jax.tree.map(np.float32, POINT)
    double = {"M": INERTIA, "k": np.float64(0.5)}
    for found in (
        DYNAMICS(np.float64(0.0), x, CONTROLS, double),
        DYNAMICS(0.0, x, CONTROLS),
        DYNAMICS.outputs(0.0, x, {"spare": np.float64(1.0)}),
        DYNAMICS.constraints(0.0, x, CONTROLS),
        DYNAMICS.retract(x, np.zeros(20)),
        DYNAMICS.difference(x, POINT),
    ):
        assert {value.dtype for value in jax.tree.leaves(found)} == {np.dtype(np.float32)}
    assert {v.dtype for v in DYNAMICS(0.0, POINT, jax.tree.map(np.float32, CONTROLS)).values()} == {
        np.dtype(np.float64)
    }


def test_states_as_plain_numbers_and_lists() -> None:
    plain = {name: np.asarray(value).tolist() for name, value in POINT.items()}
    wanted = DYNAMICS(0.0, POINT, CONTROLS)
    found = DYNAMICS(0, plain, {"F": list(range(6))})
    for name in wanted:
        assert found[name].dtype == np.float64
        np.testing.assert_array_equal(found[name], wanted[name])


def test_names_of_leaves_never_meet_those_of_time_and_constants() -> None:
    """A control called t, read by an output only, is not asked for where the rate reads the time."""
    odd, other = tx.Control("t"), tx.Control("constant")
    dynamics = tx.compile(tx.System(rates={mass: 2.0 * tx.Time()}, outputs={"y": odd * other}))
    assert float(dynamics(3.0, {"mass": 0.0})["mass"]) == 6.0
    assert dynamics.explain().unused == [
        "Control 't' is not used by any rate",
        "Control 'constant' is not used by any rate",
    ]


# ---- transformations -----------------------------------------------------------------------------------------------


def test_calls_may_be_transformed() -> None:
    """jacfwd = jacrev; vmap = loop; a call inside of a scan = calls one by one."""
    x = {name: jnp.asarray(value, float) for name, value in POINT.items()}

    def rate(V: jax.Array) -> jax.Array:
        return DYNAMICS(0.0, x | {"V": V}, CONTROLS)["V"]

    def step(V: jax.Array, _: None) -> tuple[jax.Array, None]:
        return V + 0.1 * rate(V), None

    def everything(V: jax.Array) -> dict[str, jax.Array]:
        return {
            "forward": jax.jacfwd(rate)(V),
            "reverse": jax.jacrev(rate)(V),
            "batch": jax.vmap(rate)(jnp.stack([V, 2.0 * V])),
            "scan": jax.lax.scan(step, V, None, length=2)[0],
            "hessian": jax.hessian(lambda V: jnp.sum(rate(V)))(V),
        }

    found = jax.jit(everything)(x["V"])
    np.testing.assert_allclose(found["forward"], found["reverse"], rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(found["batch"], [rate(x["V"]), rate(2.0 * x["V"])], rtol=1e-13)
    np.testing.assert_allclose(found["scan"], step(step(x["V"], None)[0], None)[0], rtol=1e-13)
    np.testing.assert_allclose(found["hessian"], found["hessian"].T, rtol=1e-13, atol=1e-14)


def test_calls_are_pure() -> None:
    before = copy.deepcopy(POINT)
    first = DYNAMICS(0.0, POINT, CONTROLS)
    DYNAMICS(5.0, jax.tree.map(lambda value: 2.0 * np.asarray(value), POINT), {"F": np.zeros(6)}, {"k": 9.0})
    second = DYNAMICS(0.0, POINT, CONTROLS)
    for name in first:
        np.testing.assert_array_equal(first[name], second[name])
        np.testing.assert_array_equal(POINT[name], before[name])


def test_the_same_tree_compiles_to_the_same_program() -> None:
    def text(dynamics: tx.Dynamics) -> str:
        inputs = dynamics.functions.prepare(0.0, POINT, CONTROLS)
        return str(
            jax.make_jaxpr(dynamics.functions.vector_field)(
                inputs.t, dict(inputs.x), dict(inputs.u), dict(inputs.params)
            )
        )

    assert text(tx.compile(SYSTEM)) == text(DYNAMICS)


# ---- the tangent space of a state ----------------------------------------------------------------------------------


def test_slices_follow_the_declaration() -> None:
    assert list(DYNAMICS.group.slices.items()) == [
        ("V", slice(0, 6)),
        ("g", slice(6, 12)),
        ("mass", slice(12, 13)),
        ("grid", slice(13, 17)),
        ("a", slice(17, 20)),
    ]
    assert DYNAMICS.dimension == 20


def test_retract_moves_every_state_by_its_own_exponential() -> None:
    d = np.random.default_rng(1).normal(size=20)
    found = DYNAMICS.retract(POINT, d)
    np.testing.assert_allclose(found["V"], POINT["V"] + d[:6], rtol=1e-15)
    np.testing.assert_allclose(found["g"], POSE @ expm(hat(d[6:12])), rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(found["mass"], 4.0 + d[12], rtol=1e-15)
    np.testing.assert_allclose(found["grid"], POINT["grid"] + d[13:17].reshape(2, 2), rtol=1e-15)
    np.testing.assert_allclose(found["a"], POSE[:3, :3] @ expm(hat(np.r_[np.zeros(3), d[17:]]))[:3, :3], rtol=1e-13)


def test_difference_undoes_retract() -> None:
    d = np.random.default_rng(2).uniform(-1.0, 1.0, size=20)
    moved = DYNAMICS.retract(POINT, d)
    np.testing.assert_allclose(DYNAMICS.difference(POINT, moved), d, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(DYNAMICS.difference(moved, POINT)[:6], -d[:6], rtol=1e-12)
    with pytest.raises(tx.ShapeError, match=r"\(20,\), got \(19,\)"):
        DYNAMICS.retract(POINT, d[:-1])
    with pytest.raises(tx.InputError, match="State 'V' is missing"):
        DYNAMICS.difference(POINT, {"g": POSE})


def test_an_angular_first_pose_has_angular_first_tangents() -> None:
    h = tx.State("h", group=tx.SE3, order=tx.ANGULAR_FIRST)
    dynamics = tx.compile(tx.System(rates={h: np.zeros(6)}))
    d = np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0])
    wanted = POSE @ expm(hat(np.r_[d[3:], d[:3]]))
    np.testing.assert_allclose(dynamics.retract({"h": POSE}, d)["h"], wanted, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(dynamics.difference({"h": POSE}, {"h": wanted}), d, rtol=1e-12)


def test_explain_counts_scalars_and_shows_the_pattern() -> None:
    p, v, m = tx.State("p", shape=(3,)), tx.State("v", shape=(3,)), tx.State("m")
    F, c = tx.Control("F", shape=(3,)), tx.Parameter("c", value=0.5)
    system = tx.System(
        rates={p: v, v: np.diag([1.0, 0.0, 0.0]) @ F / m - c * v, m: tx.Constant(-2.0)},
        outputs={"power": tx.linalg.Dot(F, v)},
    )
    explanation = tx.compile(system).explain()
    # F[0] / m - c v[0], -c v[1], -c v[2]: one division, three products, one difference, two signs.
    assert explanation.operations[1] == {"div": 1, "mul": 3, "neg": 2, "sub": 1}
    assert sum(explanation.operations[0].values()) > sum(explanation.operations[1].values())
    assert explanation.constants == {"m": -2.0}
    expected = np.zeros((7, 10), bool)
    expected[[0, 1, 2], [3, 4, 5]] = True
    expected[[3, 4, 5, 3, 3], [3, 4, 5, 6, 7]] = True
    np.testing.assert_array_equal(np.hstack([explanation.patterns["x"], explanation.patterns["u"]]), expected)
    assert explanation.picture().splitlines()[3] == "|...#..#|#..|"
    assert "runs as arrays: fewer than 500" in str(explanation)
    assert explanation.as_dict()["patterns"]["params"] == [[False]] * 3 + [[True]] * 3 + [[False]]


def test_explain_of_one_entry() -> None:
    p, v = tx.State("p", shape=(2,)), tx.State("v", shape=(2,))
    k = tx.Parameter("k", shape=(2, 2), value=np.eye(2))
    system = tx.System(rates={p: v, v: -k @ p}, outputs={"speed": tx.linalg.Norm(v)})
    dynamics = tx.compile(system)
    found = dynamics.explain("v[1]")
    assert found.reads == ["p[0]", "p[1]", "k[1, 0]", "k[1, 1]"]
    assert "v[1] depends on: p[0], p[1], k[1, 0], k[1, 1]" in str(found)
    assert dynamics.explain("p").reads == ["v[0]", "v[1]"]
    assert dynamics.explain("speed").reads == ["v[0]", "v[1]"]
    baked = tx.compile(system, bake={"k": np.diag([1.0, 0.0])})
    assert baked.explain("v[1]").value == 0.0
    assert str(baked.explain("v[1]")) == "v[1] is 0 always"
    for wrong in ("w", "v[2]", "v[1"):
        with pytest.raises(tx.InputError, match=r"explain expects|no entry"):
            dynamics.explain(wrong)
