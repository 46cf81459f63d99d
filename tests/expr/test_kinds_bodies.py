"""Which body a twist is of, which it is relative to, and on which a wrench acts: sums and rates are held to it."""

from typing import Any

import numpy as np
import pytest

import twistax as tx

lie, solve, K = tx.lie, tx.linalg.Solve, tx.kinds


def twist(name: str, frame: str, of: str = "", relative_to: str = "") -> tx.State:
    return tx.State(name, (6,), kind=tx.Twist(frame, of=of, relative_to=relative_to))


def wrench(name: str, frame: str, on: str) -> tx.Control:
    return tx.Control(name, (6,), kind=tx.Wrench(frame, on=on))


def pose(name: str, to: str, source: str) -> tx.State:
    return tx.State(name, group=tx.SE3, kind=K.Pose(to, source))


ga, gb, T = pose("ga", "world", "a"), pose("gb", "world", "b"), pose("T", "a", "b")
Va, Vb, rel = twist("Va", "a", "a", "world"), twist("Vb", "b", "b", "world"), twist("rel", "b", "b", "a")
Wa, Wb = wrench("Wa", "a", "a"), wrench("Wb", "b", "b")
Ma, Mb = (tx.Parameter(f"M{n}", value=np.diag([2.0] * 3 + [0.3] * 3), kind=K.Inertia(n)) for n in "ab")
IN_B = lie.SE3Adjoint(lie.Inverse(T)) @ Va
GRIP = lie.SE3AdjointDual(T) @ Wb

RIGHT: dict[str, dict[tx.State, Any]] = {
    "each in the world": {ga: Va, gb: Vb},
    "one relative to the other": {ga: Va, T: rel},
    "a difference": {T: Vb - IN_B},
    "a sum in any order": {T: rel + IN_B - IN_B, gb: rel - (-IN_B)},
    "three bodies": {gb: lie.SE3Adjoint(lie.Inverse(T)) @ Va + rel},
    "a reaction": {Va: solve(Ma, Wa - GRIP - lie.AdjointDual(Va, Ma @ Va))},
    "a mean of two": {Va: solve(Ma, 0.5 * Wa), ga: (Va + Va) / 2},
    "halves": {ga: lie.twist(linear=lie.linear(Va) + lie.linear(Va), angular=lie.angular(Va))},
    "columns": {ga: lie.AdjointAction(lie.Inverse(T), rel, inverse=True) + Va - lie.SE3Adjoint(T) @ rel},
}


@pytest.mark.parametrize("what", RIGHT)
def test_right_sums_are_accepted(what: str) -> None:
    further = {state: -1.0 * state for state in (Va, Vb, rel) if state not in RIGHT[what]}
    more = {state: rate for state, rate in {T: Vb - IN_B, ga: Va}.items() if state not in RIGHT[what]}
    assert isinstance(tx.System(rates={**RIGHT[what], **further, **more}), tx.System)


WRONG: dict[str, tuple[dict[tx.State, Any], str]] = {
    "a sum for a difference": ({T: Vb + IN_B}, "twists do not add up to one of a body"),
    "backwards": ({T: rel + IN_B - Vb - IN_B}, "fixed to two bodies"),
    "the other body": ({gb: Vb, T: rel, Vb: solve(Mb, lie.SE3AdjointDual(lie.Inverse(T)) @ Wa)}, "another body"),
    "wrenches on two bodies": ({Va: solve(Ma, Wa + GRIP)}, "wrenches on two bodies are added"),
    "the twist of another body": (
        {ga: lie.SE3Adjoint(T) @ Vb, gb: lie.SE3Adjoint(lie.Inverse(T)) @ Va},
        "fixed to two",
    ),
    "relative for absolute": ({gb: rel, T: rel}, "fixed to two bodies"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_sums_are_refused(what: str) -> None:
    rates, message = WRONG[what]
    further = {state: -1.0 * state for state in (Va, Vb, rel) if state not in rates}
    more = {state: rate for state, rate in {T: rel, ga: Va}.items() if state not in rates}
    with pytest.raises(tx.KindError, match=message) as caught:
        tx.System(rates={**rates, **further, **more})
    lines = str(caught.value).splitlines()
    assert [line.split(":")[0].strip() for line in lines[1:3]] == ["where", "at"]
    assert lines[-1].startswith("  fix: ")


def test_a_frame_may_have_another_name_than_its_body() -> None:
    g, V = pose("g", "world", "body"), twist("V", "body", "craft", "world")
    tx.System(rates={g: V, V: -1.0 * V})
    other, h = twist("other", "body", "tug", "world"), pose("h", "world", "body")
    with pytest.raises(tx.KindError, match="'body' is fixed to two bodies"):
        tx.System(rates={g: V, h: other, V: -1.0 * V, other: -1.0 * other})


def test_what_names_no_bodies_is_not_checked() -> None:
    plain, partly = twist("plain", "b"), twist("partly", "b", of="b")
    tx.System(rates={T: rel + plain, plain: -1.0 * plain, rel: -1.0 * rel})
    tx.System(rates={T: rel + partly - Vb, partly: -1.0 * partly, rel: -1.0 * rel, Vb: -1.0 * Vb})


def _copies(**options: Any) -> tuple[tx.System, tx.System]:
    """Two of one craft, whose output is declared in its frame."""
    g, V, F = pose("g", "world", "body"), twist("V", "body", "craft", "world"), wrench("F", "body", "craft")
    M = tx.Parameter("M", value=np.diag([2.0] * 3 + [0.3] * 3), kind=K.Inertia("body"))
    outputs = {
        "p": K.declare(g[:3, 3], tx.Point("world")),
        "nose": K.declare(np.array([0.2, 0.0, 0.0]), tx.Point("body")),
        "speed": K.declare(lie.linear(V) * 1.0, tx.FreeVector("body"), "m/s"),
    }
    craft = tx.System(rates={g: V, V: solve(M, F - lie.AdjointDual(V, M @ V))}, outputs=outputs)
    return craft.renamed("left_", **options), craft.renamed("right_", **options)


def test_copies_under_other_names_are_other_bodies() -> None:
    left, right = _copies()
    between = lie.Compose(lie.Inverse(left.left_g), right.right_g)
    carried = lie.SE3Adjoint(lie.Inverse(between)) @ left.left_V
    tip = lie.Act(left.left_g, left.output("left_nose"))
    rightly = {
        "gap": right.output("right_p") - tip,
        "closing": right.right_V - carried,
        "reaction": left.left_F - lie.SE3AdjointDual(between) @ right.right_F,
    }
    tx.join(left, right, outputs=rightly)
    wrong = {
        "frames are combined: 'left_body' and 'right_body'": right.right_V - left.left_V,
        "two frames are combined": right.output("right_speed") - left.output("left_speed"),
        "frames are combined": lie.Act(right.right_g, left.output("left_nose")),
        "twists do not add up": right.right_V + carried,
        "wrenches on two bodies": left.left_F + lie.SE3AdjointDual(between) @ right.right_F,
    }
    for message, expression in wrong.items():
        with pytest.raises(tx.KindError, match=message):
            tx.join(left, right, outputs={"wrong": expression})


def test_copies_keep_names_that_they_share() -> None:
    left, right = _copies(keep=["body", "craft"])
    tx.join(left, right, outputs={"closing": right.right_V - left.left_V})
    left, right = _copies(keep="M")  # its frame is that of both
    tx.join(left, right, outputs={"momentum": right.M @ (left.left_V - left.left_V)})
    with pytest.raises(tx.ModelError, match="keep names 'bodies'"):
        _copies(keep="bodies")
