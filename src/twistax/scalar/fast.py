"""`fast`: a JAX function of small arrays as scalars, in kernels if possible."""

from __future__ import annotations

import contextlib
import functools
import threading
import types
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Generic, Literal, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
from jax import dtypes

from ..errors import ModelError
from ..jax_inside import ClosedJaxpr, all_equations, is_key, is_traced, jaxpr_as_fun, of_one_device, opened, spread
from ..progress import say_once
from .array_primitive import on_any_mesh
from .backends import JAX, XLA, Backend, chosen
from .jax_primitive import call_program
from .kernel_function import KernelFunction
from .parts.part import Reason, reason_of
from .parts.segments import Segmented, has_parts
from .targets.llvm.backend import Native, installed

P = ParamSpec("P")
R = TypeVar("R")

#: For one thread at a time: variables of functions are replaced temporarily.
_LOCK = threading.RLock()


class Fast(Generic[P, R]):
    """The result of `fast`: a jitted function, differentiable and batched as any JAX function."""

    def __init__(
        self, function: Callable[P, R], backend: Backend, static: dict[str, Any], *, warns: bool = True
    ) -> None:
        functools.update_wrapper(self, function)
        self._function, self._backend, self._static = function, backend, static
        run = self._warned if warns else lambda *arguments: self._traced(*arguments)[0]
        self._jitted = self._jit(lambda *args, **kwargs: run(args, kwargs))

    def _jit(self, traced: Callable[..., Any]) -> Any:
        return jax.jit(functools.wraps(self._function)(traced), **self._static)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        result: R = self._jitted(*args, **kwargs)
        return result

    def __getattr__(self, name: str) -> Any:
        """`lower`, `trace` and `eval_shape` of the jitted function."""
        if name in ("lower", "trace", "eval_shape"):
            return getattr(self._jitted, name)
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def __get__(self, owner: Any, kind: Any = None) -> Any:
        return self if owner is None else _Bound(self, owner)

    def __repr__(self) -> str:
        return f"tx.fast({getattr(self._function, '__qualname__', self._function)}, backend={self._backend})"

    def _warned(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> R:
        """The results, with one warning if there is no speed-up."""
        result, reasons = self._traced(args, kwargs)
        if reasons and not any(reason.gains for reason in reasons) and not isinstance(self._backend, JAX):
            why = "; ".join(dict.fromkeys(reason.text for reason in reasons))
            missing = "" if installed() else "; llvmlite, which compiles kernels, is not installed"
            say_once(f"{self!r} gives no speed-up, JAX executes the function: {why}{missing}")
        return result

    def explain(self, *args: P.args, **kwargs: P.kwargs) -> str:
        """How the parts of the function run for arguments of these shapes and types, a line each."""
        reasons: list[Reason] = []

        def asking(*args: Any, **kwargs: Any) -> Any:
            result, parts = self._traced(args, kwargs)
            reasons.extend(parts)
            return result

        self._jit(asking).trace(*args, **kwargs)
        return "\n".join(reason.text for reason in reasons)

    def _traced(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[R, list[Reason]]:
        """The results for traced arguments, and a reason for each part."""
        leaves, structure = jax.tree.flatten((args, kwargs))
        places = [i for i, leaf in enumerate(leaves) if is_traced(leaf)]
        over = closed_over(self._function)
        if not places and not over:
            return self._function(*args, **kwargs), [Reason("as written: no argument is an array", True)]
        if any(dtypes.canonicalize_dtype(t) != t for t in (leaf.dtype for leaf in [*over, *leaves] if is_traced(leaf))):
            # Of these JAX decides operation by operation.
            reason = Reason("arrays, as written: 64-bit arrays where jax_enable_x64 is off", False)
            return self._function(*args, **kwargs), [reason]
        # Else JAX makes closed-over values inputs.
        over = over if spread([*over, *leaves]) else []
        shapes: list[Any] = []

        def flat(*values: Any) -> list[Any]:
            inside, filled = dict(zip(map(id, over), values, strict=False)), list(leaves)
            for i, value in zip(places, values[len(over) :], strict=True):
                filled[i] = value
            args, kwargs = jax.tree.unflatten(structure, filled)
            with replaced(self._function, lambda value: inside.get(id(value), value)) as function:
                results, shape = jax.tree.flatten(function(*args, **kwargs))
            shapes.append(shape)
            return results

        values = [*over, *(leaves[i] for i in places)]
        plain = [jax.ShapeDtypeStruct(v.shape, v.dtype, weak_type=v.weak_type) for v in map(jax.typeof, values)]
        with of_one_device():
            closed = jax.make_jaxpr(functools.wraps(self._function)(flat))(*plain)
            run, traced = opened(closed)
            if traced:
                shapes_of_traced = [jax.ShapeDtypeStruct(v.shape, v.dtype) for v in map(jax.typeof, traced)]
                closed = jax.make_jaxpr(run)(*shapes_of_traced, *plain)
        function, reasons = _compiled(closed, self._backend)
        result: R = jax.tree.unflatten(shapes[0], function(*traced, *values))
        return result, reasons


class _Bound(functools.partial[Any]):
    def explain(self, *args: Any, **kwargs: Any) -> str:
        text: str = self.func.explain(*self.args, *args, **kwargs)  # type: ignore[attr-defined]
        return text


def _compiled(closed: ClosedJaxpr, backend: Backend) -> tuple[Callable[..., list[Any]], list[Reason]]:
    """A function of arrays, and a reason for each of its parts."""
    variables = [*closed.jaxpr.invars, *(v for eqn in all_equations(closed.jaxpr) for v in eqn.outvars)]
    if closed.effects or any(map(is_key, variables)):
        run = functools.partial(on_any_mesh, jaxpr_as_fun(closed))
        return run, [Reason("arrays, as written: it has effects or random keys", False)]
    if not has_parts(closed, backend):
        emission = backend.emit(closed)
        return emission.function, [reason_of(emission)]
    program = Segmented(closed, backend)
    return functools.partial(call_program, program), program.parts[1]


def fast(
    function: Callable[P, R] | None = None,
    *,
    static_argnums: int | Sequence[int] | None = None,
    static_argnames: str | Iterable[str] | None = None,
    backend: Backend | Literal["auto"] = "auto",
) -> Any:
    """A JAX function of pytrees of small arrays, compiled as scalars: `jax.jit` for small dense mathematics on the CPU.

    XLA executes a function as a chain of operations on arrays of some 50 ns each, more than the arithmetic of a 3x3
    matrix takes. `fast` compiles the function to one scalar program without structural zeros and ones. llvmlite
    compiles the program to a native kernel for this processor or for CUDA devices. `lax.scan`, `fori_loop` and
    `while_loop` with a scalar body become one kernel each, with all iterations. Members of a batch (`jax.vmap` around
    the function or inside of it, `lax.map`) are computed by vector instructions, or by the threads of a CUDA device.

    JAX executes what has no scalar form (calls of libraries, large arrays, effects, random keys), and all functions on
    other devices. `fast(f).explain(*arguments)` reports how each part is executed. One warning is issued if there is no
    speed-up.

    Results have the units of the function. They equal those of the function up to round-off, except that 0 x, 0 / x and
    x - x are zero also if x is infinite or NaN, unless the backend is `tx.Native(tx.XLA(checked=True))`.

    In single precision intermediate derivatives may overflow or underflow. `jax.jacfwd(fast(f))` and
    `jax.grad(fast(f))` differentiate the program in a form that avoids this. `fast(jax.jacfwd(f))` and
    `fast(jax.grad(f))` compile the formulas of JAX, and change only those of quotients and powers to that form.

    Args:
        function: a pure function of pytrees of arrays. If omitted, `fast` is a decorator with options.
        static_argnums, static_argnames: arguments that are not arrays, as in `jax.jit`; another value recompiles.
        backend: the backend of the parts; "auto" is `tx.Native()` if llvmlite is installed, else `tx.XLA()`.
    Raises:
        ModelError: the function is not callable; an invalid backend.
    """
    choice = chosen(backend, Native() if installed() else XLA())
    static = {"static_argnums": static_argnums, "static_argnames": static_argnames}

    def made(function: Callable[P, R]) -> Fast[P, R]:
        if not callable(function):
            raise ModelError(
                f"fast expects a function, got {type(function).__name__}.\n"
                "  fix: use fast(function), or the decorator @fast"
            )
        return Fast(function, choice, static)

    return made if function is None else made(function)


def part_of_package(function: Callable[P, R], backend: Backend | Literal["auto"] = "auto") -> Fast[P, R]:
    """`fast` for functions of this package, without warnings, because users could not act on them."""
    return Fast(function, chosen(backend, Native() if installed() else XLA()), {}, warns=False)


def loops_of_package(function: Callable[..., R], largest: int) -> Callable[..., R]:
    """`part_of_package` for a function whose `while` loops end for all arguments.

    Args:
        largest: the number of entries of the largest array in its loops. Above `XLA.widest` matrices are loops over
            their entries in one kernel, and not scalars.
    """
    backend = Native() if installed() else XLA()
    if largest <= backend.widest:
        return part_of_package(function, backend)
    return KernelFunction(function, backend, of_matrices=True)


def searched(
    search: Callable[[jax.Array], R], formula: Callable[[jax.Array, R], jax.Array]
) -> Callable[[Any], jax.Array]:
    """The function formula(x, search(x)) of an array, where the results of a search count as constants.

    Both are kernels, so that derivatives are those of the formula and take no search. Both are pure; `while` loops in
    the search end for all arguments.
    """
    backend = Native() if installed() else XLA()
    constants = KernelFunction(search, backend, of_matrices=True, constant=True)
    value = KernelFunction(formula, backend)

    def function(x: Any) -> jax.Array:
        x = jnp.asarray(x)
        return value(x, constants(x))

    return function


# ---- traced values that functions close over -------------------------------------------------------------------------


def closed_over(function: Callable[..., Any]) -> list[Any]:
    """The traced values in the variables of enclosing functions, in defaults, partial functions and owners of methods.

    Also those within pytrees, and within functions, that stand there. Attributes of other objects are not looked at.
    """
    traced: dict[int, Any] = {}
    with replaced(function, lambda value: traced.setdefault(id(value), value)):
        return list(traced.values())


@contextlib.contextmanager
def replaced(function: Callable[..., Any], by: Callable[[Any], Any]) -> Iterator[Callable[..., Any]]:
    """The function with `by(value)` in place of each traced value, in a context that one thread at a time may enter."""
    with _LOCK, contextlib.ExitStack() as after:
        yield _changed(function, by, set(), after)


def _changed(value: Any, by: Callable[[Any], Any], seen: set[int], after: contextlib.ExitStack) -> Any:
    """A value with traced values replaced; the value itself if there are none, and for functions, whose variables
    change.

    Args:
        seen: functions that were met: they may hold one another.
        after: what puts their variables back.
    """
    inner = functools.partial(_changed, by=by, seen=seen, after=after)
    if isinstance(value, types.FunctionType):
        if id(value) not in seen:
            seen.add(id(value))
            filled = [(cell, "cell_contents") for cell in value.__closure__ or () if hasattr(cell, "cell_contents")]
            for place, name in [(value, "__defaults__"), (value, "__kwdefaults__"), *filled]:
                old = getattr(place, name)
                new = inner(old)
                if new is not old:
                    after.callback(setattr, place, name, old)
                    setattr(place, name, new)
        return value
    if isinstance(value, types.MethodType):
        owner = inner(value.__self__)
        return value if owner is value.__self__ else types.MethodType(value.__func__, owner)
    if isinstance(value, functools.partial) and not isinstance(value, jax.tree_util.Partial):  # which is a pytree
        parts = (value.func, value.args, value.keywords)
        new = inner(parts)
        return value if new is parts else type(value)(new[0], *new[1], **new[2])
    leaves, structure = jax.tree.flatten(value)
    if leaves and leaves[0] is value:
        return by(value) if is_traced(value) else value
    changed = list(map(inner, leaves))
    same = all(a is b for a, b in zip(leaves, changed, strict=True))
    return value if same else jax.tree.unflatten(structure, changed)
