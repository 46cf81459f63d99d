"""Scalar programs worked out by NumPy, node by node, and cases on which they are compared with JAX itself."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxpr_as_fun

from twistax.scalar.derivatives import cotangent_program, jacobian, tangent_program
from twistax.scalar.program import ScalarProgram
from twistax.scalar.reader import emitted_form, scalarize


def evaluate(program: ScalarProgram, *arguments: Any) -> list[np.ndarray]:
    """The results by NumPy: every operation by its `number`; calls by JAX."""
    g = program.graph
    entries = [np.asarray(a).reshape(-1) for a in arguments]
    values: dict[int, Any] = {}
    done: set[int] = set()
    with np.errstate(all="ignore"):
        for i in program.live:
            place, call, operation = g.input_of(i), g.call_of(i), g.operation(i)
            if place is not None:
                values[i] = entries[place[0]][place[1]]
            elif call is not None:
                if id(call) not in done:
                    done.add(id(call))
                    types = [v.aval.dtype for v in call.jaxpr.jaxpr.invars]
                    given = [
                        np.array([values[j] for j in a.reshape(-1).tolist()], t).reshape(a.shape)
                        for a, t in zip(call.arguments, types, strict=True)
                    ]
                    for nodes, result in zip(call.results, jaxpr_as_fun(call.jaxpr)(*given), strict=True):
                        values.update(zip(nodes.reshape(-1).tolist(), np.asarray(result).reshape(-1), strict=True))
            elif operation is None:
                values[i] = g.dtypes[i].type(g.numbers[i])
            else:
                found = operation.number(*(values[a] for a in g.arguments(i)))
                values[i] = np.asarray(found).astype(g.dtypes[i])[()]
                assert values[i].dtype == g.dtypes[i], (operation, values[i].dtype)
    return [
        np.array([values[i] for i in nodes.reshape(-1).tolist()], dtype).reshape(nodes.shape)
        for nodes, dtype in zip(program.outputs, program.types, strict=True)
    ]


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """A function with arguments, and which derivatives JAX gives of it."""

    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    forward: bool = True
    reverse: bool = True
    #: Names of primitives that stay calls.
    unread: bool = False
    atol: float = 1e-12

    def __str__(self) -> str:
        return self.name

    def flat(self, *arguments: Any) -> list[jax.Array]:
        return [jnp.asarray(r) for r in jax.tree.leaves(self.function(*arguments))]

    @functools.cached_property
    def arrays(self) -> list[np.ndarray]:
        return [np.asarray(a) for a in self.arguments]

    @functools.cached_property
    def program(self) -> ScalarProgram:
        return scalarize(self.flat, *(jax.ShapeDtypeStruct(a.shape, a.dtype) for a in self.arrays))

    @property
    def active(self) -> list[int]:
        return [k for k, a in enumerate(self.arrays) if np.issubdtype(a.dtype, np.floating)]

    def along(self) -> list[np.ndarray]:
        rng = np.random.default_rng(1)
        return [rng.normal(size=self.arrays[k].shape).astype(self.arrays[k].dtype) for k in self.active]

    def across(self) -> list[np.ndarray]:
        rng = np.random.default_rng(2)
        real = [o for o, t in zip(self.program.outputs, self.program.types, strict=True) if _real(t)]
        types = [t for t in self.program.types if _real(t)]
        return [rng.normal(size=o.shape).astype(t) for o, t in zip(real, types, strict=True)]

    def oracle(self, given: Sequence[jax.Array]) -> dict[str, Any]:
        """What JAX gives."""

        def moving(*some: Any) -> list[jax.Array]:
            full = list(given)
            for k, value in zip(self.active, some, strict=True):
                full[k] = value
            return [r for r in self.flat(*full) if _real(r.dtype)]

        found: dict[str, Any] = {"value": self.flat(*given)}
        own = [given[k] for k in self.active]
        if self.forward and own:
            found["forward"] = jax.jvp(moving, own, [jnp.asarray(a) for a in self.along()])[1]
        if self.reverse and own:
            found["reverse"] = jax.vjp(moving, *own)[1]([jnp.asarray(a) for a in self.across()])
        return found


def _real(dtype: Any) -> bool:
    return bool(np.issubdtype(dtype, np.floating))


def oracles(cases: Sequence[Case]) -> dict[str, dict[str, Any]]:
    """What JAX gives for all cases, compiled at once; numbers are arguments, so that XLA does not fold them."""
    together = jax.jit(
        lambda arrays: {case.name: case.oracle(a) for case, a in zip(cases, arrays, strict=True)},
        compiler_options={"xla_backend_optimization_level": 0},
    )
    return together([case.arrays for case in cases])


def compare(case: Case, expected: dict[str, Any]) -> None:
    """Value, forward and reverse derivative, Jacobian, and the form that is emitted: all as JAX has them."""
    program = case.program
    sizes = [np.abs(x[np.isfinite(x)]).max(initial=1.0) for part in expected.values() for x in map(np.asarray, part)]
    same = {"rtol": 1e-11, "atol": case.atol * float(max(sizes, default=1.0))}
    if any(a.dtype == np.float32 for a in case.arrays):
        same = {"rtol": 2e-5, "atol": 2e-5}
    for found in (evaluate(program, *case.arrays), evaluate(emitted_form(program), *case.arrays)):
        assert len(found) == len(expected["value"])
        for own, other in zip(found, expected["value"], strict=True):
            assert (own.shape, own.dtype) == (other.shape, other.dtype)
            np.testing.assert_allclose(own, other, **same, err_msg="value")
    active = case.active
    if "forward" in expected:
        derivative = tangent_program(program, active)
        for form in (derivative, emitted_form(derivative)):
            found = evaluate(form, *case.arrays, *case.along())
            for own, other in zip(found, expected["forward"], strict=True):
                assert (own.shape, own.dtype) == (other.shape, other.dtype)
                np.testing.assert_allclose(own, other, **same, err_msg="forward")
        _compare_jacobian(case, expected["forward"], same)
    if "reverse" in expected:
        derivative = cotangent_program(program, active)
        for form in (derivative, emitted_form(derivative)):
            found = evaluate(form, *case.arrays, *case.across())
            for own, other in zip(found, expected["reverse"], strict=True):
                assert (own.shape, own.dtype) == (other.shape, other.dtype)
                np.testing.assert_allclose(own, other, **same, err_msg="reverse")


def as_jax(cases: Sequence[Case]) -> Callable[[Case], None]:
    """A test of these cases; warnings are errors."""
    expected = functools.cache(lambda: oracles(cases))

    @pytest.mark.parametrize("case", cases, ids=str)
    def test(case: Case) -> None:
        compare(case, expected()[case.name])

    return test


def _compare_jacobian(case: Case, expected: Sequence[Any], same: Any) -> None:
    """The Jacobian times the tangents."""
    program, along = case.program, case.along()
    entries = jacobian(program, case.active)
    vector = np.concatenate([a.reshape(-1) for a in along]) if along else np.zeros(0)
    values = evaluate(program.restricted([np.array(node) for node in entries.values()]), *case.arrays)
    found = np.zeros(len(program.flat), np.result_type(vector))
    for (row, column), value in zip(entries, values, strict=True):
        found[row] += value * vector[column]
    flat_types = np.concatenate(
        [np.full(o.size, _real(t)) for o, t in zip(program.outputs, program.types, strict=True)]
    )
    other = np.concatenate([np.asarray(e).reshape(-1) for e in expected]) if expected else np.zeros(0)
    np.testing.assert_allclose(found[flat_types.astype(bool)], other, **same, err_msg="jacobian")
