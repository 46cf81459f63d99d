"""Sums, products, quotients, powers, matrix products: the nodes that operators build."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ShapeError
from ...groups.arrays import multiply
from ..bases import Chained, Entrywise, align, broadcast
from ..fields import Operand, Operands
from ..kinds import rules
from ..leaves import Constant
from ..node import Expr, Numbers, Shape
from ..printing.text import wrap_latex
from .comparisons import Comparison, Constraint, Equality, Inequality, Less  # noqa: F401  # for earlier pickles

_VECTOR, _MATRIX = [1.0, -2.0, 0.5], np.arange(6.0).reshape(2, 3) ** 1.5


def quotient(a: Numbers, b: Numbers) -> Numbers:
    """a / b entry by entry; for JAX arrays, its derivative neither overflows nor underflows."""
    if not (isinstance(a, jax.Array) or isinstance(b, jax.Array)):
        return a / b
    # Not at import: it loads much of JAX that `import jax` does not.
    from ...scalar.primitives import in_range

    return in_range.quotient(a, b)


def _behind_barrier(x: jax.Array) -> jax.Array:
    """x behind an optimization barrier, so that XLA does not combine it with other factors."""
    from ...scalar.primitives.in_range import behind_barrier  # not at import, as above

    return behind_barrier(x)


def is_constant(node: Expr, number: float) -> bool:
    """Whether every entry of a constant equals the number."""
    return isinstance(node, Constant) and bool((node.value == number).all())


def zeros_of(node: Expr) -> Constant:
    """A zero of the node's shape."""
    return Constant(np.zeros(node.shape))


class Add(Chained, init=False):
    """Sum a + b + ... with NumPy broadcasting.

    Attributes:
        terms: two or more expressions of broadcastable shapes, all with the same unit.
    Raises: ShapeError if the shapes do not broadcast.
    """

    terms: Operands
    kinds = rules.SUM
    function = operator.add
    infix = "+"
    cases = ({"terms": [_VECTOR, _MATRIX, Constant(2.0)]}, (lambda cls, a: cls(a, a), {"a": _VECTOR}))
    precedence = 10
    by_operators = True

    def simplify(self) -> Expr:
        """Fold constants, drop zeros and pairs x - x; the shape is preserved. Nested sums are already flattened."""
        constants = [t for t in self.terms if isinstance(t, Constant)]
        rest = _cancel([t for t in self.terms if not isinstance(t, Constant)])
        with np.errstate(all="ignore"):
            total = np.asarray(sum((c.value for c in constants), start=np.float64(0.0)))
        if not rest:
            return Constant(np.broadcast_to(total, self.shape))
        kept = np.broadcast_shapes(*(term.shape for term in rest))
        if total.any() or np.broadcast_shapes(kept, total.shape) != kept:
            rest.append(Constant(total))
            kept = np.broadcast_shapes(kept, total.shape)
        if kept != self.shape:
            rest.append(zeros_of(self))
        return rebuilt(self, rest, self.terms)

    def to_latex(self, *operands: str) -> str:
        return " + ".join(wrap_latex(t, s, 10) for t, s in zip(self.terms, operands)).replace("+ -", "- ")


class Sub(Entrywise):
    """Difference left - right with NumPy broadcasting.

    Raises: ShapeError if the shapes do not broadcast.
    """

    left: Operand
    right: Operand
    kinds = rules.DIFFERENCE
    function = operator.sub
    infix = "-"
    formula = "<0> - <1:11>"
    cases = ({"left": _VECTOR, "right": 0.25}, {"left": 3.0, "right": [1.0, 1.0, 1.0]})
    precedence = 10
    by_operators = True

    def simplify(self) -> Expr:
        """x - x is 0; x - 0 is x; 0 - x is -x; x - (-y) is x + y."""
        if self.left.key() == self.right.key() and not isinstance(self.left, Constant):
            return zeros_of(self)
        if is_constant(self.right, 0.0) and self.left.shape == self.shape:
            return self.left
        if is_constant(self.left, 0.0) and self.right.shape == self.shape:
            return Neg(self.right)
        if isinstance(self.right, Neg):
            return Add(self.left, self.right.operand)
        return self


