"""Dynamics of mechanisms with closed loops: the tree's equations with what the closures carry, as multipliers.

With G (m, n) the rows W'(J_other - Ad_T^-1 J_frame) of all closures, so that G qd = 0 holds them closed,

    M qdd + b = tau + G' lambda        G qdd + c = 0,

c = G' qd with G' the rate of G. The multipliers follow from A lambda = r with A = G M^-1 G'. Where closures say one
thing twice A is singular; then lambda is the shortest solution, in rows scaled to A_ii = 1. A few rounds of

    lambda <- (A + eps I)^-1 (r + eps lambda)

find it from zero, each leaving the share eps / (a + eps) of the error along an eigenvector with eigenvalue a: what is
found is as exact as the equations, and nothing depends on a rank that was guessed.

Source: J. Carpentier, R. Budhiraja, N. Mansard, Proximal and sparse resolution of constrained dynamic equations,
Robotics: Science and Systems (2021); E. Hairer, G. Wanner, Solving Ordinary Differential Equations II (1996), section
VII.2, for projections of what has drifted.
"""

from __future__ import annotations

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import listed
from ..errors import ModelError
from ..expr import (
    Concat,
    Constant,
    Expr,
    Hstack,
    Inputs,
    Parameter,
    Solve,
    SolvePositive,
    Sqrt,
    Stack,
    State,
    Trace,
    evaluate_all,
    leaves_of,
)
from ..expr.fields import ExprLike
from ..expr.lie import Adjoint, AdjointAction, SE3AdjointDual
from .dynamics import Wrenches, bias_forces, checked, mass_matrix
from .inertia_frames import mirrored
from .jacobians import frame_jacobian
from .loops import Loop
from .mechanism import Mechanism, Positions

#: What is added to the diagonal of A, whose entries there are one, and the rounds in which its share is taken out.
_SOFT, _ROUNDS = 1e-8, 3
#: Systems of more unknowns are LAPACK's.
_SMALL = 48
#: A row that moves nothing is scaled as one that moves so little, against the mean of all.
_LEAST = 1e-12


