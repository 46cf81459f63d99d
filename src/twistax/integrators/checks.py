"""What is checked before a flight."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp

from ..errors import InputError
from ..expr import Inputs
from ..groups import Euclidean, Group
from ..jax_inside import is_traced
from ..lowering import Dynamics
from ..lowering.inputs import is_finite

__all__ = ["check_start"]


def check_start(dynamics: Dynamics, inputs: Inputs) -> None:
    """Check what is known of the prepared start: everything finite, rotations and poses in their groups.

    Raises:
        InputError: names the value, and for a rotation how far off it is.
    """
    for kind, values in (("x0", inputs.x), ("u", inputs.u), ("params", inputs.params), ("t0", {"t0": inputs.t})):
        for name, value in values.items():
            if not is_finite(value):
                where = "t0" if kind == "t0" else f"{kind}[{name!r}]"
                raise InputError(f"{where} is not finite: {value}")
    tolerance = max(1e-6, 1e3 * float(jnp.finfo(inputs.dtype).eps))
    for name, group in dynamics.group.factors.items():
        value = inputs.x[name]
        if isinstance(group, Euclidean) or is_traced(value):
            continue
        with jax.ensure_compile_time_eval():  # inside jit other states may be traced while this one is known
            defect = float(_defect(group, value))
        if defect > tolerance:
            raise InputError(
                f"x0[{name!r}] is no element of {group.name}: off by {defect:.3g}, where {tolerance:.0e} is allowed "
                "(the rotation's R'R - I, and the last row of a pose).\n"
                "  fix: build poses with tx.pose(...), or take the nearest element with "
                f"tx.{group.name}.normalize(g)"
            )


@functools.partial(jax.jit, static_argnums=0)
def _defect(group: Group, value: jax.Array) -> jax.Array:
    return group.defect(value)