class Mul(Chained, init=False):
    """Entrywise product a * b * ... with NumPy broadcasting.

    $x y^{-n}$ with a number n, and $x (1 / y)$, are computed as $x / y^n$: the derivative of $y^{-n}$ may underflow in
    single precision where that of the product does not. At 1.5e11 m the derivative of $r^{-3}$ is -6e-45, and that of
    $GM r^{-3}$ of the Sun is -8e-25.

    Attributes:
        factors: two or more expressions of broadcastable shapes.
    Raises: ShapeError if the shapes do not broadcast.
    """

    factors: Operands
    kinds = rules.PRODUCT
    function = operator.mul
    infix = "*"
    cases = ({"factors": [_VECTOR, -0.5, Constant(3.0)]},)
    precedence = 20
    by_operators = True

    def eager_children(self) -> list[Expr]:
        """The factors, with y^n in place of y^-n, and y in place of 1 / y."""
        return [factor if (divisor := _denominator(factor)) is None else divisor for factor in self.factors]

    def evaluate_on_demand(self, values: list[jax.Array], branches: Sequence[Callable[[], jax.Array]]) -> jax.Array:
        divides = [_denominator(factor) is not None for factor in self.factors]
        if not any(divides):
            return self.evaluate(*values)
        first = divides.index(False) if False in divides else None
        product = jnp.ones((), values[0].dtype) if first is None else values[first]
        fraction = first is not None and isinstance(self.factors[first], Div)
        for i, (value, is_divisor) in enumerate(zip(values, divides)):
            if is_divisor:
                product, fraction = quotient(_behind_barrier(product) if fraction else product, value), True
            elif i != first:
                product = operator.mul(*align(product, value))
        return product

    def simplify(self) -> Expr:
        """Fold constants, drop ones, absorb zeros; the shape is preserved. Nested products are already flattened."""
        constants = [f for f in self.factors if isinstance(f, Constant)]
        rest = [f for f in self.factors if not isinstance(f, Constant)]
        with np.errstate(all="ignore"):
            product = np.asarray(functools.reduce(operator.mul, (c.value for c in constants), np.float64(1.0)))
        # The product of the constants may overflow or underflow where that of all factors does not.
        zero = functools.reduce(np.logical_or, (c.value == 0.0 for c in constants), np.False_)
        if not np.isfinite(product).all() or ((product == 0.0) != zero).any():
            return self
        if not product.any() or not rest:
            return Constant(np.broadcast_to(product, self.shape))
        kept = np.broadcast_shapes(*(factor.shape for factor in rest))
        if (product != 1.0).any() or np.broadcast_shapes(kept, product.shape) != kept:
            rest.insert(0, Constant(product))
        return rebuilt(self, rest, self.factors)

    def to_latex(self, *operands: str) -> str:
        first, *rest = (wrap_latex(f, s, 20) for f, s in zip(self.factors, operands))
        # A number behind another factor needs a dot: 2 3 is not 23.
        return first + "".join((r" \cdot " if s[0].isdigit() else r" \, ") + s for s in rest)


def _denominator(node: Expr) -> Expr | None:
    """The denominator: y^n of y^-n with a constant n, y of 1 / y; None for any other node."""
    if isinstance(node, Div) and is_constant(node.left, 1.0) and node.right.shape == node.shape:
        return node.right
    if not isinstance(node, Power) or not isinstance(node.exponent, Constant) or node.exponent.value.ndim:
        return None
    exponent = float(node.exponent.value)
    if not exponent < 0.0:
        return None
    return node.base if exponent == -1.0 else Power(node.base, Constant(-exponent))


class Div(Entrywise):
    """Entrywise quotient left / right with NumPy broadcasting.

    Raises: ShapeError if the shapes do not broadcast.
    """

    left: Operand
    right: Operand
    kinds = rules.QUOTIENT
    function = quotient
    infix = "/"
    formula = r"\frac{<0>}{<1>}"
    cases = ({"left": _VECTOR, "right": -0.5},)
    precedence = 20
    by_operators = True

    def evaluate(self, *values: Numbers) -> Numbers:
        # XLA would make (a / b) / c a / (b c), and a / (b / c) (a c) / b: the products may be out of range.
        single = [isinstance(v, jax.Array) and v.dtype.itemsize < 8 for v in values]
        separate = [isinstance(a, Div) and s for a, s in zip((self.left, self.right), single)]
        operands = [_behind_barrier(v) if inner else v for v, inner in zip(values, separate)]
        return super().evaluate(*operands)

    def simplify(self) -> Expr:
        """x / 1 is x; 0 / x is 0, unless x is known to be zero or NaN."""
        if is_constant(self.right, 1.0) and self.left.shape == self.shape:
            return self.left
        return zeros_of(self) if is_constant(self.left, 0.0) and not isinstance(self.right, Constant) else self


