"""Constants are folded in NumPy: the same numbers as JAX finds, and no program of XLA's for each operation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.expr.numerals import _in_numpy, numerals
from twistax.report.speed.cases import CASES
from twistax.scalar.primitives.table import TABLE

A = np.array([[1.0, -2.0, 0.5], [0.3, 4.0, -1.0], [2.0, 0.0, 3.0]])
V = np.array([0.7, -0.2, 1.5])
FUNCTIONS = {
    "add": lambda a, v: a + v[:, None],
    "add_any": lambda a, v: jax.grad(lambda x: x @ x)(v),
    "sub": lambda a, v: a - 2.0 * a.T,
    "mul": lambda a, v: a * a.T,
    "neg": lambda a, v: -a,
    "abs": lambda a, v: jnp.abs(a),
    "max": lambda a, v: jnp.maximum(a, a.T),
    "min": lambda a, v: jnp.minimum(a, a.T),
    "eq": lambda a, v: a == a.T,
    "ne": lambda a, v: a != a.T,
    "lt": lambda a, v: a < a.T,
    "le": lambda a, v: a <= a.T,
    "gt": lambda a, v: a > a.T,
    "ge": lambda a, v: a >= a.T,
    "and": lambda a, v: (a > 0) & (a.T > 0),
    "or": lambda a, v: (a > 0) | (a.T > 0),
    "not": lambda a, v: ~(a > 0),
    "select_n": lambda a, v: jnp.where(a > 0, a, 2.0),
    "convert_element_type": lambda a, v: (a > 0).astype(float) + (a > 1).astype(int).astype(float),
    "square": lambda a, v: jax.lax.square(a),
    "sqrt": lambda a, v: jnp.sqrt(jnp.abs(a)),
    "reduce_sum": lambda a, v: jnp.sum(a, axis=0) + jnp.sum((a > 0).astype(int)).astype(float),
    "slice": lambda a, v: a[1:, ::2],
    "squeeze": lambda a, v: a[1, 2],
    "reshape": lambda a, v: a.reshape(-1),
    "transpose": lambda a, v: jnp.transpose(a),
    "concatenate": lambda a, v: jnp.concatenate([a, a[:1]]),
    "stack": lambda a, v: jnp.stack([v, 2.0 * v], axis=1),
    "broadcast_in_dim": lambda a, v: jax.lax.broadcast_in_dim(a, (3, 2, 3), (0, 2)),
    "unstack": lambda a, v: sum(jnp.unstack(a, axis=1)),
    "dot_general": lambda a, v: jnp.einsum("ij,kj->ki", a, a[:2]) @ v,
    "copy": lambda a, v: jnp.copy(v),
    "div": lambda a, v: (a / v[:, None])[0] + jax.lax.div(jnp.array([7, -7, 5]), jnp.array([2, 2, 0])).astype(float),
    "is_finite": lambda a, v: jnp.isfinite(a / (a - 2.0)),
    "sign": lambda a, v: jnp.sign(a),
    "floor": lambda a, v: jnp.floor(a),
    "ceil": lambda a, v: jnp.ceil(a),
    "rem": lambda a, v: jax.lax.rem(a, jnp.full_like(a, 0.7)),
    "clamp": lambda a, v: jax.lax.clamp(-1.0, a, 1.0),
    "xor": lambda a, v: (a > 0) ^ (a.T > 0),
    "rev": lambda a, v: jax.lax.rev(a, (1,)),
    "split": lambda a, v: sum(jax.lax.split(v, (1, 1, 1))),
    "tile": lambda a, v: jax.lax.tile(v, (2,)),
    "another order": lambda a, v: a.ravel(order="F"),
    "whole numbers": lambda a, v: jnp.concatenate([a.reshape(-1), jnp.array([np.nan, np.inf, -1e30])]).astype(int),
    "one of many": lambda a, v: jax.lax.select_n(jnp.array([2, -1, 7], jnp.int32), v, 2.0 * v, 3.0 * v),
    "wider product": lambda a, v: jax.lax.dot(
        jnp.asarray(100 * v, jnp.int8), jnp.asarray(100 * v, jnp.int8), preferred_element_type=jnp.int32
    ),
    "batched": lambda a, v: jnp.einsum("ij,ij->i", a, a),
    "nothing": lambda a, v: v,
}
IN_JAX = {"batched", "another order", "whole numbers", "one of many", "wider product"}


def _names(jaxpr):
    for eqn in jaxpr.eqns:
        yield eqn.primitive.name
        if eqn.primitive.name == "jit":
            yield from _names(eqn.params["jaxpr"].jaxpr)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_numbers_are_those_of_jax(name):
    function = FUNCTIONS[name]
    expected = function(jnp.asarray(A), jnp.asarray(V))
    found = numerals(function, [A, V], "a function", {})
    assert found.dtype == expected.dtype
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=1e-15, atol=1e-15)
    jaxpr = jax.make_jaxpr(function)(A, V).jaxpr
    assert _in_numpy(jaxpr) == (name not in IN_JAX)


def test_every_operation_of_the_table_is_compared():
    seen = {name for function in FUNCTIONS.values() for name in _names(jax.make_jaxpr(function)(A, V).jaxpr)}
    assert {name for name, entry in TABLE.items() if entry.numpy is not None} <= seen


@pytest.mark.parametrize("name", ["add", "reduce_sum", "jit"])
def test_an_equation_of_a_later_jax_is_left_to_jax(name):
    """One more parameter, or one under another name, and NumPy is not asked."""
    jaxpr = jax.make_jaxpr(FUNCTIONS["select_n" if name == "jit" else name])(A, V).jaxpr
    (eqn,) = [eqn for eqn in jaxpr.eqns if eqn.primitive.name == name][:1]
    params = dict(eqn.params, of_the_future=1)
    if name == "jit":
        params = {"body" if key == "jaxpr" else key: None for key in eqn.params}
    changed = jaxpr.replace(eqns=[eqn.replace(params=params)])
    assert _in_numpy(jaxpr.replace(eqns=[eqn]))
    assert not _in_numpy(changed)


def test_what_numpy_does_not_do_is_left_to_jax():
    found = numerals(
        lambda x: jax.lax.while_loop(lambda s: s < 10.0, lambda s: 2.0 * s, x), [np.array(3.0)], "a loop", {}
    )
    assert found == 12.0
    assert isinstance(found, np.ndarray)


def test_a_subclass_with_its_own_evaluate_gets_arrays_of_jax():
    class Cleared(tx.Neg):
        """Entries but the first."""

        def evaluate(self, *values):
            return values[0].at[0].set(0.0)

    assert tx.Neg.by_operators
    np.testing.assert_array_equal(Cleared(tx.Constant([1.0, 2.0])).canonicalize().value, [0.0, 2.0])


def test_folding_an_arm_compiles_next_to_nothing(caplog):
    arm = CASES["aba-7"].system()
    jax.clear_caches()
    with jax.log_compiles():
        tx.compile(arm, backend=tx.XLA())
    compiled = [record for record in caplog.records if record.getMessage().startswith("Compiling")]
    assert len(compiled) < 15, [record.getMessage()[:60] for record in compiled]


def test_what_is_traced_once_is_not_taken_for_what_reads_its_operands():
    """Products with 1 / y are quotients, and tables of numbers are read where they stand."""
    x, y = tx.State("x", shape=(3,)), tx.State("y", shape=(3,))
    shifted = [x + k for k in range(1, 5)]
    roots = [a * b for a in shifted for b in (y, 1.0 / y)] + [tx.linalg.Cross(a, y) for a in shifted]
    values = {"x": np.array([1.0, -2.0, 0.5]), "y": np.array([3.0, 0.7, -1.1])}
    expected = [f(values["x"] + k) for k in range(1, 5) for f in (lambda a: a * values["y"], lambda a: a / values["y"])]
    expected += [np.cross(values["x"] + k, values["y"]) for k in range(1, 5)]
    found = jax.jit(tx.lower(tuple(roots)))(0.0, values)
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    folded = [tx.Linterp(tx.Constant(0.5), [0.0, 1.0], [0.0, float(k)]).canonicalize() for k in range(5)]
    together = sum((tx.Linterp(tx.Constant(0.5), [0.0, 1.0], [0.0, float(k)]) for k in range(5)), tx.Constant(0.0))
    assert sum(float(each.value) for each in folded) == float(together.canonicalize().value) == 5.0
