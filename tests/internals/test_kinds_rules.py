"""The rules of units and frames against the values of nodes: other units of measurement, other axes."""

import itertools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from expr_cases import CASES, function_of

import twistax as tx
from twistax.expr.kinds import lie_rules
from twistax.expr.kinds.kinds import Space
from twistax.expr.kinds.rules import Clash, Terms
from twistax.expr.kinds.unit import KILOGRAM, METRE, ONE, SECOND
from twistax.testing.nodes import Case

#: Numbers of the node itself, or a grid, are in the unit of the operand: they would have to be changed with it.
WITH_NUMBERS = {"Huber", "SmoothReLU", "HarmonicPull", "Meridian", "Temperature", "Pressure", "Linterp", "Bilerp"}
#: How many of the new units make an old one.
SCALES = (1.7, 0.6, 2.3, 1.0)


def scale_of(unit: Any) -> float:
    return math.prod(scale ** float(n) for scale, n in zip(SCALES, unit.exponents, strict=True))


def scaled(value: np.ndarray, unit: Any, spaces: dict[int, Space], order: Any) -> np.ndarray:
    """A value in the new units: all entries by the unit, linear parts of six-vectors by a metre more or less."""
    value = value * scale_of(unit)
    for axis, space in spaces.items():
        if value.shape[axis] == 6:
            metres = scale_of(METRE) ** (1.0 if space is Space.MOTION else -1.0)
            linear = slice(0, 3) if order.linear_leads else slice(3, 6)
            index: list[Any] = [slice(None)] * value.ndim
            index[axis] = linear
            value[tuple(index)] *= metres
    return value


def with_position(pose: np.ndarray) -> np.ndarray:
    """A pose in the new units."""
    pose = pose.copy()
    pose[:3, 3] *= scale_of(METRE)
    return pose


def choices(node: tx.Expr, child: tx.Expr) -> list[Any]:
    if child.shape == (3, 3) and child.is_leaf and type(node).kinds in (lie_rules.ACT, lie_rules.SAME_ROTATION):
        return [ONE]
    variable = child.is_leaf and not isinstance(child, tx.Constant) and child.shape != (4, 4)
    return [ONE, METRE, SECOND, KILOGRAM * METRE] if variable else [None]


def spaces_of(node: tx.Expr, units: Any, of_part: Space) -> dict[int, dict[int, Space]]:
    """By the number of a child, the node itself being the last one: the space of each axis."""
    rule, values = type(node).kinds, [*node.children(), node]
    assert rule is not None
    spaces: dict[int, dict[int, Space]] = {k: {} for k in range(len(values))}
    for value, axis, space in rule.spaces(node):
        spaces[next(k for k, other in enumerate(values) if other is value)][axis] = space
    made = rule.made(node, units)
    if made is not None:
        spaces[len(values) - 1][-node.ndim] = made
    if hasattr(node, "place"):  # a part: of a twist, or of a wrench
        spaces[0][-values[0].ndim] = of_part
    if isinstance(node, tx.lie.Reorder):
        for k, value in enumerate(values):
            spaces[k] = {-1 - i: of_part if i == 0 else of_part.dual for i in range(value.ndim)}
    return spaces


@pytest.mark.parametrize("case", [c for c in CASES if type(c.example.expr).__name__ not in WITH_NUMBERS], ids=str)
def test_the_unit_of_a_result_is_that_by_which_its_value_scales(case: Case) -> None:
    node, values = case.example.expr, case.values
    rule, children = type(node).kinds, node.children()
    assert rule is not None
    of_pose = any(child.shape == (4, 4) and not child.is_leaf for child in children)
    if node.is_leaf or of_pose or len({child.key() for child in children}) < len(children):
        return
    order = getattr(node, "order", tx.LINEAR_FIRST)
    before = np.asarray(function_of(node)({k: jnp.asarray(v) for k, v in values.items()})[0])
    for units, of_part in itertools.product(
        list(itertools.product(*(choices(node, child) for child in children)))[:64], Space
    ):
        spaces = spaces_of(node, units, of_part)
        try:
            unit = rule.unit(node, units, lambda value, axis, of=of_part: of if hasattr(node, "place") else None)
        except Clash:
            continue
        # Where an operand is open the result is what it would be if that fitted.
        if unit is None or (isinstance(rule, Terms) and None in units[rule.conditions :]):
            continue
        changed = dict(values)
        for k, (child, its_unit) in enumerate(zip(children, units, strict=True)):
            its_order = order
            if isinstance(node, tx.lie.Reorder):
                its_order = {True: tx.ANGULAR_FIRST, False: tx.LINEAR_FIRST}[order.linear_leads]
            if its_unit is not None:
                changed[child.name] = scaled(values[child.name], its_unit, spaces[k], its_order)
            elif child.shape == (4, 4) and child.is_leaf and not isinstance(child, tx.Constant):
                changed[child.name] = with_position(values[child.name])
        after = np.asarray(function_of(node)({k: jnp.asarray(v) for k, v in changed.items()})[0])
        wanted = scaled(np.array(before), unit, spaces[len(children)], order)
        np.testing.assert_allclose(after, wanted, rtol=1e-9, atol=1e-9, err_msg=f"{units} -> {unit}")
