"""On 8 simulated devices: programs, loops and integrations of arrays that are sharded. Prints what is wrong.

With --all also events, steps chosen by tolerances, and controls that are functions of time.
"""

import os

os.environ["XLA_FLAGS"] = "--xla_force_host_platform_device_count=8 --xla_backend_optimization_level=0"

import functools
import re
import sys
from collections.abc import Callable
from typing import Any

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec

import twistax as tx

jax.config.update("jax_enable_x64", True)

#: What takes longer too.
ALL = "--all" in sys.argv
P = PartitionSpec
MESH, EXPLICIT = (
    jax.make_mesh((4, 2), ("d", "e"), axis_types=(kind,) * 2)
    for kind in (jax.sharding.AxisType.Auto, jax.sharding.AxisType.Explicit)
)
RANDOM = np.random.default_rng(0)
X, Y, A = RANDOM.normal(size=(16, 3)), RANDOM.normal(size=(8, 6, 3)), RANDOM.normal(size=(3, 3)) * 0.3

s, p = tx.State("s", (3,)), tx.Parameter("p", value=np.eye(3))
SYSTEM = tx.System(rates={s: tx.Cos(s) * (p @ s)}, parameters=[p])


def rates(backend: Any) -> Callable[..., jax.Array]:
    dynamics = tx.compile(SYSTEM, backend=backend)
    return jax.vmap(lambda x, a: dynamics(0.0, {"s": x}, {}, {"p": a})["s"], in_axes=(0, None))


def known(x: jax.Array, a: jax.Array) -> jax.Array:
    return jnp.cos(x) * (x @ a.T)


def slopes(function: Callable[..., jax.Array]) -> Callable[..., Any]:
    return jax.grad(lambda x, a: jnp.sin(function(x, a)).sum(), (0, 1))


def loop(x: jax.Array, a: jax.Array) -> jax.Array:
    return jax.lax.fori_loop(0, 800, lambda k, c: jnp.cos(a @ c) + 1e-3 * k, x)


def loop_with_row(x: jax.Array, a: jax.Array) -> jax.Array:
    return jax.lax.fori_loop(0, 800, lambda k, c: jnp.cos(a @ c) + 1e-3 * k + a[0], x)


def until(x: jax.Array, a: jax.Array) -> jax.Array:
    """Without end where there is no member, but zeros."""
    return jax.lax.while_loop(lambda c: (jnp.abs(c) < 1.0).all(), lambda c: c + c, x + a[0] * 0.0)


def check(
    name: str,
    function: Callable[..., Any],
    expected: Any,
    spec: Any,
    x: np.ndarray = X,
    sharded: bool = True,
    mesh: Any = MESH,
) -> None:
    """The value; that the results are sharded as the argument is, and nothing was gathered."""
    given = jax.device_put(x, NamedSharding(mesh, spec)), jax.device_put(A, NamedSharding(mesh, P()))
    compiled = jax.jit(function).lower(*given).compile()
    found = compiled(*given)
    for own, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-10, atol=1e-12, err_msg=name)
    if sharded:
        own = jax.tree.leaves(found)[0].sharding
        assert own.is_equivalent_to(NamedSharding(mesh, spec), 2), (name, own)
        assert "all-gather" not in compiled.as_text(), name


for backend in (tx.Native(least=0), tx.XLA(least=0)):
    own = rates(backend)
    check("a batch", own, known(X, A), P("d"))
    check("over two axes", own, known(X, A), P(("d", "e")))
    check("derivatives", slopes(own), slopes(known)(X, A), P("d"))
    check("replicated", own, known(X, A), P())
    check("on explicit axes", own, known(X, A), P(("d", "e")), mesh=EXPLICIT)
    check("derivatives on explicit axes", slopes(own), slopes(known)(X, A), P("d"), mesh=EXPLICIT)
    for spec in (P("d"), P(None, "e"), P("d", "e")):
        check(f"a batch of batches {spec}", jax.vmap(own, in_axes=(0, None)), known(Y, A), spec, Y)
    check("entries", own, known(RANDOM.normal(size=(0, 3)), A), P(), np.zeros((0, 3)), sharded=False)
    for vma in (True, False):
        mapped = jax.shard_map(own, mesh=MESH, in_specs=(P("d"), P()), out_specs=P("d"), check_vma=vma)
        check(f"shard_map, check_vma={vma}", mapped, known(X, A), P("d"))
        check(f"its derivatives, check_vma={vma}", slopes(mapped), slopes(known)(X, A), P("d"))

