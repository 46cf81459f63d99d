"""A compiled system: the functions an integrator, a filter or an optimiser calls."""

from __future__ import annotations

import copy
import functools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, overload

import jax
import jax.numpy as jnp

from ..errors import InputError, ModelError
from ..expr import (
    Constant,
    Control,
    Equality,
    Expr,
    Inputs,
    Leaf,
    Parameter,
    State,
    canonicalize_all,
    evaluate_all,
    leaves_of,
    substitute,
)
from ..groups import Euclidean
from ..system import System
from .backends import Backend, Emission
from .explain import Dependence, Explanation
from .explainer import Explainer
from .export.methods import Exports
from .inputs import Values, prepare
from .jacobian import RateJacobian
from .native.backend import Auto
from .scalar.primitive import Derived, call_program

Arrays = dict[str, jax.Array]


class Dynamics(Exports):
    """The functions of a system, jitted and differentiable, all with the signature (t, x, u, params).

    x, u and params are dicts by leaf name. u and params may be left out; a missing parameter takes its own value.
    The result has the precision of x. Made by `compile`.

    Attributes:
        system: the system as written.
        states, controls, parameters: its leaves in order; baked parameters are gone.
        group: the product group of the state; its `slices` say where each state sits in a tangent vector.
        dimension: length of a tangent vector.
        backend: what runs its functions.
        bake, baked: the values of parameters folded into the code by name; their names.
    """

    def __init__(
        self, system: System, outputs: Iterable[str] | None, bake: Mapping[str, Any], backend: Backend
    ) -> None:
        self.system = system
        self.backend = backend
        self._emissions: dict[Any, tuple[Emission, Any]] = {}
        #: What floors above made of this system, by keys of their own.
        self.made: dict[Any, Any] = {}
        self._called: dict[RateJacobian, Derived] = {}
        self._jacobians: dict[Any, RateJacobian] = {}
        self.baked = tuple(bake)
        narrowed = _narrow(system.outputs, outputs)
        constants = _constants(system.parameters, bake)
        self.bake = {p.name: constants[p.key()].value for p in system.parameters if p.name in bake}
        self._rates = _canonical(system.rates, constants)
        self._outputs = _canonical(narrowed, constants)
        residuals = _canonical({name: c.residual() for name, c in system.constraints.items()}, constants)
        equal = {name for name, constraint in system.constraints.items() if isinstance(constraint, Equality)}
        self._inequalities = {name: residual for name, residual in residuals.items() if name not in equal}
        self._equalities = {name: residual for name, residual in residuals.items() if name in equal}
        self.states = system.states
        self.controls = system.controls
        self.parameters = tuple(p for p in system.parameters if p.name not in bake)
        self.group = system.group
        self.dimension = self.group.dimension
        self._leaves = (*self.states, *self.controls, *self.parameters)
        self._evaluate = jax.jit(functools.partial(self.evaluate, in_loop=False), static_argnums=0)

    def __repr__(self) -> str:
        kinds = {"states": self.states, "controls": self.controls, "parameters": self.parameters}
        shown = [f"{kind}: {', '.join(map(_with_shape, own))}" for kind, own in kinds.items() if own]
        return f"Dynamics({'; '.join([*shown, f'backend: {self.backend}'])})"

    # ---- what a user calls -------------------------------------------------------------------------------------

    def __call__(self, t: Any, x: Values, u: Values | None = None, params: Values | None = None) -> Arrays:
        """Rates by state name: a body velocity for a group-valued state.

        Raises:
            InputError: an unknown key, a wrong shape, or a value that is read and not given.
        """
        return self._call("rates", t, x, u, params)

    def outputs(self, t: Any, x: Values, u: Values | None = None, params: Values | None = None) -> Arrays:
        """The outputs by name. Raises as a call of the dynamics does."""
        return self._call("outputs", t, x, u, params)

    def constraints(self, t: Any, x: Values, u: Values | None = None, params: Values | None = None) -> Arrays:
        """`{"inequality": (n,) <= 0, "equality": (m,) = 0}` in the order of declaration. Raises as a call does."""
        return self._call("constraints", t, x, u, params)

    def jacobian(
        self,
        t: Any,
        x: Values,
        u: Values | None = None,
        params: Values | None = None,
        *,
        wrt: Sequence[str] = ("x", "u"),
    ) -> Arrays:
        """The derivatives of the rates: {"x": (n, n), "u": (n, m)}, what is structurally zero never worked out.

        Rows are the rates as one tangent vector, states in the order of declaration. Columns of "x" are right
        perturbations x (+) d, of "u" and "params" the entries of what is given, read row by row in the order of
        declaration. Units are those of the rates over those of the columns. Traceable and differentiable.

        Args:
            wrt: which of "x", "u", "params".
        Raises:
            InputError: as a call of the dynamics; an unknown entry in wrt.
        """
        found, arrays = self.rate_jacobian(self.prepare(t, x, u, params), tuple(wrt))
        if found not in self._called:
            self._called[found] = self.backend.derived(found.program)
        return dict(zip(found.blocks, call_program(self._called[found], *arrays), strict=True))

    def retract(self, x: Values, d: Any) -> Arrays:
        """x (+) d = x Exp(d), state by state; d is a tangent vector (n,) in the order of declaration."""
        inputs = self.prepare(0.0, x, reads=())
        return self.group.retract(inputs.x, jnp.asarray(d, inputs.dtype))

    def difference(self, x: Values, y: Values) -> jax.Array:
        """The tangent vector d with retract(x, d) = y, shape (n,): Log(x^-1 y)."""
        inputs = self.prepare(0.0, x, reads=())
        other = {name: value.astype(inputs.dtype) for name, value in self.prepare(0.0, y, reads=()).x.items()}
        return self.group.difference(inputs.x, other)

    @overload
    def explain(self) -> Explanation: ...

    @overload
    def explain(self, of: str) -> Dependence: ...

    def explain(self, of: str | None = None) -> Explanation | Dependence:
        """What is computed, what was left out, and the counts before and after. Compiles the rates once to time it.

        Args:
            of: a rate or an output, "V", or one entry of it, "V[3]", "speed": what it depends on instead.
        Raises:
            InputError: no rate and no output of that name, or no such entry.
            ModelError: too many scalars to count.
        """
        explainer = Explainer(self)
        return explainer.everything() if of is None else explainer.one(of)

    # ---- what the floors above call ----------------------------------------------------------------------------

    def prepare(
        self,
        t: Any,
        x: Values | None,
        u: Values | None = None,
        params: Values | None = None,
        *,
        reads: Iterable[str] = ("rates",),
    ) -> Inputs:
        """Check and cast the arguments once, before a loop; defaults of parameters are filled in.

        Args:
            reads: which of "rates", "outputs", "constraints" will be evaluated: what they read must be there.
        Raises:
            InputError: as a call of the dynamics.
        """
        required = {state.name for state in self.states}
        for family in reads:
            required |= self.reads[family]
        return prepare(self._leaves, required, t, x, u, params)

    def evaluate(
        self, family: str, t: jax.Array, x: Arrays, u: Arrays, params: Arrays, *, in_loop: bool = True
    ) -> Arrays:
        """Rates, outputs or constraints from prepared arguments: traceable, unchecked, not jitted.

        Args:
            in_loop: in the form that suits an integrator's loop; else in the one for calls and batches.
        """
        leaves, structure = jax.tree.flatten((t, x, u, params))
        types = tuple((jnp.shape(a), jnp.result_type(a)) for a in leaves)
        emission, shape = self.emission(family, structure, types, in_loop=in_loop)
        return jax.tree.unflatten(shape, emission.function(*leaves))

    def emission(
        self, family: str, structure: Any, types: tuple[tuple[tuple[int, ...], Any], ...], *, in_loop: bool = False
    ) -> tuple[Emission, Any]:
        """How a family of functions runs on arguments of these (shape, type), and the structure of its results."""
        backend = self.backend.in_loops() if in_loop else self.backend
        key = (backend, family, structure, types)
        if key not in self._emissions:
            shapes: list[Any] = []

            def function(*leaves: jax.Array) -> list[jax.Array]:
                results, shape = jax.tree.flatten(self.as_written(family, *jax.tree.unflatten(structure, leaves)))
                shapes.append(shape)
                return results

            closed = jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct(*each) for each in types))
            places = jax.tree.unflatten(structure, range(len(types)))
            self._emissions[key] = (backend.emit(closed, jax.tree.leaves(places[3])), shapes[0])
        return self._emissions[key]

    def with_backend(self, backend: Backend) -> Dynamics:
        """The same system, its functions run by another backend."""
        found = copy.copy(self)
        found.backend = backend
        # These know the backend; everything else is shared.
        found._called = {}
        found._evaluate = jax.jit(functools.partial(found.evaluate, in_loop=False), static_argnums=0)
        return found

    def rate_jacobian(self, inputs: Inputs, wrt: tuple[str, ...]) -> tuple[RateJacobian, list[jax.Array]]:
        """The program of the Jacobian for arguments of these types, and the arguments."""
        for kind in wrt:
            if kind not in ("x", "u", "params"):
                raise InputError(f"wrt names {kind!r}; it takes 'x', 'u' and 'params'")
        if len(set(wrt)) < len(wrt):
            raise InputError(f"wrt names something twice: {wrt}")
        given = {
            "x": (self.states, inputs.x),
            "u": (self.controls, inputs.u),
            "params": (self.parameters, inputs.params),
        }
        places = [("t", "t")]
        places += [(kind, leaf.name) for kind, (own, values) in given.items() for leaf in own if leaf.name in values]
        arrays = [inputs.t, *(given[kind][1][name] for kind, name in places[1:])]
        key = (wrt, tuple(places), inputs.dtype)
        if key not in self._jacobians:

            def flat_rates(*arrays: jax.Array) -> list[jax.Array]:
                values: dict[str, Arrays] = {"x": {}, "u": {}, "params": {}}
                for (kind, name), array in zip(places[1:], arrays[1:], strict=True):
                    values[kind][name] = array
                rates = self.as_written("rates", arrays[0], *values.values())
                return [jnp.concatenate([rates[state.name].reshape(-1) for state in self.states])]

            closed = jax.make_jaxpr(flat_rates)(*(jax.ShapeDtypeStruct(a.shape, a.dtype) for a in arrays))
            self._jacobians[key] = RateJacobian(closed, places, self.group, wrt)
        return self._jacobians[key], arrays

    def as_written(self, family: str, t: jax.Array, x: Arrays, u: Arrays, params: Arrays) -> Arrays:
        """The same in arrays, node by node."""
        roots = self.families[family]
        dtype = x[self.states[0].name].dtype
        inputs = Inputs(t, x, u, params, dtype)
        flat = [expr for exprs in roots.values() for expr in exprs]
        values = iter(evaluate_all(flat, lambda leaf: leaf.read(inputs)))
        result = {}
        for name, exprs in roots.items():
            parts = [next(values) for _ in exprs]
            result[name] = parts[0] if family != "constraints" else _joined(parts, dtype)
        return result

    def vector_field(self, t: jax.Array, x: Arrays, u: Arrays, params: Arrays) -> Arrays:
        """The rates from prepared arguments; what an integrator puts into its loop."""
        return self.evaluate("rates", t, x, u, params)

    def rate_reads(self, name: str) -> set[str]:
        """The names of the states, controls and parameters that the rate of a state reads."""
        return _names([self._rates[name]])

    @functools.cached_property
    def constraint_names(self) -> dict[str, list[str]]:
        """The name of every entry of `constraints`, for messages."""
        return {
            kind: [f"{name}[{i}]" if expr.shape else name for name, expr in found.items() for i in range(_size(expr))]
            for kind, found in (("inequality", self._inequalities), ("equality", self._equalities))
        }

    def _call(self, family: str, t: Any, x: Values, u: Values | None, params: Values | None) -> Arrays:
        inputs = self.prepare(t, x, u, params, reads=(family,))
        return self._evaluate(family, inputs.t, inputs.x, inputs.u, inputs.params)

    @functools.cached_property
    def families(self) -> dict[str, dict[str, list[Expr]]]:
        """The simplified expressions of rates, outputs and constraints, by name."""
        constraints = {"inequality": list(self._inequalities.values()), "equality": list(self._equalities.values())}
        return {
            "rates": {name: [expr] for name, expr in self._rates.items()},
            "outputs": {name: [expr] for name, expr in self._outputs.items()},
            "constraints": constraints,
        }

    @functools.cached_property
    def reads(self) -> dict[str, set[str]]:
        """The names of the leaves that each family reads."""
        return {
            family: _names([e for exprs in roots.values() for e in exprs]) for family, roots in self.families.items()
        }


