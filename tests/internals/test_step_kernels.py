"""Kernels of steps chosen by tolerances: how rows are planned, and a wrong kernel is noticed."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from windy_body import START, U, windy_body

import twistax as tx
from twistax.integrators.options import Options, plan_of
from twistax.scalar.primitives.table import OPERATIONS
from twistax.scalar.reader import scalarize
from twistax.scalar.targets.llvm.iterations import Iterations
from twistax.scalar.targets.llvm.kernel import HostKernel
from twistax.scalar.targets.llvm.kernel_body import native_form
from twistax.scalar.targets.llvm.machine_code import BuildError, Processor
from twistax.scalar.targets.llvm.self_test import check_kernel

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")


def test_rows_that_fill_up_are_never_reached() -> None:
    """There is room for 512 rows where 65 are asked for; polynomials are read for those alone."""
    dynamics = tx.compile(windy_body())
    at = np.linspace(0.0, 0.7, 65)
    plan = plan_of(dynamics, START, Options(t1=0.7, rtol=1e-6, u=U, save_at=at, between=tx.Between.POLYNOMIAL))
    np.testing.assert_allclose(plan.steps.stops.ts[:65], at)
    assert len(plan.steps.stops.ts) > 65
    assert np.isinf(plan.steps.stops.ts[65:]).all()


def test_a_wrong_kernel_for_one_body_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels are checked in turns that they take: here products are sums."""
    monkeypatch.setitem(vars(OPERATIONS["mul"]), "llvm", OPERATIONS["add"].llvm)
    number, x = jax.ShapeDtypeStruct((), int), jax.ShapeDtypeStruct((3,), float)
    step = native_form(scalarize(lambda k, x: [0.5 * x, (x > 0.0).all()], number, x))
    body = Iterations(step, 1, 1)
    with pytest.raises(BuildError, match="differ"):
        check_kernel(HostKernel(body, Processor.host()))