for function in (loop, until):
    expected = jax.vmap(function, (0, None))(X, A)
    own = jax.vmap(tx.fast(function), (0, None))
    check(function.__name__, own, expected, P("d"))
    check(f"{function.__name__} on explicit axes", own, expected, P("d"), mesh=EXPLICIT)
    for vma in (True, False):
        mapped = jax.shard_map(own, mesh=MESH, in_specs=(P("d"), P()), out_specs=P("d"), check_vma=vma)
        check(f"{function.__name__} in shard_map, check_vma={vma}", mapped, expected, P("d"))

# Ten members cannot be the same number on four devices.
ten = jax.vmap(tx.fast(until), (0, None))
check("ten of sixteen", lambda x, a: ten(x[:10], a), jax.vmap(until, (0, None))(X[:10], A), P("d"), sharded=False)

# ---- integrations ----------------------------------------------------------------------------------------------------

dynamics = tx.compile(SYSTEM)
FIXED: Any = {"dt": 0.1, "method": tx.RKMK(tx.tableaus.HEUN)}
EVENT: Any = FIXED | {"event": tx.Event(s[0] - 0.9), "save_at": np.array([0.1, 0.5])}
ADAPTIVE: Any = {"rtol": 1e-4, "method": tx.RKMK(tx.tableaus.BOGACKI_SHAMPINE3)}


def end(x: jax.Array, a: jax.Array, options: Any = FIXED) -> jax.Array:
    return jax.vmap(lambda x: tx.integrate(dynamics, {"s": x}, t1=0.5, params={"p": a}, **options).xs["s"][-1])(x)


def by_device(function: Callable[..., Any]) -> Callable[..., Any]:
    return jax.shard_map(function, mesh=MESH, in_specs=(P("d"), P()), out_specs=P("d"))


check("an integration", end, end(X, A), P("d"))
for options in (FIXED, EVENT, ADAPTIVE) if ALL else (FIXED,):
    own = functools.partial(end, options=options)
    expected = own(X, A)
    check(f"an integration in shard_map, {options}", by_device(own), expected, P("d"))
    check(f"an integration on explicit axes, {options}", own, expected, P("d"), mesh=EXPLICIT)
expected = slopes(end)(X, A)
check("derivatives of an integration in shard_map", slopes(by_device(end)), expected, P("d"))
if ALL:
    check("derivatives of an integration on explicit axes", slopes(end), expected, P("d"), mesh=EXPLICIT)

torque = tx.compile(tx.System(rates={s: tx.Cos(s) + tx.Control("held", (3,))}))


def driven(x: jax.Array, a: jax.Array) -> jax.Array:
    """By a function of time that closes over what varies."""
    u = lambda x: lambda t: {"held": jnp.sin(t) * (a @ x)}  # noqa: E731
    return jax.vmap(lambda x: tx.integrate(torque, {"s": x}, t1=0.5, u=u(x), **FIXED).xs["s"][-1])(x)


if ALL:
    check("controls that close over what varies", by_device(driven), driven(X, A), P("d"))

# ---- a function that closes over traced values -----------------------------------------------------------------------


def closing(x: jax.Array, a: jax.Array) -> jax.Array:
    """Over the start of its loop, through a default, a partial function and a function inside."""

    def one(x: jax.Array) -> jax.Array:
        def step(k: jax.Array, c: jax.Array, row: jax.Array = a[0]) -> jax.Array:
            return jnp.cos(a @ c) + 1e-3 * k + row

        return tx.fast(functools.partial(lambda y, z: z + jax.lax.fori_loop(0, 800, step, x) + y, x))(x) - 2.0 * x

    return jax.vmap(one)(x)


expected = jax.vmap(lambda x: loop_with_row(x, A))(X)
check("what closes over traced values", closing, expected, P("d"))
check("what closes over traced values, in shard_map", by_device(closing), expected, P("d"))
check("what closes over traced values, on explicit axes", closing, expected, P("d"), mesh=EXPLICIT)

# ---- exported --------------------------------------------------------------------------------------------------------

shapes = [
    jax.ShapeDtypeStruct(a.shape, float, sharding=NamedSharding(EXPLICIT, own)) for a, own in ((X, P("d")), (A, P()))
]
names = set(re.findall("twistax_[0-9a-f]{32}", jax.jit(end).lower(*shapes).as_text()))
assert names
checks = [jax.export.DisabledSafetyCheck.custom_call(name) for name in names]
exported = jax.export.export(jax.jit(end), disabled_checks=checks)(*shapes)
check("an exported integration", exported.call, end(X, A), P("d"), mesh=EXPLICIT)
print("all agree")