@dataclasses.dataclass(frozen=True)
class ClosedLoops:
    """The equations of the loops of a mechanism in one state. Expressions, made when they are asked for.

    Args:
        mechanism: with one loop or more.
        q, qd: positions and velocities; the mechanism's own states where None.
    """

    mechanism: Mechanism
    q: Positions | None = None
    qd: ExprLike | None = None

    @functools.cached_property
    def poses(self) -> list[Expr]:
        """T (4, 4) of the second frame of every loop in its first."""
        return [self.mechanism.pose(loop.other, self.q, relative_to=loop.frame) for loop in self.mechanism.loops]

    @functools.cached_property
    def gaps(self) -> Expr:
        """How far all loops are from closed (m,)."""
        return Concat(*(loop.gap(T) for loop, T in zip(self.mechanism.loops, self.poses, strict=True)))

    @functools.cached_property
    def jacobian(self) -> Expr:
        """G (m, n)."""
        rows: list[Expr] = []
        for loop, T in zip(self.mechanism.loops, self.poses, strict=True):
            first, second = (frame_jacobian(self.mechanism, name, self.q) for name in (loop.frame, loop.other))
            J = loop.constraint_basis.T @ (second - AdjointAction(T, first, inverse=True))
            rows += [J[i] for i in range(loop.rows)]
        return Stack(*rows)

    @functools.cached_property
    def velocities(self) -> Expr:
        """G qd (m,): zero where the loops stay closed."""
        return self.jacobian @ self.mechanism.coordinates("closed loops", "qd", self.qd)

    @functools.cached_property
    def drift(self) -> Expr:
        """c (m,): what G qdd + c is besides G qdd."""
        rates = self._twist_rates()
        found: list[Expr] = []
        for loop, T in zip(self.mechanism.loops, self.poses, strict=True):
            V = [self.mechanism.twist(name, self.q, self.qd) for name in (loop.frame, loop.other)]
            A = [self._of_frame(name, rates) for name in (loop.frame, loop.other)]
            seen = AdjointAction(T, V[0], inverse=True)
            # Ad_T^-1 changes by -ad of the relative twist.
            rate = A[1] - AdjointAction(T, A[0], inverse=True) + Adjoint(V[1] - seen, seen)
            found.append(loop.constraint_basis.T @ rate)
        return Concat(*found)

    def _twist_rates(self) -> list[Expr]:
        """The rates (6,) of the twists of all segments while no joint accelerates."""
        mechanism, found = self.mechanism, list[Expr]()
        qd = mechanism.coordinates("closed loops", "qd", self.qd)
        steps, twists = mechanism.transforms(self.q), mechanism.twists(self.q, self.qd)
        for segment, T, V in zip(mechanism.segments, steps, twists, strict=True):
            turned = Adjoint(V, mechanism.along(segment, qd))
            before = segment.before
            found.append(turned if before < 0 else AdjointAction(T, found[before], inverse=True) + turned)
        return found

    def _of_frame(self, name: str, rates: list[Expr]) -> Expr:
        at = self.mechanism.frame(name)
        return Constant(np.zeros(6)) if at.segment < 0 else AdjointAction(at.T, rates[at.segment], inverse=True)

    def motion(self, tau: Expr, wrenches: Wrenches | None = None) -> tuple[Expr, Expr]:
        """The accelerations (n,), and the multipliers (m,), under forces of the joints (n,)."""
        bias = bias_forces(self.mechanism, self.q, self.qd, wrenches=wrenches)
        solved = _solved(self._mass, Hstack(self.jacobian.T, (tau - bias)[:, None]))
        free, felt = solved[:, -1], solved[:, :-1]
        multipliers = self._shortest(felt, -self.drift - self.jacobian @ free)
        return free + felt @ multipliers, multipliers

    @functools.cached_property
    def corrections(self) -> tuple[Expr, Expr]:
        """What to add to positions, as velocities (n,), and to velocities (n,): one step of Newton's to closed loops.

        The shortest steps, measured by the mass matrix; so what is added to the velocities takes energy to second order
        only.
        """
        felt = _solved(self._mass, self.jacobian.T)
        back = felt @ self._shortest(felt, Stack(self.gaps, self.velocities).T)
        return -back[:, 0], -back[:, 1]

    @functools.cached_property
    def _mass(self) -> Expr:
        return mass_matrix(self.mechanism, self.q)

    def _shortest(self, felt: Expr, r: Expr) -> Expr:
        """The shortest solution of G felt x = r, r (m,) or (m, k)."""
        A = mirrored(self.jacobian @ felt)
        m = A.shape[0]
        least = (_LEAST / m) * Trace(A)
        scale = Concat(*(1.0 / Sqrt(A[i, i] + least) for i in range(m)))
        columns = scale if len(r.shape) == 1 else scale[:, None]
        soft = scale[:, None] * A * scale + _SOFT * np.eye(m)
        wanted: Expr = columns * r
        found = _solved(soft, wanted)
        for _ in range(_ROUNDS - 1):
            found = _solved(soft, wanted + _SOFT * found)
        return columns * found


