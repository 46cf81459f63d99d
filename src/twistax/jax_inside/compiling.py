"""The inside of JAX that lowers, compiles and runs: devices, meshes, options of XLA, precision."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Collection, Iterator, Sequence
from types import FrameType
from typing import Any

import jax
import jax.numpy as jnp
import jaxlib
from jax.extend.backend import backends
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun

from .tracing import has_explicit_axes, is_traced, is_tracing, shaped_array, undocumented

_set_xla_metadata = undocumented("jax.experimental.xla_metadata", "set_xla_metadata")
_argument_handlers = undocumented("jax._src.dtypes", "canonicalize_value_handlers", {})
_need_devices = undocumented("jax._src.dispatch", "prim_requires_devices_during_lowering", set())


def jax_versions() -> tuple[str, str]:
    """Those of JAX and of what it is compiled in."""
    return jax.__version__, jaxlib.__version__


def small_calls_exist() -> bool:
    """Whether this JAX can attach to a function the attributes that make XLA compile it as one small function."""
    return _set_xla_metadata is not None


def xla_metadata(**attributes: str) -> contextlib.AbstractContextManager[Any]:
    """Attach attributes to what is traced inside; nothing where this JAX cannot."""
    return contextlib.nullcontext() if _set_xla_metadata is None else _set_xla_metadata(**attributes)


def quick_compile(level: int = 1) -> dict[str, bool | str]:
    """XLA's options for programs of small arrays: half the time to compile on JAX 0.10, and as fast.

    What the variable XLA_FLAGS sets stays.

    Args:
        level: of optimisation; 0 takes half of that once more, for programs that run seldom or do little.
    """
    options: dict[str, bool | str] = {"xla_backend_optimization_level": str(level)}
    if jax.__version_info__ < (0, 11):
        options["xla_cpu_use_fusion_emitters"] = False
    flags = os.environ.get("XLA_FLAGS", "")
    return {name: value for name, value in options.items() if name not in flags}


def accelerators_exist() -> bool:
    """Whether this process has devices beside the CPU, on which a computation may run too."""
    return any(name != "cpu" for name in backends())


@contextlib.contextmanager
def in_double() -> Iterator[None]:
    """Double precision, on the CPU; and values at once, also in a function that is being traced."""
    with jax.enable_x64(True), contextlib.ExitStack() as stack:
        if accelerators_exist():
            stack.enter_context(jax.default_device(jax.local_devices(backend="cpu")[0]))
        # Only there: checks at run time, as diffrax makes them, do not work in it.
        if is_tracing() and is_traced(jnp.zeros(())):
            stack.enter_context(jax.ensure_compile_time_eval())
        yield


def batched_branches_transpose() -> bool:
    """Whether the linear part of `cond` under `vmap`, as the rule of a `custom_root` has it, can be transposed."""
    return jax.__version_info__ >= (0, 11)


def makes_an_array(getter: Any) -> bool:
    """Whether the caller of a getter of `__jax_array__` is a function of JAX that needs an array.

    The operators of JAX's arrays read it too. They leave the operation to the other operand where it is missing.
    """
    caller: FrameType = getter.f_back
    module = str(caller.f_globals.get("__name__", ""))
    return module.startswith("jax.") and not module.endswith(".array_methods")


def refuse_as_argument(cls: type, refuse: Callable[[Any], Any]) -> None:
    """Have JAX call `refuse`, which raises, where an operation gets an object of a class, or of one below it."""
    _argument_handlers[cls] = refuse


def any_of_batch(condition: jax.Array) -> jax.Array:
    """Whether a condition holds for any member of a batch: one truth value also under vmap."""
    from equinox.internal import unvmap_any

    return unvmap_any(condition)


def wrapped_terms() -> tuple[Any, Any]:
    """diffrax's term that turns time around, and its term of an adjoint."""
    from diffrax._term import AdjointTerm, WrapTerm

    return WrapTerm, AdjointTerm


def needs_devices(primitive: Primitive) -> None:
    """Have JAX say on which devices an equation runs where it is lowered."""
    _need_devices.add(primitive)


def by_one_device(context: Any) -> Any:
    """The context of a lowering to operations of one device: what varies between devices is of no concern there."""

    def plain(avals: Sequence[Any]) -> list[Any]:
        return [shaped_array(a.shape, a.dtype) if isinstance(a, jax.core.ShapedArray) else a for a in avals]

    return context.replace(avals_in=plain(context.avals_in), avals_out=plain(context.avals_out))


