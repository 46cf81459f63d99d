"""A backend that is none of the package."""

from typing import Any

import numpy as np

import twistax as tx
from twistax.scalar.backends import Backend, StepCompiler


def test_a_backend_of_ones_own() -> None:
    class Twice(Backend):
        def emit(self, closed: Any, fixed: Any = ()) -> Any:
            emitted = tx.JAX().emit(closed, fixed)
            return type(emitted)(lambda *a: [2.0 * v for v in emitted.function(*a)], None, "twice")

    x = tx.State("x", shape=(2,))
    dynamics = tx.compile(tx.System(rates={x: tx.Where(x >= 0.0, tx.Sin(x), -3.0 * x)}), backend=Twice())
    assert repr(dynamics).endswith("backend: Twice)")
    assert dynamics.explain().backend == "twice"
    rates = dynamics(0.2, {"x": np.array([1.0, -2.0])})["x"]
    np.testing.assert_allclose(rates, [2.0 * np.sin(1.0), 12.0])


def test_the_interface_is_small() -> None:
    """Functions, those of large arrays, those of any size, programs, what runs in loops, and steps; a backend of one's
    own needs the first alone.
    """
    for interface in (Backend, StepCompiler):
        assert len([name for name, value in vars(interface).items() if callable(value) and name[0] != "_"]) <= 6
    assert Backend.__abstractmethods__ == {"emit"}
