"""A function of arrays with loops, in segments: straight code as scalars, loops as kernels."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import (
    ClosedJaxpr,
    Literal,
    Unread,
    all_equations,
    alone,
    closed,
    expansion,
    inner_jaxprs,
    jaxpr_as_fun,
    parameters,
    part,
    scan_parts,
    weakly_kept,
)
from .array_primitive import ArrayProgram, is_array_program
from .backends import Backend, array_operations
from .loops import Looped, Ring, loop
from .primitives.table import say_unread
from .program import Batch
from .small_call import small_call

#: Loops of fewer operations on scalars, all iterations together, are unrolled.
_UNROLLED = 2000
_LOOPS = ("scan", "while")
#: Constants of more entries are arguments of the parts.
_LARGEST = 1000
#: Calls that are inlined once derivatives are taken.
_CALLS = {"jit": "jaxpr", "remat2": "jaxpr", "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr"}


@dataclasses.dataclass(frozen=True)
class Part:
    """Some equations of a function, with the function that runs them.

    Attributes:
        inputs, outputs: variables of the jaxpr.
        function: from the values of these to the values of those.
        reason: a sentence for each thing that is said of it.
    """

    inputs: Sequence[Any]
    outputs: Sequence[Any]
    function: Callable[..., Sequence[Any]]
    reasons: list[str]


@weakly_kept
class Segmented(ArrayProgram):
    """A function of arrays that runs in parts. It is differentiated before it is split.

    Args:
        program: the function.
        backend: what runs its parts.
    """

    def __init__(self, program: ClosedJaxpr, backend: Backend) -> None:
        super().__init__(program)
        self.backend = backend

    @functools.cached_property
    def parts(self) -> tuple[Callable[..., list[jax.Array]], list[str]]:
        """The function for platforms with kernels, and a reason for each part."""
        return emit_segments(self.program, self.backend)

    def by_xla(self, arguments: Sequence[Any], batch: Batch, inside: bool, platform: str) -> list[jax.Array]:
        return batch.each(self.parts[0], arguments)

    def made(self, program: ClosedJaxpr) -> Segmented:
        return Segmented(program, self.backend)


# ---- segments --------------------------------------------------------------------------------------------------------


def has_loops(program: ClosedJaxpr) -> bool:
    """Whether a function has loops that are not unrolled."""
    return any(map(_loops, _opened(program).jaxpr.eqns))


def emit_segments(program: ClosedJaxpr, backend: Backend) -> tuple[Callable[..., list[jax.Array]], list[str]]:
    """The function that runs a jaxpr, and a sentence for each of its parts."""
    program = _opened(program)
    jaxpr = program.jaxpr
    if not any(map(_loops, jaxpr.eqns)):
        emission = backend.emit(program)
        return emission.function, [emission.reason]
    parts = _parts(program, backend)

    def run(*arguments: jax.Array) -> list[jax.Array]:
        values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*program.consts, *arguments], strict=True))
        for step in parts:
            results = step.function(*(values[v] for v in step.inputs))
            values.update(zip(step.outputs, results, strict=True))
        return [jnp.asarray(v.val if isinstance(v, Literal) else values[v], v.aval.dtype) for v in jaxpr.outvars]

    return run, [reason for step in parts for reason in step.reasons]


def _opened(program: ClosedJaxpr) -> ClosedJaxpr:
    """The same function with called functions inlined."""
    avals: list[Any] = [v.aval for v in program.jaxpr.invars]
    shapes = (jax.ShapeDtypeStruct(a.shape, a.dtype) for a in avals)
    return jax.make_jaxpr(functools.partial(_evaluate, program))(*shapes)


def _evaluate(program: ClosedJaxpr, *arguments: Any) -> list[Any]:
    jaxpr = program.jaxpr
    values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*program.consts, *arguments], strict=True))

    def value(v: Any) -> Any:
        aval: Any = v.aval
        return jnp.asarray(v.val, aval.dtype) if isinstance(v, Literal) else values[v]

    for eqn in jaxpr.eqns:
        name = eqn.primitive.name
        if is_array_program(eqn) and not eqn.params["batch"].depth:
            inside: ClosedJaxpr | None = eqn.params["program"].program
        else:
            inside = closed(eqn.params[_CALLS[name]]) if name in _CALLS else expansion(eqn)
        if inside is None:
            variables = list(dict.fromkeys(v for v in eqn.invars if not isinstance(v, Literal)))
            outputs = jaxpr_as_fun(alone(jaxpr, eqn, variables))(*map(value, variables))
        else:
            outputs = _evaluate(inside, *map(value, eqn.invars))
        values.update(zip(eqn.outvars, outputs, strict=True))
    results: list[Any] = jaxpr.outvars
    return [value(v) for v in results]


def _loops(eqn: Any) -> bool:
    """Whether an equation is a loop that is not unrolled, or has one in its branches."""
    inside = [equation for inner in inner_jaxprs(eqn) for equation in all_equations(inner.jaxpr)]
    if eqn.primitive.name == "while" or any(is_array_program(e) or e.primitive.name == "while" for e in inside):
        return eqn.primitive.name in (*_LOOPS, "cond")
    if eqn.primitive.name == "cond":
        return any(_loops(equation) for inner in inner_jaxprs(eqn) for equation in inner.jaxpr.eqns)
    return eqn.primitive.name == "scan" and _operations(eqn) > _UNROLLED


def _operations(eqn: Any) -> int:
    return eqn.params["length"] * array_operations(closed(eqn.params["jaxpr"]).jaxpr).total()


class _Constants:
    """The values that depend on constants only, as small arrays: each part computes those that it reads.

    Attributes:
        made: the equations that do.
        known: all the variables.
    """

    def __init__(self, program: ClosedJaxpr) -> None:
        self._jaxpr = program.jaxpr
        consts = zip(program.jaxpr.constvars, program.consts, strict=True)
        self._values = {v: c for v, c in consts if np.size(c) <= _LARGEST}
        self.known, self.made = dict.fromkeys(self._values), []
        for eqn in program.jaxpr.eqns:
            small = all(v.aval.size <= _LARGEST for v in eqn.outvars)
            if small and not _loops(eqn) and all(v in self.known for v in _read([eqn])):
                self.made.append(eqn)
                self.known.update(dict.fromkeys(eqn.outvars))

    def close(self, eqns: Sequence[Any], outputs: Sequence[Any]) -> ClosedJaxpr:
        """The jaxpr of equations with the constants that they read; its inputs are the other variables they read."""
        wanted = _read(eqns) | dict.fromkeys(v for v in outputs if not isinstance(v, Literal))
        before: list[Any] = []
        for eqn in reversed(self.made):
            if any(v in wanted for v in eqn.outvars):
                before.insert(0, eqn)
                wanted |= _read([eqn])
        written = {v for eqn in (*before, *eqns) for v in eqn.outvars}
        inputs = [v for v in wanted if v not in self._values and v not in written]
        constants = {v: c for v, c in self._values.items() if v in wanted}
        return part(self._jaxpr, [*before, *eqns], inputs, outputs, constants)


def _read(eqns: Iterable[Any]) -> dict[Any, None]:
    """The variables that equations read, in order, including those that they compute."""
    return dict.fromkeys(v for eqn in eqns for v in eqn.invars if not isinstance(v, Literal))


def _parts(program: ClosedJaxpr, backend: Backend) -> list[Part]:
    """The segments in order: equations before all loops, loops, equations that depend on these, and so on."""
    jaxpr, constants = program.jaxpr, _Constants(program)
    made = set(map(id, constants.made))
    after: dict[Any, int] = {}
    groups: dict[tuple[int, bool], list[Any]] = {}
    for eqn in jaxpr.eqns:
        if id(eqn) not in made:
            rank, loops = max((after.get(v, 0) for v in _read([eqn])), default=0), _loops(eqn)
            groups.setdefault((rank, loops), []).append(eqn)
            after.update(dict.fromkeys(eqn.outvars, rank + loops))
    results = [v for v in jaxpr.outvars if not isinstance(v, Literal)]
    wanted = dict.fromkeys(results)
    parts = [_straight(constants, [], [v for v in wanted if v in constants.known], backend)]
    for (_, loops), eqns in sorted(groups.items(), key=lambda group: group[0], reverse=True):
        for chosen in [[eqn] for eqn in reversed(eqns)] if loops else [eqns]:
            outputs = [v for eqn in chosen for v in eqn.outvars if v in wanted]
            if outputs:
                new = _loop(constants, chosen[0], backend) if loops else _straight(constants, chosen, outputs, backend)
                parts.append(new)
                wanted.update(dict.fromkeys(new.inputs))
    return parts[::-1]


def _straight(constants: _Constants, eqns: Sequence[Any], outputs: Sequence[Any], backend: Backend) -> Part:
    program = constants.close(eqns, outputs)
    emission, computes = backend.emit(program), array_operations(program.jaxpr).total() > 0
    return Part(program.jaxpr.invars, outputs, emission.function, [emission.reason] if computes else [])


# ---- loops -----------------------------------------------------------------------------------------------------------


class _Operands:
    """The arguments of an equation: those that constants determine, and the others, its inputs."""

    def __init__(self, constants: _Constants, eqn: Any) -> None:
        self.is_known = [isinstance(v, Literal) or v in constants.known for v in eqn.invars]
        known = [v for v, is_known in zip(eqn.invars, self.is_known, strict=True) if is_known]
        self.inputs = [v for v, is_known in zip(eqn.invars, self.is_known, strict=True) if not is_known]
        self._types = [v.aval.dtype for v in known]
        self._known = jaxpr_as_fun(constants.close([], known))

    def joined(self, values: Iterable[Any], count: int | None = None) -> list[Any]:
        """The first `count` arguments, from the values of those that are inputs."""
        known, inputs = iter(map(jnp.asarray, self._known(), self._types)), iter(values)
        return [next(known if is_known else inputs) for is_known in self.is_known[:count]]


def _branches(operands: _Operands, eqn: Any, backend: Backend) -> Part:
    """A branch with loops in it."""
    branches = [emit_segments(closed(branch), backend) for branch in eqn.params["branches"]]

    def switched(*values: Any) -> Any:
        index, *arguments = operands.joined(values)
        return jax.lax.switch(index, [run for run, _ in branches], *arguments)

    return Part(
        operands.inputs, eqn.outvars, switched, [f"branch: {why}" for _, reasons in branches for why in reasons]
    )


def _loop(constants: _Constants, eqn: Any, backend: Backend) -> Part:
    """A loop, or a branch with loops in it."""
    name, operands = eqn.primitive.name, _Operands(constants, eqn)
    if name == "cond":
        return _branches(operands, eqn, backend)
    joined, inputs = operands.joined, operands.inputs

    def as_it_is(*values: Any) -> Any:
        return eqn.primitive.bind(*values, **eqn.params)

    try:
        ring, iteration = _iteration(eqn)
    except Unread as error:
        say_unread(error)
        return Part(inputs, eqn.outvars, lambda *values: as_it_is(*joined(values)), [f"{name}, as JAX has it"])
    is_inside = operands.is_known[: ring.fixed]
    inner = dataclasses.replace(ring, fixed=is_inside.count(False))

    def step(*values: Any) -> list[jax.Array]:
        return iteration(*joined(values[: inner.fixed], ring.fixed), *values[inner.fixed :])

    def arguments(values: Sequence[Any]) -> list[Any]:
        """The arguments of the loop that are not known inside of it."""
        every = joined(values)
        return [*(a for a, inside in zip(every, is_inside, strict=False) if not inside), *every[ring.fixed :]]

    avals = [v.aval for v in eqn.invars]
    shapes = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a, inside in zip(avals, is_inside, strict=False) if not inside]
    shapes += [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in avals[ring.fixed : ring.fixed + ring.state]]
    shapes += [jax.ShapeDtypeStruct(a.shape[1:], a.dtype) for a in avals[ring.fixed + ring.state :]]
    inside = jax.make_jaxpr(step)(*shapes)
    # Loops inside of it that are not unrolled are kernels of their own.
    around = has_loops(inside)
    kernel = None if around else backend.steps().looped(step, shapes, inner)
    if kernel is not None:
        results = [(v.aval.shape, np.dtype(v.aval.dtype)) for v in eqn.outvars]
        by_jax = lambda _, *a: as_it_is(*joined(a[: inner.fixed], ring.fixed), *a[inner.fixed :])  # noqa: E731
        looped = Looped(by_jax, results, kernel)
        reason = f"{name}: all iterations in one kernel"
        return Part(inputs, eqn.outvars, lambda *values: loop(looped, ring.length or -1, arguments(values)), [reason])
    if ring.length is None:
        run, reasons = _while_around(eqn, backend) if around else (as_it_is, [f"{name}, as JAX has it"])
        return Part(inputs, eqn.outvars, lambda *values: small_call(run, *joined(values)), reasons)
    body, reasons = emit_segments(inside, backend if around else backend.in_loops())
    run = functools.partial(_scanned, body, inner)
    reasons = [f"{name}: {reason}" for reason in reasons]
    return Part(inputs, eqn.outvars, lambda *values: small_call(run, *arguments(values)), reasons)


def _scanned(body: Callable[..., list[jax.Array]], ring: Ring, *values: Any) -> list[jax.Array]:
    """A loop as a scan of its compiled body."""
    constants, state, rows = values[: ring.fixed], values[ring.fixed :][: ring.state], values[ring.fixed + ring.state :]

    def iterate(state: Any, row: Any) -> tuple[Any, Any]:
        results = body(*constants, *state, *row)
        return results[: ring.state], results[ring.state :]

    carried, stacked = jax.lax.scan(iterate, list(state), list(rows), ring.length, ring.reverse)
    return [*carried, *stacked]


def _while_around(eqn: Any, backend: Backend) -> tuple[Callable[..., list[jax.Array]], list[str]]:
    """A `while_loop` that contains other loops, and the reasons of these."""
    asking = eqn.params["cond_nconsts"]
    fixed = asking + eqn.params["body_nconsts"]
    going, reasons_of_condition = emit_segments(closed(eqn.params["cond_jaxpr"]), backend)
    body, reasons_of_body = emit_segments(closed(eqn.params["body_jaxpr"]), backend)

    def run(*values: Any) -> list[jax.Array]:
        return jax.lax.while_loop(
            lambda state: going(*values[:asking], *state)[0],
            lambda state: body(*values[asking:fixed], *state),
            list(values[fixed:]),
        )

    return run, [f"while: {reason}" for reason in (*reasons_of_condition, *reasons_of_body)]


def _iteration(eqn: Any) -> tuple[Ring, Callable[..., list[Any]]]:
    """The order of a loop's values, and one iteration of it in that order.

    Raises:
        Unread: a loop of a later JAX.
    """
    p = eqn.params
    if eqn.primitive.name == "scan":
        fixed, carried = scan_parts(eqn)
        return Ring(fixed, carried, p["length"], p["reverse"]), jaxpr_as_fun(closed(p["jaxpr"]))
    p = parameters(eqn, {"body_jaxpr", "body_nconsts", "cond_jaxpr", "cond_nconsts"})
    asking, going = p["cond_nconsts"], jaxpr_as_fun(closed(p["cond_jaxpr"]))
    fixed, body = asking + p["body_nconsts"], jaxpr_as_fun(closed(p["body_jaxpr"]))

    def iteration(*values: Any) -> list[Any]:
        state = values[fixed:]
        return [*going(*values[:asking], *state), *body(*values[asking:fixed], *state)]

    return Ring(fixed, len(eqn.invars) - fixed), iteration
