"""All that is read of the inside of JAX, diffrax and Equinox, version by version.

Everything else in the package uses their documented interfaces; a test sees an import that goes around this folder.
Checked with JAX 0.10, 0.11 and 0.12.
"""

from jax.experimental import jet
from jax.extend.backend import backends
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

from .compiling import (
    accelerators_exist,
    any_of_batch,
    batched_branches_transpose,
    by_one_device,
    in_double,
    is_shared_out,
    jax_versions,
    makes_an_array,
    needs_devices,
    on_axes,
    quick_compile,
    refuse_as_argument,
    shared_out,
    small_calls_exist,
    wrapped_terms,
    xla_metadata,
)
from .tracing import (
    Unread,
    all_equations,
    alone,
    closed,
    expansion,
    inner_jaxprs,
    is_key,
    is_traced,
    is_tracing,
    of_one_device,
    on_key_data,
    opened,
    parameters,
    part,
    placed_as,
    scan_parts,
    shaped_array,
    source_of,
    spread,
    varying_alike,
    weakly_kept,
)
