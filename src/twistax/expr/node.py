"""The base class of nodes: immutable expressions with children, a shape, a value and a structural key.

A node class is defined in one file. It declares its fields, and some of the attributes and hooks of `Expr`. Traversal,
caching, keys, operators and printing are implemented once, for all nodes.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, TypeVar, cast, dataclass_transform, overload

import jax
import numpy as np

from ..checks import listed
from ..errors import ImmutableError, ModelError, OperationError, ShapeError
from .canonical import canonicalize_all
from .declaring import Field, bind_fields, declare_fields, digest, freeze
from .examples import Case, Example, example_of
from .graph import bottom_up, find_path
from .kinds.rules import Rule
from .operators import NODES, Operators, as_node
from .packing import pack, unpack
from .printing.printed import Printed

if TYPE_CHECKING:
    from ..groups import Order

    ExprLike: TypeAlias = "Expr | float | int | np.ndarray | jax.Array | list[Any] | tuple[Any, ...]"
else:
    ExprLike = Any

Shape = tuple[int, ...]
#: Values while a function is traced or run; where constants are folded, what NumPy has in place of an array of JAX.
Numbers = TypeVar("Numbers", jax.Array, Any)
E = TypeVar("E", bound="Expr")


class Operand:
    """Marks a field that holds one child expression (for type checkers it also accepts numbers and arrays)."""

    if TYPE_CHECKING:

        @overload
        def __get__(self, instance: None, owner: type) -> Operand: ...
        @overload
        def __get__(self, instance: object, owner: type) -> Expr: ...
        def __get__(self, instance: object | None, owner: type) -> Any: ...
        def __set__(self, instance: object, value: ExprLike) -> None: ...


if TYPE_CHECKING:
    Operands = tuple["Expr", ...]
else:

    class Operands:
        """Marks a field that holds any number of child expressions."""


@dataclass_transform(eq_default=False)
class Expr(Printed, Operators):
    """Base class of all expressions.

    Nodes are immutable. They hash by identity; `key()` compares them by structure. `==`, `<=` and `>=` build
    constraints.
    """

    #: What `evaluate` applies to the values of the operands, for a node without an `evaluate` of its own.
    function: ClassVar[Callable[..., Any]]
    #: The shapes that the operands must have and that of the result, for a node without `infer_shape` of its own.
    takes: ClassVar[tuple[Shape, ...]] = ()
    gives: ClassVar[Shape] = ()
    #: How to mend an operand of another shape.
    takes_hint: ClassVar[str | None] = None
    #: The fewest operands of a node that takes any number of them.
    fewest: ClassVar[int] = 1
    #: True where they may also come in a single list.
    listed: ClassVar[bool] = False
    #: Cases of the conformance suite where the node is smooth, and where it is not.
    cases: ClassVar[Sequence[Case]] = ()
    kinks: ClassVar[Sequence[Case]] = ()
    #: True for sums and products: an operand of the same class may be spliced into the operands.
    associative: ClassVar[bool] = False
    #: True when entries keep their places (sums, entrywise products): operands and result share their twist order.
    keeps_order: ClassVar[bool] = False
    #: What the node makes of kinds, frames and units; the conformance suite wants one, `tx.kinds.OPEN` at least.
    kinds: ClassVar[Rule | None] = None
    #: True where truth values of entries make no sense as operands.
    of_numbers: ClassVar[bool] = False
    #: True where `evaluate` needs nothing but operators, indices and methods that NumPy's arrays have too.
    by_operators: ClassVar[bool] = False
    #: True where `evaluate` reads static fields and the values of operands alone, and not what the operands are.
    by_values: ClassVar[bool] = True
    #: True for matrices whose `applied_to` is cheaper than a product with their numbers, even where these are known.
    structured: ClassVar[bool] = False
    #: True for states, controls, parameters, constants and time.
    is_leaf: ClassVar[bool] = False
    #: True for bases that are no nodes themselves. It is not inherited.
    abstract: ClassVar[bool] = True

    _fields: ClassVar[tuple[Field, ...]] = ()

    if TYPE_CHECKING:  # what `Operators` builds

        def __add__(self, other: Any) -> Expr: ...
        def __neg__(self) -> Expr: ...
        def __iter__(self) -> Iterator[Expr]: ...
        @property
        def T(self) -> Expr: ...

        __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = __add__
        __matmul__ = __rmatmul__ = __pow__ = __rpow__ = __getitem__ = __add__
        __pos__ = __abs__ = __invert__ = __neg__

    def __init_subclass__(cls, *, init: bool = True, **kwargs: Any) -> None:
        # `init=False` tells a type checker that the constructor is the inherited one.
        super().__init_subclass__(**kwargs)
        if "label" not in cls.__dict__:
            cls.label = cls.__name__
        if cls.__module__.startswith(f"{__package__}."):
            NODES[cls.__name__] = cls
        if "abstract" not in cls.__dict__:
            cls.abstract = False
        if {"evaluate", "function"} & cls.__dict__.keys() and "by_operators" not in cls.__dict__:
            cls.by_operators = False  # a new formula has to say so again
        if {"evaluate", "evaluate_on_demand"} & cls.__dict__.keys() and "by_values" not in cls.__dict__:
            cls.by_values = False
        declare_fields(cls, Expr.__init__)

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        if self.listed and len(args) == 1 and isinstance(args[0], (list, tuple)):
            args = tuple(args[0])
        values = bind_fields(type(self), args, kwargs)
        for field in self._fields:
            value = values[field.name]
            if field.variadic:
                value = tuple(map(self._child, value))
            setattr(self, field.name, self._child(value) if field.operand else value)
        self.validate()
        self._seal()

    def _child(self, value: Any) -> Expr:
        child = to_expr(value)
        return to_numbers(type(self).__name__, child) if self.of_numbers else child

    @classmethod
    def from_fields(cls: type[E], fields: Mapping[str, Any], *, validated: bool = True) -> E:
        """A node with these fields, built without its constructor; `validated` skips `validate`."""
        node = object.__new__(cls)
        node.__dict__.update(fields)
        if not validated:
            node.validate()
        node.__dict__["_sealed"] = True
        return node

    def validate(self) -> None:
        """Check static fields at construction; `infer_shape` checks shapes."""

    def _seal(self) -> None:
        self.__dict__["_sealed"] = True

    def __setattr__(self, name: str, value: Any) -> None:
        if "_sealed" in self.__dict__:
            raise ImmutableError(
                f"{type(self).__name__} is immutable: cannot assign {name!r}.\n"
                f"  fix: make a changed copy with .replace({name}=...)"
            )
        object.__setattr__(self, name, value)

    def __delattr__(self, name: str) -> None:
        raise ImmutableError(
            f"{type(self).__name__} is immutable: cannot delete {name!r}.\n  fix: build another expression"
        )

    def replace(self: E, **changes: Any) -> E:
        """A copy with some of the constructor's arguments changed."""
        taken = inspect.signature(type(self)).parameters.values()
        for name in changes.keys() - {p.name for p in taken}:
            raise OperationError(
                f"{type(self).__name__} has no {name!r}; it has: {listed([p.name for p in taken], name)}"
            )
        variadic = [p.name for p in taken if p.kind is p.VAR_POSITIONAL]
        arguments = {p.name: getattr(self, p.name) for p in taken} | changes
        operands = [operand for name in variadic for operand in arguments.pop(name)]
        return type(self)(*operands, **arguments)

    # ---- hooks -----------------------------------------------------------------------------------------------

    def infer_shape(self, *shapes: Shape) -> Shape:
        """Shape of the result from the children's shapes; raises ShapeError."""
        if not self.takes:
            raise NotImplementedError(f"{type(self).__name__} defines neither takes and gives nor infer_shape")
        for name, got, wanted in zip(self.child_names(), shapes, self.takes, strict=True):
            expect(self, name, got, wanted, self.takes_hint)
        return self.gives

    def evaluate(self, *values: Numbers) -> Numbers:
        """Value in jax.numpy from the children's values."""
        return type(self).function(*values)

    def eager_children(self) -> list[Expr]:
        """The children that are always evaluated: all, or the first ones if the others are branches.

        A child may be replaced by an expression that computes the value with a smaller error.
        """
        return self.children()

    def evaluate_on_demand(self, values: list[jax.Array], branches: Sequence[Callable[[], jax.Array]]) -> jax.Array:
        """Value from the values of the eager children; a branch is evaluated when it is called."""
        return self.evaluate(*values)

    def simplify(self) -> Expr:
        """A simpler node of the same shape, equal wherever this one is finite. Children are canonical."""
        return self

    def twist_orders(self) -> tuple[list[Order | None], Order | None]:
        """The twist order that each operand must have, and that of the result; None if any order is allowed."""
        return [None] * len(self.children()), None

    def twist_axes(self, value: Expr) -> list[int]:
        """The axes of this node or an operand to which `twist_orders` applies, counted from the last."""
        return [-1 - i for i in range(value.ndim)]

    def shared_orders(self) -> list[list[tuple[Expr, int]]]:
        """Groups of axes that must have one twist order, each as (operand or this node, axis counted from the last)."""
        values = [*self.children(), self] if self.keeps_order else []
        return [[(value, -k) for value in values if value.ndim >= k] for k in range(1, self.ndim + 1)]

    def applied_to(self, vector: Expr) -> Expr | None:
        """A cheaper node for the product of this matrix with a vector or with columns; None if there is none."""
        return None

    def transposed(self) -> Expr | None:
        """A node that is the transpose of this matrix, other than `Transpose`; None if there is none."""
        return None

    def inverted(self) -> Expr | None:
        """A node that is the inverse of this matrix, other than `Inv`; None if there is none."""
        return None

    def makes_group_element(self, *operands: bool) -> bool:
        """Whether the value is a rotation or a pose by construction, for these operands."""
        return False

    def makes_boolean(self, *operands: bool) -> bool:
        """Whether the entries are booleans, for these operands."""
        return False

    @classmethod
    def example(cls) -> list[Example]:
        """The examples for the conformance test suite."""
        cases = [(case, True) for case in cls.cases] + [(case, False) for case in cls.kinks]
        return [example_of(cls, case, smooth) for case, smooth in cases]

    # ---- structure -------------------------------------------------------------------------------------------

    def children(self) -> list[Expr]:
        """The operands, in order."""
        children: list[Expr] = []
        for field in self._fields:
            if field.variadic:
                children.extend(getattr(self, field.name))
            elif field.operand:
                children.append(getattr(self, field.name))
        return children

    def child_names(self) -> list[str]:
        """The path of each child: field names, with positions for variadic nodes."""
        names: list[str] = []
        for field in self._fields:
            if field.variadic:
                names.extend(f"{field.name}[{i}]" for i in range(len(getattr(self, field.name))))
            elif field.operand:
                names.append(field.name)
        return names

    def outline(self) -> list[tuple[str, Expr]]:
        """The named entries that `tree()` shows below this node: by default its children."""
        return list(zip(self.child_names(), self.children(), strict=True))

    def with_children(self: E, children: list[Expr]) -> E:
        """The same node with other children; a variadic node may get another number of them."""
        mine = self.children()
        if len(mine) == len(children) and all(a is b for a, b in zip(mine, children)):
            return self
        rest, fields = iter(children), {}
        free = len(children) - sum(field.operand for field in self._fields)
        for field in self._fields:
            value = getattr(self, field.name)
            if field.variadic:
                value = tuple(next(rest) for _ in range(free))
            elif field.operand:
                value = next(rest)
            fields[field.name] = value
        return type(self).from_fields(fields)

    def static_key(self) -> tuple[Any, ...]:
        """The data that distinguishes this node from others of its class with the same children."""
        return tuple(freeze(getattr(self, f.name)) for f in self._fields if not (f.operand or f.variadic))

    def key(self) -> str:
        """Digest of the structure: equal for trees of equal structure."""
        return bottom_up(self, "_key", lambda node: digest(type(node), node.static_key(), _read(node, "_key")))

    def check_shape(self) -> Shape:
        """The shape of the value.

        Raises: ShapeError if a shape in the tree does not match; the message names the node, its place, and a remedy.
        """
        return bottom_up(self, "_shape", lambda node: _shape_of(node, self))

    @property
    def shape(self) -> Shape:
        """The shape of the value; same as `check_shape()`."""
        known: Shape | None = self.__dict__.get("_shape")
        return self.check_shape() if known is None else known

    @property
    def ndim(self) -> int:
        """Number of axes of the value."""
        return len(self.shape)

    @property
    def is_group_element(self) -> bool:
        """Whether the value is known to be a rotation (3, 3) or a pose (4, 4); a plain matrix is not."""
        return bottom_up(self, "_element", lambda node: node.makes_group_element(*_read(node, "_element")))

    @property
    def boolean(self) -> bool:
        """Whether the entries are booleans, as in conditions."""
        return bottom_up(self, "_boolean", lambda node: node.makes_boolean(*_read(node, "_boolean")))

    def canonicalize(self) -> Expr:
        """A simpler tree of the same shape, equal wherever the original is finite."""
        return canonicalize_all([self])[0]

    def __hash__(self) -> int:
        return id(self)

    def __copy__(self: E) -> E:
        return self

    def __deepcopy__(self: E, memo: Any) -> E:
        return self

    def __reduce__(self) -> Any:
        return unpack, pack(self)


