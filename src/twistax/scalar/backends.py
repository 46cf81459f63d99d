"""Backends, which execute the functions of a system: JAX on arrays, XLA on scalars; `targets/llvm/backend.py` has
native code.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from typing import Any, TypeAlias
from typing import Literal as OneOf

import jax
import jax.numpy as jnp

from ..checks import instance, whole
from ..errors import ModelError
from ..jax_inside import ClosedJaxpr, Jaxpr, Literal, all_equations, inner_jaxprs, is_traced, jaxpr_as_fun, spread
from .array_primitive import on_any_mesh
from .graph import LIMITS, Limits, TooLarge
from .jax_primitive import Derived, Differentiable, call_program
from .loops import Looped, MakeKernel, Repeated, Ring
from .primitives.table import entry_of
from .program import ScalarProgram, called_names
from .reader import emitted_form, scalarize
from .small_call import is_key, known_inside

#: A step from arrays to arrays, and the shapes of its arguments.
Step: TypeAlias = Callable[..., list[jax.Array]]
Shapes: TypeAlias = Sequence[jax.ShapeDtypeStruct]

#: Steps of more scalar operations are differentiated as arrays, by XLA.
_LARGEST_STEP = 10_000
#: The most numbers that a step may close over: they become scalars one by one, and a longer table takes minutes.
_MOST_CONSTANTS = 1000
#: The most numbers that a function of matrices may close over: they are memory of its kernel.
MOST_STORED = 100_000
#: XLA recurses along chains of operations; at three times this length its stack overflows.
_LONGEST_CHAIN = 30_000
#: A function with wide intermediate arrays runs as scalars if these take at most this share of the array operations,
#: as where matrices are mostly zeros. It is tried up to this many times `largest` array operations.
_MOSTLY, _MOST_WORK = 0.25, 10
#: The most entries of an argument or a result of a kernel that is written out.
_MOST_MOVED = 4096
#: The bound of derivatives of scalar programs, which have no other form.
ANY_SIZE = 10**9


@dataclasses.dataclass(frozen=True)
class Emission:
    """A function, and the reason for the form in which it is executed."""

    function: Callable[..., list[jax.Array]]  # pure and traceable
    program: ScalarProgram | None  # that it runs; None where it runs as arrays
    reason: str  # one sentence
    few: bool = False  # whether it runs as arrays because it has few operations
    loops: bool = False  # whether it runs as loops over arrays in a kernel

    @property
    def gains(self) -> bool:
        """Whether it runs in another way than JAX has it."""
        return self.loops or self.program is not None


class StepCompiler:
    """The interface for compiling steps of loops, functions from arrays to arrays; this base class compiles none."""

    def repeated(self, step: Step, shapes: Shapes, state: int, row: Step | None = None) -> Repeated | Looped | None:
        """A step that one kernel repeats; None: it runs in an ordinary loop.

        Args:
            shapes: of its arguments.
            state: how many arguments are the state.
            row: makes a saved row from the further results of the step, if it has any.
        """
        return None

    def looped(self, step: Step, shapes: Shapes, ring: Ring) -> MakeKernel | None:
        """A maker of the kernel that runs all iterations of a loop of JAX; None: it has no kernel.

        Args:
            step: one iteration.
            ring: which results of an iteration are which arguments of the next.
        """
        return None

    def differentiable(self, step: Step, shapes: Shapes) -> Differentiable | None:
        """A step as one program, for loops that are differentiated; None: it runs as it is."""
        return None

    def of_matrices(self, function: Step, shapes: Shapes, terminates: bool = False) -> Differentiable | None:
        """A function of matrices whose entries are computed in loops of one kernel; None: it has no such form.

        Args:
            terminates: whether its `while` loops end for all arguments; else there is no such form of them.
        """
        return None

    def constant(self, function: Step, shapes: Shapes) -> Differentiable | None:
        """`of_matrices` of a function whose derivatives are not taken and whose loops end, which other kernels call."""
        return None

    def shared(self, function: Step, shapes: Shapes) -> Derived | None:
        """A function outside of loops in kernels as a kernel too, however small; None: it runs as it is."""
        return None


class Backend(ABC):
    """Converts a function of arrays to the function that is executed. Hashable; equal backends produce equal
    functions.
    """

    #: The least number of scalar operations of a call that runs as a kernel; None: no call does.
    least: int | None = None
    #: Entries beyond which arrays stay arrays, which may be batches; None: all stay arrays.
    widest: int | None = None

    def __str__(self) -> str:
        """Its name, and the options that differ from the defaults."""
        options: tuple[dataclasses.Field[Any], ...] = dataclasses.fields(self) if dataclasses.is_dataclass(self) else ()
        changed = [f"{f.name}={getattr(self, f.name)}" for f in options if getattr(self, f.name) != f.default]
        return type(self).__name__ + (f"({', '.join(changed)})" if changed else "")

    @property
    def runner(self) -> Any:
        """Runs programs as kernels; None where this backend makes none."""
        return None

    @abstractmethod
    def emit(self, closed: ClosedJaxpr, fixed: Collection[int] = ()) -> Emission:
        """The function of a jaxpr.

        Args:
            fixed: arguments that stay the same over many calls, such as parameters.
        """

    def whole(self, closed: ClosedJaxpr) -> Emission | None:
        """A function with large arrays as one kernel; None: it has no such form, or batches of it may be faster."""
        return None

    def derived(self, program: ScalarProgram) -> Derived:
        """A program with its derivatives, for `call_program`."""
        return Derived(program)

    @property
    def writes_members(self) -> bool:
        """Whether programs of members may be written out in its programs; see `MemberProgram`."""
        scalars = getattr(self, "scalars", None)
        return isinstance(scalars, XLA) and scalars.writes_members

    def in_loops(self) -> Backend:
        """The backend for functions inside the loop of an integrator."""
        return self

    def of_any_size(self) -> Backend:
        """The backend that makes kernels of functions with few operations, and with wide arrays, too."""
        return self

    def steps(self) -> StepCompiler:
        """The compiler of steps of loops."""
        return StepCompiler()


@dataclasses.dataclass(frozen=True)
class JAX(Backend):
    """Executes every function as written, by JAX operations on small arrays."""

    def emit(self, closed: ClosedJaxpr, fixed: Collection[int] = ()) -> Emission:
        return Emission(as_arrays(closed), None, "arrays, as written")


@dataclasses.dataclass(frozen=True)
class XLA(Backend):
    """Executes large functions as scalar programs without structural zeros and ones, compiled by XLA; others as arrays.

    By default 0 x, 0 / x and x - x are zero, also if x is infinite or NaN; constants are folded; x / d and y / d share
    1 / d. Functions without a scalar form are called unchanged.

    Attributes:
        checked: whether to evaluate 0 x, 0 / x and x - x, and every division.
        least: functions with fewer scalar operations, not counting those on parameters alone, are executed as arrays,
            where XLA performs the same simplifications.
        largest: functions with more scalars are executed as arrays, because they would take long to compile.
        widest: functions with an array of more entries are executed as arrays, which XLA vectorises. For intermediate
            arrays this applies unless they are mostly zeros.

    Raises:
        ModelError: least, largest or widest is not a whole number of 0 or more.
    """

    checked: bool = False
    least: int = 500
    largest: int = 30_000
    widest: int = 128

    def __post_init__(self) -> None:
        for name in ("least", "largest", "widest"):
            whole(f"XLA: {name}", getattr(self, name), 0, ModelError)

    @property
    def writes_members(self) -> bool:
        return not self.checked

    def emit(self, closed: ClosedJaxpr, fixed: Collection[int] = ()) -> Emission:
        arrays = as_arrays(closed)
        if array_operations(closed.jaxpr).total() < self.least:
            return Emission(arrays, None, f"arrays: fewer than {self.least} scalar operations", few=True)
        try:
            program = self.scalarised(closed)
        except TooLarge as error:
            return Emission(arrays, None, f"arrays: {str(error).splitlines()[0]}")
        changing = program.depending([k for k in range(len(program.inputs)) if k not in fixed])
        count = sum(program.graph.input_of(i) is None for i in changing)
        if count < self.least:
            # XLA computes what depends on parameters alone once, before a loop, if it is in arrays.
            kind = "change with time and state, " if fixed else ""
            reason = f"arrays: {count} scalar operations {kind}fewer than {self.least}"
            return Emission(arrays, None, reason, few=True)
        calls = emitted_form(program).calls if program.calls else []
        foreign = [c for c in calls if not known_inside(c.jaxpr.jaxpr)]
        if foreign:
            names = called_names(foreign)
            return Emission(arrays, None, f"arrays: it calls {names}, around which scalars would be slow")
        program.graph.largest = ANY_SIZE
        derived = Derived(program)
        return Emission(lambda *a: call_program(derived, *a), program, f"scalars: {program.operations} operations")

    def steps(self) -> StepCompiler:
        return _ScalarSteps(self)

    def scalarised(self, closed: ClosedJaxpr, limits: Limits = LIMITS, moved: bool = False) -> ScalarProgram:
        """The scalar program of a jaxpr.

        Args:
            moved: whether larger arrays may be read, put together and moved.

        Raises:
            TooLarge: there are more than `largest` scalars, or an array of more than `widest` entries; the result is
                complex, for which scalar programs have no derivatives.
        """
        if any(jnp.issubdtype(v.aval.dtype, jnp.complexfloating) for v in closed.jaxpr.outvars):
            raise TooLarge("one of the results is complex")
        ends = max((v.aval.size for v in [*closed.jaxpr.invars, *closed.jaxpr.outvars]), default=0)
        widest = max((v.aval.size for v in variables(closed.jaxpr)), default=0)
        if moved and ends <= _MOST_MOVED and wide_share(closed.jaxpr, self.widest) <= _MOSTLY:
            return self.scalars(closed, self.largest, limits)
        work = array_operations(closed.jaxpr).total() if ends <= self.widest < widest else 0
        if has_members(closed.jaxpr):
            return self.scalars(closed, self.largest, limits)
        if widest <= self.widest or 0 < work <= _MOST_WORK * self.largest:
            program = self.scalars(closed, self.largest, limits)
            if not work or program.operations <= _MOSTLY * work:
                return program
        raise TooLarge(f"one of the arrays has more than {self.widest} entries")

    def scalars(self, closed: ClosedJaxpr, largest: int, limits: Limits = LIMITS) -> ScalarProgram:
        """A jaxpr as a scalar program, up to a maximal number of scalars."""
        return scalarize(closed, checked=self.checked, largest=largest, limits=limits)


@dataclasses.dataclass(frozen=True)
class _ScalarSteps(StepCompiler):
    """Steps as scalars that XLA compiles."""

    scalars: XLA

    def differentiable(self, step: Step, shapes: Shapes) -> Derived | None:
        closed = pure(step, shapes)
        if closed is None or array_operations(closed.jaxpr).total() > _LARGEST_STEP:
            return None
        # The slopes of all stages make an array that may be wider.
        if max(v.aval.size for v in closed.jaxpr.invars) > self.scalars.widest:
            return None
        program = self.scalars.scalars(closed, ANY_SIZE)
        return Derived(program) if all(_steady(call.jaxpr.jaxpr) for call in program.calls) else None


def chosen(backend: Backend | OneOf["auto"], auto: Backend) -> Backend:
    """The backend of a user's argument; `auto` for "auto".

    Raises:
        ModelError: it is not a backend.
    """
    choice = auto if isinstance(backend, str) and backend == "auto" else backend
    instance("backend", choice, Backend, '"auto", tx.XLA(), tx.Native() or tx.JAX()', ModelError)
    return choice


def pure(function: Step, shapes: Shapes, most: int = _MOST_CONSTANTS) -> ClosedJaxpr | None:
    """The jaxpr of a function; None where it must not become a program.

    Programs have no effects, closed-over traced values or random keys. Long closed-over tables take minutes to read.
    """
    closed = jax.make_jaxpr(function)(*shapes)
    return closed if is_pure(closed, most) else None


def is_pure(closed: ClosedJaxpr, most: int = _MOST_CONSTANTS) -> bool:
    """Whether a jaxpr has a program without side effects, and at most so many constants: see `pure`."""
    keys = any(map(is_key, [*closed.jaxpr.constvars, *variables(closed.jaxpr)]))
    if closed.effects or is_traced(closed.consts) or keys:
        return False
    return sum(jnp.size(c) for c in closed.consts) <= most


def _steady(jaxpr: Jaxpr) -> bool:
    """Whether a call can be part of a small function and has a reverse derivative: none of its loops is a `while`."""
    return known_inside(jaxpr) and all(eqn.primitive.name != "while" for eqn in all_equations(jaxpr))


def array_operations(jaxpr: Any) -> Counter[str]:
    """The number of scalar operations by name, over all entries of arrays and all iterations of loops.

    Factorisations count as the cube of their size.
    """
    return operations_of(jaxpr.eqns)


def operations_of(eqns: Sequence[Any]) -> Counter[str]:
    """The number of scalar operations by name, for some equations."""
    counts: Counter[str] = Counter()
    for eqn in eqns:
        entry = entry_of(eqn)
        inner = inner_jaxprs(eqn) if entry is None else entry.runs(eqn)
        for body in inner:
            for kind, count in array_operations(body.jaxpr).items():
                counts[kind] += count * (entry.repeats(eqn) if entry else 1)
        if entry is not None:
            counts.update(entry.operations(eqn))
        elif not inner:
            counts[eqn.primitive.name] += sum(v.aval.size for v in eqn.outvars)
    return +counts


#: Operations of one instruction.
_SHORT = {"add", "add_any", "sub", "mul", "square", "neg", "abs", "max", "min", "select", "and", "or", "not"}
_SHORT |= {"eq", "ne", "lt", "le", "gt", "ge", "tanh", "logistic"}  # of the last two XLA has fast approximations
#: Operations of one instruction that take as long as another: a division, a root, a function.
_SHORT_PER_LONG = 10
#: In a batch a kernel gains where it computes at least so many short operations for each number that it moves.
_LEAST_PER_NUMBER = 2


def outweighs_memory(jaxpr: Jaxpr) -> bool:
    """Whether the computation of a function takes longer than reading its arguments and writing its results.

    Only then batches of it gain by a kernel: it reads rows of members, XLA's loops whole columns.
    """
    counts = array_operations(jaxpr).items()
    short = sum(count if name in _SHORT else _SHORT_PER_LONG * count for name, count in counts)
    read = {v for eqn in jaxpr.eqns for v in eqn.invars if not isinstance(v, Literal)}
    moved: list[Any] = [*(v for v in jaxpr.invars if v in read), *jaxpr.outvars]
    return short >= _LEAST_PER_NUMBER * sum(v.aval.size for v in moved)


def wide_share(jaxpr: Jaxpr, widest: int) -> float:
    """The fraction of operations on arrays with more entries."""

    def sizes(eqn: Any) -> list[int]:
        return [v.aval.size for v in (*eqn.invars, *eqn.outvars)]

    wide = [eqn for eqn in jaxpr.eqns if max(sizes(eqn), default=0) > widest]
    return operations_of(wide).total() / max(array_operations(jaxpr).total(), 1)


def has_members(jaxpr: Jaxpr) -> bool:
    """Whether it has batches of programs that are written out."""
    return any(getattr(eqn.params.get("program"), "written_out", False) for eqn in jaxpr.eqns)


def variables(jaxpr: Jaxpr) -> list[Any]:
    """All inputs and computed variables, also inside calls and loops."""
    return [*jaxpr.invars, *(v for eqn in all_equations(jaxpr) for v in eqn.outvars)]


def as_arrays(closed: ClosedJaxpr) -> Callable[..., list[jax.Array]]:
    """The function of a jaxpr, unchanged. Raises TooLarge for functions on which XLA would crash."""
    depth: dict[Any, int] = {}
    for eqn in closed.jaxpr.eqns if len(closed.jaxpr.eqns) > _LONGEST_CHAIN else ():
        length = 1 + max((depth.get(v, 0) for v in eqn.invars if not isinstance(v, Literal)), default=0)
        depth.update(dict.fromkeys(eqn.outvars, length))
        if length > _LONGEST_CHAIN:
            raise TooLarge(
                f"the function is a chain of more than {_LONGEST_CHAIN:,} dependent array operations, on "
                "which XLA would crash.\n"
                "  fix: write the repeated part as a node whose evaluate uses jax.lax.scan"
            )
    run = jaxpr_as_fun(closed)

    def as_it_is(*leaves: jax.Array) -> list[jax.Array]:
        # An output that is a number in the jaxpr comes back as NumPy's.
        return [jnp.asarray(value) for value in (on_any_mesh(run, *leaves) if spread(leaves) else run(*leaves))]

    return as_it_is