def compile(
    system: System,
    *,
    outputs: Iterable[str] | None = None,
    bake: Mapping[str, Any] | None = None,
    backend: Backend | Literal["auto"] = "auto",
) -> Dynamics:
    """Compile a system to jitted, differentiable functions.

    Only what is asked for is lowered: rates, outputs and constraints are separate functions, traced when first called.

    Args:
        outputs: names of the outputs to keep; all if left out.
        bake: parameters to fold into the code, name -> value; they are no inputs any more.
        backend: what runs the functions. `tx.XLA()` writes large ones out as scalars; `tx.Native()` compiles kernels by
            llvmlite; `tx.JAX()` runs everything as written, in small arrays. "auto" is `tx.XLA()`, and where llvmlite
            is installed native kernels for the large functions and the steps of explicit methods.
    Raises:
        ModelError: an unknown output or parameter; no backend.
        ShapeError: a baked value of the wrong shape.
    """
    if not isinstance(system, System):
        raise ModelError(f"compile expects a tx.System, got {type(system).__name__}; for an expression use tx.lower")
    if bake is not None and not isinstance(bake, Mapping):
        raise ModelError(f"bake must be a dict from parameter names to values, got {type(bake).__name__}")
    chosen = Auto() if isinstance(backend, str) and backend == "auto" else backend
    if not isinstance(chosen, Backend):
        raise ModelError(f'backend expects "auto", tx.XLA(), tx.Native() or tx.JAX(), got {backend!r}')
    return Dynamics(system, outputs, dict(bake or {}), chosen)


