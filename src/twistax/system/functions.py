"""The functions of a system on prepared arguments, each compiled at its first use and cached."""

from __future__ import annotations

import contextlib
import functools
import itertools
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from ..expr import Control, Equality, Expr, Inputs, Parameter, State, evaluate_all, leaves_of, postorder
from ..expr.functions.function import Call
from ..expr.transformations.vmap import elements_by
from ..jax_inside import is_traced
from ..progress import FirstCalls, say_once, watched
from ..scalar.backends import Backend, Emission, has_members
from ..scalar.graph import TooLarge
from ..scalar.jax_primitive import Derived, call_program
from ..scalar.small_call import no_small_call
from ..scalar.walk import uncollected
from .expressions import canonical, chosen_outputs, constants_of, silent
from .inputs import CallArguments, Values
from .jacobian import LARGEST, Differentiated, Places, RateJacobian, blocks_in_arrays, check_kinds, fewer
from .repeat import copies_in_a_kernel, traced_once
from .system import System, entry_names

Arrays = dict[str, jax.Array]
Made = TypeVar("Made")
#: Settings of JAX on which the numbers of a traced function depend.
_SETTINGS = ("jax_enable_x64", "jax_default_matmul_precision")


class Cache:
    """A cache by key, and by the settings of JAX that affect numbers. The least recently used entries are dropped.

    Args:
        most: the largest number of entries.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._entries: dict[Any, Any] = {}
        self._lock = threading.Lock()

    def get(self, key: Any, make: Callable[[], Made]) -> Made:
        """The cached value of a key, computed by `make` if there is none."""
        key = (*(getattr(jax.config, name) for name in _SETTINGS), key)
        kept = self._entries.get(key, self)
        if kept is self:
            with watched("compile"), uncollected():
                made: Any = make()
        else:
            made = kept
        with self._lock:
            self._entries.pop(key, None)
            self._entries[key] = made
            while len(self._entries) > self._most:
                del self._entries[next(iter(self._entries))]
        return made

    def values(self) -> list[Any]:
        """All cached values, the most recently used one last."""
        return list(self._entries.values())


class Functions:
    """The functions of a system on prepared arguments: traceable, without checks.

    They are for integrators, solvers and filters, which check arguments once, by `prepare`.

    Attributes:
        system, states, controls, parameters, group, baked, backend: as in `Dynamics`.
        families: the simplified expressions of "rates", "outputs", "constraints" and "corrections", by name.
        constraints: the simplified residuals of "inequality" and "equality", by name.
        steps: a cache, of 32 entries, of the compiled steps of integrators.
        hessians: a cache of the programs of Hessians.
        jitted: the function `evaluate`, in the form for calls.
        loops: a cache of the jitted functions of integrators, which read a `twin` of this object.
    """

    def __init__(self, system: System, outputs: Iterable[str] | None, bake: Mapping[str, Any], backend: Backend):
        constants = constants_of(system.parameters, bake) | silent(system.noises)
        self.system, self.backend = system, backend
        self.baked = {p.name: constants[p.key()].value for p in system.parameters if p.name in bake}
        self.states, self.controls, self.group = system.states, system.controls, system.group
        self.parameters = tuple(p for p in system.parameters if p.name not in bake)
        residuals = canonical({name: c.residual() for name, c in system.constraints.items()}, constants)
        equalities = {name for name, constraint in system.constraints.items() if isinstance(constraint, Equality)}
        self.constraints: dict[str, dict[str, Expr]] = {
            kind: {name: r for name, r in residuals.items() if (name in equalities) == (kind == "equality")}
            for kind in ("inequality", "equality")
        }
        chosen = chosen_outputs(system.outputs, outputs)
        self.families: dict[str, dict[str, list[Expr]]] = {
            "rates": {name: [expr] for name, expr in canonical(system.rates, constants).items()},
            "outputs": {name: [expr] for name, expr in canonical(chosen, constants).items()},
            "constraints": {kind: list(residual.values()) for kind, residual in self.constraints.items()},
            "corrections": {name: [expr] for name, expr in canonical(system.corrections, constants).items()},
        }
        self._constants, self._arguments = constants, CallArguments((*self.states, *self.controls, *self.parameters))
        self.steps, self.hessians, self.loops = Cache(32), Cache(32), Cache(32)
        self._made, self._outside = Cache(64), False
        self.without_kernel = _without_kernel(self.families["rates"], backend)
        self.jitted = _for_calls(self)

    # ---- copies with other options -----------------------------------------------------------------------------------

    def run_by(self, backend: Backend) -> Functions:
        """The same functions with another backend."""
        return self._changed(backend=backend)

    def outside_loops(self) -> Functions:
        """A copy for functions outside of loops in kernels, where large rates are separate kernels."""
        return self._changed(_outside=True)

    def with_outputs(self, names: Iterable[str]) -> Functions:
        """A copy with some of the outputs."""
        known, wanted = self.families["outputs"], set(names)
        outputs = {name: exprs for name, exprs in known.items() if name in wanted}
        twin = self._changed(families={**self.families, "outputs": outputs}, loops=Cache(32), _made=Cache(64))
        twin.__dict__.pop("reads", None)
        return twin

    def twin(self) -> Functions:
        """A copy with a separate cache `loops`: functions in the cache do not keep this object alive."""
        return self._changed(loops=Cache(32))

    def _changed(self, **changes: Any) -> Functions:
        twin = object.__new__(Functions)
        twin.__dict__.update(self.__dict__, **changes)
        twin.jitted = _for_calls(twin)
        return twin

    def __reduce__(self) -> Any:
        return Functions, (self.system, list(self.families["outputs"]), self.baked, self.backend)

    # ---- arguments ---------------------------------------------------------------------------------------------------

    def prepare(
        self,
        t: Any,
        x: Values | None,
        u: Values | None = None,
        params: Values | None = None,
        *,
        reads: Iterable[str] = ("rates",),
        names: Sequence[str] = ("t", "x", "u", "params"),
        on_host: bool = False,
    ) -> Inputs:
        """Check and convert the arguments once, before a loop; defaults of parameters are inserted.

        Args:
            reads: the families, of "rates", "outputs", "constraints", that will be evaluated: the leaves that they read
                are required.
            names: the names of the arguments in messages.
            on_host: whether to leave NumPy arrays unchanged, for a jitted function.
        Raises:
            InputError: the errors of a call of the dynamics.
        """
        required = {state.name for state in self.states}.union(*(self.reads[family] for family in reads))
        return self._arguments.prepare(required, t, x, u, params, names=names, on_host=on_host)

    def zeros(self) -> Inputs:
        """Zeros for all leaves that any function reads, in JAX's default precision."""
        read = set().union(*self.reads.values())
        x = {leaf.name: np.zeros(leaf.shape) for leaf in self.states}
        u, params = (
            {leaf.name: np.zeros(leaf.shape) for leaf in of_kind if leaf.name in read}
            for of_kind in (self.controls, self.parameters)
        )
        return self.prepare(0.0, x, u, params, reads=())

    @functools.cached_property
    def slopes(self) -> dict[str, list[tuple[Expr, Expr]]]:
        """The declared derivatives of rates, simplified: by state, pairs of an argument and a matrix.

        Raises: TooLarge, before they are built, where they take too many scalars.
        """
        if self.system.scalars_of_slopes > LARGEST:
            raise TooLarge.for_more_than(LARGEST)
        built = self.system.slopes_with({name: rate for name, (rate,) in self.families["rates"].items()})
        known = [(name, pair) for name, pairs in built.items() for pair in pairs]
        flat = {f"{k} {part}": expr for k, (_, pair) in enumerate(known) for part, expr in enumerate(pair)}
        simple, slopes = canonical(flat, self._constants) if flat else {}, dict[str, list[tuple[Expr, Expr]]]()
        for k, (name, _) in enumerate(known):
            slopes.setdefault(name, []).append((simple[f"{k} 0"], simple[f"{k} 1"]))
        return slopes

    @functools.cached_property
    def reads(self) -> dict[str, set[str]]:
        """The names of the leaves that each family reads."""
        return {family: _names(*roots.values()) for family, roots in self.families.items()}

    def rate_reads(self, name: str) -> set[str]:
        """The names of the states, controls and parameters that the rate of a state reads."""
        return _names(self.families["rates"][name])

    @functools.cached_property
    def constraint_names(self) -> dict[str, list[str]]:
        """The name of every entry of the constraints, for messages."""
        return {
            kind: [entry for name, e in constraints.items() for entry in entry_names(name, e.shape)]
            for kind, constraints in self.constraints.items()
        }

    # ---- values ------------------------------------------------------------------------------------------------------

    def call(self, family: str, t: Any, x: Values, u: Values | None, params: Values | None) -> Arrays:
        """Rates, outputs or constraints from unchecked arguments, jitted."""
        inputs = self.prepare(t, x, u, params, reads=(family,), on_host=True)
        return self.jitted(family, inputs.t, inputs.x, inputs.u, inputs.params)

    def vector_field(self, t: jax.Array, x: Arrays, u: Arrays, params: Arrays) -> Arrays:
        """The rates, for the loop of an integrator, or for functions outside of it."""
        return self.evaluate("rates", t, x, u, params, in_loop=not self._outside)

    def evaluate(
        self, family: str, t: jax.Array, x: Arrays, u: Arrays, params: Arrays, *, in_loop: bool = True
    ) -> Arrays:
        """Rates, outputs or constraints, not jitted.

        Args:
            in_loop: whether to use the form for the loop of an integrator; else that for calls and batches.
        """
        leaves, structure = jax.tree.flatten((t, x, u, params))
        types = tuple((jnp.shape(a), jnp.result_type(a)) for a in leaves)
        emission, shape = self.emission(family, structure, types, in_loop=in_loop)
        with no_small_call() if self._runs_as_kernel(emission) else contextlib.nullcontext():
            return jax.tree.unflatten(shape, emission.function(*leaves))

    def _runs_as_kernel(self, emission: Emission) -> bool:
        least, program = self.backend.least if self._outside else None, emission.program
        return least is not None and program is not None and program.operations >= least

    def emission(
        self, family: str, structure: Any, types: tuple[tuple[tuple[int, ...], Any], ...], *, in_loop: bool = False
    ) -> tuple[Emission, Any]:
        """How a family of functions is executed for arguments of these (shape, type); the structure of its results."""
        backend = self.backend.in_loops() if in_loop else self.backend

        def make() -> tuple[Emission, Any]:
            def traced(members: bool = False) -> tuple[Any, Any]:
                written = jax.make_jaxpr(lambda *arguments: self.as_written(family, *arguments), return_shape=True)
                with elements_by(parts=traced_once) if members else contextlib.nullcontext():
                    return written(*jax.tree.unflatten(structure, list(itertools.starmap(jax.ShapeDtypeStruct, types))))

            fixed = jax.tree.leaves(jax.tree.unflatten(structure, range(len(types)))[3])
            for members in (backend.writes_members, False):
                closed, shape = traced(members)
                emission = backend.emit(closed, fixed)
                if emission.program is not None or not has_members(closed.jaxpr):
                    break  # else JAX runs it, as it is written
            emission = copies_in_a_kernel(emission, self.backend, self.families[family], traced)
            return emission, jax.tree.structure(shape)

        return self._made.get((backend, family, structure, types), make)

    def as_written(self, family: str, t: jax.Array, x: Arrays, u: Arrays, params: Arrays) -> Arrays:
        """Rates, outputs or constraints in arrays, evaluated node by node."""
        return self.values(self.families[family], family == "constraints", t, x, u, params)

    def values(
        self, roots: Mapping[str, list[Expr]], joined: bool, t: jax.Array, x: Arrays, u: Arrays, params: Arrays
    ) -> Arrays:
        """Expressions by name, in arrays, evaluated node by node.

        Args:
            joined: whether all expressions of a name are joined to one vector; else a name has one expression.
        """
        dtype = x[self.states[0].name].dtype
        inputs = Inputs(t, x, u, params, dtype)
        values = iter(evaluate_all([e for exprs in roots.values() for e in exprs], lambda leaf: leaf.read(inputs)))
        result = {}
        for name, roots_of_name in roots.items():
            parts = [next(values) for _ in roots_of_name]
            if joined:
                parts = [jnp.concatenate([jnp.zeros(0, dtype), *(part.reshape(-1) for part in parts)])]
            result[name] = parts[0]
        return result

    # ---- derivatives -------------------------------------------------------------------------------------------------

    def jacobian(self, inputs: Inputs, wrt: tuple[str, ...]) -> Arrays:
        """The blocks of `Dynamics.jacobian`."""
        check_kinds(wrt)
        places, arrays = self.flat(inputs)

        def make() -> tuple[Callable[..., dict[str, jax.Array]], Any]:
            try:
                derivatives, _ = self.rate_jacobian(inputs, wrt)
            except TooLarge:
                run = functools.partial(self._columns, places, wrt)
            else:
                derived = self.backend.derived(derivatives.program)
                run = functools.partial(_by_program, list(derivatives.blocks), derived)
            return run, jax.jit(run)

        traceable, jitted = self._made.get((self.backend, "jacobian", wrt, places, inputs.dtype), make)
        return (traceable if is_traced(arrays) else jitted)(*arrays)

    def _columns(self, places: Places, wrt: tuple[str, ...], *arrays: jax.Array) -> Arrays:
        def rates(*arrays: jax.Array) -> jax.Array:
            rates = self.evaluate("rates", *self.by_kind(places, arrays), in_loop=False)
            return jnp.concatenate([rates[state.name].reshape(-1) for state in self.states])

        return blocks_in_arrays(rates, self.group, places, wrt, arrays)

    def rate_jacobian(self, inputs: Inputs, wrt: tuple[str, ...]) -> tuple[RateJacobian, list[jax.Array]]:
        """The program of the Jacobian for arguments of these types, and the arguments.

        Raises:
            InputError: an unknown or repeated entry in wrt.
            TooLarge: too many scalars.
        """
        check_kinds(wrt)
        places, arrays = self.flat(inputs)

        def make() -> RateJacobian:
            def traced(function: Callable[..., list[jax.Array]]) -> Differentiated:
                with elements_by(parts=traced_once):
                    closed = jax.make_jaxpr(functools.partial(function, places))(*arrays)
                return Differentiated(closed, places, self.group, wrt)

            if not self.slopes:
                return RateJacobian(traced(self.flat_rates))
            known = {
                name: [by.name if isinstance(by, State) else by.shape[0] for by, _ in pairs]
                for name, pairs in self.slopes.items()
            }
            return fewer(lambda: traced(self.flat_rates), RateJacobian(traced(self._flat_slopes), known))

        return self._made.get((wrt, places, inputs.dtype), make), arrays

    def flat(self, inputs: Inputs) -> tuple[Places, list[jax.Array]]:
        """The arguments in the order of declaration: the key of each, ("t", "t") or its kind and name; and the
        arrays.
        """
        leaves, by_kind = (self.states, self.controls, self.parameters), (inputs.x, inputs.u, inputs.params)
        named = {
            (kind, leaf.name): values[leaf.name]
            for kind, of_kind, values in zip(("x", "u", "params"), leaves, by_kind, strict=True)
            for leaf in of_kind
            if leaf.name in values
        }
        return (("t", "t"), *named), [inputs.t, *named.values()]

    def flat_rates(self, places: Places, *arrays: jax.Array) -> list[jax.Array]:
        """All rates as one vector, in arrays, from arguments in the form of `flat`."""
        rates = self.as_written("rates", *self.by_kind(places, arrays))
        return [jnp.concatenate([rates[state.name].reshape(-1) for state in self.states])]

    def _flat_slopes(self, places: Places, *arrays: jax.Array) -> list[jax.Array]:
        """The rates as one vector; then the vectors and the matrices of the known derivatives."""
        pairs = [pair for known in self.slopes.values() for pair in known]
        roots = {name: [rate] for name, (rate,) in self.families["rates"].items()}
        vectors = [by for by, _ in pairs if not isinstance(by, State)]
        roots |= {f"slopes {k}": [expr] for k, expr in enumerate([*vectors, *(matrix for _, matrix in pairs)])}
        results = self.values(roots, False, *self.by_kind(places, arrays))
        rates = jnp.concatenate([results.pop(state.name).reshape(-1) for state in self.states])
        return [rates, *results.values()]

    def by_kind(self, places: Places, arrays: Sequence[jax.Array]) -> tuple[jax.Array, Arrays, Arrays, Arrays]:
        """The arguments t, x, u and params, from arguments in the form of `flat`."""
        values: dict[str, Arrays] = {"x": {}, "u": {}, "params": {}}
        for (kind, name), array in zip(places[1:], arrays[1:], strict=True):
            values[kind][name] = array
        return arrays[0], values["x"], values["u"], values["params"]


