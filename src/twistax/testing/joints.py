"""The laws of a joint: relations between its pose and its motion subspace, and between its three subspaces."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import expm

from ..errors import InputError
from ..expr import Expr, State
from ..expr.graph import leaves_of
from ..groups import SE3, se3
from ..jax_inside import quick_compile
from ..mechanics.joints import Joint
from ..progress import watching
from ..system.lower import lower
from .laws import STENCIL, STEP, Check, difference_quotient

_EXACT, _BY_DIFFERENCES, _SINGLE = 2e-13, 2e-9, 100.0 * float(np.finfo(np.float32).eps)
#: How far slides go where they go far, in m.
_FAR = 7e6


@watching("check_joint")
def check_joint(joint: Joint, *, at_zero: Any = None, seed: int = 0) -> None:
    """Check that a joint satisfies the laws on which mechanisms rely: its pose must agree with its motion subspace.

    It checks shapes; that $T_pc$ is a pose, and the identity where the position is zero; $T_pc' = T_pc hat(H v)$, by
    derivatives and by differences of poses; that H is constant in the child, so that the twist changes by $H v'$ alone;
    for one freedom $T_pc(q) = T_pc(0) exp(q hat(H))$; $h*^T H = I$, $H^T Hbar* = 0$ and that both are a basis of all
    wrenches, in every frame, so that power is $F . H v = tau . v$ in W; that `velocity_of` is the inverse of `rate`;
    that springs have no force at zero, and that their deflection changes with the velocity nearby; derivatives forward
    and reverse; and single precision, with translations of 7e6 m. Positions are zero, tiny, of size 1, near half a turn
    and some turns away.

    Args:
        joint: an instance, such as `MyJoint("j", axis=(0.0, 0.0, 1.0))`, whose Parameters have values.
        at_zero: the pose $T_pc$ (4, 4) at the zero position; the identity by default.
        seed: seed of the random numbers.
    Raises:
        LawError: a law is violated. The message names the law, the values and the likely cause.
        InputError: `joint` is not a joint.
    Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 3.
    Example: `tx.testing.check_joint(tx.mechanics.joints.Planar("table"))`.
    """
    if not isinstance(joint, Joint):
        made = f".\n  fix: give an instance, {joint.__name__}(...)" if isinstance(joint, type) else ""
        raise InputError(f"check_joint expects a joint such as joints.Planar('table'), got {joint!r}{made}")
    check = Check(repr(joint))
    with jax.enable_x64(True):
        _check_declaration(check, joint)
        motion = _Motion(check, joint)
        _check_subspaces(check, motion, seed)
        zero = motion.zero()
        fix = "look at placement: the frames coincide at zero, or give at_zero, the pose there"
        expected = np.eye(4) if at_zero is None else np.asarray(at_zero, float)
        check.close("the pose at zero", motion.placed(zero), expected, _EXACT, fix)
        if joint.dofs == 0:
            return
        for label, q in motion.positions(seed).items():
            _check_motion(check, motion, label, q, np.random.default_rng(seed))
        _check_spring(check, motion, np.random.default_rng(seed))
        _check_single_precision(check, motion, seed)


class _Motion:
    """A joint as functions of its position and velocity."""

    def __init__(self, check: Check, joint: Joint) -> None:
        self.joint = joint
        values: dict[str, Any] = {"T": joint.transform}
        if joint.position is not None and joint.velocity is not None:
            rate = joint.rate(joint.position, joint.velocity)
            deflection = joint.deflection(joint.position)
            values |= {"rate": rate, "again": joint.velocity_of(joint.position, rate), "twist": joint.twist}
            values |= {} if deflection is None else {"deflection": deflection}
        with check.running("its expressions can be evaluated", "look at placement, rate and deflection"):
            self._functions = {name: lower(value) for name, value in values.items()}
            self._read = {name: {leaf.name for leaf in leaves_of(value)} for name, value in values.items()}
            self.H = np.asarray(lower(joint.motion_subspace)(0.0))

    def value(self, name: str, q: Any, v: Any = None) -> Any:
        joint = self.joint
        if joint.position is None or joint.velocity is None:
            return self._functions[name](0.0)
        x = {joint.position.name: q, joint.velocity.name: jnp.zeros_like(q, shape=(joint.dofs,)) if v is None else v}
        return self._functions[name](0.0, {key: value for key, value in x.items() if key in self._read[name]})

    @property
    def has_spring(self) -> bool:
        """Whether a spring may act on it."""
        return "deflection" in self._functions

    def placed(self, q: Any) -> np.ndarray:
        return np.asarray(self.value("T", q))

    def zero(self) -> Any:
        """The position of rest."""
        group = self.joint.group
        return jnp.zeros(self.joint.dofs) if group is None else group.identity(float)

    def moved(self, q: Any, v: Any, a: Any, s: Any) -> Any:
        """The position after s, to second order, where the velocity is v + a s."""
        group, rate = self.joint.group, self.value("rate", q, v)
        change = rate if group is None else group.entry_rate(q, rate)
        _, bend = jax.jvp(lambda p, w: self.value("rate", p, w), (q, v), (change, a))
        change_of_q = s * rate + 0.5 * s * s * bend
        return q + change_of_q if group is None else group.retract(q, change_of_q)

    def positions(self, seed: int, far: float = 1.0) -> dict[str, Any]:
        """Positions by kind: coordinates, or elements of the group, with translations up to a limit."""
        rng, k = np.random.default_rng(seed + 1), self.joint.dofs
        turns = np.abs(self.H[3:]).max(axis=0) > 0.0
        drawn = {"zero": np.zeros(k), "1e-6": 1e-6 * rng.normal(size=k), "ordinary": rng.uniform(0.5, 2.0, k)}
        drawn["beside half a turn"] = np.where(turns, np.pi - 1e-6, rng.normal(size=k))
        if self.joint.group is None:
            drawn["some turns away"] = 30.0 * rng.normal(size=k)
            return {label: jnp.asarray(np.where(turns, d, far * d)) for label, d in drawn.items()}
        group = self.joint.group
        drawn["beside half a turn"] *= np.where(group.sized, 1.0, 1.0 / np.sqrt(max(1, (~group.sized).sum())))
        return {label: group.exp(jnp.asarray(np.where(group.sized, far * d, d))) for label, d in drawn.items()}


def _check_declaration(check: Check, joint: Joint) -> None:
    k = joint.dofs
    fix = "call super().__init__(name, motion=H), and write placement as an expression"
    for name, shape in (("motion_subspace", (6, k)), ("actuation_basis", (6, k)), ("constraint_basis", (6, 6 - k))):
        with check.running(f"{name} has shape {shape}", fix):
            got = getattr(joint, name).shape
        check.holds(f"{name} has shape {shape}", got == shape, f"got {got}", fix)
    with check.running("the pose has shape (4, 4)", fix):
        _ = joint.transform
    states = [leaf for leaf in leaves_of(joint.motion_subspace) if isinstance(leaf, State)]
    message = f"the motion subspace reads {states}"
    check.holds(
        "H is constant in the child", not states, message, "write it as several joints in a row, as universal does"
    )
    if joint.position is not None and joint.velocity is not None:
        known = {joint.position.name, joint.velocity.name}
        read = {leaf.name for leaf in leaves_of(joint.transform) if isinstance(leaf, State)}
        message = f"the pose reads {sorted(read - {joint.position.name})}"
        check.holds("the pose is a function of the position", read <= {joint.position.name}, message, fix)
        rate: Expr = joint.rate(joint.position, joint.velocity)
        wanted = (k,) if joint.group is None else joint.group.tangent_shape
        check.holds("the shape of rate", rate.shape == wanted, f"got {rate.shape} for {wanted}", "look at rate")
        read = {leaf.name for leaf in leaves_of(rate) if isinstance(leaf, State)}
        check.holds(
            "rate is of position and velocity", read <= known, f"it reads {sorted(read - known)}", "look at rate"
        )


def _check_subspaces(check: Check, motion: _Motion, seed: int) -> None:
    joint, rng = motion.joint, np.random.default_rng(seed)
    k = joint.dofs
    frames = {"the joint's own frame": np.eye(4)}
    frames |= {f"frame {i}": np.asarray(se3.exp(jnp.asarray(rng.normal(size=6)))) for i in range(3)}
    T, F = State("frame of check_joint", group=SE3), State("wrench of check_joint", shape=(6,))
    screws = joint.screws_in(T)
    products = {
        "H": screws.motion_subspace,
        "h": screws.actuation_basis,
        "Hbar": screws.constraint_basis,
        "tau": screws.actuation(F),
        "reaction": screws.reaction(F),
    }
    subspaces = lower(products)
    for label, frame in frames.items():
        wrench = rng.normal(size=6)
        value = {n: np.asarray(a) for n, a in subspaces(0.0, {T.name: frame, F.name: wrench}).items()}
        H, h, Hbar, at = value["H"], value["h"], value["Hbar"], {label: frame}
        fix = "look at motion, actuation_basis and constraint_basis of the constructor"
        size = max(1.0, *(float(np.abs(a).max(initial=0.0)) for a in (H, h))) ** 2
        law = "H moves by Ad_T"
        check.close(law, H, np.asarray(se3.Ad(jnp.asarray(frame))) @ motion.H, _EXACT * size, fix, at)
        check.close("h*^T H = I: unit power", h.T @ H, np.eye(k), 1e-12 * size, fix, at)
        check.close("H^T Hbar* = 0: the bearing does no work", H.T @ Hbar, np.zeros((k, 6 - k)), 1e-12 * size, fix, at)
        rank = np.linalg.matrix_rank(np.hstack([h, Hbar]))
        check.holds("[h* Hbar*] is a basis of all wrenches", rank == 6, f"its rank is {rank} in {label}", fix)
        v = rng.normal(size=k)
        law = "power is F . H v = tau . v"
        check.close(law, value["tau"] @ v, wrench @ H @ v, 1e-11 * size, "look at actuation", at)
        law = "F = h* tau + the reaction"
        check.close(law, h @ value["tau"] + value["reaction"], wrench, 1e-12 * size, "look at reaction", at)


def _check_motion(check: Check, motion: _Motion, label: str, q: Any, rng: np.random.Generator) -> None:
    joint, k = motion.joint, motion.joint.dofs
    v, a = jnp.asarray(rng.normal(size=k)), jnp.asarray(rng.normal(size=k))
    at = {f"the position ({label})": q, "the velocity": v}
    H, T = motion.H, motion.placed(q)
    size = max(1.0, float(np.abs(T).max()))
    check.close("the pose is one", SE3.known_defect(T), 0.0, _EXACT, "look at placement", at)

    def along(s: Any) -> Any:
        return motion.value("T", motion.moved(q, v, a, s))

    def twist(s: Any) -> Any:
        T, rate = jax.jvp(along, (s,), (jnp.ones_like(s),))
        return SE3.body_velocity(T, rate)

    def all_of(s: Any) -> Any:
        xi, change = jax.jvp(twist, (s,), (jnp.ones_like(s),))
        steps = jax.vmap(along)(jnp.asarray([i * STEP for i in STENCIL]))
        jacobian = [mode(lambda p: motion.value("T", p))(q) for mode in (jax.jacfwd, jax.jacrev)]
        return xi, change, steps, jacobian, motion.value("again", q, v), motion.value("twist", q, v)

    with check.running("the pose has derivatives", "write placement of nodes that have derivatives there"):
        compiled = jax.jit(all_of, compiler_options=quick_compile(0))
        xi, change, steps, (forward, reverse), again, V = map(_host, compiled(jnp.zeros(())))
    fix = "look at placement, rate and motion: one of them has another axis, sign, order or unit than the others"
    expected = H @ np.asarray(v)
    check.close("T_pc' = T_pc hat(H v)", xi, expected, 1e-12 * size, fix, at)
    slope, hat = difference_quotient(steps), np.asarray(se3.hat(jnp.asarray(expected)))
    check.close("T_pc' = T_pc hat(H v), by differences", slope, T @ hat, _BY_DIFFERENCES * size, fix, at)
    check.close("the twist is H v", V, expected, _EXACT * size, "look at twist", at)
    fix = "H must not change in the child: write the joint as several ones in a row"
    check.close("the twist changes by H v' alone", change, H @ np.asarray(a), 1e-10 * size, fix, at)
    check.close("velocity_of undoes rate", again, v, 1e-11 * size, "look at velocity_of", at)
    check.close("reverse derivatives are forward ones", reverse, forward, 1e-12 * size, "look at placement", at)
    if k == 1 and joint.group is None and type(joint).rate is Joint.rate:
        screw = motion.placed(motion.zero()) @ expm(float(q[0]) * np.asarray(se3.hat(jnp.asarray(H[:, 0]))))
        fix = "look at placement: the motion of one screw is its exponential"
        check.close("T_pc(q) = T_pc(0) exp(q hat(H))", T, screw, 1e-12 * size**2, fix, at)


def _host(tree: Any) -> Any:
    return jax.tree.map(np.asarray, tree)


def _check_spring(check: Check, motion: _Motion, rng: np.random.Generator) -> None:
    if not motion.has_spring:
        return
    zero, v = motion.zero(), jnp.asarray(rng.normal(size=motion.joint.dofs))
    fix = "look at deflection: coordinates (k,) that are zero at rest and change by the velocity beside it"
    still = jnp.zeros_like(v)
    law, felt = "springs feel nothing at zero", lambda s: motion.value("deflection", motion.moved(zero, v, still, s))
    with check.running(law, fix):
        value, slope = jax.jvp(felt, (jnp.zeros(()),), (jnp.ones(()),))
    check.close(law, value, still, _EXACT, fix)
    check.close("springs feel the velocity beside zero", slope, v, 1e-10, fix, {"the velocity": v})


def _check_single_precision(check: Check, motion: _Motion, seed: int) -> None:
    """Each half of the pose against its size."""
    fix = "look at placement in single precision"
    for far in (1.0, _FAR):
        for label, q in motion.positions(seed, far).items():
            short = np.float32(q)
            single, double = motion.placed(short), motion.placed(short.astype(float))
            law = "the pose in single precision is that in double, to 100 round-offs"
            check.holds(law, single.dtype == np.float32, f"it is {single.dtype}", fix)
            size = np.ones((4, 4))
            size[:3, 3] = np.maximum(1.0, np.abs(double[:3, 3]).max())
            check.close(law, single, double, _SINGLE * size, fix, {f"the position ({label}, float32)": short})