def on_axes(function: Callable[..., list[Any]], depth: int, unbatched: Collection[int], context: Any) -> Any:
    """A function of batches that lie on explicit axes of a mesh, for the lowering of it: each device has its members.

    None where they do not.

    Args:
        function: the first `depth` axes of its results are those of the batch.
        depth: how many axes are of the batch.
        unbatched: the arguments that do not begin with these axes.
    """
    mesh, spec = context.avals_out[0].sharding.mesh, jax.sharding.PartitionSpec
    batch = spec(*context.avals_out[0].sharding.spec[:depth])
    if not has_explicit_axes(mesh) or all(axis is None for axis in batch):
        return None
    ins = [spec() if k in unbatched else batch for k in range(len(context.avals_in))]
    outs = [batch for _ in context.avals_out]
    mapped = jax.shard_map(function, mesh=mesh, in_specs=tuple(ins), out_specs=outs, check_vma=False)

    def run(*arguments: Any) -> list[Any]:
        places = [
            jax.sharding.NamedSharding(mesh, spec(*axes, *(None for _ in a.shape[len(axes) :])))
            for a, axes in zip(arguments, ins, strict=True)
        ]
        placed = [jax.sharding.reshard(a, place) for a, place in zip(arguments, places, strict=True)]
        return list(mapped(*placed))

    return run


def is_shared_out(context: Any) -> bool:
    """Whether XLA shares what is lowered here between the devices of a mesh, outside of `shard_map`.

    Exported programs cannot say how.
    """
    axes = context.module_context.axis_context
    if context.module_context.lowering_parameters.for_export:
        return False
    known = getattr(axes, "device_assignment", None) is not None and getattr(axes, "abstract_mesh", None) is not None
    return known and len(axes.device_assignment) > 1 and bool(getattr(jax.config, "jax_use_shardy_partitioner", True))


def shared_out(function: Callable[..., list[Any]], depth: int, unbatched: Collection[int]) -> Callable[..., list[Any]]:
    """A function of batches, where XLA shares it between devices: each computes its members.

    Args:
        function: the first `depth` axes of its results are those of the batch.
        depth: how many axes are of the batch.
        unbatched: the arguments that do not begin with these axes.
    """
    from jax.experimental.custom_partitioning import ArrayMapping, SdyShardingRule, custom_partitioning

    def run(*arguments: Any) -> list[Any]:
        program = jax.make_jaxpr(function)(*arguments)
        consts, call_with_constants = program.consts, jaxpr_as_fun(_constants_first(program))
        alone = {*range(len(consts)), *(len(consts) + k for k in unbatched)}

        def rule(mesh: Any, arguments: Sequence[Any], results: Sequence[Any]) -> SdyShardingRule:
            batch = [f"batch{k}" for k in range(depth)]
            inner: list[str] = []

            def names(rank: int, first: Sequence[str]) -> ArrayMapping:
                more = [f"entry{len(inner) + k}" for k in range(rank - len(first))]
                inner.extend(more)
                return ArrayMapping(*first, *more)

            ins = tuple(names(len(a.shape), [] if k in alone else batch) for k, a in enumerate(arguments))
            outs = tuple(names(len(a.shape), batch) for a in results)
            return SdyShardingRule(ins, outs, need_replication_factors=tuple(inner))

        def partition(mesh: Any, arguments: Sequence[Any], results: Sequence[Any]) -> Any:
            # Members that XLA would make up, where they are not as many on all devices, might never end.
            spec = [
                _dividing(mesh, axis, n) for axis, n in zip(results[0].sharding.spec, results[0].shape, strict=True)
            ]
            batch = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec(*spec[:depth]))
            every = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec())
            ins = tuple(every if k in alone else batch for k in range(len(arguments)))
            return mesh, lambda *values: function(*values[len(consts) :]), [batch for _ in results], ins

        call = custom_partitioning(lambda *values: call_with_constants(*values))
        call.def_partition(partition, sharding_rule=rule)
        return list(call(*consts, *arguments))

    return run


def _dividing(mesh: Any, axis: Any, size: int) -> Any:
    """An axis of a mesh, or several, over which so many members are the same number on each device; else None."""
    names = () if axis is None else axis if isinstance(axis, tuple) else (axis,)
    return axis if size % math.prod(mesh.shape[name] for name in names) == 0 else None


def _constants_first(program: ClosedJaxpr) -> ClosedJaxpr:
    """The same function of its constants and its arguments."""
    jaxpr = program.jaxpr
    debug = jaxpr.debug_info.with_unknown_names()
    return ClosedJaxpr(jaxpr.replace(constvars=[], invars=[*jaxpr.constvars, *jaxpr.invars], debug_info=debug), [])
