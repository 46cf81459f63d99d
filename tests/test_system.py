"""What a System refuses, one mistake at a time: the message names the thing, its place and the way out."""

from collections.abc import Callable

import numpy as np
import pytest

import twistax as tx

g = tx.State("g", group=tx.SE3)
R = tx.State("R", group=tx.SO3)
V, s = tx.State("V", (6,)), tx.State("s")
F = tx.Control("F", (6,))
p = tx.Parameter("p", value=2.0)
ZERO = np.zeros(6)

Build = Callable[[], object]

#: what: (how to build it, the error, lines it must contain)
MISTAKES: dict[str, tuple[Build, type[Exception], list[str]]] = {
    "no state": (lambda: tx.System(rates={}), tx.ModelError, ["at least one state", "rates={x: expression}"]),
    "an unknown name as a key": (
        lambda: tx.System(rates={V: F, "W": F}),
        tx.ModelError,
        ["rates names 'W'", "known are 'V'", "fix: give the State itself as the key"],
    ),
    "a control as a key": (
        lambda: tx.System(rates={V: F, "F": F}),
        tx.ModelError,
        ["rates names 'F'", "are 'V'"],
    ),
    "a key that is no leaf": (lambda: tx.System(rates={3: F}), tx.ModelError, ["key of rates", "got 3"]),
    "one state twice": (
        lambda: tx.System(rates={V: F, "V": F}),
        tx.ModelError,
        ["the rate of 'V' is given twice", "fix: one key a state"],
    ),
    "two states of one name, both with rates": (
        lambda: tx.System(rates={V: F, tx.State("V", shape=(6,)): F}),
        tx.ModelError,
        ["two States named 'V' have rates", "fix: names are unique", "the states of a joint are named after the joint"],
    ),
    "a missing rate": (
        lambda: tx.System(rates={V: F * s}),
        tx.ModelError,
        ["State 's' has no rate", "at: rates['V']: Mul.factors[1] -> State", "fix: add 's' to rates"],
    ),
    "a missing rate of a state in an output": (
        lambda: tx.System(rates={V: F}, outputs={"height": g[2, 3]}),
        tx.ModelError,
        ["State 'g' has no rate", "at: outputs['height']: Index.base -> State"],
    ),
    "a missing rate of a state in a constraint": (
        lambda: tx.System(rates={V: F}, constraints=[s <= 1.0]),
        tx.ModelError,
        ["State 's' has no rate", "constraints['s <= 1.']"],
    ),
    "a missing rate of a state in the body of a Vmap": (
        lambda: tx.System(rates={V: F}, outputs={"y": tx.Vmap(lambda z: s * z, np.ones(3))}),
        tx.ModelError,
        ["State 's' has no rate", "outputs['y']: Vmap.body -> Mul.factors[0] -> State"],
    ),
    "a state and a control of one name": (
        lambda: tx.System(rates={V: F * tx.Control("V")}),
        tx.ModelError,
        [
            "two leaves are named 'V'",
            "State of shape (6,) and Control of shape ()",
            "rates['V']: Mul.factors[1]",
            "fix:",
        ],
    ),
    "a control and a parameter of one name": (
        lambda: tx.System(rates={V: F * tx.Parameter("F", value=1.0)}),
        tx.ModelError,
        [
            "two leaves are named 'F'",
            "Control of shape (6,) and Parameter of shape ()",
            "Mul.factors[0]",
            "Mul.factors[1]",
        ],
    ),
    "two states of one name": (
        lambda: tx.System(rates={V: F * tx.State("V")}),
        tx.ModelError,
        ["two leaves are named 'V'", "differ in shape", "at: a key of rates", "and: rates['V']: Mul.factors[1]"],
    ),
    "one state with two bounds": (
        lambda: tx.System(rates={"V": F + tx.State("V", (6,), min=0.0) + tx.State("V", (6,), min=1.0)}),
        tx.ModelError,
        ["two leaves are named 'V'", "differ in min", "use one object in both places"],
    ),
    "one pose in two groups": (
        lambda: tx.System(rates={g: V, V: F * tx.State("g", (4, 4))[0, 0]}),
        tx.ModelError,
        ["two leaves are named 'g'", "differ in group"],
    ),
    "one control with two bounds": (
        lambda: tx.System(rates={V: F + tx.Control("F", (6,), max=1.0)}),
        tx.ModelError,
        ["two leaves are named 'F'", "differ in max", "Add.terms[0]", "Add.terms[1]"],
    ),
    "one parameter with two values": (
        lambda: tx.System(rates={V: F * p * tx.Parameter("p", value=3.0)}),
        tx.ModelError,
        ["two leaves are named 'p'", "differ in value"],
    ),
    "the rate of a pose is no 4x4 matrix": (
        lambda: tx.System(rates={g: tx.lie.Hat(V), V: F}),
        tx.ShapeError,
        ["the rate of 'g' expects shape (6,), got (4, 4)", "at: rates['g'] = hat(V)", "fix:", "body velocity on SE3"],
    ),
    "the rate of a rotation": (
        lambda: tx.System(rates={R: F}),
        tx.ShapeError,
        ["the rate of 'R' expects shape (3,), got (6,)", "body velocity on SO3"],
    ),
    "the rate of a vector": (
        lambda: tx.System(rates={V: F[:3]}),
        tx.ShapeError,
        ["the rate of 'V' expects shape (6,), got (3,)", "at: rates['V'] = F[:3]", "of the state's shape"],
    ),
    "the rate of a scalar is no vector of one entry": (
        lambda: tx.System(rates={s: tx.Concat(s)}),
        tx.ShapeError,
        ["the rate of 's' expects shape (), got (1,)"],
    ),
    "a shape inside of a rate": (
        lambda: tx.System(rates={V: F - tx.lie.AdjointDual(V, V[:3])}),
        tx.ShapeError,
        ["AdjointDual expects momentum with shape (6,), got (3,)", "at: rates['V']: Sub.right -> AdjointDual in (F - "],
    ),
    "a shape inside of an output": (
        lambda: tx.System(rates={V: F}, outputs={"y": V @ V[:3]}),
        tx.ShapeError,
        ["MatMul incompatible shapes: (6,) @ (3,)", "at: outputs['y']: MatMul"],
    ),
    "a shape inside of a constraint": (
        lambda: tx.System(rates={V: F}, constraints={"limit": tx.Inequality(V, V[:3])}),
        tx.ShapeError,
        ["at: constraints['limit']: "],
    ),
    "an undeclared control": (
        lambda: tx.System(rates={V: F}, controls=[]),
        tx.ModelError,
        ["Control 'F' is used but not declared", "at: rates['V']: Control", "fix: add it to controls="],
    ),
    "an undeclared parameter": (
        lambda: tx.System(rates={V: F * p}, parameters=[]),
        tx.ModelError,
        ["Parameter 'p' is used but not declared", "at: rates['V']: Mul.factors[1] -> Parameter", "parameters="],
    ),
    "a parameter declared as a control": (
        lambda: tx.System(rates={V: F * p}, controls=[F, p]),
        tx.ModelError,
        ["controls= expects Control leaves, got p"],
    ),
    "a rate that is no expression": (
        lambda: tx.System(rates={V: F, s: np.array(["a"])}),
        tx.ModelError,
        ["rates['s']: ", "expects real numbers"],
    ),
    "a rate that is true or false": (
        lambda: tx.System(rates={s: s <= 1.0}),
        tx.ModelError,
        ["the rate of 's' is true or false", "at: rates['s'] = s <= 1.", "fix: choose between numbers with tx.Where"],
    ),
    "a constraint without a relation": (
        lambda: tx.System(rates={V: F}, constraints={"limit": tx.linalg.Norm(F)}),
        tx.ModelError,
        ["constraint 'limit' is not a constraint but Norm", "fix: compare expressions"],
    ),
    "two orders": (
        lambda: tx.System(rates={g: V, V: tx.lie.AdjointDual(V, F, order=tx.ANGULAR_FIRST)}),
        tx.OrderError,
        ["two orders of six-vectors meet", "rates['V']", "the rate of the pose 'g'", "tx.lie.Reorder"],
    ),
    "an expression instead of a system": (
        lambda: tx.compile(V * 2.0),
        tx.ModelError,
        ["compile expects a tx.System, got Mul", "use tx.lower"],
    ),
    "an unknown output": (
        lambda: tx.compile(tx.System(rates={V: F}, outputs={"a": 2.0 * V}), outputs=["b"]),
        tx.ModelError,
        ["outputs names 'b'", "the system has: 'a'"],
    ),
    "an unknown parameter to bake": (
        lambda: tx.compile(tx.System(rates={V: p * F}), bake={"q": 1.0}),
        tx.ModelError,
        ["bake names 'q'", "the system has: 'p'"],
    ),
    "a shape to bake": (
        lambda: tx.compile(tx.System(rates={V: p * F}), bake={"p": [1.0, 2.0]}),
        tx.ShapeError,
        ["'p': value expects shape (), got (2,)"],
    ),
    "no value to bake": (
        lambda: tx.compile(tx.System(rates={V: p * F}), bake={"p": None}),
        tx.ModelError,
        ["bake['p'] is None"],
    ),
}


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("what", MISTAKES)
def test_mistake(what: str) -> None:
    build, error, words = MISTAKES[what]
    with pytest.raises(error) as caught:
        build()
    assert caught.type is error
    for word in words:
        assert word in str(caught.value), f"{word!r} is missing in:\n{caught.value}"


