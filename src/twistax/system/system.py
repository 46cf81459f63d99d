"""The system class: states with their rates, outputs and constraints, checked at construction."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Container, Iterable, Mapping, Sequence
from html import escape
from typing import Any, TypeVar

import numpy as np

from ..checks import listed, short
from ..errors import ModelError, ShapeError
from ..expr import (
    Constraint,
    Control,
    Expr,
    Leaf,
    Noise,
    Parameter,
    State,
    check_orders,
    declares,
    find_path,
    leaves_of,
    postorder,
    refuse_conditions,
)
from ..expr.fields import ExprLike, freeze
from ..expr.operations.comparisons import ConstraintSet
from ..expr.operations.soft import Asked, Soft, hard
from ..expr.packing import pack, unpack
from ..expr.printing.mathml import mathml
from ..expr.printing.picture import Picture, svg
from ..expr.printing.text import name_latex
from ..expr.transformations.vmap import no_elements
from ..groups import Product
from .composable import Composable
from .declared import KnownSlopes, Slopes, SlopesOnDemand, checked_slopes, expression_at, name_of, need_finite
from .labels import Labels, checked_labels

L = TypeVar("L", bound=Leaf)


class System(Composable):
    """Dynamics $x' = f(t, x, u, p)$ on a product of Lie groups, with outputs and constraints.

    Args:
        rates: the rate of every state; keys are the states or their names, in the order of tangent vectors. The rate of
            a group-valued state is its body velocity, (3,) or (6,); the rate of another state has the state's shape.
        outputs: named expressions that are computed on demand.
        constraints: constraints (`a <= b`, `a >= b`, `a == b`) or `Soft` ones: one, a list, or a mapping from names.
        corrections: for states whose exact motion stays on a manifold, such as that of closed loops: the increment of
            one Newton step onto the manifold; keys and shapes are as in `rates`. `tx.integrate` applies it after every
            step, `Dynamics.project` iterates it.
        controls, parameters: declares them, to determine their order or to keep unused ones; by default they are
            collected.
        labels: by state or control, a pair of name and unit for each entry.
        slopes: analytical derivatives of rates, for `Dynamics.jacobian`: for a state, pairs (argument, derivative). The
            argument is a state, for a derivative with respect to right perturbations, or any vector; dependence through
            this argument is not differentiated again.

    Attributes:
        states, controls, parameters, noises: tuples of leaves in order.
        rates, outputs, constraints, corrections: mappings from name to expression.
        soft: mapping from the names of soft constraints to their `Soft`.
        slopes, labels: mappings from the name of a leaf to pairs as above.
        group: the product group of all states.

    Raises:
        ModelError: a missing, unknown, duplicate or undeclared name; different leaves with one name; a value that is
            not an expression.
        ShapeError: a rate of the wrong shape, or inconsistent shapes inside an expression.
        OrderError: a [v; w] quantity is combined with a [w; v] quantity.
        KindError: values that must agree differ in their declared kind, frame or unit.

    Example: `tx.System(rates={x: v, v: (F - k * x) / m}, outputs={"energy": 0.5 * (m * v * v + k * x * x)})`
    """

    noises: tuple[Noise, ...] = ()  # for pickles of earlier versions

    def __init__(
        self,
        rates: Mapping[State | str, ExprLike],
        outputs: Mapping[str, ExprLike] | None = None,
        constraints: Asked | Iterable[Asked] | Mapping[str, Asked] = (),
        *,
        corrections: Mapping[State | str, ExprLike] | None = None,
        controls: Iterable[Control] | None = None,
        parameters: Iterable[Parameter] | None = None,
        slopes: Slopes | SlopesOnDemand | None = None,
        labels: Labels | None = None,
    ) -> None:
        if not isinstance(rates, Mapping) or not rates:
            got = short(rates) if isinstance(rates, Mapping) else type(rates).__name__
            raise ModelError(f"a System needs at least one state with a rate: rates={{x: expression}}, got {got}")
        if outputs is not None and not isinstance(outputs, Mapping):
            raise ModelError(f"outputs must be a dict from names to expressions, got {type(outputs).__name__}")
        for name in (name for name in outputs or () if not isinstance(name, str)):
            raise ModelError(f"outputs must be a dict from names to expressions, got the name {name!r}")
        expressions = {key: expression_at(f"rates[{name_of(key)!r}]", rate) for key, rate in rates.items()}
        self.outputs: dict[str, Expr] = {n: expression_at(f"outputs[{n!r}]", e) for n, e in (outputs or {}).items()}
        named = constraints_by_name(constraints)
        self.soft = {name: constraint for name, constraint in named.items() if isinstance(constraint, Soft)}
        self.constraints: dict[str, Constraint] = {name: hard(constraint) for name, constraint in named.items()}
        if corrections is not None and not isinstance(corrections, Mapping):
            raise ModelError(f"corrections must be a dict from states to expressions, got {short(corrections)}")
        self.corrections: dict[str, Expr] = {
            name_of(key): expression_at(f"corrections[{name_of(key)!r}]", e) for key, e in (corrections or {}).items()
        }
        self._roots: dict[str, Expr] = {
            **{f"corrections[{name!r}]": expr for name, expr in self.corrections.items()},
            **{f"rates[{name_of(key)!r}]": rate for key, rate in expressions.items()},
            **{f"outputs[{name!r}]": expr for name, expr in self.outputs.items()},
            **{f"constraints[{name!r}]": expr for name, expr in self.constraints.items()},
        }
        nodes = postorder(*self._roots.values())
        no_elements(leaves := [node for node in nodes if isinstance(node, Leaf)])
        for leaf in leaves:
            leaf.check_in_system()
        used = [leaf for leaf in leaves if isinstance(leaf, (State, Control, Parameter, Noise))]
        self.states: tuple[State, ...] = _states(rates, used)
        self.rates: dict[str, Expr] = dict(zip((s.name for s in self.states), expressions.values(), strict=True))
        self.controls: tuple[Control, ...] = self._declared(Control, controls, used)
        self.parameters: tuple[Parameter, ...] = self._declared(Parameter, parameters, used)
        self.noises = self._declared(Noise, None, used)
        self._check_names([*self.states, *self.controls, *self.parameters, *self.noises], used)
        self.group = Product({state.name: state.group for state in self.states})
        self._check_shapes()
        self._check_corrections()
        if isinstance(slopes, SlopesOnDemand):
            self._slopes = slopes
        else:
            self._slopes = SlopesOnDemand(lambda _: slopes or {})
            self.slopes = self.slopes_with(self.rates)  # checked at once
        self.labels = checked_labels(labels, (*self.states, *self.controls))
        rate_of = {state: self.rates[state.name] for state in self.states}
        check_orders(self._roots, rate_of)
        if any(map(declares, (*self.states, *nodes))):
            from ..expr.kinds.inference import infer_kinds  # most systems do without

            infer_kinds(self._roots, rate_of, [*self.states, *leaves], nodes)

    def __repr__(self) -> str:
        kinds = ("states", "controls", "parameters")
        return f"System({', '.join(f'{kind}={[leaf.name for leaf in getattr(self, kind)]}' for kind in kinds)})"

    def latex(self) -> str:
        """The equations in LaTeX, without dollar signs. The rate of a pose or rotation is its body velocity."""
        lines = []
        for state in self.states:
            left, rate = rf"\dot{{{state.latex()}}} &= ", self.rates[state.name].latex()
            flat = state.group.flat
            lines.append(left + (rate if flat else rf"{state.latex()} \left({rate}\right)^{{\wedge}}"))
        lines += [rf"{name_latex(name)} &= {expr.latex()}" for name, expr in self.outputs.items()]
        lines += [rf"& {constraint.latex()}" for constraint in self.constraints.values()]
        return r"\begin{aligned} " + r" \\ ".join(lines) + r" \end{aligned}"

    def svg(self) -> Picture:
        """The graphs of rates and outputs as one picture, the text of an SVG file, which notebooks display.

        Raises: ModelError for more than 300 nodes.
        """
        return svg({**{f"{name}'": rate for name, rate in self.rates.items()}, **self.outputs})

    def _repr_latex_(self) -> str:
        return f"${self.latex()}$"

    def _repr_html_(self) -> str:
        kinds = (("state", self.states), ("control", self.controls), ("parameter", self.parameters))
        rows = [("name", "kind", "shape", "group")]
        for kind, leaves in kinds:
            for leaf in leaves:
                group = getattr(leaf, "group", None)
                flat = group is None or group.flat
                rows.append((leaf.name, kind, str(leaf.shape), "" if flat else type(group).__name__))
        lines = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
        return f"<table>{lines}</table>{mathml(self.latex())}"

    @functools.cached_property
    def slopes(self) -> KnownSlopes:
        """The analytical derivatives of rates: by state, pairs of an argument and a matrix."""
        return self.slopes_with(self.rates)

    def slopes_with(self, rates: Mapping[str, Expr]) -> KnownSlopes:
        """`slopes`, built on other expressions of the rates, such as simplified ones."""
        leaves = {leaf.name for leaf in (*self.states, *self.controls, *self.parameters)}
        return checked_slopes(self._slopes.make(rates), self.group, leaves)

    @property
    def scalars_of_slopes(self) -> int:
        """The number of scalars that a program with `slopes` takes at least; zero where it is not known."""
        return self._slopes.scalars

    def __getstate__(self) -> Any:
        return pack({**self.__dict__, "slopes": self.slopes, "_slopes": self.scalars_of_slopes})

    def __setstate__(self, state: Any) -> None:
        self.__dict__.update(unpack(*state))
        known, scalars = self.slopes, self.__dict__.get("_slopes", 0)  # pickles of earlier versions have none
        self._slopes = SlopesOnDemand(lambda _: known, scalars)

    def _place(self, leaf: Leaf) -> str:
        """Where a leaf is first used."""
        for name, root in self._roots.items():
            if any(used is leaf for used in leaves_of(root)):
                return f"{name}: {find_path(root, leaf)}"
        return "a key of rates" if isinstance(leaf, State) else "declared, not used"

    def _declared(self, kind: type[L], declared: Iterable[L] | None, used: Sequence[Leaf]) -> tuple[L, ...]:
        """The leaves of one kind in order: as declared, or else as they are used."""
        used_leaves = {leaf.name: leaf for leaf in reversed(used) if isinstance(leaf, kind)}
        if declared is None:
            return tuple(reversed(used_leaves.values()))
        argument = f"{kind.__name__.lower()}s"
        declared_leaves: Iterable[Any] = (declared,) if isinstance(declared, Expr) else declared
        if not isinstance(declared_leaves, Iterable):
            raise ModelError(f"{argument}= expects {kind.__name__} leaves, got {declared_leaves!r}")
        leaves = {id(leaf): leaf for leaf in declared_leaves}
        for leaf in leaves.values():
            if not isinstance(leaf, kind):
                raise ModelError(f"{argument}= expects {kind.__name__} leaves, got {leaf!r}")
        names = {leaf.name for leaf in leaves.values()}
        for name, leaf in used_leaves.items():
            if name not in names:
                raise ModelError(
                    f"{kind.__name__} {name!r} is used but not declared.\n  at: {self._place(leaf)}\n"
                    f"  fix: add it to {argument}=, or leave out {argument}="
                )
        return tuple(leaves.values())

    def _check_names(self, declared: Sequence[Leaf], used: Sequence[Leaf]) -> None:
        known: dict[str, Leaf] = {}
        for leaf in declared:
            if known.setdefault(leaf.name, leaf) is not leaf:
                raise self._two_leaves(known[leaf.name], leaf)
        for leaf in used:
            if leaf.name not in known:
                raise ModelError(
                    f"State {leaf.name!r} has no rate.\n  at: {self._place(leaf)}\n"
                    f"  fix: add {leaf.name!r} to rates, or make it a Control or a Parameter"
                )
            if known[leaf.name] is not leaf and _differences(known[leaf.name], leaf):
                raise self._two_leaves(known[leaf.name], leaf)

    def _two_leaves(self, one: Leaf, other: Leaf) -> ModelError:
        differences = ", ".join(_differences(one, other)) if type(one) is type(other) else ""
        differ = f", which differ in {differences}" if differences else ""
        return ModelError(
            f"two leaves are named {one.name!r}: {_kind(one)} and {_kind(other)}{differ}.\n"
            f"  at: {self._place(one)}\n  and: {self._place(other)}\n"
            "  fix: names are unique within a system; rename one, or use one object in both places"
        )

    def _check_shapes(self) -> None:
        for name, root in self._roots.items():
            try:
                root.check_shape()
            except ShapeError as error:
                raise error.located(f"{name}: {error.at}") from None
        for name, root in self._roots.items():
            need_finite(name, root)
        for state in self.states:
            rate = self.rates[state.name]
            _check_rate("rate", "rates", state, rate)

    def _check_corrections(self) -> None:
        known = {state.name: state for state in self.states}
        for name, expr in self.corrections.items():
            if name not in known:
                raise ModelError(f"corrections names {name!r}, which has no rate; known are {listed(known, name)}")
            _check_rate("correction", "corrections", known[name], expr)


def _check_rate(what: str, argument: str, state: State, rate: Expr) -> None:
    """Raise ModelError or ShapeError for a rate or correction that is no tangent of the state."""
    wanted = state.group.tangent_shape
    if rate.boolean:
        raise ModelError(
            f"the {what} of {state.name!r} is a condition, not a number.\n"
            f"  at: {argument}[{state.name!r}] = {rate!r}\n  fix: use tx.Where to select between numbers"
        )
    if rate.shape != wanted:
        kind = "of the state's shape" if state.group.flat else f"a body velocity on {state.group.name}"
        raise ShapeError(
            f"the {what} of {state.name!r} expects shape {wanted}, got {rate.shape}",
            at=f"{argument}[{state.name!r}] = {rate!r}",
            hint=f"a {what} here is {kind}",
        )


def _kind(leaf: Leaf) -> str:
    return f"{type(leaf).__name__} of shape {leaf.shape}"


def entry_names(name: str, shape: tuple[int, ...]) -> list[str]:
    """The name of every entry, row by row: "h" for a scalar, "V[0]", ... for a vector, "J[0, 1]" for a matrix."""
    return [f"{name}{list(at) if at else ''}" for at in np.ndindex(*shape)]


def free_name(text: str, taken: Container[str]) -> str:
    """The text, or the first of `text (2)`, `text (3)`, ... that is not in use."""
    numbered = itertools.chain([text], (f"{text} ({number})" for number in itertools.count(2)))
    return next(name for name in numbered if name not in taken)


def constraints_by_name(constraints: Asked | Iterable[Asked] | Mapping[str, Asked]) -> dict[str, Asked]:
    """Constraints by name: those of a mapping, or with their texts as names; sets of constraints are split into their
    parts.

    Raises ModelError for objects that are not constraints.
    """
    if isinstance(constraints, Mapping):
        named = dict(constraints)
    elif not isinstance(constraints, (Iterable, Soft, ConstraintSet)):
        raise ModelError(f"constraints expects a constraint, a list or a dict of constraints, got {constraints!r}")
    else:
        named = {}
        for constraint in [constraints] if isinstance(constraints, (Expr, Soft, ConstraintSet)) else constraints:
            named[free_name(repr(hard(constraint)), named)] = constraint
    for name, value in list(named.items()):
        if isinstance(value, ConstraintSet):
            parts = {f"{name}: {part}": constraint for part, constraint in named.pop(name).named().items()}
            if taken := sorted(parts.keys() & named.keys()):
                raise ModelError(
                    f"constraints: {taken[0]!r} is a part of {name!r} and also the name of another constraint"
                )
            named |= parts
    for name, constraint in named.items():
        refuse_conditions("a system", constraint)
        if not isinstance(constraint, (Constraint, Soft)):
            raise ModelError(
                f"constraint {name!r} is not a constraint but {type(constraint).__name__}.\n"
                "  fix: compare expressions, e.g. tx.linalg.Norm(F) <= 10.0"
            )
    return named


def _states(rates: Mapping[State | str, ExprLike], used: Sequence[Leaf]) -> tuple[State, ...]:
    known = {leaf.name: leaf for leaf in [*reversed(used), *rates] if isinstance(leaf, State)}
    states: dict[str, State] = {}
    for key in rates:
        if not isinstance(key, (State, str)):
            raise ModelError(f"a key of rates must be a State or its name, got {key!r}")
        name = name_of(key)
        if name not in known:
            raise ModelError(
                f"rates names {name!r}, but no State of that name is used.\n"
                f"  fix: use the State itself as the key; known are {listed(sorted(known), name)}"
            )
        if name in states:
            first = next(other for other in rates if name_of(other) == name)
            if isinstance(first, State) and isinstance(key, State):
                raise ModelError(
                    f"two States named {name!r} have rates.\n  fix: use unique names within a system, and rename one "
                    "(the states of a joint are named after the joint)"
                )
            raise ModelError(
                f"rates contains {name!r} twice.\n  fix: use one key for each state, the State or its name"
            )
        states[name] = known[name]
    return tuple(states.values())


def _differences(one: Leaf, other: Leaf) -> list[str]:
    """The differences between two leaves of one name."""
    if type(one) is not type(other):
        return ["kind"]
    if one.shape != other.shape:
        return ["shape"]
    fields = [name for name in one.__dict__ if not name.startswith("_")]
    # One of both may leave its kind or unit open.
    fields = [name for name in fields if name not in ("kind", "unit") or getattr(other, name) is not None]
    return [name for name in fields if freeze(getattr(one, name)) != freeze(getattr(other, name))]