def _read(node: Expr, name: str) -> list[Any]:
    """What `bottom_up` keeps in the children."""
    return [child.__dict__[name] for child in node.children()]


def to_expr(value: Any) -> Expr:
    """The value itself if it is an expression, else a Constant of the number or array.

    Raises: ModelError for an object that is neither an expression nor made of real numbers.
    """
    node: Expr = as_node(value)
    return node


def _shape_of(node: Expr, root: Expr) -> Shape:
    try:
        return node.infer_shape(*_read(node, "_shape"))
    except ShapeError as error:
        raise error.located(f"{find_path(root, node)} in {root!r}") from None


def node_classes() -> Iterator[type[Expr]]:
    """Every class below `Expr`, wherever it is defined; one with several bases more than once."""
    waiting = Expr.__subclasses__()
    for cls in waiting:
        waiting.extend(cls.__subclasses__())
        yield cls


def all_nodes() -> list[type[Expr]]:
    """Every node class of this package, sorted by module and name. Bases marked `abstract` are left out."""
    package = __name__.partition(".")[0]
    classes = {cls for cls in node_classes() if not cls.abstract and cls.__module__.partition(".")[0] == package}
    return sorted(classes, key=lambda cls: (cls.__module__, cls.__qualname__))


def to_numbers(owner: str, child: Expr) -> Expr:
    """The operand of a node; constant truth values become 0 and 1. Raises ModelError for a condition."""
    if child.boolean and not child.is_leaf:
        raise ModelError(
            f"{owner} expects numbers, got the condition {child!r}.\n"
            "  fix: choose the numbers: tx.Where(condition, 1.0, 0.0)"
        )
    return to_expr(np.asarray(cast("Any", child).value, float)) if child.boolean else child


def expect(node: Expr, operand: str, got: Shape, wanted: Shape, hint: str | None = None) -> None:
    """Raise an error if an operand does not have the required shape."""
    if got != wanted:
        raise ShapeError(f"{type(node).__name__} expects {operand} with shape {wanted}, got {got}", hint=hint)
