"""The internals of JAX, diffrax and Equinox that this package reads, for each supported version.

The rest of the package uses only their documented interfaces; a test detects imports outside of this folder. Checked
with JAX 0.10, 0.11 and 0.12.
"""

from jax.experimental import io_callback, jet
from jax.extend.backend import backends
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Primitive, Var, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

from .meshes import is_shared_out, on_axes, shared_out
from .tracing import (
    Unread,
    accelerators_exist,
    all_equations,
    alone,
    any_of_batch,
    batched_branches_transpose,
    by_one_device,
    closed,
    drops_dead_results,
    expansion,
    in_double,
    inner_jaxprs,
    is_key,
    is_traced,
    is_tracing,
    jax_versions,
    makes_an_array,
    needs_devices,
    of_one_device,
    on_key_data,
    opened,
    parameters,
    part,
    placed_as,
    quick_compile,
    refuse_as_argument,
    scan_parts,
    shaped_array,
    small_calls_exist,
    source_of,
    spread,
    varying_alike,
    weakly_kept,
    with_results,
    wrapped_terms,
    xla_metadata,
)
