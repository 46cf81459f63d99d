"""Tracing and compilation in JAX: jaxprs, tracing state, array types on meshes, XLA options.

Unknown contents of an equation raise `Unread`: the caller then leaves that equation to JAX, which computes the same
numbers, and notifies the user once.
"""

from __future__ import annotations

import contextlib
import importlib
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from types import FrameType
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import jaxlib
from jax.extend.backend import backends
from jax.extend.core import ClosedJaxpr, Jaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import partial_eval

T = TypeVar("T")


def undocumented(module: str, name: str, otherwise: Any = None) -> Any:
    """An attribute of a JAX module; `otherwise` if this version of JAX has it elsewhere."""
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError):
        return otherwise


_weak_types = undocumented("jax._src.util", "weakref_cache_key_types", set())
_nothing_traced = undocumented("jax._src.core", "trace_state_clean")
_varying_checked = undocumented("jax._src.config", "_check_vma")
_set_xla_metadata = undocumented("jax.experimental.xla_metadata", "set_xla_metadata")
_argument_handlers = undocumented("jax._src.dtypes", "canonicalize_value_handlers", {})
_need_devices = undocumented("jax._src.dispatch", "prim_requires_devices_during_lowering", set())


class Unread(Exception):
    """An equation has parameters that this version of twistax does not know. Users never see this error."""


def parameters(eqn: Any, *known: Collection[str]) -> Mapping[str, Any]:
    """The parameters of an equation whose names are exactly one of the sets `known`.

    Raises:
        Unread: they are not.
    """
    if not any(set(eqn.params) == set(names) for names in known):
        raise Unread(f"JAX {jax.__version__} gives {eqn.primitive.name} the parameters {sorted(eqn.params)}")
    return eqn.params


def closed(jaxpr: Jaxpr | ClosedJaxpr) -> ClosedJaxpr:
    """A jaxpr with its constants; one without constants gets an empty list."""
    return jaxpr if isinstance(jaxpr, ClosedJaxpr) else ClosedJaxpr(jaxpr, [])


def _is_jaxpr(value: Any) -> bool:
    return isinstance(value, (ClosedJaxpr, Jaxpr))


def inner_jaxprs(eqn: Any) -> list[ClosedJaxpr]:
    """The jaxprs among the parameters of an equation: bodies of loops, branches, called functions that are written
    out.
    """
    inner = [closed(p) for p in jax.tree.leaves(list(eqn.params.values()), is_leaf=_is_jaxpr) if _is_jaxpr(p)]
    program: Any = eqn.params.get("program")
    written: Any = getattr(program, "program", None)
    if _is_jaxpr(written) and getattr(program, "inside_kernels", None) is None:
        inner.append(closed(written))
    inside = expansion(eqn)
    return inner if inside is None else [*inner, inside]


def expansion(eqn: Any, own_derivatives: bool = True) -> ClosedJaxpr | None:
    """The expansion of a composite operation of JAX 0.12, such as searchsorted; None for other operations.

    Args:
        own_derivatives: also of functions that bring their own derivatives.
    """
    composite: Any = eqn.params.get("_prim") if eqn.primitive.name == "call_hi_primitive" else None
    if not hasattr(composite, "expand") or (type(composite).__name__.startswith("Custom") and not own_derivatives):
        return None

    def opened(*arguments: Any) -> list[Any]:
        return jax.tree.leaves(composite.expand(*jax.tree.unflatten(composite.in_tree, arguments)))

    return jax.make_jaxpr(opened)(*(jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in eqn.invars))


def all_equations(jaxpr: Any) -> Iterator[Any]:
    """The equations of a jaxpr, and after each those of its inner jaxprs."""
    for eqn in jaxpr.eqns:
        yield eqn
        for inner in inner_jaxprs(eqn):
            yield from all_equations(inner.jaxpr)


def alone(jaxpr: Jaxpr, eqn: Any, inputs: Sequence[Any]) -> ClosedJaxpr:
    """The jaxpr of one equation of `jaxpr`, of these variables."""
    return part(jaxpr, [eqn], inputs, eqn.outvars)


