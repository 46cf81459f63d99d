"""Checks of what a system declares: expressions, derivatives of rates, and whether they are finite."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Container, Iterable, Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ..checks import listed, short
from ..errors import ModelError, ShapeError
from ..expr import (
    Add,
    Block,
    Concat,
    Constant,
    Constraint,
    Control,
    Div,
    Expr,
    Hstack,
    Mul,
    Neg,
    Parameter,
    Stack,
    State,
    Sub,
    Vstack,
    find_path,
    leaves_of,
    to_expr,
)
from ..expr.fields import ExprLike
from ..groups import Product


def name_of(key: Any) -> str:
    """The name of a leaf, or the name itself."""
    return key if isinstance(key, str) else getattr(key, "name", repr(key))


def expression_at(place: str, value: ExprLike) -> Expr:
    """The value as an expression. Raises ModelError that names its place if it is none."""
    try:
        return to_expr(value)
    except ModelError as error:
        raise ModelError(f"{place}: {error}") from None


#: Of a state: pairs of what its rate depends on and the derivative by it.
Slopes: TypeAlias = Mapping[State | str, Iterable[tuple[ExprLike, ExprLike]]]


#: The same as expressions, by the name of the state.
KnownSlopes: TypeAlias = dict[str, tuple[tuple[Expr, Expr], ...]]


class SlopesOnDemand(NamedTuple):
    """Derivatives of rates that are built when they are first needed.

    Attributes:
        make: builds them, from the expressions of the rates by name.
        scalars: the number of scalars that a program with them takes at least. Too large a program is
            not built.
    """

    make: Callable[[Mapping[str, Expr]], Slopes | KnownSlopes]
    scalars: int = 0


def checked_slopes(slopes: Slopes | KnownSlopes, group: Product, leaves: Container[str]) -> KnownSlopes:
    """Declared derivatives as expressions, by state.

    Args:
        group: of all states.
        leaves: the names of states, controls and parameters.
    Raises:
        ModelError: they are no pairs, or name a state or read a leaf that the system does not have.
        ShapeError: a derivative of the wrong shape.
    """
    if not isinstance(slopes, Mapping):
        raise ModelError(f"slopes must be a dict from states to pairs, got {type(slopes).__name__}")
    groups, checked = group.factors, KnownSlopes()
    for key, pairs in slopes.items():
        name = name_of(key)
        place = f"slopes[{name!r}]"
        if name not in groups:
            raise ModelError(f"slopes names {name!r}, which has no rate; it expects one of {listed(groups, name)}")
        pairs_of_state = list(pairs) if isinstance(pairs, Iterable) else [pairs]
        if not all(isinstance(pair, (tuple, list)) and len(pair) == 2 for pair in pairs_of_state):
            raise ModelError(f"{place} expects pairs (argument, derivative), got {short(pairs_of_state)}")
        checked[name] = tuple((expression_at(place, by), expression_at(place, slope)) for by, slope in pairs_of_state)
        for leaf in leaves_of(*itertools.chain(*checked[name])):
            if isinstance(leaf, (State, Control, Parameter)) and leaf.name not in leaves:
                raise ModelError(f"{place} reads {leaf.name!r}, which the system does not have")
        for by, slope in checked[name]:
            if not isinstance(by, State) and by.ndim != 1:
                raise ShapeError(
                    f"{place} expects derivatives with respect to a state or a vector, got one with "
                    f"respect to shape {by.shape}"
                )
            wanted = (groups[name].dimension, groups[by.name].dimension if isinstance(by, State) else by.shape[0])
            if slope.shape != wanted:
                raise ShapeError(
                    f"{place} expects shape {wanted} for the derivative with respect to {short(by)}, got {slope.shape}"
                )
    return checked


# ---- finite expressions ----------------------------------------------------------------------------------------------

#: Nodes whose value has a NaN if an operand has one.
_PASSING = (Add, Sub, Mul, Div, Neg, Stack, Concat, Block, Hstack, Vstack)


def need_finite(place: str, root: Expr) -> None:
    """Raise ModelError if an expression (for a constraint, its residual) is not finite for any state."""
    root = root.residual() if isinstance(root, Constraint) else root
    if (not_finite := _not_finite(root)) is not None:
        raise ModelError(
            f"{place} is never finite: it expects finite numbers, got {not_finite!r}.\n"
            f"  at: {find_path(root, not_finite)}\n  fix: use a tx.Parameter for an unknown value"
        )


def _not_finite(root: Expr) -> Constant | None:
    """A constant that makes the value NaN whatever the states are, or that is the value and infinite; None if none."""
    if isinstance(root, Constant) and not np.isfinite(root.value).all():
        return root
    waiting, seen = [root], set[int]()
    while waiting:
        node = waiting.pop()
        if isinstance(node, Constant) and np.isnan(node.value).any():
            return node
        # Other nodes may drop the entry, or choose another branch.
        if isinstance(node, _PASSING) and id(node) not in seen:
            seen.add(id(node))
            waiting.extend(node.children())
    return None
