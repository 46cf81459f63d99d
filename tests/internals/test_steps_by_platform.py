"""Which accelerators take kernels of steps."""

import jax
import jax.numpy as jnp
import pytest
from turning_top import integrated, top

import twistax as tx
from compiled_steps import programs_of_steps
from twistax.scalar.targets.llvm import step_kernels


@pytest.mark.parametrize(("platform", "kernels"), [("tpu", False), ("cuda", True)])
def test_other_accelerators_take_no_kernels(platform: str, kernels: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """There a step written out whole would compile for long and run no faster."""
    pytest.importorskip("llvmlite", reason="native kernels need llvmlite")
    dynamics = tx.compile(top(), backend=tx.Native())
    monkeypatch.setattr(step_kernels, "backends", lambda: {"cpu": None, platform: None})
    cost = integrated(dynamics, steps=3, method=tx.RKMK(tx.tableaus.DOP853))
    jax.make_jaxpr(cost)(jnp.zeros(3))
    jax.make_jaxpr(jax.grad(cost))(jnp.zeros(3))
    steps = [made for made in dynamics.functions.steps.values() if made is not None]
    assert (steps != programs_of_steps(dynamics)) == kernels
    assert all((program.runner is not None) == kernels for program in programs_of_steps(dynamics))
