"""A transcribed phase as the solver's core has it: kernels of its rates, rows and ends, and points as flat arrays."""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..precision import in_double
from ..solver.kernels import Argument, BatchKernel, SmoothKernels
from ..solver.transcription import EQUALITY, INEQUALITY, NONE, Method, Phase, PhaseKernels, Transcription
from .conditions import Conditions
from .interval import _simpson
from .shooting import Shooting
from .transcribed import Given, Point
from .transcription import Collocation, MultipleShooting


class Flat:
    """Arrays by name as one vector, in the order of the names."""

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        self.shapes = dict(shapes)
        sizes = [math.prod(shape) for shape in self.shapes.values()]
        self.size = sum(sizes)
        self._ends = np.cumsum([0, *sizes]).tolist()

    def split(self, vector: Any) -> dict[str, Any]:
        """The arrays of a vector (..., size)."""
        places = zip(self.shapes.items(), self._ends, self._ends[1:])
        return {name: vector[..., a:b].reshape(*vector.shape[:-1], *shape) for (name, shape), a, b in places}

    def joined(self, arrays: Mapping[str, Any], axes: int = 0) -> Array:
        """The vector (..., size) of arrays with so many axes in front."""
        flat = [np.reshape(arrays[name], (*np.shape(arrays[name])[:axes], -1)) for name in self.shapes]
        return np.concatenate(flat, axis=-1, dtype=float) if flat else np.zeros(0)


def method_of(transcription: MultipleShooting | Collocation) -> Method:
    """The Runge-Kutta method of a transcription, with weights of the running cost."""
    tableau, substeps = transcription.tableau, transcription.substeps
    if isinstance(transcription, Collocation):
        a, b, c = tableau.a, tableau.b, tableau.c
        weights = np.concatenate([np.zeros(substeps + 1), np.tile(b / substeps, substeps)])
        return Method(a, b, c, substeps, True, weights)
    a, c = tableau.counted
    square = np.zeros((len(c), len(c)))
    for row, own in zip(square, a):
        row[: len(own)] = own
    weights = np.concatenate([_simpson(substeps), np.zeros(substeps * len(c))])
    return Method(square, np.asarray(tableau.b[: len(c)]), np.asarray(c), substeps, False, weights)


