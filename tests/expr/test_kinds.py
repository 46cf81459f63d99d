"""Kinds, frames and units: wrong models are refused with both places named, right ones are accepted and unchanged."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import twistax as tx

lie, solve, cross = tx.lie, tx.linalg.Solve, tx.linalg.Cross
vector, K = tx.FreeVector, tx.kinds

g = tx.State("g", group=tx.SE3, kind=K.Pose("world", "body"))
V = tx.State("V", shape=(6,), kind=tx.Twist("body", of="craft", relative_to="world"))
h = tx.State("h", shape=(6,), kind=tx.Momentum("body"))
M = tx.Parameter("M", value=np.diag([2.0, 2.0, 2.0, 0.1, 0.2, 0.3]), kind=K.Inertia("body"))
W = tx.Control("W", shape=(6,), kind=tx.Wrench("body"))
far = tx.Control("far", shape=(6,), kind=tx.Wrench("world"))
push = tx.Control("push", shape=(3,), kind=vector("world"), unit="N")
R = tx.State("R", group=tx.SO3, kind=K.Rotation("world", "body"))
q = tx.State("q", shape=(4,), kind=K.Rotation("world", "body"))
w = tx.State("w", shape=(3,), kind=vector("body"), unit="rad/s")
p = tx.State("p", shape=(3,), kind=tx.Point("world"))
v = tx.State("v", shape=(3,), kind=vector("world"), unit=tx.units.metres / tx.units.seconds)
J = tx.Parameter("J", value=np.diag([0.1, 0.2, 0.3]), kind=K.Inertia("body"))
torque = tx.Control("torque", shape=(3,), kind=vector("body"), unit="N m")
mass = tx.Parameter("mass", value=2.0, unit="kg")
x, speed = tx.State("x", unit="m"), tx.State("speed", unit="m/s")
angle = tx.State("angle", unit="rad")
k = tx.Parameter("k", value=3.0, unit="N/m")

MASSES = tx.Parameter("masses", value=[1.0, 2.0], unit="kg")

ZERO = np.zeros(3)
BODY = lie.AdjointDual(V, M @ V)


def rates(*pairs: tuple[tx.State, Any], **outputs: Any) -> Callable[[], tx.System]:
    return lambda: tx.System(rates=dict(pairs), outputs=outputs)


RIGHT = {
    g: V,
    V: solve(M, W + lie.SE3AdjointDual(lie.Inverse(g)) @ far - BODY),
    h: W - lie.AdjointDual(solve(M, h), h),
    R: w,
    q: tx.spatial.SSMP(w) @ q / 2,
    w: solve(J, torque - cross(w, J @ w)),
    p: v,
    v: push / mass + [0.0, 0.0, -9.81],
    x: speed,
    speed: -k * x / mass,
    angle: speed / x,
}


def outputs(**named: Any) -> Callable[[], tx.System]:
    return lambda: tx.System(rates=RIGHT, outputs=named)


WRONG: dict[str, tuple[Callable[[], tx.System], str, str]] = {
    "a force meant in world axes": (
        rates((g, V), (V, solve(M, lie.wrench(force=push, torque=ZERO) - BODY))),
        "two frames are combined: ",
        "tx.lie.Inverse(g[:3, :3]) @ push",
    ),
    "a wrench of the world": (rates((g, V), (V, solve(M, far - BODY))), "two frames", "tx.lie.SE3AdjointDual"),
    "a twist in place of a momentum": (
        rates((g, V), (V, solve(M, W - lie.AdjointDual(V, V)))),
        "a twist is combined with a wrench",
        "M @ V",
    ),
    "a wrench as the rate of a twist": (rates((g, V), (V, W)), "a twist is combined", "Solve(M, F)"),
    "a wrench carried as a twist": (
        rates((g, V), (V, solve(M, lie.SE3Adjoint(lie.Inverse(g)) @ far - BODY))),
        "a twist is combined",
        "SE3AdjointDual",
    ),
    "the pose the wrong way": (
        rates((g, V), (V, solve(M, lie.SE3AdjointDual(g) @ far - BODY))),
        "two frames",
        "tx.lie.Inverse(g)",
    ),
    "halves of a twist in two frames": (outputs(y=M @ np.concatenate([v, w])), "two frames", "is in 'body'"),
    "a power of two twists": (
        rates((g, V), (V, solve(M, W)), y=tx.linalg.Dot(V, M @ V + V)),
        "a twist is combined",
        "power",
    ),
    "a torque of the world": (rates((R, w), (w, solve(J, R @ w))), "two frames", "R maps 'body' to 'world'"),
    "a quaternion the wrong way": (
        rates((q, tx.spatial.SSMP(w) @ q / 2), (w, solve(J, tx.spatial.QDCM(q) @ torque))),
        "two frames",
        "QDCM(q)",
    ),
    "a column of the wrong axes": (outputs(y=R[0, :] * angle + R[:, 0]), "two frames", "maps 'body' to 'world'"),
    "metres and kilograms": (rates((x, x + mass)), "Add has one unit, got m and kg", "divide by"),
    "a rate without a second": (rates((x, x)), "the rate of 'x' in m is in m/s, got m", "divide by"),
    "a sine of metres": (outputs(y=tx.Sin(x)), "Sin expects radians", "divide by"),
    "an exponent of metres": (outputs(y=tx.Exp(-x)), "Exp expects", "divide by"),
    "a mass forgotten": (rates((x, speed), (speed, -k * x)), "the rate of 'speed' in m/s is in m/s2", "kg"),
    "an angle of a speed and a length": (outputs(y=tx.Atan2(x, speed)), "Atan2 expects operands of one unit", "s"),
    "a choice between units": (outputs(y=tx.Where(x <= 2.0, x, speed)), "Where has one unit", "s"),
    "a comparison": (outputs(y=tx.Where(x <= speed, x, x)), "Inequality has one unit", "s"),
    "a point moved by a speed": (outputs(y=lie.Act(g, R.T @ v)), "a pose transforms points", "divide"),
    "parts that make no six-vector": (outputs(y=lie.wrench(force=push, torque=R @ w)), "a six-vector is", "divide"),
    "a branch": (outputs(y=tx.Cond(x <= 2.0, v, R.T @ v)), "two frames", "maps 'body' to 'world'"),
    "the body of a map": (
        outputs(y=tx.Vmap(lambda s: s * (v + R.T @ v), np.arange(3.0))),
        "two frames",
        "maps 'body' to 'world'",
    ),
    "a scalar added to a vector": (outputs(y=v + speed), "a scalar is added to each entry", "a direction"),
    "a scalar taken off a vector": (outputs(y=w - speed / x), "a scalar is added to each entry", "a direction"),
    "a pose times a length": (outputs(y=(x * g)[:3, :3]), "a pose has no single unit", "divide by"),
    "a table of another unit": (outputs(y=x + tx.Linterp(angle, [0.0, 1.0], MASSES)), "Add has one unit", "kg"),
    "a table at another unit": (outputs(y=tx.Linterp(angle, MASSES, [0.0, 1.0])), "Linterp has one unit along", "kg"),
    "a quantity": (outputs(y=x + 3.0 * tx.units.seconds), "Add has one unit, got m and s", "divide"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_model_is_refused_with_its_place_and_the_way_out(what: str) -> None:
    build, first, fix = WRONG[what]
    with pytest.raises(tx.KindError) as caught:
        build()
    lines = str(caught.value).splitlines()
    assert lines[0].startswith(first), lines
    assert lines[1].startswith("  where: "), lines
    assert fix in lines[-1], lines
    assert lines[-1].startswith("  fix: ")


SOUND: dict[str, dict[str, Any]] = {
    "nothing else": {},
    "a position of a body": {"y": p - g[:3, 3], "z": lie.Act(lie.Inverse(g), p)},
    "a power": {"y": tx.linalg.Dot(V, W), "z": V @ (M @ V) / 2 / tx.Time()},
    "the length of a six-vector": {"y": tx.linalg.Dot(V, V), "z": W @ W, "n": tx.linalg.Norm(W)},
    "parts": {"y": lie.linear(V) + R.T @ v, "z": lie.angular(W) + torque, "f": lie.linear(far) - push},
    "a constant in two frames": {"y": v + np.ones(3), "z": w + np.ones(3)},
    "plain numbers": {"y": x + 1.0, "z": tx.Sin(2 * angle + 0.3), "a": tx.Max(x, 0.0), "b": 0.5 * x - speed},
    "a sine of time": {"y": tx.Sin(tx.Time()) + 0.5 * angle},
    "powers": {"y": tx.Sqrt(x**2 + tx.Square(x)) + x, "z": x**3 / (x * x) - x},
    "a logarithm of a pose": {"y": lie.SE3Log(g), "z": lie.SE3Exp(V * tx.Time())},
    "branches": {"y": tx.Cond(x <= 2.0, v, R @ (R.T @ v)), "z": tx.Where(x <= 1.0, x, 2 * x)},
    "tables": {"y": tx.Linterp(x, [0.0, 1.0], [0.0, 3.0]) + speed},
    "a rate": {"y": tx.Rate(p, {p: v}) + v},
    "two maps": {
        "y": tx.Vmap(lambda e: e + v, np.ones((2, 3))),
        "z": tx.Vmap(lambda e: e + w, np.ones((2, 3))),
    },
    "a vector within limits": {"y": tx.Max(v, -1.0 * speed), "z": v + 1.0},
    "a map": {"y": tx.Vmap(lambda s: s * (v + v), np.arange(3.0))},
    "vectors in two frames as features": {
        "y": np.concatenate([p, w]),
        "z": tx.Function(lambda a: 2.0 * a, (3,), name="net")(np.concatenate([p, w])[:3]),
    },
    "columns and rows": {"y": v + v @ R[:, 2] * R[:, 2], "z": w * R[2, :]},
    "an inertia carried": {
        "y": far + lie.SE3AdjointDual(g) @ M @ lie.SE3Adjoint(lie.Inverse(g)) @ (lie.SE3Adjoint(g) @ V) / tx.Time()
    },
}


@pytest.mark.parametrize("what", SOUND)
def test_a_right_model_is_accepted(what: str) -> None:
    assert isinstance(outputs(**SOUND[what])(), tx.System)


def test_nothing_declared_nothing_checked() -> None:
    pose, twist, height = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,)), tx.State("h")
    tx.System(rates={pose: twist, twist: -lie.AdjointDual(twist, twist), height: height + tx.Parameter("m", value=2.0)})


def test_what_a_leaf_leaves_open_is_inferred() -> None:
    open_force = tx.Control("F", shape=(6,))
    system = tx.System(rates={g: V, V: solve(M, open_force - BODY)})
    known = tx.compile(system).explain(kinds=True)
    assert known.leaves["V"] == "a twist, in 'body', unit 1/s"
    assert known.leaves["F"] == "a wrench or momentum, in 'body', unit open"
    assert known.leaves["g"] == "from 'body' to 'world'"
    assert known.rates["V"] == "a twist, in 'body', unit 1/s2"
    assert known.declared == ["g", "V", "M"]
    assert known.open == []
    lines = str(known).splitlines()
    assert lines[lines.index("states") + 2] == "  V  a twist, in 'body', unit 1/s  (declared)"
    assert lines[lines.index("controls") + 1] == "  F  a wrench or momentum, in 'body', unit open"
    with pytest.raises(tx.KindError, match="two frames are combined"):
        tx.System(rates={g: V, V: solve(M, open_force - BODY)}, outputs={"y": open_force + far})


def test_a_kind_is_for_a_shape_and_a_unit_is_si() -> None:
    with pytest.raises(tx.ModelError, match=r"Twist is for shape \(6,\), got \(3,\)"):
        tx.State("V", shape=(3,), kind=tx.Twist("body"))
    with pytest.raises(tx.ModelError, match=r"'T' is on SE\(?3\)?, got kind=Rotation"):
        tx.State("T", group=tx.SE3, kind=tx.kinds.Rotation("world", "body"))
    with pytest.raises(tx.ModelError, match="'furlong' is none of"):
        tx.State("h", unit="furlong")
    with pytest.raises(tx.ModelError, match="use an SI unit"):
        tx.State("h", unit=tx.units.feet)


def test_values_have_the_unit_of_their_leaf() -> None:
    m, kg = tx.units.metres, tx.units.kilograms
    tx.State("h", unit="m", min=0.0, max=3.0 * tx.units.feet)
    tx.State("V", shape=(6,), kind=tx.Twist("body"), scale=2.0 * m / tx.units.seconds)
    for build in (
        lambda: tx.State("h", unit="m", max=3.0 * kg),
        lambda: tx.State("p", shape=(3,), kind=tx.Point("world"), initial=[1.0 * m, 2.0 * m, 3.0 * kg]),
        lambda: tx.Control("u", unit="m", scale=3.0 * kg),
        lambda: tx.Parameter("k", value=3.0 * kg, unit="m"),
        lambda: tx.Constant(3.0 * kg, unit="m"),
    ):
        with pytest.raises(tx.ModelError, match=r"is declared in m, but .*= is in kg"):
            build()


def test_programs_are_the_same_with_and_without_kinds() -> None:
    """The keys, and so the compiled programs, do not depend on what leaves declare."""

    def body(**said: Any) -> tx.System:
        pose = tx.State("g", group=tx.SE3, **({"kind": said["g"]} if said else {}))
        twist = tx.State("V", shape=(6,), **({"kind": said["V"]} if said else {}))
        force = tx.Control("W", shape=(6,), **({"kind": said["W"]} if said else {}))
        inertia = tx.Parameter("M", value=np.diag([2.0] * 3 + [0.1] * 3), **({"kind": said["M"]} if said else {}))
        return tx.System(
            rates={pose: twist, twist: solve(inertia, force - lie.AdjointDual(twist, inertia @ twist))},
            outputs={"z": 2 * pose[2, 3] + lie.linear(twist)[2] * tx.Time()},
        )

    kinds = {"g": g.kind, "V": V.kind, "W": W.kind, "M": M.kind}
    plain, typed = body(), body(**kinds)
    for family in ("rates", "outputs"):
        one, other = getattr(plain, family), getattr(typed, family)
        assert {n: e.key() for n, e in one.items()} == {n: e.key() for n, e in other.items()}
        simple = [{n: e.canonicalize().key() for n, e in exprs.items()} for exprs in (one, other)]
        assert simple[0] == simple[1]
    counts = [tx.compile(system).explain().operations for system in (plain, typed)]
    assert counts[0] == counts[1]


def test_a_changed_copy_and_a_pickle_keep_the_kind() -> None:
    import pickle

    for leaf in (V.replace(name="other"), pickle.loads(pickle.dumps(V))):
        assert leaf.kind == V.kind
        assert leaf.unit == V.unit


def test_one_leaf_of_a_name_may_leave_its_kind_open_and_two_kinds_are_refused() -> None:
    typed = tx.State("V", shape=(6,), kind=tx.Twist("body"))
    plain, other = tx.State("V", shape=(6,)), tx.State("V", shape=(6,), kind=tx.Wrench("body"))
    for state, used in ((typed, plain), (plain, typed)):
        tx.System(rates={state: -1.0 * state}, outputs={"y": used})
        with pytest.raises(tx.KindError, match="a twist is combined"):
            tx.System(rates={state: -1.0 * state}, outputs={"y": used + W}, controls=[W])
    with pytest.raises(tx.ModelError, match=r"two leaves are named 'V'.*differ in kind"):
        tx.System(rates={typed: -1.0 * typed}, outputs={"y": other})


def test_what_is_open_is_told() -> None:
    x, y, u = tx.State("x", unit="m"), tx.State("y"), tx.Control("u")
    known = tx.compile(tx.System(rates={x: 2.0 * x, y: u}, outputs={"z": x + 0.5})).explain(kinds=True)
    assert known.open == ["y", "u", "rate of x", "rate of y"]
    assert str(known).endswith("nothing is known of: y, u, rate of x, rate of y")


def craft() -> tx.System:
    """A body in space, its wrench in its frame."""
    M = np.diag([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
    body = tx.Control("F", (6,), kind=tx.Wrench("body"))
    rate = tx.linalg.Solve(M, body - tx.lie.AdjointDual(V, M @ V))
    outputs = {"v": tx.lie.linear(V), "p": K.declare(g[:3, 3], tx.Point("world"))}
    return tx.System(rates={g: V, V: rate}, outputs=outputs)


@pytest.mark.parametrize("count", [1, 3, 4, 5, 6])
def test_fleets_have_the_kinds_of_one_copy(count: int) -> None:
    """What is connected to all copies, or to one of them, is checked as for one."""
    fleet = tx.repeat(craft(), count)

    def joined(kind: Any) -> tx.System:
        return tx.join(fleet, connect={fleet.F: tx.Control("W", (count, 6), kind=kind)})

    joined(tx.Wrench("body"))
    for wrong in (tx.Wrench("world"), tx.Twist("body")):
        with pytest.raises(tx.KindError, match=r"'W'|W takes|W is"):
            joined(wrong)
    along = tx.Control("along", (3,), kind=vector("world"))
    tx.join(fleet, outputs={"right": fleet.output("p")[0] @ along})
    with pytest.raises(tx.KindError, match="two frames are combined"):
        tx.join(fleet, outputs={"wrong": fleet.output("v")[0] @ along})


def test_copies_under_other_names_keep_what_expressions_declare() -> None:
    left = craft().renamed("left_")
    along = tx.Control("along", (3,), kind=vector("body"))
    with pytest.raises(tx.KindError, match="two frames are combined"):
        tx.join(left, outputs={"wrong": left.output("left_p") @ along})
    assert "in 'world'" in str(tx.compile(left).explain(kinds=True)).split("left_p")[1]


def test_a_map_with_other_batches_is_no_false_alarm() -> None:
    """The body of one map, once over points in the world and once over points of the body."""
    world, body = (tx.Parameter(name, (5, 3), kind=vector(name)) for name in ("world", "body"))
    squares = tx.Vmap(lambda p: p @ p, world)
    tx.System(rates={p: v, v: -1.0 * v}, outputs={"a": squares, "b": squares.with_children([body])})
    back = tx.Vmap(lambda p: -p, world)
    sums = {"c": back + world, "d": back.with_children([body]) + body}
    tx.System(rates={p: v, v: -1.0 * v}, outputs=sums)
    alike = back.with_children([tx.Parameter("other", (5, 3), kind=vector("world"))])
    with pytest.raises(tx.KindError, match="two frames are combined"):
        tx.System(rates={p: v, v: -1.0 * v}, outputs=sums | {"wrong": alike + body})