def closed_dynamics(
    mechanism: Mechanism,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    tau: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> tuple[Expr, dict[str, Expr]]:
    """The accelerations (n,) of a mechanism with loops, and the wrench (6,) that each puts on its second frame.

    The wrenches are those on `other`, about its origin in its axes, by the names of the loops. On `frame` the loop
    puts their opposite. Where closures say one thing twice, or a planar linkage is closed in space, the wrenches are
    the shortest that give the motion, see the module.

    Args:
        mechanism: with one loop or more.
        q, qd, tau, wrenches: as for `forward_dynamics`.
    Raises:
        ShapeError: an argument of another shape.
        ModelError: positions or frames that are not known; no loops.
    """
    owner = "closed_dynamics"
    if not checked(owner, mechanism).loops:
        raise ModelError(f"{owner} expects a mechanism with loops, got none.\n  fix: Mechanism(links, loops=[...])")
    forces = mechanism.coordinates(owner, "tau", np.zeros(mechanism.dofs) if tau is None else tau)
    accelerations, multipliers = ClosedLoops(mechanism, q, qd).motion(forces, wrenches)
    found, at = dict[str, Expr](), 0
    for loop in mechanism.loops:
        found[loop.name] = loop.constraint_basis @ multipliers[at : at + loop.rows]
        at += loop.rows
    return accelerations, found


def loop_wrench(
    mechanism: Mechanism,
    loop: str,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    tau: ExprLike | None = None,
    *,
    frame: str | None = None,
    wrenches: Wrenches | None = None,
) -> Expr:
    """$F = [f; tau]$ (6,), N and N m, that a closure puts on its second frame, in any frame; its own unless given.

    With tau of `mechanism.system(outputs=lambda qdd, tau: ...)` it is that of the motion. Without, motors are off.

    Raises: as `closed_dynamics`; ModelError for a loop that is not known.
    """
    of = loop_of(mechanism, loop)
    F = closed_dynamics(mechanism, q, qd, tau, wrenches=wrenches)[1][loop]
    if frame is None:
        return F
    return SE3AdjointDual(mechanism.pose(of.other, q, relative_to=frame)) @ F


def loop_wrenches(
    mechanism: Mechanism,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    tau: ExprLike | None = None,
    *,
    wrenches: Wrenches | None = None,
) -> dict[str, Expr]:
    """All that the closures put on the tree, by frame, with `wrenches`: for the `wrenches` of functions of the tree.

    With them `joint_wrench` and `inverse_dynamics` are those of the mechanism with closed loops. Raises as
    `closed_dynamics` does.
    """
    forces = closed_dynamics(mechanism, q, qd, tau, wrenches=wrenches)[1]
    found: dict[str, ExprLike] = dict(wrenches or {})
    for loop, T in zip(mechanism.loops, ClosedLoops(mechanism, q, qd).poses, strict=True):
        F = forces[loop.name]
        for name, own in ((loop.other, F), (loop.frame, -(SE3AdjointDual(T) @ F))):
            found[name] = found[name] + own if name in found else own
    return found  # type: ignore[return-value]


def loop_gap(mechanism: Mechanism, loop: str, q: Positions | None = None) -> Expr:
    """How far a loop is from closed (m,), m and rad. Raises ShapeError; ModelError for a loop that is not known."""
    of = loop_of(mechanism, loop)
    return of.gap(mechanism.pose(of.other, q, relative_to=of.frame))


def loop_of(mechanism: Mechanism, name: str) -> Loop:
    """The closure of a name. Raises ModelError."""
    loops = {loop.name: loop for loop in mechanism.loops}
    if name not in loops:
        raise ModelError(f"there is no loop {name!r}; known are {listed(loops, name)}")
    return loops[name]


def _solved(A: Expr, b: Expr) -> Expr:
    """A^-1 b of a positive definite matrix: small ones entry by entry, large ones by LAPACK, which compiles at once."""
    return SolvePositive(A, b) if A.shape[0] <= _SMALL else Solve(A, b)


def redundant_rows(mechanism: Mechanism) -> int:
    """How many rows of G depend on others, in a posture drawn at random; parameters have their values, or one."""
    G = ClosedLoops(mechanism).jacobian
    rng, x, params = np.random.default_rng(0), dict[str, jax.Array](), dict[str, jax.Array]()
    for leaf in leaves_of(G):
        if isinstance(leaf, State):
            x[leaf.name] = leaf.group.retract(leaf.group.identity(), rng.normal(size=leaf.group.dimension))
        elif isinstance(leaf, Parameter):
            params[leaf.name] = jnp.asarray(np.ones(leaf.shape) if leaf.value is None else leaf.value)
    inputs = Inputs(jnp.zeros(()), x, {}, params, jnp.zeros(()).dtype)
    (found,) = evaluate_all([G], lambda leaf: leaf.read(inputs))
    rank = np.linalg.matrix_rank(np.asarray(found, np.float64), tol=1e-5 * float(jnp.abs(found).max()))
    return int(found.shape[0] - rank)
