"""The table of primitives against the JAX at hand: what it knows is what there is, and the rest is left to JAX."""

from __future__ import annotations

import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from scalar_cases import Case, as_jax, evaluate
from table_examples import EXAMPLES

from twistax import progress
from twistax.jax_inside import Literal, Unread, all_equations
from twistax.scalar.backends import array_operations
from twistax.scalar.graph import ScalarGraph
from twistax.scalar.primitives.entry import Entry
from twistax.scalar.primitives.interface import nodes
from twistax.scalar.primitives.table import OPERATIONS, TABLE
from twistax.scalar.reader import JaxprReader, emitted_form, scalarize
from twistax.scalar.small_call import known_inside, small_call


def traced(name: str) -> Any:
    function, *arrays = EXAMPLES[name]
    return jax.make_jaxpr(function)(*map(jnp.asarray, arrays))


def test_every_entry_has_an_example() -> None:
    """`select`, which JAX has not, excepted."""
    assert set(TABLE) - set(EXAMPLES) <= {"select", "call_hi_primitive"}


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_parameters_are_those_that_jax_gives(name: str) -> None:
    """A parameter that a later JAX adds, drops or renames is seen here, also in what an example is made of."""
    found = list(all_equations(traced(name).jaxpr))
    assert any(eqn.primitive.name == name for eqn in found)
    for eqn in found:
        entry = TABLE.get(eqn.primitive.name)
        if entry is not None:
            assert entry.understands(eqn) or "branches_platforms" in eqn.params, eqn


def test_every_scalar_example_is_read() -> None:
    """But for what is left to JAX on purpose."""
    left = {name for name, entry in TABLE.items() if type(entry) is Entry and entry.read is None}
    assert left == {"round", "while"}
    for name, (function, *arrays) in EXAMPLES.items():
        if name not in left | {"custom_jvp_call", "custom_vjp_call", "custom_linear_solve"}:
            shapes = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in arrays]
            program = scalarize(lambda *a, f=function: jax.tree.leaves(f(*a)), *shapes)
            assert name == "convert_element_type" or not program.calls, name


