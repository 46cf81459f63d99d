"""Maps of an expression over the elements of a batch."""

from __future__ import annotations

import contextlib
import contextvars
import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import callable_with, whole
from ...errors import ModelError, OperationError, ShapeError
from ..fields import Operands
from ..graph import function_of, leaves_of, other_leaves, substitute
from ..kinds import rules
from ..leaves import Constant, Leaf
from ..node import Expr, Shape, to_expr, to_numbers
from ..operations.comparisons import Constraint

#: The placeholders of the Vmaps that are being built around the current one.
_around: contextvars.ContextVar[tuple[tuple[Placeholder, ...], ...]] = contextvars.ContextVar("around", default=())


_POINTS = np.arange(8.0).reshape(4, 2) ** 1.5


#: Makes a program from the function of one element, and a key that is equal for functions that compute the same.
_Program: TypeAlias = Callable[[Callable[..., Any], str], Callable[..., Any]]


class _Programs(NamedTuple):
    """What makes programs of the elements of batches: of copies of a system, and of parts of one."""

    copies: _Program | None = None
    parts: _Program | None = None


_programs: contextvars.ContextVar[_Programs] = contextvars.ContextVar("programs", default=_Programs())  # noqa: B039


@contextlib.contextmanager
def elements_by(*, copies: _Program | None = None, parts: _Program | None = None) -> Iterator[None]:
    """A context in which each batch of copies of a system, or of parts of one, is a batch of the program of one
    element.
    """
    token = _programs.set(_Programs(copies, parts))
    try:
        yield
    finally:
        _programs.reset(token)


class Placeholder(Leaf):
    """One element of a batch inside the body of a Vmap. It has no meaning elsewhere."""

    # It is no node of its own for users or for the conformance suite.
    abstract = True

    def __init__(self, depth: int, number: int, shape: Shape) -> None:
        self._declare(f"e_{depth}.{number}", shape)

    def read(self, inputs: Any) -> jax.Array:
        raise _leaked(self)


def _leaked(element: Placeholder) -> ModelError:
    return ModelError(
        f"{element.name!r} stands for an element of a Vmap's batch and has no value outside of that Vmap's body.\n"
        "  fix: use it within the function that Vmap was given; for elements of several batches Vmap(fn, [a, b])"
    )


def no_elements(leaves: Iterable[Leaf], but: Iterable[Placeholder] = ()) -> None:
    """Raise ModelError if an element of a Vmap is among the leaves, other than the known ones."""
    known = set(map(id, but))
    for leaf in leaves:
        if isinstance(leaf, Placeholder) and id(leaf) not in known:
            raise _leaked(leaf)


