"""The part of `System` for composition by `tx.join`: leaves by name, outputs as expressions, renamed copies."""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Mapping
from typing import Any

from ..checks import listed
from ..errors import ModelError
from ..expr import Control, Expr, Leaf, Parameter, State, postorder, substitute
from ..expr.graph import with_facts
from ..expr.kinds.declare import kind_of, renamed_frames
from ..expr.operations.soft import Soft
from ..expr.orders import bodies
from .declared import Slopes, SlopesOnDemand


class Composable:
    """A base class of `System`."""

    states: tuple[State, ...]
    controls: tuple[Control, ...]
    parameters: tuple[Parameter, ...]
    outputs: dict[str, Expr]

    def __getattr__(self, name: str) -> Any:
        """The state, control or parameter with a name: `system.thrust` is the control "thrust"."""
        if not name.startswith("_"):
            leaves = named_leaves(self)
            if name in leaves:
                return leaves[name]
            raise AttributeError(
                f"{self!r} has no {name!r}; its leaves are {listed(leaves, name)}", name=name, obj=self
            )
        raise AttributeError(name, name=name, obj=self)

    def output(self, name: str) -> Expr:
        """The expression of an output, for a connection by `tx.join`.

        Raises:
            ModelError: no output has that name.
        """
        if name not in self.outputs:
            raise ModelError(
                f"output names {name!r}, which is not an output; the system has: {listed(self.outputs, str(name))}"
            )
        return self.outputs[name]

    def renamed(self, prefix: str, *, keep: Collection[str] = ()) -> Any:
        """The same system with other names: of states, controls, parameters, outputs and constraints.

        The renamed leaves are new objects: `left = leg.renamed("left_")` and `right = leg.renamed("right_")` are two
        legs, which `tx.join` combines. Frames and bodies that move with the system have the prefix too, so that the
        check of kinds distinguishes those of two copies: the source frames of poses and rotations, the bodies of
        twists and those on which wrenches act. Other frames, such as the world, are common to all copies.

        Args:
            prefix: the prefix of all names.
            keep: names that do not change: of controls and parameters, such as that of gravity, which are then shared,
                and of frames and bodies. Frames and bodies that a shared control or parameter declares keep their
                names. If a frame that moves keeps its name, so do all bodies.
        Raises:
            ModelError: an empty prefix, or a name in `keep` that is not a control, parameter, frame or body.

        Example: `tx.join(leg.renamed("left_", keep=["g"]), leg.renamed("right_", keep=["g"]))`.
        """
        if not isinstance(prefix, str) or not prefix:
            raise ModelError(f"renamed expects a prefix, a non-empty string, got {prefix!r}")
        kept, leaves = {keep} if isinstance(keep, str) else set(keep), named_leaves(self)
        kinds = {name: kind for name, leaf in leaves.items() if (kind := kind_of(leaf)) is not None}
        inputs = {leaf.name for leaf in (*self.controls, *self.parameters)}
        known = inputs.union(*(kind.names() for kind in kinds.values()))
        for name in kept:
            if name not in known:
                raise ModelError(
                    f"renamed: keep names {name!r}; it expects controls, parameters, frames and bodies: {listed(known)}"
                )
        common = kept.union(*(kind.names() for name, kind in kinds.items() if name in kept), _mapped_names(self))
        moving = set[str]().union(*(kind.moving() for name, kind in kinds.items() if name not in kept))
        if moving & common:  # a common frame is fixed to one body, whose name is common then
            moving &= set[str]().union(*(kind.frames().values() for kind in kinds.values()))
        relabel = functools.partial(renamed_frames, names={name: prefix + name for name in moving - common})
        exchange = {
            leaf.key(): relabel(with_facts(leaf.replace(name=prefix + name), leaf))
            for name, leaf in leaves.items()
            if name not in kept
        }
        new_name = lambda name: name if name in kept & inputs else prefix + name  # noqa: E731
        return type(self)(**arguments_of(self, exchange, new_name, relabel))


def named_leaves(system: Any) -> dict[str, Leaf]:
    """The states, controls and parameters of a system by name."""
    kinds = (system.__dict__.get(kind, ()) for kind in ("states", "controls", "parameters"))
    return {leaf.name: leaf for leaves in kinds for leaf in leaves}


def _mapped_names(system: Any) -> set[str]:
    """The frames and bodies that the functions of maps declare inside, where they are not renamed."""
    families = (system.rates, system.outputs, system.constraints, system.corrections)
    inside = {
        inner
        for node in postorder(*(root for family in families for root in family.values()))
        for body in bodies(node)
        for inner in postorder(body)
        if not isinstance(inner, (State, Control, Parameter))
    }
    return set[str]().union(*(kind.names() for node in inside if (kind := kind_of(node)) is not None))


def exchanged(value: Any, exchange: Mapping[str, Expr], relabel: Callable[[Expr], Expr] | None = None) -> Any:
    """An expression or a constraint, soft or not, with expressions in place of leaves; numbers as they are."""
    if isinstance(value, Soft):
        weights = {"l1": value.l1, "l2": value.l2}
        exchanged_weights = {k: exchanged(w, exchange, relabel) for k, w in weights.items()}
        return Soft(exchanged(value.constraint, exchange, relabel), **exchanged_weights)
    return substitute(value, exchange, relabel) if isinstance(value, Expr) else value


def arguments_of(
    system: Any,
    exchange: Mapping[str, Expr],
    name: Callable[[str], str] = str,
    relabel: Callable[[Expr], Expr] | None = None,
) -> dict[str, Any]:
    """The arguments of a `System` that is this one with other leaves.

    Args:
        exchange: the expressions that replace leaves, by the keys of these; a state is replaced by a state.
        name: a function that returns a new name.
        relabel: a function that returns the replacement of other nodes, see `substitute`.
    """

    def swapped(expr: Any) -> Any:
        return substitute(expr, exchange, relabel)

    def leaves(of_kind: tuple[Leaf, ...]) -> list[Any]:
        """The replaced leaves that are still leaves of their kind."""
        now = [exchange.get(leaf.key(), leaf) for leaf in of_kind]
        return [new for old, new in zip(of_kind, now, strict=True) if type(new) is type(old)]

    def slopes(_: Mapping[str, Expr]) -> Slopes:
        known = system.slopes.items()
        return {name(key): [(swapped(by), swapped(slope)) for by, slope in pairs] for key, pairs in known}

    return {
        "rates": {exchange.get(s.key(), s): swapped(system.rates[s.name]) for s in system.states},
        "outputs": {name(key): swapped(expr) for key, expr in system.outputs.items()},
        "constraints": {
            name(k): exchanged(system.soft.get(k, c), exchange, relabel) for k, c in system.constraints.items()
        },
        "corrections": {name(key): swapped(expr) for key, expr in system.corrections.items()},
        "controls": leaves(system.controls),
        "parameters": leaves(system.parameters),
        "slopes": SlopesOnDemand(slopes, system.scalars_of_slopes),
        "labels": {name(key): pairs for key, pairs in system.labels.items()},
    }
