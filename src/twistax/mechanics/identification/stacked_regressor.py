"""The regressor of many samples, as numbers."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Mapping
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from ...checks import listed, name_list, reals
from ...errors import InputError, ModelError
from ...expr import Concat, Constant, Expr, Parameter, State, leaves_of
from ...scalar.fast import part_of_package
from ...system.lower import lower
from ..kinematic_tree import KinematicTree
from .regressor import BODY, DRIVE, Regressor, forces_of_parameters, inverse_dynamics_regressor

#: Standard gravity, m/s2, which converts a mass and a length into a force and a time.
_GRAVITY = 9.80665
#: The exponents of mass and length in the unit of a body's parameter.
_LENGTHS = (0, 1, 1, 1, 2, 2, 2, 2, 2, 2)

Array = NDArray[np.float64]


class StackedRegressor:
    """The regressor of a mechanism at many samples, and the sizes of its parameters.

    The function Y theta is compiled; the columns of Y are its values for unit vectors. This program is as small as that
    of inverse dynamics, while the matrix has as many entries as degrees of freedom times parameters.

    Args:
        mechanism: a tree or a chain.
        drives: as in `inverse_dynamics_regressor`.
    Attributes:
        regressor: the regressor as expressions.
        states: the states of a sample, including "qdd".
        params: the names of Parameters.
    """

    def __init__(self, mechanism: KinematicTree, drives: tuple[str, ...] | None) -> None:
        qdd = State("qdd", (mechanism.dofs,))
        self.regressor: Regressor = inverse_dynamics_regressor(mechanism, qdd=qdd, drives=drives)
        self.mechanism, self._bodies = mechanism, len(BODY) * len(mechanism.segments)
        count = len(self.regressor.names)
        parts = [*range(len(BODY), self._bodies + 1, len(BODY))]
        self._parts = parts if parts[-1:] == [count] else [*parts, count]
        widths = np.diff([0, *self._parts])
        theta = [State(f"parameters {i}", (int(width),)) for i, width in enumerate(widths)]
        self._forces = self._compiled(forces_of_parameters(mechanism, Concat(*theta), drives, qdd), by_column=True)
        self._springs = self._compiled(_springs(mechanism), by_column=False)
        roots = (self.regressor.matrix, self.regressor.parameters, _springs(mechanism))
        self.params = {leaf.name for leaf in leaves_of(*roots) if isinstance(leaf, Parameter)}
        self._values = jax.jit(lower(self.regressor.parameters))
        q = mechanism.q
        self.states: tuple[State, ...] = (*([q] if isinstance(q, State) else q.values()), mechanism.qd, qdd)

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(mechanism: KinematicTree, drives: tuple[str, ...] | None) -> StackedRegressor:
        """The programs of a mechanism are compiled once and cached."""
        return StackedRegressor(mechanism, drives)

    @staticmethod
    def _compiled(forces: Expr, *, by_column: bool) -> Any:
        needed, function = {leaf.name for leaf in leaves_of(forces) if isinstance(leaf, State)}, lower(forces)
        known = {leaf.name for leaf in leaves_of(forces) if isinstance(leaf, Parameter)}

        def at(sample: Any, column: Any, params: Any) -> Any:
            x = {name: value for name, value in {**sample, **column}.items() if name in needed}
            return function(0.0, x, params={name: value for name, value in params.items() if name in known})

        one = part_of_package(at)
        columns = jax.vmap(one, in_axes=(None, 0, None)) if by_column else one
        return jax.jit(jax.vmap(columns, in_axes=(0, None, None)))

    def matrix(self, samples: Mapping[str, Any], params: Mapping[str, Any]) -> Array:
        """Y (count, n, p) for samples by state, each (count, ...)."""
        units = np.split(np.eye(len(self.regressor.names)), self._parts[:-1], axis=1)
        with jax.enable_x64(True):
            columns = self._forces(dict(samples), {f"parameters {i}": u for i, u in enumerate(units)}, dict(params))
            return np.swapaxes(np.asarray(columns, dtype=np.float64), 1, 2)

    def random_matrix(self, params: Mapping[str, Any], count: int | None = None, seed: int = 0) -> Array:
        """Y (count n, p) at random states; by default there are three times as many equations as parameters.

        Elements of SO(3) and SE(3) are random; other entries are between -pi and pi.
        """
        count = -(-3 * len(self.names) // self.mechanism.dofs) if count is None else count
        rng = np.random.default_rng(seed)
        samples = {state.name: _random(state, rng, count) for state in self.states if state.shape != (0,)}
        return self.matrix(samples, params).reshape(-1, len(self.names))

    def springs(self, samples: Mapping[str, Any], params: Mapping[str, Any]) -> Array:
        """The forces (count, n) of the springs of all drives."""
        with jax.enable_x64(True):
            return np.asarray(self._springs(dict(samples), {}, dict(params)), dtype=np.float64)

    def values(self, params: Mapping[str, Any]) -> Array:
        """The parameters theta (p,) of the mechanism."""
        known = {leaf.name for leaf in leaves_of(self.regressor.parameters)}
        with jax.enable_x64(True):
            theta = self._values(0.0, {}, params={k: v for k, v in params.items() if k in known})
            return np.asarray(theta, dtype=np.float64)

    def size(self, theta: Array) -> tuple[float, float]:
        """The mean mass of the bodies, kg, and the root mean square distance of mass from their joints, m."""
        bodies = theta[: self._bodies].reshape(-1, len(BODY))
        mass, moments = bodies[:, 0], 0.5 * bodies[:, [4, 6, 9]].sum(axis=1)
        count = np.count_nonzero(mass)
        if not (count and mass.sum() > 0.0 and moments.sum() > 0.0):
            return 0.0, 0.0
        return float(mass.sum() / count), float(np.sqrt(moments.sum() / mass.sum()))

    def typical(self, owner: str, theta: Array, size: Any) -> tuple[float, float]:
        """The mass, kg, and the length, m, of typical bodies: the argument `size`, or by default those of the
        parameters theta.

        Raises:
            ModelError: the mechanism has no masses.
            InputError: a size that is not two positive numbers.
        """
        if size is None:
            mass, length = self.size(theta)
            if not mass:
                raise ModelError(
                    f"{owner}: all masses of the mechanism lie on its joints, so the size of its "
                    "parameters is unknown.\n  fix: pass size=(kg, m) of a typical body"
                )
            return mass, length
        pair = reals(f"{owner}: size", size, InputError)
        if pair.shape != (2,) or not (np.isfinite(pair).all() and (pair > 0.0).all()):
            raise InputError(f"{owner} expects size as two positive numbers, kg and m, got {size!r}")
        return float(pair[0]), float(pair[1])

    def scales(self, mass: float, length: float) -> Array:
        """The size (p,) of each parameter, in its unit, from a mass and a length; for drives, such that they carry the
        weight of the mass.
        """
        bodies = np.tile(mass * length ** np.array(_LENGTHS, dtype=np.float64), self._bodies // len(BODY))
        return np.array([*bodies, *(self._of_drive(name, mass, length) for name in self.names[self._bodies :])])

    def unknown(self, owner: str, links: Collection[str] | None, drives: Collection[str]) -> NDArray[np.bool_]:
        """Which of the parameters (p,) are unknown: those of some links, by default all with a body, and of some kinds
        of drives.

        Raises: ModelError for an unknown link or kind, a link that no joint moves, and if no parameter is unknown.
        """
        segments = self.mechanism.segments
        if links is None:
            chosen = {i for i, segment in enumerate(segments) if segment.body is not None}
        else:
            names = name_list(f"{owner}: links", links, ModelError)
            chosen = {self.mechanism.frame(name).segment for name in names}
            still = [name for name in names if self.mechanism.frame(name).segment < 0]
            if still:
                raise ModelError(f"{owner}: no joint force depends on {listed(still)}, which do not move")
        kinds = name_list(f"{owner}: drives", drives, ModelError)
        for kind in kinds:
            if kind not in DRIVE:
                raise ModelError(f"{owner} expects drives among {listed(DRIVE, kind)}, got {kind!r}")
        bodies = np.repeat([i in chosen for i in range(len(segments))], len(BODY))
        joints = [name.rpartition(".")[2] in kinds for name in self.names[self._bodies :]]
        unknown = np.concatenate([bodies, joints]).astype(bool)
        if not unknown.any():
            raise ModelError(f"{owner} expects at least one unknown link or drive, got none")
        return unknown

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters."""
        return self.regressor.names

    def _of_drive(self, name: str, mass: float, length: float) -> float:
        joint, _, kind = name.rpartition(".")
        H = self.mechanism.segment_of(joint).link.joint.motion_subspace
        slides = isinstance(H, Constant) and not np.any(H.value[3:])
        inertia = mass * length ** (0 if slides else 2)
        rate = np.sqrt(_GRAVITY / length)
        return float(inertia * {DRIVE[0]: 1.0, DRIVE[1]: rate, DRIVE[2]: rate**2}[kind])


def _springs(mechanism: KinematicTree) -> Expr:
    """The spring force (n,) on each degree of freedom."""
    forces: list[Expr] = [Constant(0.0)] * mechanism.dofs
    for segment, place in zip(mechanism.segments, mechanism.positions("identify", None), strict=True):
        drive, deflection = segment.link.drive, segment.link.joint.deflection(place)
        if deflection is not None and drive.sprung:
            spring = dataclasses.replace(drive, damping=0.0, friction=0.0)
            for k, i in enumerate(segment.freedoms):
                force = spring.passive(deflection[k], Constant(0.0))
                forces[i] = forces[i] if force is None else forces[i] + segment.scaled(force)
    return Concat(*forces)


def _random(state: State, rng: np.random.Generator, count: int) -> Array:
    if state.group.flat:
        return rng.uniform(-np.pi, np.pi, size=(count, *state.shape))
    from scipy.spatial.transform import Rotation

    T = np.tile(np.eye(state.shape[0]), (count, 1, 1))
    T[:, :3, :3] = Rotation.from_quat(rng.normal(size=(count, 4))).as_matrix()
    if state.shape == (4, 4):
        T[:, :3, 3] = rng.normal(size=(count, 3))
    return T
