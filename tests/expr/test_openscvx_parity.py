"""The four operators of OpenSCvx's adjoint module, held to its surface: what a user of 0.5.2 finds unchanged here.

The expected values stand in this file, so that nothing but this package is needed; where OpenSCvx is installed, it is
asked the same questions. Its values are another matter, see test_openscvx_values.py: both packages call their vectors
[v; w], but most of its formulas are those of [w; v]; the last tests show it of the coadjoint.
"""

import dataclasses
from typing import Any

import numpy as np
import pytest
from expr_cases import value_of
from openscvx_cases import CASES, OURS
from openscvx_lowering import openscvx

import twistax as tx


@dataclasses.dataclass(frozen=True)
class Surface:
    """What one operator shows."""

    name: str
    arguments: tuple[str, ...]
    text: str
    accepts: tuple[int, ...]
    gives: tuple[int, ...]

    def of(self, package: Any) -> Any:
        return getattr(package.lie, self.name)

    def operands(self, package: Any) -> list[Any]:
        return [package.State(f"x{i}", shape=self.accepts) for i in range(len(self.arguments))]


SURFACES = [
    Surface("Adjoint", ("twist1", "twist2"), "ad({}, {})", (6,), (6,)),
    Surface("AdjointDual", ("twist", "momentum"), "ad_dual({}, {})", (6,), (6,)),
    Surface("SE3Adjoint", ("transform",), "Ad({})", (4, 4), (6, 6)),
    Surface("SE3AdjointDual", ("transform",), "Ad_dual({})", (4, 4), (6, 6)),
]

#: (operator, argument that does not fit, its shape, the sentence)
SENTENCES = [
    ("Adjoint", "twist1", (3,), "Adjoint expects twist1 with shape (6,), got (3,)"),
    ("Adjoint", "twist2", (6, 1), "Adjoint expects twist2 with shape (6,), got (6, 1)"),
    ("AdjointDual", "twist", (), "AdjointDual expects twist with shape (6,), got ()"),
    ("AdjointDual", "momentum", (7,), "AdjointDual expects momentum with shape (6,), got (7,)"),
    ("SE3Adjoint", "transform", (3, 3), "SE3Adjoint expects transform with shape (4, 4), got (3, 3)"),
    ("SE3AdjointDual", "transform", (6,), "SE3AdjointDual expects transform with shape (4, 4), got (6,)"),
]

#: Numbers that may stand where an expression is expected.
NUMBERS = [2, 0.5, np.arange(6.0), np.eye(4), np.float64(3.0)]


@pytest.fixture(params=["twistax", "openscvx"])
def package(request: pytest.FixtureRequest) -> Any:
    """Both packages answer the same questions, the other one only where it is there."""
    return tx if request.param == "twistax" else openscvx()


by_surface = pytest.mark.parametrize("surface", SURFACES, ids=lambda surface: surface.name)


@by_surface
def test_arguments_are_attributes_and_children(surface: Surface, package: Any) -> None:
    operands = surface.operands(package)
    by_name = dict(zip(surface.arguments, operands, strict=True))
    for node in (surface.of(package)(*operands), surface.of(package)(**by_name)):
        assert all(getattr(node, name) is operand for name, operand in by_name.items())
        children = node.children()
        assert isinstance(children, list)
        assert len(children) == len(operands)
        assert all(child is operand for child, operand in zip(children, operands, strict=True))


@by_surface
@pytest.mark.parametrize("number", NUMBERS, ids=repr)
def test_numbers_and_arrays_become_constants(surface: Surface, number: Any, package: Any) -> None:
    node = surface.of(package)(*[number] * len(surface.arguments))
    for name, child in zip(surface.arguments, node.children(), strict=True):
        assert getattr(node, name) is child
        assert isinstance(child, package.Constant)
        np.testing.assert_array_equal(child.value, number)
        assert child.check_shape() == np.shape(number)


@by_surface
def test_shape(surface: Surface, package: Any) -> None:
    assert surface.of(package)(*surface.operands(package)).check_shape() == surface.gives


@by_surface
def test_repr(surface: Surface, package: Any) -> None:
    operands = surface.operands(package)
    node = surface.of(package)(*operands)
    assert repr(node) == surface.text.format(*map(repr, operands))
    moved = package.lie.SE3Adjoint(package.State("T", shape=(4, 4)))
    nested = surface.of(package)(*[moved] * len(operands))
    assert repr(nested) == surface.text.format(*[repr(moved)] * len(operands))