class Vmap(Expr):
    """fn applied to every element of a batch: `Vmap(lambda p: Norm(x - p), batch=points)`.

    Shapes: batches (n, *s), mapped over `axis`; fn maps an expression of shape s, for each batch, to one of shape r;
    the result is (n, *r). fn is called once, when the expression is built; it may use any other leaf or expression.

    If fn returns a constraint the result is the constraint on all elements:
    `Vmap(lambda p: Norm(x - p) >= 1, points)` is `Vmap(lambda p: 1 - Norm(x - p), points) <= 0`.

    Attributes:
        batches: the expressions or arrays to map over; a list means several batches, one for each argument of fn.
        axis: the axis mapped over, counted from 0.
        body: what fn returned.
        placeholders: the arguments fn was called with.
        copies: whether the elements are systems that are large enough for a separate program; see `elements_by`.
    Raises:
        ShapeError: a batch without that axis, or batches of different length; a substitution that changes the shape of
            the elements.
        ModelError: no batch; a batch of conditions.
    """

    batches: Operands
    axis: int
    body: Expr
    placeholders: tuple[Expr, ...]
    copies: bool = False
    kinds = rules.MAPPED
    cases = (
        (lambda cls, x, points: cls(lambda p: p * x - 2.0, points), {"x": [0.3, -0.4], "points": _POINTS}),
        (
            lambda cls, x, points, radii: cls(lambda p, r: r * (p @ x), [points, radii]),
            {"x": [0.3, -0.4], "points": _POINTS, "radii": np.arange(1.0, 5.0)},
        ),
        (lambda cls, points: cls(lambda c: c @ c, points, axis=1), {"points": _POINTS}),
        (lambda cls, points: cls(lambda p: cls(lambda q: p @ q, points), points), {"points": _POINTS}),
    )

    def __new__(cls, fn: Callable[..., Any], batch: Any, axis: int = 0) -> Any:
        axis = whole("Vmap: axis", axis, 0, ShapeError)
        batches = _batches(batch if isinstance(batch, (list, tuple)) else [batch])
        around = _around.get()
        elements = enumerate(_element_shapes([b.check_shape() for b in batches], axis))
        placeholders = tuple(Placeholder(len(around), i, shape) for i, shape in elements)
        callable_with("Vmap", fn, [placeholder.name for placeholder in placeholders], OperationError)
        token = _around.set((*around, placeholders))
        try:
            body = _expression(fn(*placeholders))
        finally:
            _around.reset(token)
        no_elements(leaves_of(body, *batches), but=[*placeholders, *itertools.chain(*around)])
        residual = body.residual() if isinstance(body, Constraint) else body
        node = cls.from_fields(
            {"batches": batches, "axis": axis, "body": residual, "placeholders": placeholders, "copies": False}
        )
        return type(body)(node, 0.0) if isinstance(body, Constraint) else node

    def __init__(self, fn: Callable[..., Any], batch: Any, axis: int = 0) -> None:
        """Everything is done by `__new__`, which for a constraint gives a constraint."""

    def replace(self, **changes: Any) -> Vmap:
        raise OperationError(f"a Vmap has no fields to replace, got {', '.join(changes)}.\n  fix: build another Vmap")

    @functools.cached_property
    def captured(self) -> list[Leaf]:
        """The leaves that the body depends on besides its placeholders."""
        return other_leaves(self.body, self.placeholders)

    def makes_boolean(self, *operands: bool) -> bool:
        return self.body.boolean

    def children(self) -> list[Expr]:
        return [*self.batches, *self.captured]

    def child_names(self) -> list[str]:
        return [f"batches[{i}]" for i in range(len(self.batches))] + ["body"] * len(self.captured)

    def outline(self) -> list[tuple[str, Expr]]:
        return [("body", self.body), *((f"batches[{i}]", batch) for i, batch in enumerate(self.batches))]

    def with_children(self, children: list[Expr]) -> Vmap:
        batches, captured = children[: len(self.batches)], children[len(self.batches) :]
        exchange = {old.key(): new for old, new in zip(self.captured, captured, strict=True) if old.key() != new.key()}
        body = substitute(self.body, exchange) if exchange else self.body
        return (
            self
            if body is self.body and all(a is b for a, b in zip(batches, self.batches))
            else self.over(_batches(batches), body)
        )

    def over(self, batches: Sequence[Expr], body: Expr) -> Vmap:
        """The same map with other batches and another body with the same placeholders."""
        fields = {"batches": tuple(batches), "axis": self.axis, "body": body, "placeholders": self.placeholders}
        return type(self).from_fields(fields | {"copies": self.copies})

    def of_copies(self) -> Vmap:
        """The same for elements that are systems."""
        return Vmap.from_fields({field.name: getattr(self, field.name) for field in self._fields} | {"copies": True})

    def of_parts(self) -> Vmap:
        """The same for elements that are parts of one system, such as limbs."""
        return MapOfParts.from_fields({field.name: getattr(self, field.name) for field in self._fields})

    def infer_shape(self, *shapes: Shape) -> Shape:
        elements = _element_shapes(list(shapes[: len(self.batches)]), self.axis)
        for i, (shape, placeholder) in enumerate(zip(elements, self.placeholders, strict=True)):
            if shape != placeholder.shape:
                raise ShapeError(
                    f"Vmap expects elements of batch {i} with shape {placeholder.shape}, for which its function was "
                    f"called, got {shape}.\n  fix: build another Vmap"
                )
        return (shapes[0][self.axis], *self.body.check_shape())

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self._mapped(_programs.get().copies if self.copies else None, *values)

    def _mapped(self, program: _Program | None, *values: jax.Array) -> jax.Array:
        leaves, count = [*self.placeholders, *self.captured], len(self.batches)
        if program is None:
            element = function_of(self.body, leaves, {})
        else:  # numbers are part of the program
            by_leaf = dict(zip(leaves, values, strict=True))
            with jax.ensure_compile_time_eval():
                numbers = {
                    leaf.key(): jnp.asarray(leaf.value, by_leaf.pop(leaf).dtype)
                    for leaf in self.captured
                    if isinstance(leaf, Constant)
                }
            element = program(function_of(self.body, list(by_leaf), numbers), self.body.key())
            values = tuple(by_leaf.values())
        in_axes = (*[self.axis] * count, *[None] * (len(values) - count))
        return jax.vmap(element, in_axes=in_axes)(*values)

    def simplify(self) -> Expr:
        """The body is simplified."""
        body = self.body.canonicalize()
        return self if body is self.body else self.over(self.batches, body)

    def details(self) -> list[str]:
        return [f"axis={self.axis}"] if self.axis else []

    def to_text(self, *operands: str) -> str:
        names = ", ".join(p.to_text() for p in self.placeholders)
        batches = ", ".join(operands[: len(self.batches)])
        batches = batches if len(self.batches) == 1 else f"[{batches}]"
        return f"Vmap({', '.join([f'{names} -> {self.body!r}', f'batch={batches}', *self.details()])})"

    def to_latex(self, *operands: str) -> str:
        pairs = zip(self.placeholders, operands)
        over = r",\, ".join(rf"{p.to_latex()} \in {batch}" for p, batch in pairs)
        return rf"\left[{self.body.latex()}\right]_{{{over}}}"


class MapOfParts(Vmap):
    """A Vmap over parts of one system. The function of one part is traced once in programs of scalars."""

    # It is a Vmap for users and for the conformance suite.
    abstract = True

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self._mapped(_programs.get().parts, *values)


def _expression(value: Any) -> Expr:
    try:
        return to_expr(value)
    except ModelError as error:
        raise ModelError(f"Vmap expects a function that returns an expression: {error}") from None


def _batches(values: Iterable[Any]) -> tuple[Expr, ...]:
    """Operands made of numbers. Raises ModelError."""
    return tuple(to_numbers("Vmap", to_expr(value)) for value in values)


def _element_shapes(shapes: list[Shape], axis: int) -> list[Shape]:
    if not shapes:
        raise ModelError("Vmap expects at least one batch, got []")
    for i, shape in enumerate(shapes):
        if axis >= len(shape):
            raise ShapeError(f"Vmap expects batch {i} to have the axis {axis}, got shape {shape}")
        if shape[axis] != shapes[0][axis]:
            raise ShapeError(
                f"Vmap expects batches of equal length along axis {axis}, "
                f"got {shapes[0][axis]} and {shape[axis]} (batch {i})"
            )
    return [shape[:axis] + shape[axis + 1 :] for shape in shapes]
