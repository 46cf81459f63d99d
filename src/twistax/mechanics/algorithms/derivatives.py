"""Derivatives of the dynamics with respect to positions, velocities and accelerations or forces, in the tangent space.

Positions are varied by right perturbations: a perturbation d of joint j moves everything beyond it by the twist S_j d,
where S = Ad_T H is the motion column of the joint. Let V and A be the twists and accelerations of the segments, let
`before` be the segment before j, and

    S'_j = V_j x S_j        P_j = V_before x S_j        P'_j = A_before x S_j + V_before x P_j,

then in the perturbed segments V_i changes by P_j, and A_i by P'_j - V_i x P_j, as seen in axes that move with them.
Summed from the tips to the base, with I and B of `spread.py` and F the wrench of the joint,

    d tau_i / d q_j   = S_i . (I_i P'_j + B_i P_j)                for i = j and beyond,
                      = S_i . (I_j P'_j + B_j P_j + S_j x* F_j)   for i before j,
    d tau_i / d qd_j  = S_i . (I_k (P_j + S'_j) + B_k S_j)        with k the later one of i and j,
    d tau_i / d qdd_j = S_i . I_k S_j.

All quantities are expressed in a frame that coincides with the first segment of a tree and moves at its constant linear
velocity, which is permitted because inertial frames are equivalent. The motion of the first joint enters through the
acceleration and the angular velocity of its segment. The derivatives of accelerations are -M^-1 times those of the
forces; if the first joint is free, the part due to its acceleration needs no M.

Sources: J. Carpentier, N. Mansard, Analytical derivatives of rigid body dynamics algorithms, RSS (2018); S. Singh,
R. Russell, P. Wensing, Efficient analytical derivatives of rigid-body dynamics using spatial vector algebra, IEEE RA-L
(2022), there [w; v].
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ...expr import Block, Concat, Constant, Expr, Hstack, InverseFactor, Stack, Where
from ...expr.fields import ExprLike
from ..kinematic_tree import KinematicTree, Positions
from ..tree import Segment
from .branch import NOTHING, Branch, ForceColumns, MovingFrame
from .dynamics import Wrenches, checked, outside
from .forward_dynamics import forward_dynamics
from .inertia_frames import mirrored
from .limbs import coordinates_of, equal_limbs, others
from .motion import ZERO
from .rotors import turning_by_velocities
from .spread import Spread


class ForceDerivatives(NamedTuple):
    """Derivatives of joint forces (n,) with respect to positions (right perturbations),
    velocities and accelerations.
    """

    q: Expr
    qd: Expr
    qdd: Expr


class AccelerationDerivatives(NamedTuple):
    """Derivatives of accelerations (n,) with respect to positions (right perturbations),
    velocities and joint forces.
    """

    q: Expr
    qd: Expr
    tau: Expr


def inverse_dynamics_derivatives(
    mechanism: KinematicTree,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    qdd: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> ForceDerivatives:
    """The derivatives (n, n) of `inverse_dynamics` with respect to positions, velocities and accelerations.

    The derivative with respect to accelerations is the mass matrix. Columns follow the order of the velocities; a
    position on a group is varied by a right perturbation, in the order of its body velocity.

    Args: as for `inverse_dynamics`. Wrenches are assumed constant in the axes of their frames.
    Raises: the errors of `inverse_dynamics`.
    """
    owner = "inverse_dynamics_derivatives"
    rates = checked(owner, mechanism).coordinates(owner, "qdd", np.zeros(mechanism.dofs) if qdd is None else qdd)
    perturbed = _Perturbed(owner, mechanism, q, qd, rates, wrenches)
    by_q, by_qd = perturbed.by_motion()
    through = perturbed.by_acceleration
    return ForceDerivatives(by_q + through(perturbed.moved), by_qd + through(perturbed.hastened), perturbed.mass_matrix)


def forward_dynamics_derivatives(
    mechanism: KinematicTree,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    tau: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> AccelerationDerivatives:
    """The derivatives (n, n) of `forward_dynamics` with respect to positions, velocities and joint forces.

    The derivative with respect to forces is the inverse of the mass matrix. Columns are as for
    `inverse_dynamics_derivatives`.

    Args, Raises: as for `forward_dynamics`. Wrenches are assumed constant in the axes of their frames.
    """
    owner = "forward_dynamics_derivatives"
    if checked(owner, mechanism).loops:
        raise ModelError(
            f"{owner} expects a tree, got one with closed loops.\n  fix: use tx.compile(mechanism.system()).jacobian"
        )
    qdd = forward_dynamics(checked(owner, mechanism), q, qd, tau, wrenches=wrenches)
    return acceleration_derivatives(owner, mechanism, q, qd, qdd, wrenches)


def acceleration_derivatives(
    owner: str,
    mechanism: KinematicTree,
    q: Positions | None,
    qd: ExprLike | None,
    qdd: Expr,
    wrenches: Wrenches | None,
) -> AccelerationDerivatives:
    """The result of `forward_dynamics_derivatives` for known accelerations qdd (n,)."""
    perturbed = _Perturbed(owner, mechanism, q, qd, qdd, wrenches)
    by_q, by_qd = perturbed.by_motion()
    M, n = perturbed.mass_matrix, mechanism.dofs
    moved, hastened = perturbed.free_root(perturbed.moved), perturbed.free_root(perturbed.hastened)
    if moved is None or hastened is None:
        by_q = by_q + perturbed.by_acceleration(perturbed.moved)
        by_qd = by_qd + perturbed.by_acceleration(perturbed.hastened)
    V = InverseFactor(M)
    both = -(V @ (V.T @ Hstack(by_q, by_qd)))
    qdd_by_q, qdd_by_qd = both[:, :n], both[:, n:]
    if moved is not None and hastened is not None:
        qdd_by_q, qdd_by_qd = qdd_by_q - moved, qdd_by_qd - hastened
    return AccelerationDerivatives(qdd_by_q, qdd_by_qd, mirrored(V @ V.T))


class _Perturbed:
    """A motion, and the changes of the joint forces under small perturbations of it.

    Limbs of equal structure are a map over the limbs; the other segments are the trunk.
    """

    def __init__(
        self,
        owner: str,
        mechanism: KinematicTree,
        q: Positions | None,
        qd: ExprLike | None,
        qdd: Expr,
        wrenches: Wrenches | None,
    ) -> None:
        self.mechanism, self._qd = mechanism, mechanism.coordinates(owner, "qd", qd)
        pushes, positions = outside(owner, mechanism, wrenches), mechanism.positions(owner, q)
        groups = equal_limbs(mechanism, pushes)
        trunk = others(mechanism, groups)
        transforms = {i: segment.link.transform(positions[i]) for i, segment in trunk.items()}
        on_trunk = {i: pushes[i] for i in trunk}
        self._trunk = branch = Branch(trunk, transforms, self._qd, qdd, mechanism.gravity, on_trunk)
        self._limbs = list[_Limb]()
        for group in groups:
            frames = [group.on_parents({i: frame[k] for i, frame in branch.moving.items()}) for k in range(3)]
            batches = [*frames, group.positions(positions), group.rows(self._qd), group.rows(qdd)]
            mapped = group.map(_limb, batches)
            for k, parent in enumerate(group.parents):
                *spread, F, felt, turned, by_q, carried_q, by_qd, carried_qd, M = mapped.of(mapped.rows[k])
                branch.add(parent, Spread(*spread), F)
                columns = ForceColumns(by_q, carried_q), ForceColumns(by_qd, carried_qd), ForceColumns(M, felt)
                entries = [i for place in group.places(k) for i in mechanism.segments[place].freedoms]
                self._limbs.append(_Limb(entries, branch.carry(parent), felt, turned, columns))
        branch.gather()
        self.moved, self.hastened = branch.moved, branch.hastened

    def by_motion(self) -> tuple[Expr, Expr]:
        """The derivatives of the forces with respect to positions and velocities, without the parts of `moved` and
        `hastened`.
        """
        freedoms, turning = self._trunk.freedoms, turning_by_velocities(self.mechanism, self._qd)
        by_q = self._joined(self._trunk.by_position(), [freedom.moved for freedom in freedoms], 0)
        by_qd = self._joined(self._trunk.by_velocity(), [freedom.hastened for freedom in freedoms], 1)
        return by_q, by_qd if turning is None else by_qd + turning

    @functools.cached_property
    def mass_matrix(self) -> Expr:
        """The mass matrix M (n, n), including rotors."""
        return self._joined(self._trunk.mass_matrix(), [(freedom.S, ZERO) for freedom in self._trunk.freedoms], 2)

    def _joined(self, trunk: ForceColumns, changes: list[tuple[Expr, Expr]], kind: int) -> Expr:
        """The columns of trunk and limbs (n, n), for the arguments of I and B of the freedoms of the trunk."""
        N = len(self._trunk.freedoms)
        rows: list[list[ExprLike]] = [[trunk.forces]]
        for number, limb in enumerate(self._limbs):
            count, columns, on_path = len(limb.entries), limb.columns[kind], Constant(limb.on_path[:, None])
            nothing = Constant(np.zeros((N, count)))
            rows[0].append(Where(on_path, self._trunk.motions @ columns.wrenches.T, nothing))
            x, b = (Stack(*(change[part] for change in changes)) for part in (0, 1))
            beyond = x @ limb.felt.T + b @ limb.turned.T
            zeros = [Constant(np.zeros((count, len(other.entries)))) for other in self._limbs]
            rows.append([Where(on_path, beyond, nothing).T, *zeros[:number], columns.forces, *zeros[number + 1 :]])
        return self._gathered(Block(rows) if self._limbs else trunk.forces)

    def _gathered(self, pairs: Expr) -> Expr:
        """Rows and columns of joints, summed to those of the velocities (n, n): mimic joints add to the joints that
        they follow.
        """
        entries = [(freedom.entry, freedom.ratio) for freedom in self._trunk.freedoms]
        entries += [(entry, 1.0) for limb in self._limbs for entry in limb.entries]
        G = np.zeros((len(entries), self.mechanism.dofs))
        for row, (entry, ratio) in enumerate(entries):
            G[row, entry] = ratio
        if np.array_equal(G, np.eye(len(G))):
            return pairs
        if np.array_equal(G @ G.T, np.eye(len(G))):
            order = G.argmax(0)
            return pairs[order][:, order]
        return Constant(G.T) @ pairs @ Constant(G)

    # ---- effect of the acceleration of the first segments -----------------------------------------------------------

    def by_acceleration(self, changes: dict[int, Expr]) -> Expr:
        """The change of the forces under a change of the accelerations of the first segments."""
        columns = list[Expr]()
        for number in range(len(self._trunk.freedoms)):
            change = changes.get(number, NOTHING)
            beyond = [self._trunk.carry(other.place)[number] for other in self._trunk.freedoms]
            parts: list[Expr] = [Where(np.array(beyond), self._trunk.felt @ change, np.zeros(len(beyond)))]
            for limb in self._limbs:
                parts.append(limb.felt @ change if limb.on_path[number] else Constant(np.zeros(len(limb.entries))))
            columns.append(Concat(*parts))
        count = sum(len(limb.entries) for limb in self._limbs)
        columns += [Constant(np.zeros(len(columns) + count))] * count
        return self._gathered(Stack(*columns).T)

    def free_root(self, changes: dict[int, Expr]) -> Expr | None:
        """The same change as accelerations of a free first joint (n, n); None if the first joint is another one."""
        segments, n = self.mechanism.segments, self.mechanism.dofs
        roots = [root for root in segments if root.before < 0]
        if any(len(root.freedoms) < 6 or root.link.drive.rotor is not None for root in roots):
            return None
        columns: list[Expr] = [Constant(np.zeros(n))] * n
        for number, change in changes.items():
            freedom = self._trunk.freedoms[number]
            root = segments[freedom.place]
            # H of six degrees of freedom is square: the accelerations are H^-1 of the change.
            basis = root.link.joint.actuation_basis.T
            spread = np.zeros((n, 6))
            spread[list(root.freedoms), range(6)] = 1.0
            columns[freedom.entry] = Constant(spread) @ (basis @ change)
        return Stack(*columns).T


class _Limb(NamedTuple):
    """The degrees of freedom of a limb, by the trunk's and by themselves."""

    entries: list[int]  # among the velocities
    on_path: NDArray[np.bool_]  # which degrees of freedom of the trunk move it
    felt: Expr
    turned: Expr
    columns: tuple[ForceColumns, ForceColumns, ForceColumns]  # with respect to positions, velocities and accelerations


def _limb(segments: dict[int, Segment], T: Expr, V: Expr, A: Expr, q: Expr, qd: Expr, qdd: Expr) -> list[Expr]:
    """What a limb adds to its parent, and the attributes of `_Limb`."""
    transforms = {i: segment.link.transform(q[coordinates_of(segment)]) for i, segment in segments.items()}
    branch = Branch(segments, transforms, qd, qdd, MovingFrame(T, V, A), dict.fromkeys(segments))
    spread, F = branch.gather()
    by_q, by_qd, M = branch.by_position(), branch.by_velocity(), branch.mass_matrix()
    return [*spread, F, branch.felt, branch.turned, *by_q, *by_qd, M.forces]