def _narrow(outputs: Mapping[str, Expr], names: Iterable[str] | None) -> dict[str, Expr]:
    if names is None:
        return dict(outputs)
    names = [names] if isinstance(names, str) else list(names)
    for name in names:
        if name not in outputs:
            raise ModelError(f"unknown output {name!r}; the system has: {', '.join(outputs) or 'none'}")
    return {name: outputs[name] for name in names}


def _constants(parameters: tuple[Parameter, ...], bake: Mapping[str, Any]) -> dict[str, Constant]:
    """The baked parameters: key of the leaf -> constant."""
    known = {p.name: p for p in parameters}
    constants: dict[str, Constant] = {}
    for name, value in bake.items():
        if name not in known:
            raise ModelError(
                f"bake names {name!r}, which is no parameter; the system has: {', '.join(known) or 'none'}"
            )
        if value is None:
            raise ModelError(f"bake[{name!r}] is None; give the value to fold in, of shape {known[name].shape}")
        constants[known[name].key()] = Constant(known[name].replace(value=value).value)
    return constants


def _canonical(exprs: Mapping[str, Expr], constants: Mapping[str, Expr]) -> dict[str, Expr]:
    roots = [substitute(expr, constants) for expr in exprs.values()] if constants else list(exprs.values())
    return dict(zip(exprs, canonicalize_all(roots), strict=True))


def _names(roots: list[Expr]) -> set[str]:
    """The names of the states, controls and parameters that the roots read."""
    return {leaf.name for leaf in leaves_of(*roots) if isinstance(leaf, (State, Control, Parameter))}


def _with_shape(leaf: Leaf) -> str:
    group = leaf.group if isinstance(leaf, State) else Euclidean()
    return f"{leaf.name} {leaf.shape if isinstance(group, Euclidean) else group.name}"


def _size(expr: Expr) -> int:
    size = 1
    for n in expr.shape:
        size *= n
    return size


def _joined(parts: list[jax.Array], dtype: Any) -> jax.Array:
    return jnp.concatenate([p.reshape(-1) for p in parts]) if parts else jnp.zeros(0, dtype)