def _another_jax(entry: Entry, monkeypatch: pytest.MonkeyPatch) -> None:
    """As if JAX gave the primitive one parameter more, or one less."""
    known = entry.takes.split("|")[0].split()
    monkeypatch.setitem(vars(entry), "takes", " ".join(known[1:]) if known else "mystery")


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_unknown_parameter_leaves_the_equation_to_jax(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """At each place that reads parameters: the same numbers, one warning, no crash."""
    function, *arrays = EXAMPLES[name]
    arrays = [jnp.asarray(a) for a in arrays]
    closed = traced(name)
    expected = jax.tree.leaves(function(*arrays))
    _another_jax(TABLE[name], monkeypatch)
    monkeypatch.setattr(progress, "_SAID", set())
    with warnings.catch_warnings(record=True) as messages:
        warnings.simplefilter("always")
        program = scalarize(closed)
        found = [evaluate(program, *arrays), evaluate(emitted_form(program), *arrays)]
        assert program.calls
        assert array_operations(closed.jaxpr).total() >= 0
        assert not known_inside(closed.jaxpr)
        found.append(jax.tree.leaves(small_call(function, *arrays)))
    told = [str(message.message) for message in messages]
    assert [m for m in told if "which this twistax does not know" in m] == told
    assert len(told) == 1
    assert f"gives {name} the parameters" in told[0]
    for results in found:
        for own, other in zip(results, expected, strict=True):
            assert (own.shape, own.dtype) == (other.shape, other.dtype)
            np.testing.assert_allclose(own, other, rtol=1e-14)


def test_a_parameter_more_is_not_known() -> None:
    """The other way round: an equation that holds more."""
    (eqn,) = traced("transpose").jaxpr.eqns
    with pytest.raises(Unread, match="gives transpose the parameters"):
        TABLE["transpose"].understands(eqn.replace(params={**eqn.params, "mystery": 1}))


#: Parameters that change no number: where arrays lie, and how they are kept; promises of the caller; how derivatives
#: are made, which are made of the scalars here; the number that is taken beyond the end, where gathers are left to JAX;
#: what complex numbers and results of another type have, which are not read.
IDLE = """
sharding out_sharding in_shardings out_shardings in_layouts out_layouts ctx_mesh name inline keep_unused donated_invars
weak_type indices_are_sorted unique_indices is_stable unroll prevent_cse differentiated policy symbolic_zeros
jvp_jaxpr_fun fwd_jaxpr_thunk bwd num_consts out_trees ft_out fill_value conjugate_a preferred_element_type
update_consts
"""
#: The sum and the product, by the names of their primitives; where a program runs.
NAMED = {
    "scatter-add": {"update_jaxpr"},
    "scatter-mul": {"update_jaxpr"},
    "scalar_program": {"inside"},
    "native_program": {"inside"},
    "batched_function": {"inside"},
    "custom_vmap_call": {"rule", "in_tree", "out_tree"},
}


class Watched(dict[str, Any]):
    """Parameters that know which of them were read."""

    def __init__(self, params: dict[str, Any]) -> None:
        super().__init__(params)
        self.read: set[str] = set()

    def __getitem__(self, name: str) -> Any:
        self.read.add(name)
        return super().__getitem__(name)

    def get(self, name: str, default: Any = None) -> Any:
        self.read.add(name)
        return super().get(name, default)


@pytest.mark.parametrize("name", [name for name in EXAMPLES if TABLE[name].read is not None or name in OPERATIONS])
def test_a_rule_reads_all_parameters(name: str) -> None:
    """But for those without effect: what is taken and not read would be wrong in silence."""
    eqn = next(eqn for eqn in all_equations(traced(name).jaxpr) if eqn.primitive.name == name)
    watched = Watched(eqn.params)
    eqn = eqn.replace(params=watched)
    entry, graph = TABLE[name], ScalarGraph(np.float64)
    assert watched is eqn.params
    assert entry.understands(eqn)
    arrays = [
        graph.array(np.asarray(v.val, v.aval.dtype))
        if isinstance(v, Literal)
        else nodes([graph.input(k, j, np.dtype(v.aval.dtype)) for j in range(v.aval.size)], v.aval.shape)
        for k, v in enumerate(eqn.invars)
    ]
    entry.scalars(JaxprReader(graph, keep_calls=False), eqn, *arrays)
    assert set(watched) - watched.read <= set(IDLE.split()) | NAMED.get(name, set())


# ---- values of parameters that are not read --------------------------------------------------------------------------

V, M = np.arange(1.0, 6.0) / 3.0, np.arange(1.0, 13.0).reshape(3, 4) / 5.0
PLACES = np.array([3, 0])
WITHIN = {"forward": False, "reverse": False}

CASES = [
    Case("a function at places", lambda a: a.at[PLACES].apply(jnp.sin), (V,), **WITHIN),
    Case("a function at places beyond", lambda a: a.at[np.array([7, 1])].apply(jnp.sqrt), (V,), **WITHIN),
    Case("smaller at places", lambda a: (a.at[PLACES].min(0.5), a.at[PLACES].max(0.5)), (V,), **WITHIN),
    Case("less at places", lambda a: a.at[PLACES].subtract(0.5), (V,), **WITHIN),
    Case("along an axis", lambda a: jnp.take_along_axis(a, np.array([[1], [0], [3]]), 1), (M,), **WITHIN),
    Case("put along an axis", lambda a: jnp.put_along_axis(a, np.array([[1], [0]]), 9.0, 1, inplace=False), (M[:2],)),
    Case("another order of axes", lambda a: lax.reshape(a, (12,), (1, 0)), (M,)),
    Case("in another order", lambda a: a.ravel(order="F"), (M,)),
    Case("as exactly as can be", lambda a: lax.exp(a, accuracy=lax.AccuracyMode.HIGHEST), (V,), **WITHIN),
    Case("sorted by two keys", lambda a, b: lax.sort((a, b), num_keys=2), (PLACES, PLACES[::-1]), **WITHIN),
    Case("by platform", lambda a: lax.platform_dependent(a, cpu=jnp.sin, default=jnp.cos), (V,), **WITHIN),
    Case(
        "by an algorithm that rounds",
        lambda a: lax.dot(a, a.T, precision=lax.DotAlgorithmPreset.BF16_BF16_F32, preferred_element_type=np.float32),
        (M.astype(np.float32),),
        **WITHIN,
    ),
    Case(
        "filled with a number", lambda a, k: a.at[k].get(mode="fill", fill_value=7.0), (V, np.array([9, 1])), **WITHIN
    ),
]


test_values_that_are_not_read_are_left_to_jax = as_jax(CASES)
