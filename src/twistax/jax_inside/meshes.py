"""Batches on the devices of a mesh, each of which computes its members."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from .tracing import has_explicit_axes


def on_axes(function: Callable[..., list[Any]], depth: int, unbatched: Collection[int], context: Any) -> Any:
    """A function of batches on explicit axes of a mesh, for its lowering: each device has its members.

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
    """Whether XLA distributes the lowered operations over the devices of a mesh, outside of `shard_map`.

    Exported programs cannot say how.
    """
    axes = context.module_context.axis_context
    if context.module_context.lowering_parameters.for_export:
        return False
    known = getattr(axes, "device_assignment", None) is not None and getattr(axes, "abstract_mesh", None) is not None
    return known and len(axes.device_assignment) > 1 and bool(getattr(jax.config, "jax_use_shardy_partitioner", True))


def shared_out(function: Callable[..., list[Any]], depth: int, unbatched: Collection[int]) -> Callable[..., list[Any]]:
    """A function of batches that XLA distributes over devices: each device computes its members.

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
