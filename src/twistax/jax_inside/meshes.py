"""The inside of JAX that places arrays: meshes of devices, the axes arrays vary on, and lowering on several devices."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any

import jax
from jax.extend.core import Primitive, jaxpr_as_fun

from .programs import constants_first, shaped_array, undocumented

_need_devices = undocumented("jax._src.dispatch", "prim_requires_devices_during_lowering", set())
_varying_checked = undocumented("jax._src.config", "_check_vma")


def spread(values: Sequence[Any]) -> bool:
    """Whether the type of any array says how it lies on a mesh: on manual axes of `shard_map`, or on explicit ones."""
    avals = [getattr(value, "aval", None) for value in values]
    arrays = [aval for aval in avals if isinstance(aval, jax.core.ShapedArray)]
    return any(aval.mat.varying or _explicit(aval.sharding.mesh) for aval in arrays)


def _explicit(mesh: Any) -> bool:
    return jax.sharding.AxisType.Explicit in (mesh.axis_types or ())


@contextlib.contextmanager
def of_one_device() -> Iterator[None]:
    """What is traced inside is a function of plain arrays: loops and branches ask there for nothing that meshes add."""
    with contextlib.ExitStack() as settings:
        if _varying_checked is not None:
            settings.enter_context(_varying_checked(False))
        if _explicit(jax.sharding.get_abstract_mesh()):
            settings.enter_context(jax.sharding.use_abstract_mesh(jax.sharding.AbstractMesh((), ())))
        yield


def varying_alike(arguments: Sequence[Any]) -> list[Any]:
    """Arguments of one equation: inside of `shard_map` those that all devices share vary as the others do."""
    axes = [jax.typeof(a).mat.varying for a in arguments]
    every = frozenset().union(*axes)
    return [
        a if varying == every else jax.lax.pcast(a, tuple(every - varying), to="varying")
        for a, varying in zip(arguments, axes, strict=True)
    ]


def placed_as(aval: Any, depth: int, shared: Collection[int], arguments: Sequence[Any]) -> Any:
    """The abstract value of a result on the mesh of the arguments: its first `depth` axes lie as theirs do.

    Args:
        shared: the arguments that do not have these axes.
    """
    like = next((a for a in arguments if a.mat.varying or _explicit(a.sharding.mesh)), None)
    if like is None:
        return aval
    specs = [a.sharding.spec[:depth] for k, a in enumerate(arguments) if k not in shared and a.sharding.spec]
    batch = [next((axis for axis in axes if axis is not None), None) for axes in zip(*specs, strict=True)]
    spec = jax.sharding.PartitionSpec(*batch, *(None for _ in aval.shape[len(batch) :]))
    return like.update(shape=aval.shape, dtype=aval.dtype, weak_type=False, sharding=like.sharding.update(spec=spec))


def by_one_device(context: Any) -> Any:
    """The context of a lowering to operations of one device: what varies between devices is of no concern there."""

    def plain(avals: Sequence[Any]) -> list[Any]:
        return [shaped_array(a.shape, a.dtype) if isinstance(a, jax.core.ShapedArray) else a for a in avals]

    return context.replace(avals_in=plain(context.avals_in), avals_out=plain(context.avals_out))


def needs_devices(primitive: Primitive) -> None:
    """Have JAX say on which devices an equation runs where it is lowered."""
    _need_devices.add(primitive)


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
    if not _explicit(mesh) or all(axis is None for axis in batch):
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
        consts, call_with_constants = program.consts, jaxpr_as_fun(constants_first(program))
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
