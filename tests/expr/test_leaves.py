"""Leaves: what they carry, what they refuse, and that they stay as they are."""

from typing import Any

import numpy as np
import pytest

from twistax import expr as tx
from twistax.errors import ImmutableError, ModelError
from twistax.groups import ANGULAR_FIRST, LINEAR_FIRST, SE3, SO3, pose

ROTATED = np.asarray(pose(position=[1.0, 2.0, 3.0], euler=[0.1, -0.2, 0.3]))


def test_shapes() -> None:
    assert tx.State("x").shape == ()
    assert tx.State("x", shape=4).shape == (4,)
    assert tx.State("g", group=SE3).shape == (4, 4)
    assert tx.State("R", group=SO3).shape == (3, 3)
    assert tx.Parameter("M", value=np.eye(3)).shape == (3, 3)
    assert tx.Time().shape == ()


def test_what_an_optimiser_reads() -> None:
    x = tx.State("x", shape=(3,), min=-1.0, max=[1.0, None, 2.0], initial=[0.0, None, 1.0], final=0.0, scale=10.0)
    np.testing.assert_array_equal(x.min, [-1.0, -1.0, -1.0])
    np.testing.assert_array_equal(x.max, [1.0, np.inf, 2.0])
    np.testing.assert_array_equal(x.initial, [0.0, np.nan, 1.0])
    np.testing.assert_array_equal(x.final, np.zeros(3))
    np.testing.assert_array_equal(x.scale, [10.0] * 3)
    assert x.guess is None
    assert tx.State("x", shape=(3,), guess=np.ones((7, 3))).guess.shape == (7, 3)
    u = tx.Control("u", shape=(2,), min=[0.0, None], guess=[1.0, 2.0])
    np.testing.assert_array_equal(u.min, [0.0, -np.inf])
    g = tx.State("g", group=SE3, initial=ROTATED, scale=[1, 1, 1, 0.1, 0.1, 0.1])
    np.testing.assert_array_equal(g.initial, ROTATED)
    assert g.scale.shape == (6,)
    assert g.min is None
    assert g.order is LINEAR_FIRST
    assert tx.State("g", group=SE3, order=ANGULAR_FIRST).order is ANGULAR_FIRST


@pytest.mark.parametrize(
    "leaf",
    [
        tx.State("x", shape=(2,), min=0.0),
        tx.State("g", group=SE3, initial=ROTATED),
        tx.Control("u"),
        tx.Parameter("p", value=2.0),
    ],
    ids=str,
)
def test_replace_makes_a_changed_copy(leaf: Any) -> None:
    other = leaf.replace(name="other")
    assert (other.name, other.shape) == ("other", leaf.shape)
    assert type(other) is type(leaf)
    assert other.key() != leaf.key()
    for field in ("min", "initial", "value"):
        np.testing.assert_array_equal(getattr(other, field, None), getattr(leaf, field, None))
    with pytest.raises(ImmutableError, match=r"replace\(name=\.\.\.\)"):
        leaf.name = "changed"
    assert leaf.name != "changed"


def test_replaced_fields_are_checked_again() -> None:
    x = tx.State("x", shape=(3,), min=0.0)
    np.testing.assert_array_equal(x.replace(max=5.0).max, [5.0] * 3)
    assert x.max is None
    with pytest.raises(ModelError, match="expects min below max"):
        x.replace(max=-1.0)
    with pytest.raises(ImmutableError):
        x.min = 3.0
    with pytest.raises(ValueError, match="read-only"):
        x.min[0] = 3.0
    changed = (x + 1.0).replace(terms=(x, 2.0))
    assert changed.key() == (x + 2.0).key()
    norm = tx.Norm(x).replace(ord=1)
    assert norm.key() == tx.Norm(x, 1).key()
    block = tx.Block([[x]]).replace(blocks=[[x], [x]])
    assert block.shape == (2, 3)


def test_bounds_do_not_make_another_leaf() -> None:
    """Bounds are for the optimiser; the value of an expression does not depend on them."""
    assert tx.State("x", min=0.0).key() == tx.State("x").key()


def test_a_constant_is_a_copy() -> None:
    source = np.ones(3)
    constant = tx.Constant(source)
    source[0] = 5.0
    np.testing.assert_array_equal(constant.value, np.ones(3))
    with pytest.raises(ValueError, match="read-only"):
        constant.value[0] = 2.0
    assert tx.Constant(np.array([1, 2])).value.dtype == np.float64
    assert tx.Constant(True).value.dtype == bool
    assert tx.Constant([1.0, 2.0]).key() == tx.Constant(np.array([1.0, 2.0])).key()


def test_names_in_latex() -> None:
    cases = {"x": "x", "m_dry": r"m_{\mathrm{dry}}", "mass": r"\mathrm{mass}", "a_b_c": r"a_{\mathrm{b\_c}}"}
    assert {name: tx.State(name).latex() for name in cases} == cases
    assert tx.Constant(1e-7).latex() == r"10^{-7}"
    assert tx.Constant(2.5e-9).latex() == r"2.5 \times 10^{-9}"
    assert tx.Constant([True, False]).latex() == r"\begin{bmatrix} \top \\ \bot \end{bmatrix}"
    assert tx.Constant(np.ones((2, 2, 2))).latex().startswith(r"\mathrm{const}")