def _without_kernel(rates: Mapping[str, list[Expr]], backend: Backend) -> dict[str, str]:
    """The names of each `tx.Function` that cannot be part of a kernel, with the reasons; warns once of each."""
    reasons: dict[str, str] = {}
    for node in postorder(*(expr for exprs in rates.values() for expr in exprs)):
        if isinstance(node, Call) and backend.runner is not None:
            shapes = [jax.ShapeDtypeStruct(child.shape, jnp.zeros(()).dtype) for child in node.children()]
            reason = backend.runner.without_kernel(lambda *values, node=node: [node.evaluate(*values)], shapes)
            if reason is not None and reasons.setdefault(node.name, reason) is reason:
                say_once(f"rates that call the Function {node.name!r} run by XLA, without native kernels: {reason}")
    return reasons


def _for_calls(functions: Functions) -> Callable[..., Arrays]:
    return FirstCalls("compile").of(jax.jit(functools.partial(functions.evaluate, in_loop=False), static_argnums=0))


def _by_program(kinds: Sequence[str], program: Derived, *arrays: jax.Array) -> Arrays:
    return dict(zip(kinds, call_program(program, *arrays), strict=True))


def _names(*roots: list[Expr]) -> set[str]:
    """The names of the states, controls and parameters that the roots read."""
    leaves = leaves_of(*(expr for exprs in roots for expr in exprs))
    return {leaf.name for leaf in leaves if isinstance(leaf, (State, Control, Parameter))}
