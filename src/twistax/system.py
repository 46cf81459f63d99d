"""A system: states with their rates, outputs and constraints, checked as a whole when it is built."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar

from .errors import ModelError, ShapeError
from .expr import Constraint, Control, Expr, Leaf, Parameter, State, check_orders, find_path, leaves_of, to_expr
from .expr.fields import ExprLike
from .groups import Euclidean, Product

L = TypeVar("L", bound=Leaf)


class System:
    """Dynamics x' = f(t, x, u, p) on a product of Lie groups, with outputs and constraints.

    Args:
        rates: the rate of every state; keys are the states or their names, in the order tangent vectors shall have.
            The rate of a group-valued state is its body velocity, shape (3,) or (6,); of another state, of its shape.
        outputs: named expressions to be computed on demand.
        constraints: constraints (`a <= b`, `a >= b`, `a == b`), a list or a mapping from names.
        controls, parameters: declare them to fix their order or to keep unused ones; otherwise they are found.

    Attributes:
        states, controls, parameters: tuples of leaves in order.
        rates: mapping from state name to expression.
        outputs, constraints: mappings from name to expression.
        group: the product group the state lives on.

    Raises:
        ModelError: a missing, unknown, duplicate or undeclared name.
        ShapeError: a rate of the wrong shape, or a shape that does not fit inside an expression.
        OrderError: a [v; w] quantity meets a [w; v] one.
    """

    def __init__(
        self,
        rates: Mapping[State | str, ExprLike],
        outputs: Mapping[str, ExprLike] | None = None,
        constraints: Sequence[Constraint] | Mapping[str, Constraint] = (),
        *,
        controls: Iterable[Control] | None = None,
        parameters: Iterable[Parameter] | None = None,
    ) -> None:
        if not rates:
            raise ModelError("a System needs at least one state with a rate: rates={x: expression}")
        self.outputs: dict[str, Expr] = {name: to_expr(expr) for name, expr in (outputs or {}).items()}
        self.constraints: dict[str, Constraint] = _named_constraints(constraints)
        self._roots: dict[str, Expr] = {
            **{f"rates[{_name_of(key)!r}]": to_expr(rate) for key, rate in rates.items()},
            **{f"outputs[{name!r}]": expr for name, expr in self.outputs.items()},
            **{f"constraints[{name!r}]": expr for name, expr in self.constraints.items()},
        }
        used = list(leaves_of(*self._roots.values()))
        self.states: tuple[State, ...] = _declared_states(rates, used)
        self.rates: dict[str, Expr] = {s.name: to_expr(r) for s, r in zip(self.states, rates.values())}
        self.controls: tuple[Control, ...] = _declared(Control, controls, used, self._place)
        self.parameters: tuple[Parameter, ...] = _declared(Parameter, parameters, used, self._place)
        self.group = Product({state.name: state.group for state in self.states})
        self._check_names([*self.states, *self.controls, *self.parameters], used)
        self._check_shapes()
        check_orders(self._roots, {state: self.rates[state.name] for state in self.states})

    def __repr__(self) -> str:
        kinds = (("states", self.states), ("controls", self.controls), ("parameters", self.parameters))
        return f"System({', '.join(f'{kind}={[leaf.name for leaf in leaves]}' for kind, leaves in kinds)})"

    def _place(self, leaf: Leaf) -> str:
        """Where a leaf is first used."""
        for name, root in self._roots.items():
            if any(found is leaf for found in leaves_of(root)):
                return f"{name}: {find_path(root, leaf)}"
        return "not used"

    def _check_names(self, declared: list[Leaf], used: list[Leaf]) -> None:
        known: dict[str, Leaf] = {}
        for leaf in declared:
            if leaf.name in known:
                raise ModelError(
                    f"two leaves are named {leaf.name!r}: {_kind(known[leaf.name])} and {_kind(leaf)}.\n"
                    "  fix: names are unique within a system; rename one"
                )
            known[leaf.name] = leaf
        for leaf in used:
            if isinstance(leaf, (State, Control, Parameter)):
                mine = known.get(leaf.name)
                if mine is None:
                    raise ModelError(
                        f"State {leaf.name!r} has no rate.\n  at: {self._place(leaf)}\n"
                        f"  fix: add {leaf.name}: <rate> to rates, or make it a Control or a Parameter"
                    )
                if mine.key() != leaf.key():
                    raise ModelError(
                        f"two leaves are named {leaf.name!r}: {_kind(mine)} and {_kind(leaf)}.\n"
                        f"  at: {self._place(leaf)}\n  fix: names are unique within a system; rename one"
                    )

    def _check_shapes(self) -> None:
        for name, root in self._roots.items():
            try:
                root.check_shape()
            except ShapeError as error:
                raise error.located(f"{name}: {error.at}") from None
        for state in self.states:
            rate = self.rates[state.name]
            euclidean = isinstance(state.group, Euclidean)
            wanted = state.shape if euclidean else (state.group.dimension,)
            if rate.shape != wanted:
                kind = "of the state's shape" if euclidean else f"a body velocity on {state.group.name}"
                raise ShapeError(
                    f"the rate of {state.name!r} expects shape {wanted}, got {rate.shape}",
                    at=f"rates[{state.name!r}] = {rate!r}",
                    hint=f"a rate here is {kind}",
                )


def _kind(leaf: Leaf) -> str:
    return f"{type(leaf).__name__} of shape {leaf.shape}"


def _name_of(key: State | str) -> str:
    return key if isinstance(key, str) else getattr(key, "name", repr(key))


def _named_constraints(constraints: Sequence[Constraint] | Mapping[str, Constraint]) -> dict[str, Constraint]:
    if not isinstance(constraints, Mapping):
        if isinstance(constraints, Expr):
            constraints = [constraints]
        named: dict[str, Constraint] = {}
        for constraint in constraints:
            name = text = repr(constraint)
            number = 1
            while name in named:
                number += 1
                name = f"{text} ({number})"
            named[name] = constraint
        constraints = named
    for name, constraint in constraints.items():
        if not isinstance(constraint, Constraint):
            raise ModelError(
                f"constraint {name!r} is not a constraint but {type(constraint).__name__}.\n"
                "  fix: compare expressions, e.g. tx.linalg.Norm(F) <= 10.0"
            )
    return dict(constraints)


def _declared_states(rates: Mapping[State | str, ExprLike], used: list[Leaf]) -> tuple[State, ...]:
    found = {leaf.name: leaf for leaf in used if isinstance(leaf, State)}
    states: list[State] = []
    for key in rates:
        if isinstance(key, State):
            states.append(key)
        elif isinstance(key, str):
            if key not in found:
                known = ", ".join(sorted(found)) or "none"
                raise ModelError(
                    f"rates names {key!r}, but no State of that name is used (known: {known}).\n"
                    "  fix: give the State itself as the key"
                )
            states.append(found[key])
        else:
            raise ModelError(f"a key of rates must be a State or its name, got {key!r}")
    return tuple(states)


def _declared(kind: type[L], declared: Iterable[L] | None, used: list[Leaf], place: object) -> tuple[L, ...]:
    found: dict[str, L] = {}
    for leaf in used:
        if isinstance(leaf, kind):
            other = found.setdefault(leaf.name, leaf)
            if other is not leaf and _metadata(other) != _metadata(leaf):
                raise ModelError(
                    f"two {kind.__name__}s are named {leaf.name!r} and differ in shape, bounds or value.\n"
                    "  fix: use one object, or rename one"
                )
    if declared is None:
        return tuple(found.values())
    declared = tuple(declared)
    for leaf in declared:
        if not isinstance(leaf, kind):
            raise ModelError(f"{kind.__name__.lower()}s must be {kind.__name__} leaves, got {leaf!r}")
    missing = [name for name in found if name not in {leaf.name for leaf in declared}]
    if missing:
        where = place(found[missing[0]]) if callable(place) else ""
        raise ModelError(
            f"{kind.__name__} {missing[0]!r} is used but not declared.\n  at: {where}\n"
            f"  fix: add it to {kind.__name__.lower()}s=, or leave {kind.__name__.lower()}s= out"
        )
    return declared


def _metadata(leaf: Leaf) -> tuple[object, ...]:
    from .expr.fields import freeze

    return (leaf.key(), *(freeze(v) for k, v in sorted(leaf.__dict__.items()) if not k.startswith("_")))