def part(
    jaxpr: Jaxpr, eqns: Sequence[Any], inputs: Sequence[Any], outputs: Sequence[Any], constants: Mapping[Any, Any] = {}
) -> ClosedJaxpr:
    """The jaxpr of some equations of `jaxpr`, from variables to variables.

    Args:
        constants: variables whose values are known.
    """
    debug = jaxpr.debug_info.with_unknown_names()
    piece = jaxpr.replace(
        constvars=list(constants), invars=list(inputs), outvars=list(outputs), eqns=list(eqns), debug_info=debug
    )
    return ClosedJaxpr(piece, list(constants.values()))


def with_results(program: ClosedJaxpr, used: Sequence[bool]) -> ClosedJaxpr:
    """The jaxpr, of the same arguments, that computes only the results that are used."""
    jaxpr, kept, _ = partial_eval.dce_jaxpr_consts(program.jaxpr, used, instantiate=True)
    return ClosedJaxpr(jaxpr, [c for c, keep in zip(program.consts, kept, strict=True) if keep])


def drops_dead_results(primitive: Primitive, rule: Callable[[Sequence[bool], Any], tuple[list[bool], Any]]) -> None:
    """Registers what becomes of an equation of which only some results are read.

    Newer versions of JAX also say, before the equation, which of its arguments are read later on.
    """
    partial_eval.dce_rules[primitive] = lambda used, *live_and_equation: rule(used, live_and_equation[-1])


def opened(program: ClosedJaxpr) -> tuple[Callable[..., list[Any]], list[Any]]:
    """A jaxpr as a function of the traced values that it closes over, then of its arguments; and those values.

    Transformations must see them.
    """
    traced = [i for i, value in enumerate(program.consts) if is_traced(value)]
    if not traced:
        return jaxpr_as_fun(program), []

    def function(*values: Any) -> list[Any]:
        consts = list(program.consts)
        for i, value in zip(traced, values[: len(traced)], strict=True):
            consts[i] = value
        return jaxpr_as_fun(ClosedJaxpr(program.jaxpr, consts))(*values[len(traced) :])

    return function, [program.consts[i] for i in traced]


def source_of(jaxpr: ClosedJaxpr) -> str | None:
    """Name and place of the function a jaxpr was traced from."""
    return jaxpr.jaxpr.debug_info.func_src_info


def scan_parts(eqn: Any) -> tuple[int, int]:
    """How many inputs of a scan are constants, and how many are carried.

    Raises:
        Unread: a scan of a later JAX.
    """
    common = {"jaxpr", "length", "reverse", "unroll"}
    p = parameters(eqn, common | {"num_carry", "num_consts"}, common | {"ft_in", "ft_out"})  # JAX 0.10; 0.11 and later
    if "num_consts" in p:
        return p["num_consts"], p["num_carry"]
    try:
        sizes = [len(tree) for tree in p["ft_in"].unpack()]  # constants, carried, scanned over
    except (AttributeError, TypeError):
        sizes = []
    if len(sizes) != 3 or sum(sizes) != len(eqn.invars):
        raise Unread(f"JAX {jax.__version__} groups the inputs of a scan as {p['ft_in']}")
    return sizes[0], sizes[1]


def is_key(variable: Any) -> bool:
    """Whether a variable of a jaxpr holds random keys."""
    dtype = getattr(variable.aval, "dtype", None)  # an effect's token has none
    return dtype is not None and bool(jax.dtypes.issubdtype(dtype, jax.dtypes.prng_key))


def on_key_data(program: ClosedJaxpr) -> ClosedJaxpr:
    """The function with the raw data of random keys in place of keys."""
    arguments, results = program.jaxpr.invars, program.jaxpr.outvars
    if not any(is_key(v) for v in (*arguments, *results)):
        return program

    def function(*values: Any) -> list[Any]:
        wrapped = [
            jax.random.wrap_key_data(value, impl=v.aval.dtype._impl) if is_key(v) else value
            for v, value in zip(arguments, values, strict=True)
        ]
        pairs = zip(results, jaxpr_as_fun(program)(*wrapped), strict=True)
        return [jax.random.key_data(value) if is_key(v) else value for v, value in pairs]

    structs = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in arguments]
    data = [jax.eval_shape(jax.random.key_data, s) if is_key(v) else s for v, s in zip(arguments, structs, strict=True)]
    return jax.make_jaxpr(function)(*data)


