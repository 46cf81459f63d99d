"""Dynamics of mechanisms with closed loops: the equations of the tree with loop constraints and Lagrange multipliers.

With G (m, n) the rows W'(J_other - Ad_T^-1 J_frame) of all loop constraints, closed loops satisfy G qd = 0 and

    M qdd + b = tau + G' lambda        G qdd + c = 0,

c = G' qd with G' the rate of G. Loop constraints may be redundant, in all configurations or in some. Only rows that are
independent in the current configuration are used, see `loop_rows`. Their multipliers follow from A mu = r with A = G
M^-1 G', which is positive definite for these rows. The constraint wrenches are the minimum-norm solution with the same
joint forces.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II (1996), section VII.1 for the equations, VII.2
for projections that remove the drift.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from ...checks import listed
from ...errors import ModelError
from ...expr import Concat, Constant, Dot, Expr, Hstack, Max, Sqrt, Stack, Sum, Where
from ...expr.fields import ExprLike
from ...expr.lie import Adjoint, AdjointAction, SE3AdjointDual
from ..kinematic_tree import KinematicTree, Positions
from ..loops import Loop
from .dynamics import Wrenches, bias_forces, checked, mass_matrix
from .inertia_frames import mirrored
from .jacobians import frame_jacobian
from .loop_rows import UNIT, LoopRows, numbers, solved


@dataclasses.dataclass(frozen=True)
class ClosedLoops:
    """The loop equations of a mechanism at one state, as expressions that are built when first read.

    Args:
        mechanism: a mechanism with at least one loop.
        q, qd: positions and velocities; None for the states of the mechanism.
    """

    mechanism: KinematicTree
    q: Positions | None = None
    qd: ExprLike | None = None

    @functools.cached_property
    def poses(self) -> list[Expr]:
        """For every loop, the pose T (4, 4) of its second frame in the first."""
        return [self.mechanism.pose(loop.other, self.q, relative_to=loop.frame) for loop in self.mechanism.loops]

    @functools.cached_property
    def gaps(self) -> Expr:
        """The closure residuals of all loops (m,)."""
        return Concat(*(loop.gap(T) for loop, T in zip(self.mechanism.loops, self.poses, strict=True)))

    @functools.cached_property
    def jacobian(self) -> Expr:
        """The Jacobian G (m, n) of the loop constraints."""
        rows: list[Expr] = []
        for loop, T in zip(self.mechanism.loops, self.poses, strict=True):
            first, second = (frame_jacobian(self.mechanism, name, self.q) for name in (loop.frame, loop.other))
            J = loop.constraint_basis.T @ (second - AdjointAction(T, first, inverse=True))
            rows += [J[i] for i in range(loop.rows)]
        return Stack(*rows)

    @functools.cached_property
    def velocities(self) -> Expr:
        """The rates G qd (m,) of the closure residuals, zero while the loops are closed."""
        return self.jacobian @ self.mechanism.coordinates("closed loops", "qd", self.qd)

    @functools.cached_property
    def drift(self) -> Expr:
        """The velocity term c (m,) of the second rates G qdd + c of the closure residuals."""
        rates = self._twist_rates()
        rows: list[Expr] = []
        for loop, T in zip(self.mechanism.loops, self.poses, strict=True):
            V = [self.mechanism.twist(name, self.q, self.qd) for name in (loop.frame, loop.other)]
            A = [self._of_frame(name, rates) for name in (loop.frame, loop.other)]
            seen = AdjointAction(T, V[0], inverse=True)
            # The rate of Ad_T^-1 is -ad of the relative twist times Ad_T^-1.
            rate = A[1] - AdjointAction(T, A[0], inverse=True) + Adjoint(V[1] - seen, seen)
            rows.append(loop.constraint_basis.T @ rate)
        return Concat(*rows)

    def _twist_rates(self) -> list[Expr]:
        """The rates (6,) of the twists of all segments at zero joint accelerations."""
        mechanism, twist_rates = self.mechanism, list[Expr]()
        qd = mechanism.coordinates("closed loops", "qd", self.qd)
        steps, twists = mechanism.transforms(self.q), mechanism.twists(self.q, self.qd)
        for segment, T, V in zip(mechanism.segments, steps, twists, strict=True):
            turned = Adjoint(V, mechanism.along(segment, qd))
            before = segment.before
            twist_rates.append(turned if before < 0 else AdjointAction(T, twist_rates[before], inverse=True) + turned)
        return twist_rates

    def _of_frame(self, name: str, rates: list[Expr]) -> Expr:
        at = self.mechanism.frame(name)
        return Constant(np.zeros(6)) if at.segment < 0 else AdjointAction(at.T, rates[at.segment], inverse=True)

    @functools.cached_property
    def rows(self) -> LoopRows:
        """The matrix G, and which of its rows are independent."""
        return LoopRows(self.mechanism, self.jacobian)

    def motion(self, tau: Expr, wrenches: Wrenches | None = None) -> LoopMotion:
        """Accelerations and multipliers under joint forces (n,)."""
        bias = bias_forces(self.mechanism, self.q, self.qd, wrenches=wrenches)
        both = solved(self._mass, Hstack(self.jacobian.T, (tau - bias)[:, None]))
        free, felt = both[:, -1], both[:, :-1]
        A, r = mirrored(self.jacobian @ felt), -self.drift - self.jacobian @ free
        mu = self.rows.solve(A, r)
        return LoopMotion(self.rows, free + felt @ mu, mu, A, r)

    @functools.cached_property
    def corrections(self) -> tuple[Expr, Expr]:
        """Corrections of positions, as velocities (n,), and of velocities (n,): one Newton step towards closed loops.

        They are the shortest steps in the norm of the mass matrix, so the correction of the velocities changes the
        energy only to second order.
        """
        felt = solved(self._mass, self.jacobian.T)
        back = felt @ self.rows.solve(mirrored(self.jacobian @ felt), Stack(self.gaps, self.velocities).T)
        return -back[:, 0], -back[:, 1]

    @functools.cached_property
    def _mass(self) -> Expr:
        return mass_matrix(self.mechanism, self.q)


@dataclasses.dataclass(frozen=True)
class LoopMotion:
    """The motion of a mechanism with loops: accelerations (n,), and multipliers mu (m,) with A mu = r for the selected
    rows.
    """

    rows: LoopRows
    accelerations: Expr
    mu: Expr
    A: Expr
    r: Expr

    @functools.cached_property
    def multipliers(self) -> Expr:
        """The minimum-norm multipliers lambda (m,) that are equivalent to mu."""
        return self.rows.shortest(self.mu)

    def diagnostics(self) -> dict[str, Expr]:
        """See `loop_diagnostics`."""
        chosen, distances = self.rows.independent[0], self.rows.independent[1]
        longest, rank = Max(_largest(distances), UNIT), Sum(chosen)
        nearest = -_largest(-Where(chosen > 0.5, distances, longest))
        measures = self.rows.measures
        # The residual of A mu = r, solved for the error of mu; and the difference between the forces of all and of the
        # selected rows.
        left = self.rows.solve(self.A, self.r - self.A @ self.mu) / measures
        unlike = self.rows.scaled.T @ ((self.multipliers - self.mu) / measures)
        return {
            "rank": rank,
            "redundant": float(len(measures)) - rank,
            "reciprocal_condition": nearest / longest,
            "misalignment": _largest((1.0 - chosen) * distances) / longest,
            "wrench_error": Sqrt(Dot(left, left) + Dot(unlike, unlike) / nearest**2),
        }


def _largest(vector: Expr) -> Expr:
    entries = [vector[i] for i in range(vector.shape[0])]
    return Max(*entries) if len(entries) > 1 else entries[0]


def closed_dynamics(
    mechanism: KinematicTree,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    tau: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> tuple[Expr, dict[str, Expr]]:
    """The accelerations (n,) of a mechanism with closed loops, and the constraint wrench (6,) of each loop.

    The wrench acts on the frame `other`, about its origin and in its axes; the opposite wrench acts on `frame`. The key
    is the name of the loop. If loop constraints are redundant, for example in a planar linkage that is closed in space,
    the wrenches are not unique: the result is the minimum-norm solution in the norm of `loops.Metric`.

    Args:
        mechanism: a mechanism with at least one loop.
        q, qd, tau, wrenches: as for `forward_dynamics`.
    Raises:
        ShapeError: an argument of another shape.
        ModelError: unknown positions or frames; a mechanism without loops.
    """
    motion = _motion("closed_dynamics", mechanism, q, qd, tau, wrenches)
    constraint_wrenches, row = dict[str, Expr](), 0
    for loop in mechanism.loops:
        constraint_wrenches[loop.name] = loop.constraint_basis @ motion.multipliers[row : row + loop.rows]
        row += loop.rows
    return motion.accelerations, constraint_wrenches


def _motion(
    owner: str,
    mechanism: KinematicTree,
    q: Positions | None,
    qd: ExprLike | None,
    tau: ExprLike | None,
    wrenches: Wrenches | None,
) -> LoopMotion:
    if not checked(owner, mechanism).loops:
        raise ModelError(f"{owner} expects a mechanism with loops, got none.\n  fix: Mechanism(links, loops=[...])")
    forces = mechanism.coordinates(owner, "tau", np.zeros(mechanism.dofs) if tau is None else tau)
    return ClosedLoops(mechanism, q, qd).motion(forces, wrenches)


def loop_diagnostics(
    mechanism: KinematicTree,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    tau: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> dict[str, Expr]:
    """Measures of the loop constraints at a configuration, as a dict from names to scalars ().

    Let $G_s = D G E^-1$ be the rows of the loop constraints in the norm of `loops.Metric`, and d the distance of each
    row from the span of the rows selected before it.

    - `rank`: number of independent rows, of all m.
    - `redundant`: m minus the rank: the number of redundant rows at this configuration.
    - `reciprocal_condition`: $d_min / max(d_max, 1)$ over the selected rows, from 1 down to the tolerance. It is small
      near a singular configuration, where a row becomes dependent on the others, and 1 if no row is selected.
    - `misalignment`: the largest d of an omitted row, divided by $max(d_max, 1)$: the degree to which redundant
      constraints contradict each other, for example because axes are not exactly parallel.
    - `wrench_error`: an estimate, N, of the error of all loop wrenches together, in the norm of `loops.Metric`: the
      residual from round-off plus the effect of misalignment on redundant wrenches, both divided by the smallest
      distance.

    Args:
        mechanism: a mechanism with at least one loop.
        q, qd, tau, wrenches: as for `forward_dynamics`; only `wrench_error` depends on the last two.
    Raises: as `closed_dynamics`.
    Source: N. Higham, Accuracy and Stability of Numerical Algorithms (2002), section 10.3, for rank determination by
    pivoting.
    """
    return _motion("loop_diagnostics", mechanism, q, qd, tau, wrenches).diagnostics()


def loop_wrench(
    mechanism: KinematicTree,
    loop: str,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    tau: ExprLike | None = None,
    *,
    frame: str | None = None,
    wrenches: Wrenches | None = None,
) -> Expr:
    """The constraint wrench $F = [f; tau]$ (6,), N and N m, of a loop on its frame `other`, expressed in any frame, by
    default in `other`.

    Pass the tau of `mechanism.system(outputs=lambda qdd, tau: ...)` for the wrench during a motion. Without it the
    motors exert no force.

    Raises: as `closed_dynamics`; ModelError for an unknown loop.
    """
    of = loop_of(mechanism, loop)
    F = closed_dynamics(mechanism, q, qd, tau, wrenches=wrenches)[1][loop]
    if frame is None:
        return F
    return SE3AdjointDual(mechanism.pose(of.other, q, relative_to=frame)) @ F


def loop_wrenches(
    mechanism: KinematicTree,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    tau: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> dict[str, Expr]:
    """The constraint wrenches of all loops, added to `wrenches`, by frame. Pass them as `wrenches=` to functions of the
    tree.

    With these wrenches, `joint_wrench` and `inverse_dynamics` are valid for the mechanism with closed loops. Raises the
    errors of `closed_dynamics`.
    """
    forces = closed_dynamics(mechanism, q, qd, tau, wrenches=wrenches)[1]
    total: dict[str, ExprLike] = dict(wrenches or {})
    for loop, T in zip(mechanism.loops, ClosedLoops(mechanism, q, qd).poses, strict=True):
        F = forces[loop.name]
        for name, F_frame in ((loop.other, F), (loop.frame, -(SE3AdjointDual(T) @ F))):
            total[name] = total[name] + F_frame if name in total else F_frame
    return total  # type: ignore[return-value]


def loop_gap(mechanism: KinematicTree, loop: str, q: Positions | None = None) -> Expr:
    """The closure residual (m,) of a loop, m and rad; zero if the loop is closed. Raises ShapeError for positions of
    another shape, and ModelError for an unknown loop.
    """
    of = loop_of(mechanism, loop)
    return of.gap(mechanism.pose(of.other, q, relative_to=of.frame))


def loop_of(mechanism: KinematicTree, name: str) -> Loop:
    """The loop constraint with a name. Raises ModelError for an unknown name."""
    loops = {loop.name: loop for loop in mechanism.loops}
    if name not in loops:
        raise ModelError(f"there is no loop {name!r}; known are {listed(loops, name)}")
    return loops[name]


def redundant_rows(mechanism: KinematicTree) -> int:
    """The number of redundant rows of G at a random configuration; a parameter has its value, or one if it has none."""
    rows = ClosedLoops(mechanism).rows
    lengths = np.linalg.svd(numbers(rows.scaled), compute_uv=False)
    return int(np.sum(lengths <= max(mechanism.loop_metric.tolerance, 1e-5) * lengths[0])) + max(
        0, rows.scaled.shape[0] - len(lengths)
    )