# ---- what a System holds -----------------------------------------------------------------------------------------


def test_leaves_in_order_of_declaration() -> None:
    a, b = tx.State("zeta"), tx.State("alpha", group=tx.SO3)
    u, w = tx.Control("w"), tx.Control("a")
    system = tx.System(rates={a: u, b: w * np.ones(3)}, parameters=[p])
    assert [leaf.name for leaf in system.states] == ["zeta", "alpha"]
    assert list(system.rates) == ["zeta", "alpha"]
    assert [leaf.name for leaf in system.controls] == ["w", "a"]
    assert system.parameters == (p,)
    assert system.group.slices == {"zeta": slice(0, 1), "alpha": slice(1, 4)}
    assert repr(system) == "System(states=['zeta', 'alpha'], controls=['w', 'a'], parameters=['p'])"
    ordered = tx.System(rates={a: u, b: w * np.ones(3)}, controls=[w, u])
    assert [leaf.name for leaf in ordered.controls] == ["a", "w"]


def test_keys_may_be_names_and_rates_numbers() -> None:
    system = tx.System(rates={"V": F + 0.0 * V, g: ZERO, s: 1.0})
    assert [leaf.name for leaf in system.states] == ["V", "g", "s"]
    assert system.states[0] is V


def test_one_name_with_equal_leaves_is_one_leaf() -> None:
    again = tx.State("V", (6,))
    system = tx.System(rates={V: F - again}, controls=[F, F])
    assert system.states == (V,)
    assert system.controls == (F,)


