"""Inverse kinematics: joint positions for which frames reach their targets."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import listed, number, real_array, short, whole
from ...errors import InputError
from ...jax_inside import is_traced
from ...progress import watching
from ...scalar.fast import loops_of_package, part_of_package
from ...system.lower import lower
from ...system.system import constraints_by_name
from ..algorithms.dynamics import checked
from ..kinematic_tree import KinematicTree
from ..tasks.configuration_space import Arrays, ConfigurationSpace
from ..tasks.rows import task_list
from ..tasks.task import Task
from .errors import ReachErrors
from .result import ReachResult, ReachStatus
from .solver import SearchEnd, SearchOptions, SeededSearch

#: The tolerance of a target's matrix to be a pose.
_NEARLY = 1e-4
#: A multiplier within this factor of what is left of the gradient is not distinguishable from zero.
_SIGNIFICANT = 10.0


@watching("reach")
def reach(
    mechanism: KinematicTree,
    targets: Mapping[str, Any],
    *,
    tasks: Iterable[Task] = (),
    secondary: Iterable[Task] = (),
    constraints: Any = (),
    start: Mapping[str, Any] | None = None,
    seeds: int = 8,
    candidates: int = 64,
    length: float = 0.3,
    position_tolerance: float = 1e-5,
    angle_tolerance: float = 1e-5,
    iterations: int = 160,
) -> ReachResult:
    """Inverse kinematics within joint limits: joint positions for which frames reach target poses or positions.

    It minimises $|e|^2$ with $e = [p_d - p; l Log(R^T R_d)]$ of all frames, by damped least squares on the groups,

        $d = D J^T (J D J^T + mu 1)^-1 e$

    where D is zero for joints at a limit. If 15 steps from a seed do not reach the target, a quasi-Newton method for
    large residuals continues, so that searches of targets out of reach end at minima. The search starts from successive
    seeds until one reaches the target. At the first minimum of a seed, joints that are blocked by a limit move to the
    middle of their ranges, and the search continues. A seed is the best of some random candidates, which are the same
    in every call. All targets are computed in one kernel. The function works under `jit`, `vmap` and `grad`. Its
    derivatives are those of the nearest solution, $dx = J^+ de$, if the target is reached, and zero otherwise.

    Additional `tasks` have the same priority as the targets. The error of a constraint $c(q) <= 0$ is $max(c, 0)$. Once
    all of these are satisfied, steps in their null space reduce the weighted errors of `secondary` tasks, to a local
    minimum near the first solution or until the iterations end. Other targets, lengths, tolerances, weights, and
    values of Parameters do not recompile.

    Source: T. Sugihara, Solvability-Unconcerned Inverse Kinematics by the Levenberg-Marquardt Method, IEEE Transactions
    on Robotics 27 (2011), equations 14 to 18; C. Kanzow, N. Yamashita, M. Fukushima, Levenberg-Marquardt Methods with
    Strong Local Convergence Properties for Solving Nonlinear Equations with Convex Constraints (2004), for limits.

    Args:
        mechanism: a tree or a chain without loop constraints.
        targets: by frame, poses (..., 4, 4) or positions (..., 3) in the base, all with the same leading axes. They may
            be empty if there are tasks.
        tasks: additional tasks whose targets are numbers, such as `CenterOfMassTask` or `LookAtTask`; satisfied if the
            weighted error is at most `position_tolerance`.
        secondary: tasks of lower priority, such as `PostureTask`.
        constraints: inequalities of positions, such as {"shelf": signed_distance(...) >= 0.02}.
        start: positions by state for the first seed, with the leading axes of the targets or none.
        seeds: the largest number of seeds for a target.
        candidates: the number of random positions from which each seed is chosen.
        length: l, m: a rotation of 1 rad counts as this distance.
        position_tolerance, angle_tolerance: the tolerances of a frame at its target, m and rad.
        iterations: the largest number of iterations from one seed.
    Raises:
        ModelError: an unknown frame; loop constraints; joints on other groups than SO(3) and SE(3); a mechanism without
            moving joints; tasks whose targets are Controls, or whose errors do not depend on positions; constraints
            that are not inequalities of positions.
        InputError: targets or a start of the wrong shape, or not finite; numbers out of their range.

    Example:
        `reach(arm, {"flange": tx.pose(position=[0.4, 0.1, 0.5])}).x["q"]`
    """
    checked("reach", mechanism)
    tasks, secondary = task_list("reach: tasks", tasks), task_list("reach: secondary", secondary)
    arrays, leading = _targets(mechanism, targets, bool(tasks))
    for name, value in (("seeds", seeds), ("candidates", candidates), ("iterations", iterations)):
        whole(f"reach: {name}", value, 1)
    for name, size in (
        ("length", length),
        ("position_tolerance", position_tolerance),
        ("angle_tolerance", angle_tolerance),
    ):
        number(f"reach: {name}", size, "a positive number", lambda x: 0.0 < x < np.inf)
    shapes = tuple((name, value.shape[1:]) for name, value in arrays.items())
    errors = ReachErrors.of(mechanism, shapes, tasks, secondary, tuple(constraints_by_name(constraints).items()))
    search = _Reacher.of(errors, SearchOptions(iterations), seeds, candidates)
    tolerances = {"position_tolerance": np.asarray(position_tolerance), "angle_tolerance": np.asarray(angle_tolerance)}
    first = None if start is None else _start(errors.space, start, leading)
    return search(arrays, first, errors.numbers(length) | tolerances, leading)


def _targets(
    mechanism: KinematicTree, targets: Mapping[str, Any], may_be_empty: bool
) -> tuple[Arrays, tuple[int, ...]]:
    """The targets (count, ...), and their leading axes. Raises InputError for invalid targets."""
    if not isinstance(targets, Mapping) or not (targets or may_be_empty):
        raise InputError(f"reach expects targets by the names of frames, got {short(targets)}")
    arrays, leading = Arrays(), dict[str, tuple[int, ...]]()
    for frame, value in targets.items():
        mechanism.frame(frame)
        real_array(f"reach: the target of {frame!r}", value)  # raises an error for values that are not real numbers
        T = jnp.asarray(value)
        if not jnp.issubdtype(T.dtype, jnp.floating) or T.dtype.itemsize < 4:
            T = T.astype(np.float32 if jnp.issubdtype(T.dtype, jnp.floating) else float)
        size = 2 if T.shape[-2:] == (4, 4) else 1
        if T.shape[-size:] not in ((4, 4), (3,)):
            raise InputError(f"reach expects the target of {frame!r} as (..., 4, 4) or (..., 3), got {T.shape}")
        leading[frame] = T.shape[:-size]
        arrays[frame] = T.reshape(math.prod(leading[frame]), *T.shape[-size:])
        if not is_traced(T):
            _check(frame, np.asarray(arrays[frame]))
    if len(set(leading.values())) > 1:
        raise InputError(f"reach expects targets with the same leading axes, got {leading}")
    return arrays, next(iter(leading.values()), ())


def _check(frame: str, T: np.ndarray) -> None:
    """Raise InputError for targets that are not finite, or that are not poses."""
    if not np.isfinite(T).all():
        finite = np.isfinite(T).reshape(len(T), -1).all(axis=1)
        raise InputError(f"reach expects finite targets, got as target of {frame!r}\n{T[~finite][0]}")
    if (invalid := _is_invalid(T)).any():
        raise InputError(
            f"reach expects poses [R p; 0 1] as targets of {frame!r}, got\n{T[invalid][0]}\n"
            "  fix: tx.pose(...) builds one"
        )


def _is_invalid(T: Any) -> Any:
    """Whether targets (..., 3) are not finite, or targets (..., 4, 4) are not poses, (...)."""
    xp: Any = jnp if is_traced(T) else np
    if T.shape[-1] == 3:
        return ~xp.isfinite(T).all(axis=-1)
    R = T[..., :3, :3]
    off = xp.abs(xp.swapaxes(R, -1, -2) @ R - np.eye(3, dtype=T.dtype)).max(axis=(-2, -1))
    off = off + xp.abs(xp.linalg.det(R) - 1.0) + xp.abs(T[..., 3, :] - np.eye(4, dtype=T.dtype)[3]).max(axis=-1)
    return ~((off <= _NEARLY) & xp.isfinite(T[..., :3, 3]).all(axis=-1))


def _start(space: ConfigurationSpace, start: Mapping[str, Any], leading: tuple[int, ...]) -> Arrays:
    """The first seed of each target. Raises InputError for an invalid start."""
    if set(start) != set(space.names):
        raise InputError(f"reach: start expects {listed(space.names)}, got {listed(start)}")
    count, arrays = math.prod(leading), Arrays()
    for state in space.states:
        real_array(f"reach: start of {state.name!r}", start[state.name])
        value = jnp.asarray(start[state.name])
        if not is_traced(value) and not np.isfinite(np.asarray(value)).all():
            raise InputError(f"reach: start expects finite numbers for {state.name!r}, got {short(value)}")
        if value.shape not in (state.shape, (*leading, *state.shape)):
            either = f"{state.shape} or {(*leading, *state.shape)}"
            raise InputError(f"reach: start expects {state.name!r} with shape {either}, got {value.shape}")
        arrays[state.name] = jnp.broadcast_to(value, (*leading, *state.shape)).reshape(count, *state.shape)
    return arrays


class _Reacher:
    """The compiled search for some errors and options. Their numbers are arguments."""

    def __init__(self, errors: ReachErrors, options: SearchOptions, seeds: int, candidates: int) -> None:
        """`candidates`: the number for each seed."""
        self.errors = errors
        self._options, self._seeds = options, seeds
        self._frames = tuple(errors.shapes)
        sizes = self.errors.constraints.sizes
        self._constraints = tuple(name for name, size in sizes.items() for _ in range(size))
        pool = self.errors.space.random(np.random.default_rng(0), seeds * candidates)
        poses = dict[str, Any]()
        if self._frames:
            mechanism = errors.space.mechanism
            forward = lower({name: mechanism.pose(name) for name in self._frames})
            with jax.ensure_compile_time_eval():  # the first call may be inside a traced function
                poses = jax.jit(jax.vmap(part_of_package(lambda x: forward(0.0, x))))(pool)
        self._pool = {name: value.reshape(seeds, candidates, *value.shape[1:]) for name, value in pool.items()}
        parts = [self._feature(name, np.asarray(poses[name])) for name in self._frames]
        self._features = np.concatenate([np.zeros((seeds * candidates, 0)), *parts], axis=1)
        self._search = SeededSearch(self.errors, options)
        n = errors.space.mechanism.dofs
        largest = max(errors.size, n) * n  # of the Jacobian and of the second derivatives
        self._first_steps = loops_of_package(self._search.first_steps, largest)
        self._remaining_steps = loops_of_package(self._search.remaining_steps, largest)
        self._last_step = part_of_package(self._polished)
        self._call = jax.jit(self._all, static_argnums=3)

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(*arguments: Any) -> _Reacher:
        """Each search is compiled once and cached."""
        return _Reacher(*arguments)

    def __call__(self, targets: Arrays, start: Arrays | None, numbers: Arrays, leading: tuple[int, ...]) -> ReachResult:
        result: ReachResult = self._call(targets, start, numbers, leading)
        return result

    def _feature(self, frame: str, T: Any) -> Any:
        """Positions (count, 3), and for a pose also the entries of R / sqrt(2), (count, 12)."""
        pose = dict(zip(self._frames, self._kinds(), strict=True))[frame]
        if not pose:
            return T[:, :3, 3] if T.ndim == 3 else T
        turned = T[:, :3, :3].reshape(len(T), 9) * math.sqrt(0.5)
        return (jnp if is_traced(T) else np).concatenate([T[:, :3, 3], turned], axis=1)

    def _kinds(self) -> list[bool]:
        """For each frame whether its target is a pose."""
        return [shape == (4, 4) for shape in self.errors.shapes.values()]

    def _chosen(self, targets: Arrays, length: Any, count: int) -> Arrays:
        """The best candidate of each seed, (count, seeds, ...), by |p - p_d|^2 + l^2 |R - R_d|_F^2 / 2."""
        parts = [self._feature(name, targets[name]) for name in self._frames]
        wanted = jnp.concatenate(parts, axis=1) if parts else jnp.zeros((count, 0))
        turned = np.concatenate([np.zeros(0, bool), *([False] * 3 + [True] * 9 * pose for pose in self._kinds())])
        scale = jnp.where(turned.astype(bool), length, 1.0).astype(wanted.dtype)[None]
        features, wanted = jnp.asarray(self._features, dtype=wanted.dtype) * scale, wanted * scale
        far = jnp.sum(features**2, axis=1)[None] - 2.0 * wanted @ features.T  # without a part that all candidates share
        best = jnp.argmin(far.reshape(count, self._seeds, features.shape[0] // self._seeds), axis=2)
        rows = jnp.arange(self._seeds)[None]
        return {name: jnp.asarray(value, dtype=wanted.dtype)[rows, best] for name, value in self._pool.items()}

    def _all(self, targets: Arrays, start: Arrays | None, numbers: Arrays, leading: tuple[int, ...]) -> ReachResult:
        """The result for targets (count, ...), with leading axes."""
        # Only the last step is differentiated.
        still = jax.tree.map(jax.lax.stop_gradient, targets)
        seeds = self._chosen(still, numbers["length"], math.prod(leading))
        dtype = next(iter(seeds.values())).dtype
        numbers = jax.tree.map(lambda value: jnp.asarray(value, dtype), numbers)
        if start is not None:
            seeds = {n: s.at[:, 0].set(jax.lax.stop_gradient(start[n]).astype(s.dtype)) for n, s in seeds.items()}
        solution = jax.tree.map(jax.lax.stop_gradient, self._solutions(still, seeds, numbers))
        result = jax.vmap(self._last_step, (0, 0, None))(targets, solution, numbers)
        return jax.tree.map(lambda a: a.reshape(*leading, *a.shape[1:]), result)

    def _solutions(self, targets: Arrays, seeds: Arrays, numbers: Arrays) -> SearchEnd:
        """The searches for all targets. Those that go on are neighbours: a kernel takes the steps of neighbours
        together.
        """
        begun = jax.vmap(self._first_steps, (0, 0, None))(targets, seeds, numbers)
        order = jnp.argsort(~jax.vmap(self._search.needs_more)(begun, seeds), stable=True)
        begun, targets, seeds = jax.tree.map(lambda a: a[order], (begun, targets, seeds))
        solution: SearchEnd = jax.vmap(self._remaining_steps, (0, 0, 0, None))(begun, targets, seeds, numbers)
        places = jnp.argsort(order)
        return jax.tree.map(lambda a: a[places], solution)

    def _polished(self, targets: Arrays, end: SearchEnd, numbers: Arrays) -> ReachResult:
        """For one target: a last Gauss-Newton step if it is reached, and the attributes of the result."""
        search, fixed = self._search, jax.lax.stop_gradient
        e, J = self.errors.active(end.r, end.J)
        reached, (free, slope) = search.reached(e, numbers), search.steepness(end.x, e, J)
        open_J = jnp.where(free[None], J, 0.0)
        size = jnp.sum(open_J * open_J)
        mu = jnp.where(size > 0.0, np.finfo(e.dtype).eps * size, 1.0)  # a target on the base depends on no joint
        step = jnp.where(reached, search.least_squares(open_J, e, mu), 0.0)
        r, _ = self.errors(self.errors.space.moved(end.x, step), targets, numbers)
        after, _ = self.errors.active(r, end.J)
        # Near a singular configuration the step may increase the error: then it is not taken, but its derivatives are
        # kept.
        worse = (jnp.sum(after * after) > jnp.sum(e * e)) | ~search.reached(after, numbers)
        # Of the value zero, with the derivatives of the solution with respect to the targets.
        change = jnp.where(reached, search.least_squares(open_J, after - fixed(after), mu), 0.0)
        x = self.errors.space.moved(end.x, jnp.where(worse, 0.0, step) + change)
        r = jnp.where(worse, end.r - fixed(r), 0.0) + r - end.J @ change
        distance, angle = self._measures(r[: self.errors.rows_of_tasks], numbers["length"])
        # First-order conditions: a limit without a multiplier is not the cause.
        scale = jnp.sqrt(jnp.maximum(jnp.sum(J * J) * jnp.sum(e * e), np.finfo(e.dtype).tiny))
        multiplier = jnp.where(free, 0.0, jnp.abs(J.T @ e) / scale)
        flat = self._options.flat_in(e.dtype)
        at_minimum = ~reached & (slope <= flat)
        at_limit = at_minimum & (multiplier > _SIGNIFICANT * flat)
        certain = at_minimum & (end.minima == self._seeds)
        missed = jnp.where(certain, int(ReachStatus.UNREACHABLE), int(ReachStatus.MAX_ITERATIONS))
        missed = jnp.where(jnp.any(at_limit), int(ReachStatus.LIMIT), missed)
        status = jnp.where(reached, int(ReachStatus.REACHED), missed)
        for T in targets.values():
            status = jnp.where(_is_invalid(T), int(ReachStatus.INVALID_TARGET), status)
        measures = (slope, end.minima, end.seeds, r[self.errors.rows_of_tasks :])
        names = (self._frames, self.errors.space.joints, self._constraints)
        return ReachResult(x, status, distance, angle, at_limit, *measures, *names)

    def _measures(self, error: jax.Array, length: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Distances in m and angles in rad, (frames,)."""
        distances, angles, row = list[Any](), list[Any](), 0
        for pose in self._kinds():
            distances.append(jnp.linalg.norm(error[row : row + 3]))
            turn = jnp.linalg.norm(error[row + 3 : row + 6]) / length if pose else jnp.zeros_like(error[0])
            angles.append(turn)
            row += 6 if pose else 3
        nothing = jnp.zeros(0, error.dtype)
        return (jnp.stack(distances), jnp.stack(angles)) if distances else (nothing, nothing)
