"""Choices: maximum and minimum, predicates, selection by a condition, and branches."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any as Anything
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import OperationError, ShapeError
from ..bases import Chained, Entrywise, Variadic, align, broadcast
from ..fields import ExprLike, Operand, Operands
from ..kinds import rules
from ..leaves import Constant
from ..node import Expr, Shape, to_expr
from .arithmetic import rebuilt, zeros_of

_VALUES = {"a": [1.0, -2.0, 0.5], "s": 0.25}
_CASES = r"\begin{cases} <1> & <0> \\ <2> & \text{otherwise} \end{cases}"


class Extremum(Chained, init=False):
    """Base class of Max, Min and LogSumExp."""

    operands: Operands
    kinds: ClassVar[rules.Rule | None] = rules.ALIKE
    abstract = True
    cases = (
        {"operands": [[1.0, -2.0, 0.5], 0.25]},
        {"operands": [[1.0, -3.0, 0.5], [0.5, -3.5, 1.0], -1.0]},
    )
    kinks = ({"operands": [[1.0, 1.0, 1.0], Constant(1.0)]},)
    #: How two constants combine.
    combine: ClassVar[Anything]
    #: Whether x with x is x.
    idempotent: ClassVar[bool] = True

    def simplify(self) -> Expr:
        """Constants are folded into one, and equal operands count once. Nested ones are already flattened."""
        constants = [o.value for o in self.operands if isinstance(o, Constant)]
        rest = [o for o in self.operands if not isinstance(o, Constant)]
        if self.idempotent:
            rest = list({o.key(): o for o in rest}.values())
        if constants:
            rest.append(Constant(functools.reduce(type(self).combine, constants)))
        return rebuilt(self, rest, self.operands)


class Max(Extremum, init=False):
    """Greatest of two or more operands, entry by entry with broadcasting, in one unit.

    At ties the derivative is distributed: two equal operands get one half each.

    Raises:
        ShapeError: the shapes do not broadcast.
        ModelError: fewer than two operands.
    """

    function = jnp.maximum
    combine = np.maximum
    latex_name = r"\max"


class Min(Extremum, init=False):
    """Least of two or more operands, entry by entry with broadcasting, in one unit.

    At ties the derivative is distributed: two equal operands get one half each.

    Raises:
        ShapeError: the shapes do not broadcast.
        ModelError: fewer than two operands.
    """

    function = jnp.minimum
    combine = np.minimum
    latex_name = r"\min"


class LogSumExp(Extremum, init=False):
    """$log(e^a + e^b + ...)$, entry by entry with broadcasting: a smooth maximum, above it by at most log(number).

    It does not overflow for large operands.

    Raises:
        ShapeError: the shapes do not broadcast.
        ModelError: fewer than two operands.
    """

    kinds = rules.NUMBERS
    combine = np.logaddexp
    idempotent = False

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jax.nn.logsumexp(jnp.stack(jnp.broadcast_arrays(*align(*values))), axis=0)


def _predicate(node: str, value: Anything) -> Expr:
    """The value as an expression, if its entries are true or false."""
    if isinstance(value, (bool, np.bool_, Expr)) or getattr(value, "dtype", None) == np.dtype(bool):
        expr = to_expr(value)
        if expr.boolean:
            return expr
    raise OperationError(
        f"{node} expects conditions such as x <= 5 or x < 5, or All, Any and Not of them, "
        f"got {type(value).__name__}: {value!r}"
    )


class Reduction(Variadic, init=False):
    """Base class of All and Any: one truth value from the entries of one or more predicates."""

    predicates: Operands
    kinds = rules.OPEN
    abstract = True
    associative = True
    listed = True
    kinks = (
        (lambda cls, x, s: cls([x >= 0.0, s <= 1.0]), {"x": [0.5, 0.2, 0.9], "s": 2.0}),
        (lambda cls, x: cls(x >= 1.0), {"x": [0.5, 0.2, 1.9]}),
        (lambda cls, x, s: cls([x >= 0.0, s <= 1.0]), {"x": [0.5, 0.2, 0.9], "s": 0.5}),
        (lambda cls, x: cls(x >= 2.0), {"x": [0.5, 0.2, 1.9]}),
    )
    #: How the entries of one predicate and then the predicates combine; the value that leaves the result as it is.
    reduce: ClassVar[Anything]
    combine: ClassVar[Anything]
    neutral: ClassVar[bool]

    def __init__(self, *predicates: Anything) -> None:
        entries = predicates[0] if len(predicates) == 1 and isinstance(predicates[0], (list, tuple)) else predicates
        super().__init__(*(_predicate(type(self).__name__, predicate) for predicate in entries))

    def makes_boolean(self, *operands: bool) -> bool:
        return True

    def infer_shape(self, *shapes: Shape) -> Shape:
        return ()

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return functools.reduce(type(self).combine, [type(self).reduce(value) for value in values])

    def simplify(self) -> Expr:
        """Constants without effect vanish; a deciding constant is the result. Nested ones are already flattened."""
        kept: list[Expr] = []
        for predicate in self.predicates:
            if not isinstance(predicate, Constant):
                kept.append(predicate)
            elif bool(type(self).reduce(jnp.asarray(predicate.value))) is not self.neutral:
                return Constant(not self.neutral)
        if not kept:
            return Constant(self.neutral)
        return self if len(kept) == 1 and kept[0].shape else rebuilt(self, kept, self.predicates)


class All(Reduction, init=False):
    """True if every entry of every predicate is true; shape (). Predicates are passed one by one or in a list.

    Attributes:
        predicates: conditions (lhs <= rhs, lhs < rhs, lhs == rhs), All, Any or Not.
    Raises:
        TypeError: an operand that is not a condition.
        ValueError: no predicate.
    """

    reduce = jnp.all
    combine = jnp.logical_and
    neutral = True


class Any(Reduction, init=False):
    """True if at least one entry of one predicate is true; shape (). Predicates are passed one by one or in a list.

    Attributes, Raises: as for `All`.
    """

    reduce = jnp.any
    combine = jnp.logical_or
    neutral = False


class Not(Entrywise):
    """True where the condition is false, entry by entry; the operator `~`.

    ~(x <= y) and x > y differ where a side is NaN: comparisons with NaN are false, so the first is true. No rewrite
    replaces one by the other.

    Attributes:
        condition: a comparison, All, Any or Not.
    Raises:
        TypeError: an operand that is not a condition.
    """

    kinds = rules.OPEN
    of_numbers = False
    condition: Operand
    function = jnp.logical_not
    formula = r"\lnot \left(<0>\right)"
    precedence = 90
    kinks = ((lambda cls, a, s: cls(a <= s), _VALUES), (lambda cls, a: cls(cls(a < 0.5)), {"a": [1.0, 0.5, -2.0]}))

    def __init__(self, condition: Anything) -> None:
        super().__init__(_predicate("Not", condition))

    def makes_boolean(self, *operands: bool) -> bool:
        return True

    def simplify(self) -> Expr:
        """Not(Not(x)) is x."""
        return self.condition.condition if isinstance(self.condition, Not) else self

    def to_text(self, *operands: str) -> str:
        return f"~({operands[0]})"


class Where(Entrywise):
    """x where the condition is true, else y, entry by entry with broadcasting.

    Both sides are evaluated everywhere. If a side that is not selected is NaN or has an infinite derivative, the
    derivative of the result is NaN: keep the arguments of both sides valid, or use Cond.

    Attributes:
        condition: a comparison, All, Any or Not.
        x, y: the values, in one unit.
    Raises:
        TypeError: an operand that is not a condition.
        ShapeError: the shapes do not broadcast.
    """

    kinds = rules.CHOICE
    of_numbers = False
    condition: Operand
    x: Operand
    y: Operand
    function = jnp.where
    formula = _CASES
    cases = (
        (lambda cls, a, s: cls(a <= s, a**2, s), _VALUES),
        (lambda cls, a, s: cls(s <= 0.0, a, -a), _VALUES),
    )

    def __init__(self, condition: Anything, x: ExprLike, y: ExprLike) -> None:
        super().__init__(_predicate("Where", condition), x, y)

    def makes_boolean(self, *operands: bool) -> bool:
        return operands[1] and operands[2]

    def simplify(self) -> Expr:
        """A constant condition selects a side; equal sides need no condition; a Not exchanges the sides."""
        condition = self.condition
        if isinstance(condition, Not):
            return Where(condition.condition, self.y, self.x)
        if self.x.key() == self.y.key() and self.x.shape == self.shape:
            return self.x
        if isinstance(condition, Constant) and condition.value.all() and self.x.shape == self.shape:
            return self.x
        if isinstance(condition, Constant) and not condition.value.any() and self.y.shape == self.shape:
            return self.y
        return self


class Cond(Expr):
    """The true branch if the predicate is true, else the false branch; only the selected branch is evaluated.

    So a branch may be undefined where it is not selected: neither its value nor its derivative is computed. Under
    `jax.vmap` with a batched predicate both are evaluated, as in Where. For branches of a few operations Where is
    faster. The branches broadcast against each other.

    Attributes:
        predicate: a scalar comparison, All, Any, Not, or a list of conditions that must all hold.
        true_branch, false_branch: expressions of broadcastable shapes, in one unit.
    Raises:
        TypeError: the predicate is not a condition.
        ShapeError: the predicate is not a scalar, or the branches do not broadcast.
    """

    predicate: Operand
    true_branch: Operand
    false_branch: Operand
    kinds = rules.CHOICE
    keeps_order = True
    formula = _CASES
    cases = (
        (lambda cls, a, s: cls(s <= 1.0, a**2, s), _VALUES),
        (lambda cls, a, s: cls([s <= 1.0, s >= 0.5], a, -a), _VALUES),
    )

    def __init__(self, predicate: Anything, true_branch: ExprLike, false_branch: ExprLike) -> None:
        predicate = All(predicate) if isinstance(predicate, (list, tuple)) else _predicate("Cond", predicate)
        super().__init__(predicate, true_branch, false_branch)

    def infer_shape(self, *shapes: Shape) -> Shape:
        if shapes[0] != ():
            raise ShapeError(
                f"Cond expects predicate with shape (), got {shapes[0]}",
                hint="use tx.All or tx.Any for a single truth value, or tx.Where to select entry by entry",
            )
        return broadcast(self, *shapes[1:])

    def makes_boolean(self, *operands: bool) -> bool:
        return operands[1] and operands[2]

    def eager_children(self) -> list[Expr]:
        return [self.predicate]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        predicate, true_value, false_value = values
        return self.evaluate_on_demand([predicate], [lambda: true_value, lambda: false_value])

    def evaluate_on_demand(self, values: list[jax.Array], branches: Sequence[Callable[[], jax.Array]]) -> jax.Array:
        on_true, on_false = (lambda branch=branch: jnp.broadcast_to(branch(), self.shape) for branch in branches)
        return jax.lax.cond(values[0], on_true, on_false)

    def simplify(self) -> Expr:
        """A constant predicate selects a branch; equal branches need no predicate; a Not exchanges the branches."""
        if isinstance(self.predicate, Not):
            return Cond(self.predicate.condition, self.false_branch, self.true_branch)
        if self.true_branch.key() == self.false_branch.key():
            return self.true_branch
        if isinstance(self.predicate, Constant):
            chosen = self.true_branch if self.predicate.value.all() else self.false_branch
            if chosen.shape == self.shape:
                return chosen
            return self if chosen.boolean else chosen + zeros_of(self)
        return self
