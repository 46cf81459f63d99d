"""How large an error of a step may be, entry by entry of the tangent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..checks import listed, real_array
from ..errors import InputError
from ..expr import State
from ..jax_inside import is_traced
from ..system.dynamics import Dynamics
from ..system.inputs import cast
from .charts import Blocks, StateCoordinates

#: No tolerance is finer than this many times the precision of the numbers.
_FINEST = 10.0


class Tolerances(NamedTuple):
    """Allowed is atol + rtol * size, size the state's own or the scale it declares, but never less than round-off."""

    rtol: Any  # ()
    atol: Any  # name -> () or (n,), in the order in which the state's deviations are held
    scale: Any  # name -> (n,), the sizes that states declare

    def scaled(self, local: StateCoordinates, e: Blocks, before: Blocks, after: Blocks) -> jax.Array:
        """The entries of a difference of coordinates, each in units of what is allowed: (dimension,)."""
        return _flat(local.deviation(e, after)) / self._allowed(local.sizes(before, after))

    def mean_square(self, local: StateCoordinates, e: Blocks, before: Blocks, after: Blocks) -> jax.Array:
        """The mean square of `scaled`: up to one where a difference is allowed."""
        return jnp.mean(jnp.square(self.scaled(local, e, before, after)))

    def by_state(self, local: StateCoordinates, e: Blocks, before: Blocks, after: Blocks) -> dict[str, jax.Array]:
        """The largest entry of each state's difference, in the same units."""
        deviations, sizes = local.deviation(e, after), local.sizes(before, after)
        return {
            name: jnp.max(jnp.abs(_flat(deviations[name]) / self._allowed_part(name, _flat(sizes[name]))))
            for name in deviations
        }

    def reach(self, local: StateCoordinates, y: Blocks) -> jax.Array:
        """The size of a state in the same units."""
        sizes = local.sizes(y, y)
        return jnp.sqrt(jnp.mean(jnp.square(_flat(sizes) / self._allowed(sizes))))

    def _allowed(self, sizes: Blocks) -> jax.Array:
        return _flat({name: self._allowed_part(name, _flat(block)) for name, block in sizes.items()})

    def _allowed_part(self, name: str, size: jax.Array) -> jax.Array:
        info = jnp.finfo(size.dtype)
        typical = self.scale.get(name, size)
        finest = jnp.maximum(info.eps * _FINEST * size, info.tiny)
        return jnp.maximum(self.atol[name] + self.rtol * typical, finest)


def _flat(tree: Any) -> jax.Array:
    return ravel_pytree(tree)[0]


def tolerances_of(dynamics: Dynamics, rtol: Any, atol: Any, dtype: Any) -> Tolerances:
    """The tolerances a user gave, checked as far as they are known. Raises InputError."""
    if rtol is None:
        raise InputError("atol is given without rtol.\n  fix: give both, e.g. rtol=1e-9, atol=1e-9")
    relative = _numbers("rtol", rtol, dtype)
    if relative.shape != ():
        raise InputError(f"rtol must be one number, got shape {relative.shape}; atol may be a dict by state")
    finest = _FINEST * float(jnp.finfo(dtype).eps)
    if not is_traced(rtol):
        if not 0.0 <= float(rtol) < np.inf:
            raise InputError(f"rtol must be a positive number, got {float(rtol):g}.\n  fix: e.g. rtol=1e-6")
        if float(rtol) < finest:
            precise = (
                'use float64: jax.config.update("jax_enable_x64", True) before anything else, and x0 in double '
                "precision, or "
            )
            precise = precise if np.dtype(dtype) == np.float32 else ""
            raise InputError(
                f"rtol = {float(rtol):g} is below {finest:.1e}, ten times the round-off of {np.dtype(dtype).name}.\n"
                f"  fix: {precise}give a larger rtol"
            )
    atol = rtol if atol is None else atol
    names = [state.name for state in dynamics.states]
    given = atol if isinstance(atol, Mapping) else dict.fromkeys(names, atol)
    for name in given:
        if name not in names:
            raise InputError(f"atol names {name!r}, which is no state; the states are: {listed(names, name)}")
    for name in names:
        if name not in given:
            raise InputError(f"atol has no entry for state {name!r}.\n  fix: atol={{..., {name!r}: 1e-9}}")
    return Tolerances(
        relative,
        {state.name: _absolute(state, given[state.name], dtype) for state in dynamics.states},
        {
            s.name: _held(s, _numbers(f"scale of state {s.name!r}", s.scale, dtype))
            for s in dynamics.states
            if s.scale is not None
        },
    )


def _absolute(state: State, value: Any, dtype: Any) -> Any:
    """The allowed error of one state; a pair for one with a rotation and a position is (rotation, position)."""
    place, group = f"atol of state {state.name!r}", state.group
    is_pose = {part.unit for part in group.parts} == {"rad", "m"}
    if isinstance(value, (tuple, list)) and is_pose and len(value) == 2 and not any(map(np.ndim, value)):
        rotation, position = (_numbers(place, part, dtype) for part in value)
        stack: Any = jnp.stack if is_traced(value) else np.stack
        array = _held(state, stack([rotation if angular else position for angular in group.angular]))
    else:
        array = _numbers(place, value, dtype)
        shape = group.tangent_shape
        if array.shape not in ((), shape):
            pair = ", or the pair (rotation, position)" if is_pose else ""
            raise InputError(f"{place} expects a number or shape {shape}{pair}, got shape {array.shape}")
        array = _held(state, array) if array.shape else array
    # Not < 0, so that NaN is refused too.
    if not is_traced(array) and not (np.asarray(array) >= 0.0).all():
        raise InputError(f"{place} must not be negative, got {array}")
    return array


def _held(state: State, array: Any) -> Any:
    """Values by tangent entry, in the order in which the state's deviations are held."""
    return state.group.to_linear_first(array.reshape(-1))


def _numbers(place: str, value: Any, dtype: Any) -> Any:
    array = real_array(place, value)
    if array.dtype == bool:
        raise InputError(f"{place} expects real numbers, got {value!r}")
    return cast(place, array, dtype, on_host=True)
