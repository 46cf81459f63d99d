"""The unknowns of a trim: entries of states, controls and parameters, with scales and bounds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..checks import reals, short
from ..errors import InputError
from ..expr import Inputs
from ..linear.discretize import Controls
from ..linear.labels import labels, positions, tangent_shapes
from ..system.dynamics import Dynamics


class Unknowns:
    """The free entries, and the map from them to points.

    Attributes:
        columns: the index of each unknown among the perturbations of all states, controls and parameters.
        names, lower, upper: name and bounds of each unknown.
    """

    def __init__(self, dynamics: Dynamics, start: Inputs, free: Mapping[str, Any], params: tuple[str, ...]) -> None:
        self._dynamics = dynamics
        self._controls = {leaf.name: leaf.shape for leaf in dynamics.controls}
        self._params = params
        param_shapes = {name: start.params[name].shape for name in params}
        shapes = {**tangent_shapes(dynamics.group), **self._controls, **param_shapes}
        if len(shapes) < len(dynamics.group.factors) + len(self._controls) + len(param_shapes):
            raise InputError("trim expects states, controls and parameters with different names")
        self.columns = positions("trim: free", free, shapes)
        if not self.columns:
            raise InputError("trim expects at least one free state, control or parameter")
        every = labels(shapes)
        self.names = [every[i] for i in self.columns]
        lower, upper, scale = (np.full(len(every), value) for value in (-np.inf, np.inf, np.nan))
        ends = np.cumsum([0, *(np.prod(shape, dtype=int) for shape in shapes.values())])
        where = {name: slice(a, b) for name, a, b in zip(shapes, ends[:-1], ends[1:])}
        flat = [place.flat for place in dynamics.group.factors.values()]
        sizes = [place.dimension for place in dynamics.group.factors.values()]
        self._curved = np.zeros(len(every), bool)
        self._curved[: sum(sizes)] = ~np.repeat(flat, sizes)
        for leaf in (*dynamics.states, *dynamics.controls):
            place = where[leaf.name]
            for bound, into in ((leaf.min, lower), (leaf.max, upper)):
                if bound is not None:
                    into[place] = np.broadcast_to(bound, leaf.shape).reshape(-1)
            if leaf.scale is not None:
                scale[place] = np.reshape(leaf.scale, -1)
        for name, pair in free.items():
            if pair is None:
                continue
            if not isinstance(pair, (tuple, list)) or len(pair) != 2:
                raise InputError(f"free[{name!r}] expects (least, most) or None, got {short(pair)}")
            places = positions("trim: free", [name], shapes)
            if self._curved[places].any():
                raise InputError(f"free[{name!r}]: a perturbation on a group has no bounds; pass None")
            for bound, into in zip(pair, (lower, upper)):
                if bound is not None:
                    numbers = reals(f"free[{name!r}]", bound, InputError).reshape(-1)
                    if numbers.size not in (1, len(places)):
                        raise InputError(f"free[{name!r}] expects a bound or {len(places)} of them, got {short(bound)}")
                    into[places] = numbers
        self._scale, self._half = scale, (upper - lower) / 2.0
        self.lower, self.upper = lower[self.columns], upper[self.columns]
        for name, low, high in zip(self.names, self.lower, self.upper):
            if not low < high:
                raise InputError(
                    f"trim: {name} is free, but its bounds {low:g} and {high:g} coincide or contradict each other"
                )

    def _flat(self, point: Inputs) -> np.ndarray:
        """Values where they are numbers; zeros for what lies on a group."""
        group = self._dynamics.group.factors
        states = [
            np.asarray(point.x[name]).reshape(-1) if factor.flat else np.zeros(factor.dimension)
            for name, factor in group.items()
        ]
        controls = [
            np.asarray(point.u.get(name, np.zeros(shape))).reshape(-1) for name, shape in self._controls.items()
        ]
        params = [np.asarray(point.params[name]).reshape(-1) for name in self._params]
        return np.concatenate([*states, *controls, *params])

    def values(self, point: Inputs) -> np.ndarray:
        return self._flat(point)[self.columns]

    def scales(self, point: Inputs, reach: bool = False) -> np.ndarray:
        """The scales of all perturbations: that of the leaf, else its size (at least 1), or half the distance of its
        bounds if that is less.

        Distant bounds must not hide a residual. But for a target far from a start at zero, the bounds are the only
        information: with `reach`, half their distance is used wherever both exist.
        """
        size = np.maximum(1.0, np.abs(self._flat(point)))
        known = np.where(np.isfinite(self._half), self._half, size) if reach else np.minimum(self._half, size)
        return np.where(np.isnan(self._scale), known, self._scale)

    @property
    def on_group(self) -> np.ndarray:
        """Which of the unknowns are perturbations on a group."""
        return self._curved[self.columns]

    def in_chart(self, slopes: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Derivatives with respect to the unknowns of `moved` at z, from those with respect to perturbations of the
        moved point.
        """
        full = np.zeros(self._dynamics.dimension)
        free_states = [(i, k) for k, i in enumerate(self.columns) if i < len(full)]
        for i, k in free_states:
            full[i] = z[k]
        n = len(full)
        right = np.asarray(self._dynamics.group.right_jacobian(jnp.asarray(full)))
        return np.concatenate([slopes[:, :n] @ right, slopes[:, n:]], axis=1)[:, self.columns]

    def allows(self, point: Inputs, column: int, step: float) -> bool:
        """Whether a perturbation respects the bounds of the unknowns."""
        if column not in self.columns:
            return True
        k = self.columns.index(column)
        return bool(self.lower[k] <= self.values(point)[k] + step <= self.upper[k])

    def moved(self, point: Inputs, z: np.ndarray) -> Inputs:
        """The point after perturbations of the free quantities."""
        full = np.zeros(len(self._scale))
        full[self.columns] = z
        return self.perturbed(point, full)

    def perturbed(self, point: Inputs, full: np.ndarray) -> Inputs:
        """The point after perturbations of all states, controls and free parameters."""
        n, m = self._dynamics.dimension, sum(np.prod(s, dtype=int) for s in self._controls.values())
        controls = Controls(self._dynamics.controls)
        u = controls.split(controls.join(point.u, np.float64) + full[n : n + m])
        params, at = dict(point.params), n + m
        for name in self._params:
            value = params[name]
            params[name] = value + full[at : at + value.size].reshape(value.shape)
            at += value.size
        return dataclasses.replace(
            point, x=self._dynamics.group.retract(dict(point.x), jnp.asarray(full[:n])), u=u, params=params
        )
