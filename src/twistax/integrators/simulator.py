"""An integration that is checked and compiled once and called often, with little overhead in Python."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import listed, short
from ..errors import InputError
from ..expr import Inputs
from ..jax_inside import is_traced
from ..system.dynamics import Dynamics
from ..system.inputs import read_values
from .controls import ControlTable
from .integrate import integrated, solution_of
from .loop.rollout import packed_rollout, unpacked
from .method import flattened
from .methods.projected import need_start_on_manifold
from .options import Options, need_element, plan_of
from .results.solution import Solution

#: The options that a call may change, and the options of `integrate` that are fixed.
_GIVEN = ("x0", "u", "params")
_OPTIONS = tuple(f.name for f in dataclasses.fields(Options) if f.name not in ("throw", "progress", *_GIVEN))


def simulator(
    dynamics: Dynamics, x0: Mapping[str, Any], *, u: Any = None, params: Any = None, throw: bool = True, **options: Any
) -> Simulator:
    """Compile an integration once for many calls: `fly = tx.simulator(...)`, then `fly(x0)`, `fly(x0, params={...})`.

    A call has an overhead of some tens of microseconds in Python; `tx.integrate`, which checks all of its arguments in
    every call, takes some hundreds. A call checks its arguments, and returns the same `Solution`.

    Args:
        dynamics: a compiled system.
        x0, u, params: as for `tx.integrate`. A call may pass other values with the same names, shapes and kinds;
            omitted ones keep the values passed here. Functions of time and the times of tables are fixed.
        throw: as for `tx.integrate`.
        options: all other options of `tx.integrate`, except `progress`; they are fixed.
    Returns:
        the `Simulator`.
    Raises:
        InputError, ModelError: the errors of `tx.integrate`; an unknown option; a traced argument.
    """
    for name in options:
        if name not in _OPTIONS:
            raise InputError(f"simulator has no option {name!r}; there are: {listed(_OPTIONS, name)}")
    return Simulator(dynamics, x0, Options(u=u, params=params, throw=throw, **options))


@dataclasses.dataclass(frozen=True)
class _Slot:
    """The place of a value among the arrays of the compiled loop."""

    leaf: Any  # the state, control or parameter
    places: tuple[int, ...]
    value: Any  # what it was when the simulator was made: an array, or a table
    check: Callable[[np.ndarray], None] | None  # of a state in a group


class Simulator:
    """A compiled integration, to be called with initial states, controls and parameters. Made by `tx.simulator`.

    Attributes:
        dynamics: the compiled system.
    """

    def __init__(self, dynamics: Dynamics, x0: Any, options: Options) -> None:
        self.dynamics = dynamics
        self._x0, self._options = x0, options
        plan = plan_of(dynamics, x0, options)
        if plan.traced:
            raise InputError(
                "simulator expects numbers, got a traced JAX value.\n"
                "  fix: use tx.integrate inside of jit, vmap and grad"
            )
        self._stepper, self._steps = plan.stepper, plan.steps
        self._ts, self._dtype = jax.device_put(plan.ts), plan.t0.dtype
        self._run, leaves, structure = flattened(packed_rollout, plan.stepper, plan.steps, plan.x)
        self._leaves = jax.device_put([jnp.asarray(leaf) for leaf in leaves])
        stepper, _, x = jax.tree.unflatten(structure, range(len(leaves)))
        signals: Any = plan.stepper.signals
        by_name = getattr(signals, "values", {}), getattr(stepper.signals, "values", {})
        inputs = (
            (dynamics.states, plan.x, x),
            (dynamics.controls, *by_name),
            (dynamics.parameters, plan.stepper.params, stepper.params),
        )
        self._slots: dict[str, dict[str, _Slot]] = {
            kind: {
                leaf.name: _Slot(
                    leaf, tuple(jax.tree.leaves(at[leaf.name])), values[leaf.name], self._check(kind, leaf)
                )
                for leaf in leaves
                if leaf.name in at
            }
            for kind, (leaves, values, at) in zip(_GIVEN, inputs, strict=True)
        }
        self._start = jnp.asarray(plan.t0), plan.x

    def _check(self, kind: str, leaf: Any) -> Callable[[np.ndarray], None] | None:
        group = self.dynamics.group.factors[leaf.name] if kind == "x0" else None
        if group is None or group.flat:
            return None
        return lambda value: need_element(leaf.name, group, value)

    def __repr__(self) -> str:
        return f"<Simulator of {self.dynamics!r}>"

    def __call__(self, x0: Any = None, *, u: Any = None, params: Any = None) -> Solution:
        """The solution from a start, with controls and parameters; those left out keep the values of the constructor.

        Where something is traced this is `tx.integrate`: `jit`, `vmap` and derivatives apply.

        Raises:
            InputError: an unknown name, another shape, what is not finite or no element of its group; another table
                than before, in its kind, length or times; a function, or anything in place of one.
            IntegrationError: as `tx.integrate`.
        """
        changes = {"x0": x0, "u": u, "params": params}
        if is_traced(tuple(changes.values())):
            return self._traced(changes)
        leaves, changed = list(self._leaves), dict[str, dict[str, Any]]()
        for kind, values in changes.items():
            if values is not None:
                changed[kind] = self._placed(kind, values, leaves)
        stepper = self._stepper
        if "u" in changed:
            signals: Any = stepper.signals
            stepper = dataclasses.replace(stepper, signals=type(signals)(signals.values | changed["u"]))
        if "params" in changed:
            stepper = dataclasses.replace(stepper, params=stepper.params | changed["params"])
        if self.dynamics.system.corrections and changed:
            self._need_manifold(stepper, changed.get("x0", {}))
        result = unpacked(self._run(*leaves))
        options = self._options
        return solution_of(stepper, self._steps, result, self._ts, options.save_at is None, options.throw)

    def _placed(self, kind: str, values: Any, leaves: list[Any]) -> dict[str, Any]:
        """The values, checked and cast, written into the leaves."""
        slots, placed = self._slots[kind], {}
        if not isinstance(values, Mapping):
            raise InputError(f"{kind} must be a dict from names to values, got {short(values)}")
        for name, value in values.items():
            slot = slots.get(name)
            if slot is None:
                fixed = ", and the function u stays" if kind == "u" and callable(self._options.u) else ""
                raise InputError(
                    f"unknown key {name!r} in {kind}; the simulator was built with: {listed(slots, name)}{fixed}"
                )
            if isinstance(slot.value, ControlTable) or isinstance(value, ControlTable):
                placed[name] = self._table(f"{kind}[{name!r}]", slot.value, value)
                for k, leaf in zip(slot.places, jax.tree.leaves(placed[name]), strict=True):
                    leaves[k] = leaf
            else:
                placed[name] = leaves[slot.places[0]] = self._array(kind, slot, value)
        return placed

    def _array(self, kind: str, slot: _Slot, value: Any) -> Any:
        as_before = isinstance(value, (np.ndarray, jax.Array)) and value.dtype == self._dtype
        if not (as_before and value.shape == slot.leaf.shape):
            value = read_values(kind, (slot.leaf,), {slot.leaf.name: value}, self._dtype, on_host=True)[slot.leaf.name]
        known = np.asarray(value)
        if not np.isfinite(known).all():
            raise InputError(f"{kind}[{slot.leaf.name!r}] expects finite numbers, got {known}")
        if slot.check is not None:
            slot.check(known)
        return value

    def _table(self, place: str, before: Any, value: Any) -> Any:
        same = type(value) is type(before) and value.values.shape == before.values.shape
        if not same or not np.array_equal(np.asarray(value.ts, before.ts.dtype), before.ts):
            raise InputError(
                f"{place} expects a value like that of the simulator, {type(before).__name__} of shape "
                f"{np.shape(getattr(before, 'values', before))} at the same times, got {short(value)}.\n"
                "  fix: make another tx.simulator for other times"
            )
        return value.astype(self._dtype)

    def _need_manifold(self, stepper: Any, x: dict[str, Any]) -> None:
        t0, before = self._start
        u = stepper.signals.during(self.dynamics, t0, jnp.zeros_like(t0))(t0)
        need_start_on_manifold(self.dynamics, Inputs(t0, {**before, **x}, u, stepper.params, self._dtype))

    def _traced(self, changes: dict[str, Any]) -> Solution:
        arguments = {"x0": self._x0, "u": self._options.u, "params": self._options.params}
        for kind, values in changes.items():
            if values is not None:
                arguments[kind] = (
                    {**(arguments[kind] or {}), **values} if isinstance(arguments[kind], Mapping | None) else values
                )
        x0 = arguments.pop("x0")
        return integrated(self.dynamics, x0, dataclasses.replace(self._options, **arguments))
