"""How integrations of a system were compiled: as kernels, as programs of scalars, or neither."""

from typing import Any

import twistax as tx
from twistax.integrators.loop.kernels import KernelSteps
from twistax.scalar.jax_primitive import Derived
from twistax.scalar.loops import Repeated


def _compiled(dynamics: tx.Dynamics, kind: type[Any]) -> list[Any]:
    return [made for made in dynamics.functions.steps.values() if isinstance(made, kind)]


def kernels_of_equal_steps(dynamics: tx.Dynamics) -> list[KernelSteps]:
    """The kernels of integrations by equal steps."""
    return _compiled(dynamics, KernelSteps)


def kernels_of_chosen_steps(dynamics: tx.Dynamics) -> list[Repeated]:
    """The kernels of integrations by steps chosen by tolerances."""
    return _compiled(dynamics, Repeated)


def programs_of_steps(dynamics: tx.Dynamics) -> list[Derived]:
    """The programs of single steps, with derivatives of their own."""
    return _compiled(dynamics, Derived)
