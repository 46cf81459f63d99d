"""The rate of an expression along a motion: its time derivative as time and states change."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import short
from ...errors import ModelError, OperationError, ShapeError
from ...groups import Group
from ..fields import ExprLike
from ..graph import function_of, leaves_of, other_leaves, postorder, substitute
from ..kinds import rules
from ..leaves import Constant, Control, Leaf, State, Time
from ..node import Expr, Shape, expect, to_expr, to_numbers


class _Placeholder(Leaf):
    """A leaf that moves, inside the body of a Rate."""

    group: Group | None

    abstract = True

    def __init__(self, depth: int, number: int, of: Leaf) -> None:
        # Of several Rates, one inside of another, the outer one has the larger depth: their leaves stay apart.
        self._declare(f"r_{depth}.{number}", of.shape, group=getattr(of, "group", None))

    def static_key(self) -> tuple[Any, ...]:
        return (self.name, self.shape, repr(self.group))

    def makes_group_element(self, *operands: bool) -> bool:
        return self.group is not None and self.group.rigid

    def entry_rate(self, value: jax.Array, rate: jax.Array) -> jax.Array:
        """The rate of the entries of a value."""
        return rate if self.group is None else self.group.entry_rate(value, rate)


#: Leaves of the body with these types do not move because their rates are zero; those with others have no rates.
_AT_REST = (State, Control, _Placeholder)


class Rate(Expr):
    """$de/dt$ of an expression e by forward differentiation.

    It is the sum of the partial derivatives of e times the rates of its leaves.

    Shape: that of the expression. Time has the rate 1, parameters and constants have none. The rate of a state on a
    group is its body velocity, as in the rates of a System. A rate of a rate is the second derivative. Units: those of
    the expression, per second.

    Substitution preserves the rates: an expression that replaces a state or control has the rate of that leaf, with the
    same substitution. An expression that replaces a parameter may depend on the leaves whose rates are known.

    Args:
        operand: the expression.
        rates: rates of the states and controls that it depends on, by leaf or by name; others are ignored.
    Attributes:
        body: the operand, with placeholders for the leaves that have rates.
        placeholders: these leaves.
        depth: the nesting depth of Rates.
        along: the leaves that have rates, then their rates.
    Raises:
        ModelError: the operand depends on a state or control without a rate, directly or after a substitution; a
            substitution identifies two leaves whose rates differ; the operand, a rate or a substituted value is a
            condition.
        ShapeError: a rate does not have the shape of its leaf, or of its body velocity, directly or after a
            substitution; a substitution changes the shape of a leaf.
    Source: A. Griewank, A. Walther, Evaluating Derivatives (2008), chapter 3.
    """

    body: Expr
    placeholders: tuple[_Placeholder, ...]
    depth: int
    along: tuple[Expr, ...]  # the leaves that move, then their rates
    kinds = rules.OPEN
    cases = (
        (lambda cls, x, v: cls(x[0] * x[1] ** 2 * x, {x: v}), {"x": [0.3, -0.4, 0.8], "v": [1.0, 2.0, -0.5]}),
        (
            lambda cls, x, v, a: cls(cls(x * x[0], {x: v}), {x: v, v: a}),
            {"x": [0.3, -0.4], "v": [1.0, 2.0], "a": [0.2, 0.7]},
        ),
    )

    def __new__(cls, operand: ExprLike, rates: Mapping[Any, ExprLike] | None = None) -> Any:
        expr = to_numbers("Rate", to_expr(operand))
        expr.check_shape()
        pairs = list(_moving(expr, rates_by_name(rates or {})))
        depth = 1 + _depth(expr)
        placeholders = tuple(_Placeholder(depth, k, leaf) for k, (leaf, _) in enumerate(pairs))
        body = substitute(
            expr, {leaf.key(): placeholder for (leaf, _), placeholder in zip(pairs, placeholders, strict=True)}
        )
        leaves, velocities = tuple(leaf for leaf, _ in pairs), tuple(rate for _, rate in pairs)
        return cls._of(body, placeholders, depth, (*leaves, *velocities))

    def __init__(self, operand: ExprLike, rates: Mapping[Any, ExprLike] | None = None) -> None:
        """Everything is done by `__new__`: the fields are not the arguments."""

    @classmethod
    def _of(cls, body: Expr, placeholders: tuple[_Placeholder, ...], depth: int, along: tuple[Expr, ...]) -> Rate:
        return cls.from_fields({"body": body, "placeholders": placeholders, "depth": depth, "along": along})

    def replace(self, **changes: Any) -> Rate:
        raise OperationError(f"a Rate has no fields to replace, got {', '.join(changes)}.\n  fix: build another Rate")

    @property
    def _captured(self) -> list[Leaf]:
        """The leaves of the body that do not move."""
        return other_leaves(self.body, self.placeholders)

    @property
    def operand(self) -> Expr:
        """The expression."""
        count = len(self.placeholders)
        return substitute(
            self.body, {placeholder.key(): leaf for placeholder, leaf in zip(self.placeholders, self.along[:count])}
        )

    @property
    def rates(self) -> dict[str, Expr]:
        """The rates of the states and controls that the expression depends on, by name."""
        count = len(self.placeholders)
        moving = dict(zip((leaf.key() for leaf in self.along[:count]), self.along[count:], strict=True))
        rates: dict[str, Expr] = {}
        for leaf in changing(self.operand):
            if not isinstance(leaf, Time):
                rates[leaf.name] = moving.get(leaf.key(), Constant(np.zeros(_rate_shape(leaf))))
        return rates

    def children(self) -> list[Expr]:
        return [*self.along, *self._captured]

    def child_names(self) -> list[str]:
        count = len(self.placeholders)
        moving = [f"{what}[{k}]" for what in ("leaves", "rates") for k in range(count)]
        return moving + ["body"] * len(self._captured)

    def outline(self) -> list[tuple[str, Expr]]:
        return [("body", self.body), *zip(self.child_names(), self.along, strict=False)]

    def with_children(self, children: list[Expr]) -> Rate:
        count = len(self.along)
        leaves_and_rates = tuple(to_numbers("Rate", child) for child in children[:count])
        pairs = list(zip(self._captured, children[count:], strict=True))
        if all(a is b for a, b in zip(leaves_and_rates, self.along, strict=True)) and all(
            a.key() == b.key() for a, b in pairs
        ):
            return self
        moving = self._moving_after(leaves_and_rates, pairs)
        exchange = {old.key(): substitute(new, moving) for old, new in pairs if old.key() != new.key()}
        # Rates that come into the body have placeholders too: those of this one get a depth that is free.
        depth, placeholders = self.depth + _depth(*exchange.values()), self.placeholders
        if depth > self.depth:
            placeholders = tuple(_Placeholder(depth, k, old) for k, old in enumerate(self.placeholders))
            pairs_of_depths = zip(self.placeholders, placeholders, strict=True)
            deeper: dict[str, Expr] = {old.key(): new for old, new in pairs_of_depths}
            exchange = deeper | {key: substitute(new, deeper) for key, new in exchange.items()}
        return self._of(
            substitute(self.body, exchange) if exchange else self.body, placeholders, depth, leaves_and_rates
        )

    def _moving_after(self, leaves_and_rates: Sequence[Expr], pairs: Sequence[tuple[Leaf, Expr]]) -> dict[str, Expr]:
        """The placeholders by leaf after an exchange of children. Raises ModelError where a rate is not known."""
        count = len(self.placeholders)
        rates = {leaf.key(): "" for old, new in pairs if isinstance(old, _AT_REST) for leaf in _with_rates(new)}
        moving: dict[str, Expr] = {}
        for leaf, rate, placeholder in zip(
            leaves_and_rates[:count], leaves_and_rates[count:], self.placeholders, strict=True
        ):
            if not isinstance(leaf, (Time, *_AT_REST)):
                continue
            if rates.setdefault(leaf.key(), rate.key()) != rate.key():
                raise ModelError(
                    f"Rate: the substitution replaces leaves with different rates by {leaf.name!r}.\n"
                    "  fix: substitute in the expression, then build its Rate"
                )
            moving[leaf.key()] = placeholder
        for old, new in pairs:
            unknown = [leaf for leaf in _with_rates(new) if leaf.key() not in rates]
            if unknown:
                inside = isinstance(unknown[0], _Placeholder)
                kind, name = "leaf" if inside else type(unknown[0]).__name__.lower(), unknown[0].name
                raise ModelError(
                    f"Rate: the substitution replaces {old.name!r}, which has no rate, by an expression of "
                    f"the {kind} {name!r}, whose rate is not known.\n"
                    "  fix: substitute in the expression, then build its Rate with all rates"
                )
        return moving

    def infer_shape(self, *shapes: Shape) -> Shape:
        count, names = len(self.placeholders), self.child_names()
        wanted = [leaf.shape for leaf in self.placeholders] + [_rate_shape(leaf) for leaf in self.placeholders]
        for name, got, shape in zip(names[: 2 * count], shapes[: 2 * count], wanted, strict=True):
            expect(self, name, got, shape)
        return self.body.check_shape()

    def evaluate(self, *values: jax.Array) -> jax.Array:
        count = len(self.placeholders)
        leaves, rates, captured = values[:count], values[count : 2 * count], values[2 * count :]
        scope = {leaf.key(): value for leaf, value in zip(self._captured, captured, strict=True)}
        value = function_of(self.body, self.placeholders, scope)
        if not count:
            return jnp.zeros_like(value())
        velocities = [p.entry_rate(g, xi) for p, g, xi in zip(self.placeholders, leaves, rates, strict=True)]
        return jax.jvp(value, tuple(leaves), tuple(velocities))[1]

    def simplify(self) -> Expr:
        """The body is simplified."""
        body = self.body.canonicalize()
        return self if body is self.body else self._of(body, self.placeholders, self.depth, self.along)

    def to_text(self, *operands: str) -> str:
        count = len(self.placeholders)
        moving = (f"{placeholder.name}={operand}" for placeholder, operand in zip(self.placeholders, operands))
        rates = (f"{placeholder.name}'={operand}" for placeholder, operand in zip(self.placeholders, operands[count:]))
        return f"Rate({', '.join([repr(self.body), *moving, *rates])})"

    def to_latex(self, *operands: str) -> str:
        return rf"\frac{{d}}{{dt}}\left({self.body.latex()}\right)"


def rates_by_name(rates: Mapping[Any, ExprLike]) -> dict[str, Expr]:
    """The rates of states and controls by name. Raises ModelError for another kind of key, or a value that is not an
    expression.
    """
    by_name: dict[str, Expr] = {}
    if not isinstance(rates, Mapping):
        raise ModelError(
            f"rates must be a dict from states, controls or their names to expressions, got {short(rates)}"
        )
    for key, rate in rates.items():
        name = key if isinstance(key, str) else getattr(key, "name", None)
        if not isinstance(name, str) or not isinstance(key, (str, State, Control)):
            raise ModelError(f"the keys of rates must be states, controls or their names, got {key!r}")
        by_name[name] = to_expr(rate)
    return by_name


def changing(*roots: Expr) -> list[Leaf]:
    """The leaves whose values change along a motion: time, states and controls, each once."""
    leaves = {leaf.key(): leaf for leaf in leaves_of(*roots) if isinstance(leaf, (Time, State, Control))}
    return list(leaves.values())


def _with_rates(expr: Expr) -> list[Leaf]:
    """The leaves that change, with the placeholders of a Rate around this one."""
    return [*changing(expr), *(leaf for leaf in leaves_of(expr) if isinstance(leaf, _Placeholder))]


def _moving(expr: Expr, rates: Mapping[str, Expr]) -> Iterator[tuple[Leaf, Expr]]:
    for leaf in changing(expr):
        if isinstance(leaf, Time):
            yield leaf, Constant(1.0)
            continue
        if leaf.name not in rates:
            kind = type(leaf).__name__.lower()
            raise ModelError(
                f"Rate: the expression depends on the {kind} {leaf.name!r}, whose rate is not known.\n"
                f"  fix: pass rates={{{leaf.name!r}: its rate}}, zero if it is constant"
            )
        rate, wanted = to_numbers("Rate", rates[leaf.name]), _rate_shape(leaf)
        if rate.shape != wanted:
            raise ShapeError(f"Rate expects the rate of {leaf.name!r} with shape {wanted}, got {rate.shape}")
        simplified = rate.canonicalize()
        if not (isinstance(simplified, Constant) and not simplified.value.any()):
            yield leaf, rate


def _rate_shape(leaf: Leaf) -> Shape:
    group: Group | None = getattr(leaf, "group", None)
    return leaf.shape if group is None else group.tangent_shape


def _depth(*roots: Expr) -> int:
    """How many Rates stand one inside of another."""
    return max((node.depth for node in postorder(*roots) if isinstance(node, Rate)), default=0)