class Functions:
    """The functions of a phase as kernels read them: of (eta, u, p), shares, points of nodes, and numbers."""

    def __init__(self, shooting: Shooting, params: Mapping[str, Array]) -> None:
        self._shooting = shooting
        group = shooting.dynamics.group
        self.point = Flat({name: shooting.leaves[name].shape for name in group.factors})
        self.params = Flat({name: np.shape(value) for name, value in params.items()})
        self.final = self.point
        self.limits = shooting.border.limits.shape
        self._data = self.params.size + self.final.size + math.prod(self.limits)

    def data(self, given: Given) -> Array:
        """The numbers that kernels read."""
        parts = (self.params.joined(given.params), self.final.joined(given.final), np.ravel(given.limits))
        return np.concatenate(parts)

    def kernels(self, nodes: Mapping[int, Conditions]) -> PhaseKernels:
        """All of them, compiled."""
        own, n, g = self._shooting, self._shooting.n, self._shooting.border.size
        of_q = {Argument.Z: own.size, Argument.SHARE: 1, Argument.BASE: self.point.size, Argument.DATA: self._data}
        of_node = {**of_q, Argument.Z: n + g}
        gap = {Argument.Z: n, Argument.BASE: self.point.size, Argument.TARGET: self.point.size}
        conditions = [(k, SmoothKernels(self._node(rows), of_node)) for k, rows in nodes.items()]
        end = SmoothKernels(self._end, {Argument.Z: n + g, Argument.BASE: self.point.size, Argument.DATA: self._data})
        flat = all(factor.flat for factor in own.dynamics.group.factors.values())
        move = {Argument.Z: n, Argument.BASE: self.point.size}
        return PhaseKernels(
            SmoothKernels(self._rate, of_q),
            SmoothKernels(self._rows, of_q),
            SmoothKernels(self._gap, gap),
            [*conditions, (own.intervals, end)],
            None if flat else SmoothKernels(self._retract, move, 0).kernels[0],
            None if flat else SmoothKernels(self._turn, {Argument.Z: n}, 0).kernels[0],
        )

    def _numbers(self, data: jax.Array) -> tuple[dict[str, Any], dict[str, Any], jax.Array]:
        params, final, limits = jnp.split(data, [self.params.size, self.params.size + self.final.size])
        return self.params.split(params), self.final.split(final), limits.reshape(self.limits)

    def _rate(self, q: jax.Array, share: jax.Array, base: jax.Array, data: jax.Array) -> jax.Array:
        return self._shooting._rate_at(q, share[0], self.point.split(base), self._numbers(data)[0])

    def _rows(self, q: jax.Array, share: jax.Array, base: jax.Array, data: jax.Array) -> jax.Array:
        return self._shooting._point_at(q, share[0], self.point.split(base), self._numbers(data)[0])

    def _gap(self, eta: jax.Array, base: jax.Array, target: jax.Array) -> jax.Array:
        return self._shooting.local.gap(eta, self.point.split(base), self.point.split(target))

    def _end(self, z: jax.Array, base: jax.Array, data: jax.Array) -> jax.Array:
        params, final, limits = self._numbers(data)
        none = jnp.zeros(self._shooting.border.size, z.dtype)
        return self._shooting._end_at(z, (self.point.split(base), none), Given(params, final, limits))

    def _node(self, conditions: Conditions) -> Any:
        def at_node(z: jax.Array, share: jax.Array, base: jax.Array, data: jax.Array) -> jax.Array:
            own = self._shooting
            b, x = z[own.n :], own.dynamics.group.retract(self.point.split(base), z[: own.n])
            begin, length = own.span(b)
            params = self._numbers(data)[0] | own.border.params(b)
            return conditions.values(begin + share[0] * length, x, params)

        return at_node

    def _retract(self, d: jax.Array, base: jax.Array) -> jax.Array:
        moved = self._shooting.dynamics.group.retract(self.point.split(base), d)
        return jnp.concatenate([moved[name].reshape(-1) for name in self.point.shapes])

    def _turn(self, c: jax.Array) -> jax.Array:
        return self._shooting.dynamics.group.left_jacobian(c).reshape(-1)


class Bounds(NamedTuple):
    """Rows that are limits of single unknowns: the core takes these as bounds.

    Attributes:
        rows: places among all rows.
        variables: places in v.
        upper: whether it is an upper limit.
        limits: of leaves; NaN where it is that of a time or of a free parameter.
    """

    rows: Array
    variables: Array
    upper: Array
    limits: Array