class Neg(Entrywise):
    """Negative -x, entry by entry."""

    operand: Operand
    kinds = rules.NEGATIVE
    function = operator.neg
    formula = "-<0:15>"
    cases = ({"operand": _VECTOR},)
    precedence = 15
    by_operators = True

    def simplify(self) -> Expr:
        """-(-x) is x."""
        return self.operand.operand if isinstance(self.operand, Neg) else self

    def to_text(self, *operands: str) -> str:
        return f"(-{operands[0]})"


class Power(Entrywise):
    """Entrywise power base ** exponent with NumPy broadcasting.

    A constant integer exponent is computed by multiplication, so that its derivative at zero is exact. A negative one
    is the power of 1 / base, which is representable if the result is.

    Raises: ShapeError if the shapes do not broadcast.
    """

    base: Operand
    exponent: Operand
    kinds = rules.POWER
    precedence = 40
    infix = "**"
    formula = "{<0:50>}^{<1>}"
    cases = (
        {"base": [1.0, -2.0, 0.0], "exponent": Constant(2.0)},
        {"base": [1.0, 2.0, 0.5], "exponent": 1.3},
        {"base": [1.0, 2.0, 0.5], "exponent": Constant(-1.0)},
    )
    keeps_order = False

    def evaluate(self, *values: jax.Array) -> jax.Array:
        base, exponent = align(*values)
        if isinstance(self.exponent, Constant) and self.exponent.value.ndim == 0:
            number = float(self.exponent.value)
            if number.is_integer() and abs(number) <= 64:
                if isinstance(self.base, Mul) and _leaves_range(self.base.factors, number, base.dtype):
                    base = _behind_barrier(base)  # XLA would take the power of the number alone
                base = base if number >= 0.0 else quotient(jnp.ones_like(base), base)
                return jax.lax.integer_pow(base, abs(int(number)))
        if isinstance(self.exponent, Constant) and (self.exponent.value <= -1.0).all():
            return jnp.power(quotient(jnp.ones((), base.dtype), base), -exponent)
        if isinstance(self.exponent, Constant) and (self.exponent.value < 0.0).all():
            return quotient(jnp.ones((), base.dtype), jnp.power(base, -exponent))
        return jnp.power(base, exponent)

    def simplify(self) -> Expr:
        """x ** 1 is x; x ** 0 is 1."""
        if is_constant(self.exponent, 1.0) and self.base.shape == self.shape:
            return self.base
        return Constant(np.ones(self.shape)) if is_constant(self.exponent, 0.0) else self


def _leaves_range(factors: Sequence[Expr], exponent: float, dtype: Any) -> bool:
    """Whether the power of a constant factor alone overflows or underflows; that of the whole product may not."""
    info = jnp.finfo(dtype)
    with np.errstate(all="ignore"):
        powers = [np.abs(np.asarray(f.value, float)) ** abs(exponent) for f in factors if isinstance(f, Constant)]
    return any(bool(((p != 0.0) & ((p < info.tiny**0.5) | (p > info.max**0.5))).any()) for p in powers)


#: Matrix products of at most so many scalar multiplications are written as sums of products, which XLA fuses.
_SMALL = 512


