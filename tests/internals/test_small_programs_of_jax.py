"""Programs of another JAX, and functions without metadata."""

import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from test_jax_inside import ARGUMENTS, recursion
from twistax import progress
from twistax.jax_inside import tracing
from twistax.scalar.reader import scalarize
from twistax.scalar.targets.xla import as_function


@pytest.mark.parametrize("params", [{"later": 1}, {"ft_in": "?", "ft_out": "?", "num_consts": None, "num_carry": None}])
def test_a_scan_of_another_jax_runs_as_jax_has_it(params: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_SAID", set())
    closed = jax.make_jaxpr(recursion)(*ARGUMENTS)
    kept = tracing.parameters

    def other(eqn: Any, *known: Any) -> Any:
        if eqn.primitive.name != "scan":
            return kept(eqn, *known)
        changed = {**eqn.params, **params}
        changed = {name: value for name, value in changed.items() if value is not None}
        return kept(eqn.replace(params=changed), *known)

    monkeypatch.setattr(tracing, "parameters", other)
    with pytest.warns(RuntimeWarning, match="scan.*which this twistax does not know: JAX executes this operation"):
        program = scalarize(closed)
    assert [call.jaxpr.jaxpr.eqns[0].primitive.name for call in program.calls] == ["scan"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # said once
        again = scalarize(closed)
    for expected, found in zip(recursion(*ARGUMENTS), as_function(again)(*map(jnp.asarray, ARGUMENTS)), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_without_metadata_functions_run_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    from twistax.scalar.small_call import small_call

    monkeypatch.setattr(tracing, "_set_xla_metadata", None)
    assert not tracing.small_calls_exist()
    x = jnp.arange(3.0)
    np.testing.assert_array_equal(small_call(lambda a: a * a, x), x * x)