class Staged:
    """A problem of one phase for the core.

    Attributes:
        transcription: its functions and sizes.
        bounds: its rows that are limits of single unknowns.
    """

    def __init__(self, shooting: Shooting, conditions: Mapping[int, Conditions], method: Method, given: Given) -> None:
        self.shooting = shooting
        self.functions = Functions(shooting, given.params)
        with in_double():
            kernels = self.functions.kernels(conditions)
        layout, K = shooting.layout, shooting.intervals
        self.bounds = bounds_of_rows(shooting)
        kinds = np.where(shooting.exists, np.where(shooting.equality, EQUALITY, INEQUALITY), NONE)
        kinds[self.bounds.rows] = NONE
        inner, end = np.split(kinds, [K * layout.per_interval])
        inner = inner.reshape(K, -1)
        path = np.zeros((K, (shooting.substeps + 1) * layout.path_rows), int)
        path[:, layout.asked] = inner[:, : len(layout.asked)]
        at_nodes = [inner[k, len(layout.asked) :][: layout.counts[k]] for k in conditions]
        rows = [*at_nodes, end]
        self._rows = layout.path_rows if len(shooting.path.names) else 0
        path = path.reshape(K, shooting.substeps + 1, layout.path_rows)[:, :, : self._rows]
        phase = Phase(
            shooting.n,
            shooting.m,
            self.functions.point.size,
            method,
            kernels,
            shooting.mesh.shares[:-1],
            shooting.mesh.widths,
            self.functions.data(given),
            path,
            rows,
            np.zeros(path.shape),
            [np.zeros(len(own)) for own in rows],
        )
        self.phase = phase
        self.transcription = Transcription(phase, shooting.border.size)

    @functools.cached_property
    def turning(self) -> Array:
        """The places in v of tangents that are rotations."""
        own = self.shooting
        places = np.arange(own.intervals + 1)[:, None] * (own.n + own.m) + np.flatnonzero(own.turns)
        return places.ravel()

    def coordinates(self, point: Point) -> Array:
        """v of a point: states that are flat, controls and shared unknowns as they are, others zero."""
        own, K = self.shooting, self.shooting.intervals
        d = np.zeros((K + 1, own.n))
        for name, part in own.dynamics.group.slices.items():
            if own.dynamics.group.factors[name].flat:
                d[:, part] = np.reshape(point.xs[name], (K + 1, -1))
        inner = np.concatenate([d[:-1], point.us], axis=1)
        return np.concatenate([inner.ravel(), d[-1], np.ravel(point.border)])

    def limits(self, point: Point, given: Given) -> tuple[Array, Array]:
        """Lower and upper bounds of v; equal where an entry is fixed."""
        own, v, n = self.shooting, self.coordinates(point), self.shooting.n
        lower, upper = np.full(len(v), -np.inf), np.full(len(v), np.inf)
        border = len(v) - own.border.size
        sides = np.asarray(given.limits)
        lower[border:], upper[border:] = sides[:, 0], sides[:, 1]
        of_leaf = ~np.isnan(self.bounds.limits)
        for bound, side, most in ((lower, ~self.bounds.upper, np.maximum), (upper, self.bounds.upper, np.minimum)):
            at = of_leaf & side
            most.at(bound, self.bounds.variables[at], self.bounds.limits[at])
        fixed = np.flatnonzero(~own.free.d[0])
        lower[fixed] = upper[fixed] = v[:n][fixed]
        return lower, upper

    def flat(self, point: Point) -> Array:
        """z of a point."""
        nodes = self.functions.point.joined(point.xs, 1)
        us = np.asarray(point.us)
        inner = np.concatenate([nodes[:-1], us], axis=1)
        return np.concatenate([inner.ravel(), nodes[-1], np.ravel(point.border)])

    @functools.cached_property
    def stages_of_rows(self) -> tuple[Array, Array]:
        """The stage of every inequality and of every equality."""
        stages = self.transcription.stages
        every = np.arange(len(stages.states))
        return np.repeat(every, stages.inequalities), np.repeat(every, stages.equalities)

    def places_alone(self) -> Iterator[tuple[Array, Array]]:
        """Places of inequalities and equalities, of which no two stand in one stage; together they are all."""
        stages = self.stages_of_rows
        numbers = [np.arange(len(own)) - np.searchsorted(own, own) for own in stages]
        most = [int(own.max(initial=-1)) + 1 for own in numbers]
        none = np.zeros(0, int)
        for k in range(most[0]):
            yield np.flatnonzero(numbers[0] == k), none
        for k in range(most[1]):
            yield none, np.flatnonzero(numbers[1] == k)

    def levelled_rows(self, inequalities: Array, equalities: Array) -> tuple[Array, Array]:
        """Sizes of rows: of a path row the largest of all its places; 1 where there is none."""
        sizes = [np.where(np.isfinite(a) & (a > 0.0), a, 0.0) for a in (inequalities, equalities)]
        for row in range(self.phase.path.shape[2]):
            for kind, own in zip((INEQUALITY, EQUALITY), sizes):
                places = self.transcription.path_places[..., row][self.phase.path[..., row] == kind]
                own[places] = own[places].max(initial=0.0)
        return sizes[0] + (sizes[0] == 0.0), sizes[1] + (sizes[1] == 0.0)

    def point(self, z: Array) -> Point:
        """The point of z."""
        own, K = self.shooting, self.shooting.intervals
        width = self.functions.point.size
        split = K * (width + own.m)
        inner, last, border = np.split(z, [split, split + width])
        inner = inner.reshape(K, -1)
        nodes = np.concatenate([inner[:, :width], last[None]])
        return Point(self.functions.point.split(nodes), inner[:, width:], border)

    def rows(self, h: Array, e: Array) -> Array:
        """Numbers of inequalities and equalities as those of all rows, zero where none is."""
        own, layout, K = self.shooting, self.shooting.layout, self.shooting.intervals
        found = np.zeros(len(own.exists))
        inner = found[: K * layout.per_interval].reshape(K, -1)
        places = self.transcription.path_places.reshape(K, -1)
        if places.size:
            whole = np.where(self.phase.path.reshape(K, -1) == EQUALITY, _at(e, places), _at(h, places))
            whole = np.where(places >= 0, whole, 0.0)
            inner[:, : len(layout.asked)] = whole.reshape(K, own.substeps + 1, -1).reshape(K, -1)[:, layout.asked]
        *nodes, end = [
            np.where(at >= 0, np.where(kind == EQUALITY, _at(e, at), _at(h, at)), 0.0)
            for at, kind in zip(self.transcription.node_places, self.phase.conditions)
        ]
        for (k, _), values in zip(self.phase.kernels.nodes, nodes):
            inner[k, len(layout.asked) :][: len(values)] = values
        found[K * layout.per_interval :] = end
        return found


