"""Arbitrary functions of arrays as nodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import short
from ...errors import ModelError, ShapeError
from ...jax_inside import is_traced
from ..fields import Operands
from ..kinds import rules
from ..node import Expr, Shape, to_expr
from .parameter_tree import ParameterTree, is_real_array

#: Errors of functions that need concrete values of their arguments. These are TypeErrors, too.
_NEEDS_NUMBERS = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.NonConcreteBooleanIndexError,
)


class Function:
    """A JAX function of arrays for use in expressions: `tx.Function(net, (3,))(x, u)` is an expression.

    $y = f(a_1, \\ldots, a_n)$, where f is a neural network, a table of another library, a function with custom
    derivatives (`jax.custom_jvp`, `jax.custom_vjp`), or calls Python outside of JAX (`jax.pure_callback`). f is called
    with one array of the operand's shape for each operand, and with a pytree for a `tx.ParameterTree`. It returns one
    array. It must be pure: the same arguments give the same values. Values and derivatives are those of JAX. Arrays of
    real numbers in f, such as the weights of an `equinox.Module`, are cast to the precision of the operands and are
    constants; a `tx.ParameterTree` makes them parameters. Units are not checked. Source: JAX's documentation, "Custom
    derivative rules" and "External callbacks".

    Args:
        f: the function, or another callable, such as an `equinox.Module`.
        shape: the shape of its value; by default it is determined by tracing f.
        name: its name in messages, formulas and `explain`; the name of f by default.
    Raises:
        ModelError: f is not callable, has weights that JAX is tracing, needs concrete values of its arguments, or does
            not return an array of real numbers.
        ShapeError: f fails for operands of these shapes, or its value has a shape other than `shape`.

    Example:
        drag = tx.Function(lambda v: -0.3 * jnp.linalg.norm(v) * v, shape=(3,), name="drag")
        system = tx.System(rates={p: v, v: drag(v) / m + g})
    """

    def __init__(self, f: Any, shape: Any = None, name: Any = None) -> None:
        if not callable(f) or isinstance(f, Expr):
            raise ModelError(
                f"Function expects a function of arrays, got {short(f)}.\n"
                "  fix: use tx.Function(f, shape)(x), which calls f with the arrays of the operands"
            )
        if isinstance(f, type):
            raise ModelError(
                f"Function expects a function of arrays, got the class {f.__name__}; pass an instance of it"
            )
        if is_traced(f):
            raise ModelError(
                f"Function expects a function with known numbers, got {type(f).__name__} with an array that JAX "
                "traces.\n  fix: make the arrays a tx.ParameterTree, an operand of the function, and pass params"
            )
        if name is not None and (not isinstance(name, str) or not name):
            raise ModelError(f"Function expects name to be a non-empty string, got {name!r}")
        self.f, self.shape = f, None if shape is None else _shape(shape)
        self.name = str(name or getattr(f, "__name__", type(f).__name__))

    def __repr__(self) -> str:
        shape = "" if self.shape is None else f", shape={self.shape}"
        return f"Function({self.name!r}{shape})"

    def __call__(self, *operands: Any) -> Call:
        """The expression f(operands). Its shape is checked immediately. Raises the errors of `Function`."""
        exprs = [e for operand in operands for e in (operand.parameters if _is_tree(operand) else [to_expr(operand)])]
        trees = tuple(operand if _is_tree(operand) else None for operand in operands)
        call = Call(*exprs, f=self.f, result_shape=self.shape, name=self.name, trees=trees)
        call.check_shape()
        return call


class Call(Expr, init=False):
    """The value of a `tx.Function` for its operands. Made by calling the function.

    Shapes: those that the function accepts -> the shape that it returns.

    Attributes:
        operands: the expressions that are its arguments.
        f: the function of arrays.
        result_shape: the required shape of its value; None: any.
        name: the name of the function.
        trees: for each argument of f its `ParameterTree`, whose arrays are operands; None for an ordinary operand.
    Raises:
        ModelError, ShapeError: as for `tx.Function`.
    """

    operands: Operands
    f: Callable[..., Any]
    result_shape: Shape | None
    name: str
    trees: tuple[ParameterTree | None, ...]
    of_numbers = True
    kinds = rules.OPEN
    cases = (
        (lambda cls, x: Function(_sine, name="sine")(x), {"x": [0.3, -2.0]}),
        (lambda cls, A, x: Function(_product, (2,))(A, x), {"A": [[1.0, 2.0], [0.5, -1.0]], "x": [0.3, -2.0]}),
        (
            lambda cls, x, **_: Function(_affine, (2,))(ParameterTree("p", {"A": np.ones((2, 2)), "b": np.ones(2)}), x),
            {"x": [0.3, -2.0], "p['A']": [[1.0, 2.0], [0.5, -1.0]], "p['b']": [0.1, 0.2]},
        ),
    )

    def infer_shape(self, *shapes: Shape) -> Shape:
        dtype = jax.dtypes.canonicalize_dtype(float)
        got = self._traced([jax.ShapeDtypeStruct(shape, dtype) for shape in shapes])
        if not isinstance(got, jax.ShapeDtypeStruct) or jnp.issubdtype(got.dtype, jnp.complexfloating):
            raise ModelError(
                f"Function {self.name!r} expects a function that returns one array of real numbers, got "
                f"{got.dtype if isinstance(got, jax.ShapeDtypeStruct) else short(got)}.\n"
                "  fix: return one array, for example with jnp.concatenate, or use a tx.Function for each part"
            )
        if self.result_shape is not None and got.shape != self.result_shape:
            raise ShapeError(
                f"Function {self.name!r} expects a value of shape {self.result_shape}, got {got.shape} for operands of "
                f"shapes {_listed(shapes)}",
                hint="pass the shape of the result, or correct the function",
            )
        return tuple(got.shape)

    def _traced(self, structs: Sequence[jax.ShapeDtypeStruct]) -> Any:
        try:
            return jax.eval_shape(self._applied, *structs)
        except _NEEDS_NUMBERS as error:
            raise ModelError(
                f"Function {self.name!r} needs concrete values of its arguments, which tracing by JAX does not have: "
                f"{_first_line(error)}\n"
                "  fix: write it in jax.numpy and jax.lax, or call other code by jax.pure_callback, with "
                "derivatives by jax.custom_jvp"
            ) from error
        except (TypeError, ValueError, IndexError) as error:
            shapes = _listed([struct.shape for struct in structs])
            raise ShapeError(
                f"Function {self.name!r} fails for operands of shapes {shapes}: {type(error).__name__}: "
                f"{_first_line(error)}",
                hint="check the shapes of its arguments, one array for each operand",
            ) from error

    def _applied(self, *values: Any) -> Any:
        dtype = jnp.result_type(*values)
        with jax.ensure_compile_time_eval():  # cast here, and not in each call
            f = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype) if is_real_array(leaf) else leaf, self.f)
        rest = iter(values)
        arguments = [next(rest) if t is None else t.filled([next(rest) for _ in t.parameters]) for t in self.trees]
        return f(*arguments)

    def evaluate(self, *values: Any) -> Any:
        return jnp.asarray(self._applied(*map(jnp.asarray, values)), jnp.result_type(*values))

    def details(self) -> list[str]:
        return []

    def to_text(self, *operands: str) -> str:
        return f"{self.name}({', '.join(operands)})"

    def to_latex(self, *operands: str) -> str:
        name = self.name.replace("_", r"\_")
        return rf"\mathrm{{{name}}}\left({', '.join(operands)}\right)"


def _sine(x: jax.Array) -> jax.Array:
    return jnp.sin(x)


def _product(A: jax.Array, x: jax.Array) -> jax.Array:
    return jnp.tanh(A @ x)


def _affine(p: Any, x: jax.Array) -> jax.Array:
    return p["A"] @ x + p["b"]


def _is_tree(value: Any) -> bool:
    return isinstance(value, ParameterTree)


def _shape(shape: Any) -> Shape:
    sizes = tuple(shape) if isinstance(shape, (tuple, list)) else (shape,)
    if not all(isinstance(n, (int, np.integer)) and not isinstance(n, bool) and n >= 1 for n in sizes):
        raise ModelError(f"Function: shape expects a tuple of positive whole numbers, got {shape!r}")
    return tuple(int(n) for n in sizes)


def _listed(shapes: Sequence[Shape]) -> str:
    return ", ".join(map(str, shapes))


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [""])[0]
