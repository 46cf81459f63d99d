"""The part of `System` for composition by `tx.join`: leaves by name, outputs as expressions, renamed copies."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

from ..checks import listed
from ..errors import ModelError
from ..expr import Control, Expr, Leaf, Parameter, State, substitute
from ..expr.operations.soft import Soft


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
            legs,
        which `tx.join` combines.

        Args:
            prefix: the prefix of all names.
            keep: names of controls and parameters that are not renamed, such as that of gravity, and so are shared.
        Raises:
            ModelError: an empty prefix, or a name in `keep` that is not a control or parameter.

        Example: `tx.join(leg.renamed("left_", keep=["g"]), leg.renamed("right_", keep=["g"]))`.
        """
        if not isinstance(prefix, str) or not prefix:
            raise ModelError(f"renamed expects a prefix, a non-empty string, got {prefix!r}")
        kept = {keep} if isinstance(keep, str) else set(keep)
        inputs = {leaf.name for leaf in (*self.controls, *self.parameters)}
        for name in kept:
            if name not in inputs:
                raise ModelError(f"renamed: keep names {name!r}; it expects controls and parameters: {listed(inputs)}")
        exchange = {
            leaf.key(): leaf.replace(name=prefix + name)
            for name, leaf in named_leaves(self).items()
            if name not in kept
        }
        return type(self)(**arguments_of(self, exchange, lambda name: name if name in kept else prefix + name))


def named_leaves(system: Any) -> dict[str, Leaf]:
    """The states, controls and parameters of a system by name."""
    kinds = (system.__dict__.get(kind, ()) for kind in ("states", "controls", "parameters"))
    return {leaf.name: leaf for leaves in kinds for leaf in leaves}


def exchanged(value: Any, exchange: Mapping[str, Expr]) -> Any:
    """An expression or a constraint, possibly soft, with leaves replaced by expressions; numbers are unchanged."""
    if isinstance(value, Soft):
        weights = {"l1": value.l1, "l2": value.l2}
        return Soft(exchanged(value.constraint, exchange), **{k: exchanged(w, exchange) for k, w in weights.items()})
    return substitute(value, exchange) if isinstance(value, Expr) else value


def arguments_of(system: Any, exchange: Mapping[str, Expr], name: Callable[[str], str] = str) -> dict[str, Any]:
    """The arguments of a `System` that is this one with other leaves.

    Args:
        exchange: the expressions that replace leaves, by the keys of these; a state is replaced by a state.
        name: a function that returns a new name.
    """

    def swapped(expr: Any) -> Any:
        return substitute(expr, exchange)

    def leaves(of_kind: tuple[Leaf, ...]) -> list[Any]:
        """The replaced leaves that are still leaves of their kind."""
        now = [exchange.get(leaf.key(), leaf) for leaf in of_kind]
        return [new for old, new in zip(of_kind, now, strict=True) if type(new) is type(old)]

    return {
        "rates": {exchange.get(s.key(), s): swapped(system.rates[s.name]) for s in system.states},
        "outputs": {name(key): swapped(expr) for key, expr in system.outputs.items()},
        "constraints": {name(k): exchanged(system.soft.get(k, c), exchange) for k, c in system.constraints.items()},
        "corrections": {name(key): swapped(expr) for key, expr in system.corrections.items()},
        "controls": leaves(system.controls),
        "parameters": leaves(system.parameters),
        "slopes": {
            name(key): [(swapped(by), swapped(slope)) for by, slope in pairs] for key, pairs in system.slopes.items()
        },
        "labels": {name(key): pairs for key, pairs in system.labels.items()},
    }