class MatMul(Expr):
    """Matrix product left @ right, NumPy's rules for vectors, matrices and stacks.

    Raises: ShapeError for a scalar operand, or inner sizes that differ.
    """

    kinds = rules.MATRIX_PRODUCT
    of_numbers = True
    by_values = True
    left: Operand
    right: Operand
    infix = "@"
    formula = r"<0:20> \, <1:21>"
    cases = (
        {"left": _MATRIX, "right": _VECTOR},
        {"left": _VECTOR, "right": [0.3, 1.0, 2.0]},
        {"left": _MATRIX, "right": Constant(np.ones((3, 2)))},
    )
    precedence = 20

    def infer_shape(self, *shapes: Shape) -> Shape:
        left, right = shapes
        if not left or not right:
            raise ShapeError(
                f"MatMul expects vectors or matrices, got {left} @ {right}", hint="use * to multiply by a scalar"
            )
        inner = right[-2] if len(right) > 1 else right[0]
        if left[-1] != inner:
            point = "; tx.lie.Act(T, p) transforms the point p by the pose T" if (left, inner) == ((4, 4), 3) else ""
            hint = f"{left[-1]} columns meet {inner} rows{point}"
            raise ShapeError(f"MatMul incompatible shapes: {left} @ {right}", hint=hint)
        stack = broadcast(self, left[:-2], right[:-2])
        return stack + (left[-2:-1] if len(left) > 1 else ()) + (right[-1:] if len(right) > 1 else ())

    def evaluate(self, *values: jax.Array) -> jax.Array:
        left, right = values
        if left.ndim > 2 or right.ndim > 2 or left.size * right.size > _SMALL * right.shape[0]:
            if left.ndim > 2 and right.ndim > 2:
                left, right = align(left, right)
            return jnp.matmul(left, right, precision=jax.lax.Precision.HIGHEST)
        if left.ndim == 1:
            return jnp.sum((left if right.ndim == 1 else left[:, None]) * right, axis=0)
        return multiply(left, right)

    def shared_orders(self) -> list[list[tuple[Expr, int]]]:
        left, right = self.left, self.right
        shared = [[(left, -1), (right, -min(right.ndim, 2))]]
        if left.ndim > 1:
            shared.append([(left, -2), (self, -1 if right.ndim == 1 else -2)])
        if right.ndim > 1:
            shared.append([(right, -1), (self, -1)])
        return shared

    def makes_group_element(self, *operands: bool) -> bool:
        return all(operands)

    def simplify(self) -> Expr:
        """Identity matrices vanish; a product with zeros is zero; some matrices are applied without being built."""
        if is_identity(self.left) and self.right.shape == self.shape:
            return self.right
        if is_identity(self.right) and self.left.shape == self.shape:
            return self.left
        both = isinstance(self.left, Constant) and isinstance(self.right, Constant)  # whose product is not finite
        if not both and (is_constant(self.left, 0.0) or is_constant(self.right, 0.0)):
            return zeros_of(self)
        applied = self.left.applied_to(self.right) if self.right.ndim in (1, 2) else None
        return self if applied is None else applied

    def applied_to(self, vector: Expr) -> Expr | None:
        """(A B) x is A (B x), which needs no matrix product."""
        matrices = self.left.ndim == self.right.ndim == 2
        return MatMul(self.left, MatMul(self.right, vector)) if matrices and vector.ndim == 1 else None


def is_identity(node: Expr) -> bool:
    """Whether a constant is an identity matrix."""
    if not isinstance(node, Constant) or node.value.ndim != 2 or node.value.shape[0] != node.value.shape[1]:
        return False
    return bool((node.value == np.eye(node.value.shape[0])).all())


def _cancel(terms: list[Expr]) -> list[Expr]:
    """Drop pairs x, -x."""
    left: dict[int, Expr] = {}
    waiting: dict[tuple[str, bool], list[int]] = {}
    for i, term in enumerate(terms):
        negative = isinstance(term, Neg)
        key = term.operand.key() if isinstance(term, Neg) else term.key()
        opposite = waiting.get((key, not negative))
        if opposite:
            del left[opposite.pop()]
        else:
            left[i] = term
            waiting.setdefault((key, negative), []).append(i)
    return list(left.values())


def rebuilt(node: Any, operands: list[Expr], before: tuple[Expr, ...]) -> Expr:
    """The variadic node with new operands; itself if nothing changed, the operand if only one is left."""
    if len(operands) == 1:
        return operands[0]
    if len(operands) == len(before) and all(a.key() == b.key() for a, b in zip(operands, before)):
        return node
    return type(node)(*operands)
