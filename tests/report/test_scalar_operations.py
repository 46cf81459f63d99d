"""The report of scalar operations measures what it says."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from twistax.lowering.scalar.program import scalarize
from twistax.report import scalar_operations


def test_the_free_body_stays_below_its_bar_and_agrees() -> None:
    case = scalar_operations.cases()[0]
    program = scalarize(case.function, *(jax.ShapeDtypeStruct((n,), jnp.float64) for n in case.sizes))
    assert program.operations <= case.bar
    value, slope = scalar_operations._disagreement(program, case)
    assert value < scalar_operations.VALUE_BAR
    assert slope < scalar_operations.JACOBIAN_BAR


def test_a_disagreement_is_seen() -> None:
    case = scalar_operations.cases()[0]
    program = scalarize(case.function, *(jax.ShapeDtypeStruct((n,), jnp.float64) for n in case.sizes))
    other = dataclasses.replace(case, function=lambda *a: [1.0 + 1e-9 + r for r in case.function(*a)])
    value, _ = scalar_operations._disagreement(program, other)
    assert np.isfinite(value)
    assert value > 1e-3
