"""The shapes of a mechanism's links and their poses along a motion, for the view."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from numpy import ndarray as Array

from ..checks import listed
from ..errors import InputError
from ..expr import Expr, State, leaves_of
from ..expr.lie import Compose
from ..system.lower import lower
from ..view import Body, Ellipsoid, Shape

if TYPE_CHECKING:
    from .kinematic_tree import KinematicTree
    from .tree import Link


def links_in_view(mechanism: KinematicTree, xs: Mapping[str, Any], params: Mapping[str, Any]) -> list[Body]:
    """All frames of a mechanism, including the base, as bodies for the view. A link without shapes is drawn as the
    ellipsoid of its inertia.

    Args:
        xs: the states of `mechanism.system()` by name; the leading axis is time.
        params: values of parameters; a parameter of the mechanism without a value has its default.
    Raises: InputError for positions that are not among the states.
    """
    poses = mechanism.poses()
    frames = {n: f.T if f.segment < 0 else Compose(poses[f.segment], f.T) for n, f in mechanism.frames.items()}
    x = {leaf.name: xs.get(leaf.name) for leaf in leaves_of(*frames.values()) if isinstance(leaf, State)}
    for name, value in x.items():
        if value is None:
            raise InputError(
                f"show: the mechanism has the state {name!r}, which the motion does not have; its states "
                f"are: {listed(xs, name)}"
            )
    count = len(next(iter(xs.values())))
    used_params = {n: p for n, p in params.items() if any(leaf.name == n for leaf in leaves_of(*frames.values()))}
    function = lower(frames)
    poses_at_times = jax.jit(jax.vmap(lambda x: function(0.0, x, params=used_params), axis_size=count))(
        {name: np.asarray(value) for name, value in x.items()}
    )
    shapes = {link.name: tuple(link.shapes) or _of_inertia(link, params) for link in mechanism.links}
    shapes[mechanism.base] = mechanism.shapes
    return [Body(n, np.asarray(poses_at_times[n]), shapes.get(n, ()), axes=False, trail=False) for n in frames]


def _of_inertia(link: Link, params: Mapping[str, Any]) -> tuple[Shape, ...]:
    """The ellipsoid of a link's inertia; nothing for a point mass, or for an inertia that changes during the motion."""
    if link.body is None:
        return ()
    parts: list[Expr] = [link.body.mass, link.body.center_of_mass, link.body.inertia]
    leaves = leaves_of(*parts)
    if any(isinstance(leaf, State) for leaf in leaves):
        return ()
    used_params = {n: p for n, p in params.items() if any(leaf.name == n for leaf in leaves)}
    values: list[Array] = [np.asarray(value, dtype=np.float64) for value in lower(parts)(0.0, {}, params=used_params)]
    mass, center, inertia = values
    return (Ellipsoid.of_inertia(float(mass), center, inertia),) if inertia.any() and mass > 0.0 else ()
