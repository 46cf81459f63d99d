"""Every operation on vectors, against NumPy, with special values."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")

from native_programs import at_every_width, processors, program_of, run

import twistax as tx
from twistax.scalar.primitives.entry import convert
from twistax.scalar.primitives.table import OPERATIONS
from twistax.scalar.reader import scalarize
from twistax.scalar.targets.llvm.code import NotNative
from twistax.scalar.targets.llvm.kernel_body import native_form
from twistax.scalar.targets.llvm.machine_code import Processor

SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, -3.0, np.inf, -np.inf, np.nan, 1e-30, -1e-30, 7.25, -7.75, 1e9, 3.0]
RANDOM = np.random.default_rng(0)
UNARY = [
    *("neg", "abs", "sign", "floor", "ceil", "sqrt", "cbrt", "exp", "exp2", "expm1", "log", "log1p", "sin", "cos"),
    *("tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "logistic", "stop_gradient"),
    "is_finite",
]
BINARY = ["add", "sub", "mul", "div", "rem", "max", "min", "pow", "atan2", "eq", "ne", "lt", "le", "gt", "ge"]
ON_INTEGERS = ["add", "sub", "mul", "max", "min", "and", "or", "xor", "eq", "ne", "lt", "le", "gt", "ge"]
ON_TRUTH = ["and", "or", "xor", "eq", "ne", "lt", "le", "gt", "ge", "max", "min"]
#: Units in the last place: NumPy's own functions are not exact either.
ULPS = {"logistic": 4.0, "exp2": 4.0}


def _pairs() -> tuple[np.ndarray, np.ndarray]:
    a, b = np.meshgrid(SPECIAL, SPECIAL)
    more = RANDOM.normal(size=(2, 40)) * 3.0
    return np.concatenate([a.ravel(), more[0]]), np.concatenate([b.ravel(), more[1]])


def _same(name: str, own: np.ndarray, other: np.ndarray, array: np.ndarray | None = None) -> None:
    other = np.asarray(other).astype(own.dtype)
    if own.dtype.kind != "f":
        np.testing.assert_array_equal(own, other, err_msg=name)
        return
    np.testing.assert_array_equal(np.isnan(own), np.isnan(other), err_msg=name)
    np.testing.assert_array_equal(np.isinf(own), np.isinf(other), err_msg=name)
    finite = np.isfinite(other)
    unit = np.spacing(np.abs(other[finite]))
    wrong = np.abs(own[finite] - other[finite]) > ULPS.get(name, 4.0) * unit
    assert not wrong.any(), (name, own[finite][wrong], other[finite][wrong])
    signed = finite | np.isinf(other)
    if array is not None:
        # XLA's, where it and NumPy give a zero the same sign.
        signed = signed & (np.signbit(array) == np.signbit(other))
    np.testing.assert_array_equal(np.signbit(own[signed]), np.signbit(other[signed]), err_msg=f"sign of {name}")


def _as_xla(operations: list[Any], columns: list[np.ndarray]) -> list[np.ndarray]:
    together = jax.jit(
        lambda *values: [operation.array(*values) for operation in operations],
        compiler_options={"xla_backend_optimization_level": 0},
    )
    return [np.asarray(value) for value in together(*columns)]


@at_every_width
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_operations_on_reals(dtype: Any, processor: Processor) -> None:
    x = np.concatenate([SPECIAL, RANDOM.normal(size=60) * 2.0]).astype(dtype)
    a, b = (values.astype(dtype) for values in _pairs())
    with np.errstate(all="ignore"):
        for names, columns in ((UNARY, [x]), (BINARY, [a, b])):
            operations = [OPERATIONS[name] for name in names]
            found = run(program_of(operations, dtype, len(columns)), processor, *columns)
            arrays = _as_xla(operations, columns)
            for operation, own, array in zip(operations, found, arrays, strict=True):
                assert own.dtype == array.dtype
                _same(operation.name, own, operation.number(*columns), array)


def test_narrow_vectors_with_fused_products() -> None:
    """As ARM has them."""
    operations = [OPERATIONS[name] for name in ("add", "mul", "div", "max", "atan2", "lt")]
    a, b = _pairs()
    with np.errstate(all="ignore"):
        for dtype in (np.float64, np.float32):
            columns = a.astype(dtype), b.astype(dtype)
            found = run(program_of(operations, dtype, 2), processors()[-1], *columns)
            for operation, own in zip(operations, found, strict=True):
                _same(operation.name, own, operation.number(*columns))


def test_vectors_that_are_not_there_are_refused() -> None:
    with pytest.raises(tx.ModelError, match="expects bits of at most"):
        Processor.host(1024)


@at_every_width
def test_three_arguments(processor: Processor) -> None:
    low, high = -1.0, 2.0
    x = np.array(SPECIAL)
    found = run(program_of([OPERATIONS["clamp"]], float, 3), processor, low, x, high)[0]
    np.testing.assert_array_equal(found, np.clip(x, low, high))
    program = program_of([OPERATIONS["lt"]], float, 2)
    graph = program.graph
    chosen = graph.node(OPERATIONS["select"], program.flat[0], *(int(i[0]) for i in program.inputs))
    program = program.restricted([np.array([chosen])])
    a, b = _pairs()
    np.testing.assert_array_equal(run(program, processor, a, b)[0], np.where(a < b, a, b))


@at_every_width
@pytest.mark.parametrize("dtype", [np.int32, np.int64, np.bool_])
def test_operations_on_integers_and_truth(dtype: Any, processor: Processor) -> None:
    values = np.array([False, True] if dtype == np.bool_ else [0, 1, -1, 5, -7, 2**30, -(2**31)], dtype)
    a, b = (v.ravel() for v in np.meshgrid(values, values))
    names = ON_TRUTH if dtype == np.bool_ else ON_INTEGERS
    operations = [OPERATIONS[name] for name in names]
    with np.errstate(all="ignore"):
        found = run(program_of(operations, dtype, 2), processor, a, b)
        for operation, own in zip(operations, found, strict=True):
            np.testing.assert_array_equal(own, operation.number(a, b), err_msg=operation.name)
        single = ["not"] if dtype == np.bool_ else ["not", "neg", "abs", "sign"]
        found = run(program_of([OPERATIONS[name] for name in single], dtype, 1), processor, values)
        for name, own in zip(single, found, strict=True):
            np.testing.assert_array_equal(own, OPERATIONS[name].number(values), err_msg=name)


@at_every_width
@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int32, np.int64, np.bool_])
def test_conversions(dtype: Any, processor: Processor) -> None:
    """As JAX has them: to the nearest integer there is, not a number to zero."""
    values = np.array([0, 1, 1, 0] if dtype == np.bool_ else [0, 1, -5, 2**31 - 1], dtype)
    if np.issubdtype(dtype, np.floating):
        values = np.array([*SPECIAL, 1e12, -1e12, 1e20, 2.5, -2.5], dtype)
    targets = [np.dtype(t) for t in (np.float64, np.float32, np.int32, np.int64, bool) if t != dtype]
    operations = [convert(target) for target in targets]
    found = run(program_of(operations, dtype, 1), processor, values)
    for operation, own, array in zip(operations, found, _as_xla(operations, [values]), strict=True):
        np.testing.assert_array_equal(own, array, err_msg=operation.name)


@at_every_width
def test_float64_numbers_of_float32_programs(processor: Processor) -> None:
    """Sines in both precisions side by side."""

    def function(x: Any) -> list[Any]:
        turned = jnp.sin(jnp.where(x > 0.5, 0.1, 0.3) / 3.0) + jnp.where(x > 2.0, 1.0, 2.0)
        return [turned.astype(x.dtype) * jnp.sin(x)]

    x = RANDOM.normal(size=(100, 1)).astype(np.float32)
    result = run(scalarize(function, jax.ShapeDtypeStruct((1,), x.dtype)), processor, x)[0]
    turned = np.sin(np.where(x > 0.5, 0.1, 0.3) / 3.0) + np.where(x > 2.0, 1.0, 2.0)
    np.testing.assert_allclose(result, (turned.astype(np.float32) * np.sin(x))[:, 0], rtol=5e-7)


@pytest.mark.parametrize("name", ["div", "rem"])
def test_division_of_integers_is_not_native(name: str) -> None:
    with pytest.raises(NotNative, match=f"{name} of i64"):
        native_form(program_of([OPERATIONS[name]], np.int64, 2))


def test_every_operation_is_tried() -> None:
    """So that a new operation gets a rule, or is refused on purpose."""
    tried = {*UNARY, *BINARY, *ON_INTEGERS, *ON_TRUTH, "not", "clamp", "select"}
    assert tried == set(OPERATIONS)