@pytest.mark.parametrize(("name", "argument", "shape", "sentence"), SENTENCES, ids=[s[3] for s in SENTENCES])
def test_sentences(name: str, argument: str, shape: tuple[int, ...], sentence: str, package: Any) -> None:
    surface = next(s for s in SURFACES if s.name == name)
    operands = dict(zip(surface.arguments, surface.operands(package), strict=True))
    operands[argument] = package.State("wrong", shape=shape)
    node = surface.of(package)(**operands)  # the shape is checked when asked for, not before
    with pytest.raises(ValueError) as caught:
        node.check_shape()
    assert str(caught.value).splitlines()[0] == sentence


@by_surface
def test_canonicalize_keeps_the_operator(surface: Surface, package: Any) -> None:
    operands = surface.operands(package)
    canonical = surface.of(package)(*operands).canonicalize()
    assert type(canonical) is surface.of(package)
    assert [repr(child) for child in canonical.children()] == [repr(operand) for operand in operands]


def test_the_error_also_says_where_and_how_to_mend() -> None:
    V = tx.State("V", shape=(6,))
    with pytest.raises(tx.ShapeError, match=r"(?s)^Adjoint expects twist2 .*\n  at: Add.terms\[0\] -> Adjoint"):
        (tx.lie.Adjoint(V, V[:3]) + V).check_shape()


def published_coadjoint(xi: tx.Expr, momentum: tx.Expr) -> tx.Expr:
    """[w x f + v x tau; w x tau], the published formula for xi = [v; w], momentum = [f; tau]."""
    v, w, f, tau = tx.lie.linear(xi), tx.lie.angular(xi), tx.lie.linear(momentum), tx.lie.angular(momentum)
    cross = tx.linalg.Cross
    return tx.lie.twist(linear=cross(w, f) + cross(v, tau), angular=cross(w, tau))


#: What AdjointDual of 0.5.2 computes, said in the operators of this package; OpenSCvx itself is asked elsewhere.
THEIRS = next(case.here for case in CASES if case.node == "AdjointDual")


def test_the_published_coadjoint_stands_as_written_here() -> None:
    rng = np.random.default_rng(6)
    xi, momentum = rng.normal(size=(2, 6))
    theirs = value_of(published_coadjoint(tx.Constant(xi), tx.Constant(momentum)))
    np.testing.assert_allclose(theirs, value_of(THEIRS(OURS, xi, momentum)), rtol=1e-13)


def test_only_this_coadjoint_is_dual_to_the_bracket_both_share() -> None:
    """<ad*_xi mu, eta> + <mu, ad_xi eta> = 0."""
    xi, momentum, eta = map(tx.Constant, np.random.default_rng(7).normal(size=(3, 6)))
    bracket = tx.linalg.Dot(momentum, tx.lie.Adjoint(xi, eta))
    assert abs(value_of(tx.linalg.Dot(tx.lie.AdjointDual(xi, momentum), eta) + bracket)) < 1e-14
    assert abs(value_of(tx.linalg.Dot(published_coadjoint(xi, momentum), eta) + bracket)) > 0.1


@pytest.mark.parametrize(("coadjoint", "conserves"), [(tx.lie.AdjointDual, True), (published_coadjoint, False)])
def test_a_free_body_keeps_its_momentum_in_space_with_this_coadjoint_only(coadjoint: Any, conserves: bool) -> None:
    """m = 2 kg, J = diag(1, 2, 3) kg m2, no force, 5 s. Energy is blind: both formulas keep it."""
    M = np.diag([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    momentum = M @ V
    body = tx.System(
        rates={g: V, V: tx.linalg.Solve(M, -coadjoint(V, momentum))},
        outputs={"momentum": g[:3, :3] @ tx.lie.linear(momentum), "energy": 0.5 * tx.linalg.Dot(V, momentum)},
    )
    dynamics = tx.compile(body)
    start = {"g": np.eye(4), "V": np.array([1.0, -0.5, 0.3, 0.4, 1.1, -0.7])}
    end = tx.integrate(dynamics, start, t1=5.0, dt=5e-3, method=tx.RKMK(tx.tableaus.RK4))
    before = dynamics.outputs(0.0, start)
    after = dynamics.outputs(5.0, {name: values[-1] for name, values in end.xs.items()})
    lost = float(np.linalg.norm(after["momentum"] - before["momentum"]))
    assert lost < 1e-9 if conserves else lost > 1.0
    assert float(after["energy"]) == pytest.approx(float(before["energy"]), rel=1e-9)