def test_constraints_get_names() -> None:
    limit = tx.linalg.Norm(F) <= 10.0
    system = tx.System(rates={V: F}, constraints=[limit, limit, V[0] == 0.0])
    assert list(system.constraints) == ["Norm(F) <= 10.", "Norm(F) <= 10. (2)", "V[0] == 0."]
    assert list(tx.System(rates={V: F}, constraints={"thrust": limit}).constraints) == ["thrust"]
    assert list(tx.System(rates={V: F}, constraints=limit).constraints) == ["Norm(F) <= 10."]


@pytest.mark.parametrize(
    "use",
    [
        lambda s: tx.integrate(s, {"x": 1.0}, t1=1.0, dt=0.1),
        lambda s: tx.trajectory.linearize(s, 0.0, {"x": 1.0}),
        lambda s: tx.trajectory.discretize(s, 0.0, {"x": 1.0}, None, 0.1),
        lambda s: tx.trajectory.Problem(s, objective=tx.Minimize(0.0), nodes=3, final_time=1.0, initial={}, final={}),
        lambda s: tx.diffrax.ambient_term(s),
        lambda s: tx.diffrax.lie_term(s),
    ],
    ids=["integrate", "linearize", "discretize", "Problem", "ambient_term", "lie_term"],
)
def test_a_system_that_is_not_compiled_is_named(
    use: Callable[[tx.System], object], unchecked: None, request: pytest.FixtureRequest
) -> None:
    message = f"{request.node.callspec.id} expects a compiled system, got System.\n  fix: dynamics = tx.compile"
    with pytest.raises(tx.ModelError, match=message):
        use(tx.System(rates={tx.State("x"): 1.0}))