def is_traced(tree: Any) -> bool:
    """Whether JAX is tracing any leaf, so that its numbers are not known."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def is_tracing() -> bool:
    """Whether JAX is tracing at this point; True if that cannot be determined."""
    return _nothing_traced is None or not _nothing_traced()


def weakly_kept(cls: type[T]) -> type[T]:
    """Prevent JAX's trace caches from keeping parameters of equations of this class alive."""
    _weak_types.add(cls)
    return cls


def shaped_array(shape: tuple[int, ...], dtype: Any) -> Any:
    """The abstract value of an array."""
    return jax.core.ShapedArray(shape, dtype)


def spread(values: Sequence[Any]) -> bool:
    """Whether the type of any array says how it lies on a mesh: on manual axes of `shard_map`, or on explicit ones."""
    avals = [getattr(value, "aval", None) for value in values]
    arrays = [aval for aval in avals if isinstance(aval, jax.core.ShapedArray)]
    return any(aval.mat.varying or has_explicit_axes(aval.sharding.mesh) for aval in arrays)


def has_explicit_axes(mesh: Any) -> bool:
    """Whether types of arrays say how they lie on axes of a mesh."""
    return jax.sharding.AxisType.Explicit in (mesh.axis_types or ())


@contextlib.contextmanager
def of_one_device() -> Iterator[None]:
    """What is traced inside is a function of plain arrays: loops and branches ask there for nothing that meshes add."""
    with contextlib.ExitStack() as settings:
        if _varying_checked is not None:
            settings.enter_context(_varying_checked(False))
        if has_explicit_axes(jax.sharding.get_abstract_mesh()):
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
    like = next((a for a in arguments if a.mat.varying or has_explicit_axes(a.sharding.mesh)), None)
    if like is None:
        return aval
    specs = [a.sharding.spec[:depth] for k, a in enumerate(arguments) if k not in shared and a.sharding.spec]
    batch = [next((axis for axis in axes if axis is not None), None) for axes in zip(*specs, strict=True)]
    spec = jax.sharding.PartitionSpec(*batch, *(None for _ in aval.shape[len(batch) :]))
    return like.update(shape=aval.shape, dtype=aval.dtype, weak_type=False, sharding=like.sharding.update(spec=spec))


# ---- what is compiled ------------------------------------------------------------------------------------------------


def jax_versions() -> tuple[str, str]:
    """Those of JAX and of what it is compiled in."""
    return jax.__version__, jaxlib.__version__


def small_calls_exist() -> bool:
    """Whether this version of JAX can attach the attributes by which XLA compiles a function as one small function."""
    return _set_xla_metadata is not None


def xla_metadata(**attributes: str) -> contextlib.AbstractContextManager[Any]:
    """Attach attributes to traced operations; does nothing if this version of JAX cannot."""
    return contextlib.nullcontext() if _set_xla_metadata is None else _set_xla_metadata(**attributes)


def quick_compile(level: int = 1) -> dict[str, bool | str]:
    """XLA options for programs of small arrays: half the compile time on JAX 0.10, at the same run time.

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
    """Whether this process has devices other than the CPU, on which a computation may run."""
    return any(name != "cpu" for name in backends())


@contextlib.contextmanager
def in_double() -> Iterator[None]:
    """A context with double precision on the CPU, in which values are computed immediately, also inside traced
    functions.
    """
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
    """Make JAX call `refuse`, which raises, if an operation gets an instance of a class or of a subclass."""
    _argument_handlers[cls] = refuse


def any_of_batch(condition: jax.Array) -> jax.Array:
    """Whether a condition holds for any member of a batch: one truth value also under vmap."""
    from equinox.internal import unvmap_any

    return unvmap_any(condition)


def wrapped_terms() -> tuple[Any, Any]:
    """diffrax's term for reversed time, and its adjoint term."""
    from diffrax._term import AdjointTerm, WrapTerm

    return WrapTerm, AdjointTerm


def needs_devices(primitive: Primitive) -> None:
    """Make JAX report, at lowering, the devices on which an equation runs."""
    _need_devices.add(primitive)


def by_one_device(context: Any) -> Any:
    """A context for the lowering to operations of one device, in which types do not record what varies between
    devices.
    """

    def plain(avals: Sequence[Any]) -> list[Any]:
        return [shaped_array(a.shape, a.dtype) if isinstance(a, jax.core.ShapedArray) else a for a in avals]

    return context.replace(avals_in=plain(context.avals_in), avals_out=plain(context.avals_out))