def _at(values: Array, places: Array) -> Array:
    return values[np.clip(places, 0, len(values) - 1)] if len(values) else np.zeros(places.shape)


def bounds_of_rows(shooting: Shooting) -> Bounds:
    """Which rows of a phase are limits of states at nodes, of controls, of times and of free parameters."""
    own, layout, K = shooting, shooting.layout, shooting.intervals
    width, first_box = own.n + own.m, len(own.path.names) - len(own.path.bounds)
    found: list[tuple[int, int, bool, float]] = []

    def add(row: int, path_row: int, stage: int) -> None:
        if path_row < first_box or not own.exists[row]:
            return
        bound = own.path.bounds[path_row - first_box]
        if bound.leaf in own.dynamics.group.slices:
            if not own.dynamics.group.factors[bound.leaf].flat:
                return
            column = own.dynamics.group.slices[bound.leaf].start + bound.entry
        else:
            column = own.n + own.local.controls.slices[bound.leaf].start + bound.entry
        found.append((row, stage * width + column, bound.sign > 0.0, bound.limit))

    for k in range(K):
        for place, row in enumerate(layout.asked):
            if row < len(own.path.names):
                add(k * layout.per_interval + place, int(row), k)
    inner = K * layout.per_interval
    first_state = len(own.exists) - inner - len(layout.end_states)
    limits = own.border.finite if own.is_last else []
    first_state -= len(limits)
    for place, row in enumerate(layout.end_states):
        add(inner + first_state + place, int(row), K)
    for place, (entry, side) in enumerate(limits):
        row = len(own.exists) - len(limits) + place
        if own.exists[row]:
            found.append((row, K * width + own.n + entry, bool(side), np.nan))
    rows, variables, upper, sides = (np.array(a) for a in zip(*found)) if found else (np.zeros(0, int),) * 4
    return Bounds(rows.astype(int), variables.astype(int), upper.astype(bool), sides.astype(float))
