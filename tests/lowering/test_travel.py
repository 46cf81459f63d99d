"""Systems and what is compiled of them travel to other processes."""

import multiprocessing
import pickle
import sys
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.expr import Expr

x, u = tx.State("x", shape=(3,), initial=[1.0, 2.0, 3.0]), tx.Control("u", shape=(3,))
J = tx.Parameter("J", value=np.diag([1.0, 2.0, 3.0]))
POINT: Any = (0.1, {"x": np.array([0.3, -0.2, 0.5])}, {"u": np.array([1.0, 0.5, 0.2])})


class Applied(Expr):
    """A function of the user's, entry by entry."""

    operand: tx.expr.fields.Operand
    own: Callable[[jax.Array], jax.Array]

    def infer_shape(self, *shapes: tuple[int, ...]) -> tuple[int, ...]:
        return shapes[0]

    def evaluate(self, *values: Any) -> Any:
        return self.own(values[0])


def twice(value: jax.Array) -> jax.Array:
    return 2.0 * value


def _system(last: Expr = x) -> tx.System:
    return tx.System(
        {x: tx.linalg.Solve(J, u - tx.linalg.Cross(x, J @ x)) + Applied(last, twice)},
        outputs={"size": tx.linalg.Norm(x), "half": 0.5 * x},
        constraints=[u <= 3.0],
    )


def _rates(dynamics: tx.Dynamics) -> np.ndarray:
    with jax.enable_x64(True):
        return np.asarray(dynamics(*POINT)["x"])


@pytest.mark.parametrize("backend", ["auto", tx.JAX(), tx.XLA(least=0), tx.Native(least=0)], ids=str)
def test_a_compiled_system_comes_back_as_it_was(backend: Any) -> None:
    dynamics = tx.compile(_system(), backend=backend, bake={"J": np.diag([2.0, 3.0, 4.0])}, outputs=["size"])
    before = _rates(dynamics)
    back = pickle.loads(pickle.dumps(dynamics))
    np.testing.assert_array_equal(_rates(back), before)
    assert repr(back) == repr(dynamics)
    assert list(back.outputs(*POINT)) == ["size"]
    np.testing.assert_array_equal(back.states[0].initial, [1.0, 2.0, 3.0])


def test_what_expressions_of_a_system_share_stays_shared() -> None:
    part: Expr = x
    for _ in range(2000):
        part = tx.Sin(part)
    system = tx.System({x: part}, outputs={f"o{k}": part + float(k) for k in range(20)})
    assert len(pickle.dumps(system)) < 1.2 * len(pickle.dumps(part)) + 20_000
    back = pickle.loads(pickle.dumps(system))
    assert back.outputs["o1"].children()[0] is back.rates["x"]
    assert [e.key() for e in back.outputs.values()] == [e.key() for e in system.outputs.values()]


def test_a_new_process_computes_the_same() -> None:
    dynamics = tx.compile(_system())
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        (found,) = pool.map(_rates, [dynamics])
    np.testing.assert_array_equal(found, _rates(dynamics))


def test_what_pickle_refuses_is_named_with_its_node(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "cloudpickle", raising=False)  # it takes more
    with pytest.raises(pickle.PicklingError, match=r"(?s)the node Applied\(x.*own <function .*top level of a module"):
        pickle.dumps(tx.compile(tx.System({x: tx.Sin(Applied(x, lambda value: value))})))

    class Here(tx.Sin):
        """A class that no other process can find."""

    with pytest.raises(pickle.PicklingError, match=r"the node Here\(x\) cannot be pickled for its class"):
        pickle.dumps(Here(x))


@pytest.mark.parametrize(
    ("expr", "module", "key"),
    [
        (tx.State("x") < 1.0, "twistax.expr.arithmetic", "d5ee1f4a0978171c8b15da2d6a29e343"),
        (tx.State("x") <= 1.0, "twistax.expr.operations.arithmetic", "8584111153b61782fd5640be5d9e857d"),
        (tx.lie.LeftJacobian(tx.State("w", (3,))), "twistax.expr.lie.elements", "48851983524313e0322db4e1a996cabd"),
    ],
    ids=["<", "<=", "LeftJacobian"],
)
def test_a_class_that_has_moved_is_found_by_its_earlier_name_and_keeps_its_key(
    expr: Expr, module: str, key: str
) -> None:
    named = pickle.GLOBAL + f"{module}\n{type(expr).__name__}\n".encode() + pickle.STOP
    assert pickle.loads(named) is type(expr)
    assert expr.key() == key
