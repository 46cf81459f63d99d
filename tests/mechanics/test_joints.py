"""Joints: their subspaces in any frame, their poses against their twists, and what is refused."""

from functools import partial
from typing import Any

import jax
import mpmath
import numpy as np
import pytest
from mechanics_oracles import pose
from scipy.integrate import solve_ivp

import twistax as tx
from oracles import hat
from twistax.mechanics import joints

AXIS = np.array([1.0, -2.0, 2.0]) / 3.0
PITCH = 0.3  # m/rad


class Helical(joints.Joint):
    """A screw, as a user adds it: it mixes m and rad, so it says what drives it."""

    def __init__(self, name: str) -> None:
        motor = np.concatenate([np.zeros(3), AXIS])
        super().__init__(name, motion=np.concatenate([PITCH * AXIS, AXIS]), actuation_basis=motor)

    def placement(self, position: tx.Expr) -> tx.Expr:
        q = position[0]
        return tx.lie.Pose(tx.lie.AxisRotation(q, AXIS), PITCH * q * AXIS)


class Cylindrical(joints.Joint):
    """A turn about and a slide along one axis, the slide first."""

    def __init__(self, name: str) -> None:
        motion = np.zeros((6, 2))
        motion[:3, 0] = motion[3:, 1] = AXIS
        super().__init__(name, motion=motion)

    def placement(self, position: tx.Expr) -> tx.Expr:
        return tx.lie.Pose(tx.lie.AxisRotation(position[1], AXIS), position[0] * AXIS)


#: Every joint, its motions written out, and its degrees of freedom.
JOINTS: dict[str, tuple[joints.Joint, np.ndarray]] = {
    "hinge": (joints.Revolute("hinge", axis=(0.0, 0.0, 2.0)), np.eye(6)[:, 5:]),
    "oblique": (joints.Revolute("oblique", axis=5.0 * AXIS), np.concatenate([np.zeros(3), AXIS])[:, None]),
    "slide": (joints.Prismatic("slide", axis=AXIS), np.concatenate([AXIS, np.zeros(3)])[:, None]),
    "ball": (joints.Spherical("ball"), np.eye(6)[:, 3:]),
    "free": (joints.Free("free"), np.eye(6)),
    "weld": (joints.Fixed("weld"), np.zeros((6, 0))),
    "screw": (Helical("screw"), np.concatenate([PITCH * AXIS, AXIS])[:, None]),
    "cylinder": (Cylindrical("cylinder"), np.kron(np.eye(2), AXIS[:, None])),
}
by_joint = pytest.mark.parametrize("name", JOINTS)

T = tx.State("T", group=tx.SE3)
F = tx.State("F", shape=(6,))


@pytest.fixture(scope="module")
def frames() -> dict[str, np.ndarray]:
    """Random frames and a wrench in each; the first frame is the joint's own."""
    rng = np.random.default_rng(4)
    return {
        "T": np.stack([np.eye(4)] + [pose(rng) for _ in range(19)]),
        "F": rng.normal(size=(20, 6)),
    }


@pytest.fixture(scope="module")
def screws(frames: dict[str, np.ndarray]) -> dict[str, dict[str, np.ndarray]]:
    """All that the joints say in those frames, compiled together."""
    asked = {}
    for name, (joint, _) in JOINTS.items():
        found = joint.screws_in(T)
        asked[name] = {
            "H": found.motion_subspace,
            "h": found.actuation_basis,
            "H_bar": found.constraint_basis,
            "actuation": found.actuation(F),
            "reaction": found.reaction(F),
            "wrench": found.wrench(np.arange(1.0, joint.dofs + 1.0)),
        }
    flat = {f"{name} {what}": expr.canonicalize() for name, parts in asked.items() for what, expr in parts.items()}
    values = jax.jit(jax.vmap(partial(tx.lower(flat), 0.0)))(frames)
    return {name: {what: np.asarray(values[f"{name} {what}"]) for what in parts} for name, parts in asked.items()}


@by_joint
def test_the_motions_move_as_4x4_matrices(name: str, screws: Any, frames: dict[str, np.ndarray]) -> None:
    joint, H = JOINTS[name]
    assert joint.dofs == H.shape[1]
    for frame, moved in zip(frames["T"], screws[name]["H"], strict=True):
        for column, got in zip(H.T, moved.T, strict=True):
            np.testing.assert_allclose(hat(got), frame @ hat(column) @ np.linalg.inv(frame), atol=1e-13)


def test_orthogonality_to_the_working_wrench_is_no_law(screws: Any) -> None:
    """In the joint's frame it holds, in others it does not: a dot product of two wrenches depends on the frame."""
    products = np.einsum("nij,nik->njk", screws["hinge"]["h"], screws["hinge"]["H_bar"])
    np.testing.assert_allclose(products[0], np.zeros((1, 5)), atol=1e-15)
    assert np.abs(products[1:]).max(axis=(1, 2)).min() > 0.1


def test_the_joint_itself_says_the_same_in_its_own_frame(screws: Any, frames: dict[str, np.ndarray]) -> None:
    joint, _ = JOINTS["screw"]
    own = {"H": joint.motion_subspace, "h": joint.actuation_basis, "H_bar": joint.constraint_basis}
    own |= {"actuation": joint.actuation(F), "reaction": joint.reaction(F), "wrench": joint.wrench([1.0])}
    for what, value in tx.lower(own)(0.0, {"F": frames["F"][0]}).items():
        np.testing.assert_allclose(value, screws["screw"][what][0], atol=1e-15)


def test_the_basis_of_a_joint_along_a_coordinate_axis_is_made_of_coordinate_axes() -> None:
    basis = JOINTS["hinge"][0].constraint_basis.value
    assert (basis == np.eye(6)[:, :5]).all()
    assert not np.signbit(basis).any()
    slide = joints.Prismatic("slide", axis=(0.0, -1.0, 0.0)).constraint_basis.value
    assert (slide == np.delete(np.eye(6), 1, axis=1)).all()
    oblique = JOINTS["oblique"][0].constraint_basis.value
    np.testing.assert_allclose(oblique.T @ oblique, np.eye(5), atol=1e-15)


# ---- poses --------------------------------------------------------------------------------------------------------


def test_a_hinge_turns_as_the_exponential_of_many_digits() -> None:
    angles = np.array([0.0, 1e-9, 0.3, 2.0, np.pi, 5.5, -4.0])
    got = jax.vmap(partial(tx.lower(JOINTS["oblique"][0].transform), 0.0))({"oblique_position": angles[:, None]})
    with mpmath.workdps(50):
        for angle, T_pc in zip(angles, got, strict=True):
            turn = mpmath.matrix(hat(np.concatenate([np.zeros(3), AXIS])).tolist()) * mpmath.mpf(float(angle))
            exact = np.array(mpmath.expm(turn, method="taylor").tolist(), dtype=float)
            np.testing.assert_allclose(T_pc, exact, atol=1e-15)


def test_a_hinge_costs_one_sine_and_one_cosine() -> None:
    joint, _ = JOINTS["oblique"]
    f = partial(tx.lower(joint.transform.canonicalize()), 0.0)
    names = [str(equation.primitive) for equation in jax.make_jaxpr(f)({"oblique_position": np.ones(1)}).eqns]
    assert names.count("sin") == names.count("cos") == 1
    assert len(names) < 25


def test_precision_follows_the_arrays() -> None:
    joint, _ = JOINTS["oblique"]
    both = (joint.transform, joint.screws_in(joint.transform).constraint_basis)
    for value in tx.lower(both)(0.0, {"oblique_position": np.ones(1, np.float32)}):
        assert value.dtype == np.float32


def test_ball_and_free_body_follow_their_twists() -> None:
    """Both integrated under velocities that run in time, against a plain integration of the 4x4 matrices."""
    ball, free, t = joints.Spherical("ball"), joints.Free("free"), tx.Time()
    turn = tx.Concat(tx.Cos(2.0 * t), 0.5, tx.Sin(t))
    drive = tx.Concat(1.0, tx.Sin(3.0 * t), t, turn)
    system = tx.System(
        rates={**ball.rates, **free.rates, ball.velocity: turn, free.velocity: drive}, outputs={"T": ball.transform}
    )
    dynamics = tx.compile(system)
    rng = np.random.default_rng(1)
    start = {
        "ball_position": pose(rng)[:3, :3],
        "free_position": pose(rng),
        "ball_velocity": np.zeros(3),
        "free_velocity": np.zeros(6),
    }
    end = tx.integrate(dynamics, start, t1=2.0, dt=2e-3).xs

    def rate(s: float, y: np.ndarray) -> np.ndarray:
        one, two, wrap = y[:16].reshape(4, 4), y[16:32].reshape(4, 4), y[32:]
        w = np.array([np.cos(2.0 * s), 0.5, np.sin(s)])
        about = np.concatenate([np.zeros(3), wrap[:3]])
        force = np.concatenate([[1.0, np.sin(3.0 * s), s], w])
        return np.concatenate([(one @ hat(about)).ravel(), (two @ hat(wrap[3:])).ravel(), w, force])

    first = np.eye(4)
    first[:3, :3] = start["ball_position"]
    y0 = np.concatenate([first.ravel(), start["free_position"].ravel(), np.zeros(9)])
    y = solve_ivp(rate, (0.0, 2.0), y0, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(end["ball_position"][0], y[:16].reshape(4, 4)[:3, :3], atol=1e-10)
    np.testing.assert_allclose(end["free_position"][0], y[16:32].reshape(4, 4), atol=1e-10)
    last = {name: value[0] for name, value in end.items()}
    np.testing.assert_allclose(dynamics.outputs(2.0, last)["T"], y[:16].reshape(4, 4), atol=1e-10)


# ---- what a joint is ----------------------------------------------------------------------------------------------


def test_states() -> None:
    hinge, ball, free, weld = (JOINTS[name][0] for name in ("hinge", "ball", "free", "weld"))
    assert hinge.position is not None
    assert (hinge.position.name, hinge.position.shape) == ("hinge_position", (1,))
    assert hinge.velocity is not None
    assert (hinge.velocity.name, hinge.velocity.shape) == ("hinge_velocity", (1,))
    assert ball.position is not None
    assert ball.position.group == tx.SO3
    assert free.position is not None
    assert free.position.group == tx.SE3
    assert [(key.name, rate) for key, rate in ball.rates.items()] == [("ball_position", ball.velocity)]
    assert (weld.position, weld.velocity, weld.rates) == (None, None, {})
    assert weld.transform.is_group_element
    assert (tx.lower(weld.twist)(0.0) == 0.0).all()
    assert repr(hinge) == "Revolute('hinge')"


class Loose(joints.Joint):
    """Takes whatever motion it is given."""

    def placement(self, position: tx.Expr) -> tx.Expr:
        return tx.Constant(np.eye(4))


class Mismatched(Loose):
    group = tx.SO3


class Flat(Loose):
    def placement(self, position: tx.Expr) -> tx.Expr:
        return tx.Constant(np.eye(3))


def two_of_one_name() -> tx.System:
    one, other = joints.Revolute("h", axis=(0, 0, 1)), joints.Revolute("h", axis=(1, 0, 0))
    return tx.System(rates={**one.rates, one.velocity: [0.0], **other.rates, other.velocity: [0.0]})


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("build", "error", "words"),
    [
        (lambda: joints.Revolute("", axis=(0, 0, 1)), tx.ModelError, "Revolute needs a name"),
        (lambda: joints.Spherical(3), tx.ModelError, "Spherical needs a name"),  # type: ignore[arg-type]
        (lambda: joints.Revolute("h", axis=(0, 0, 0)), tx.ModelError, "Revolute 'h' expects axis to be a direction"),
        (lambda: joints.Prismatic("p", axis=(0, np.nan, 1)), tx.ModelError, "Prismatic 'p' expects axis to be a"),
        (lambda: joints.Prismatic("p", axis=(0, 1)), tx.ShapeError, r"axis with shape \(3,\), got \(2,\)"),
        (lambda: joints.Revolute("h", axis="z"), tx.ModelError, "Revolute 'h': axis expects real numbers, got 'z'"),
        (lambda: tx.lie.AxisRotation(tx.State("q", shape=(1,)), AXIS).shape, tx.ShapeError, r"angle\[0\]"),
        (lambda: Loose("j", motion=np.ones((6, 2))), tx.ModelError, "independent columns"),
        (lambda: Loose("j", motion=np.full((6, 1), np.inf)), tx.ModelError, "finite"),
        (lambda: Loose("j", motion="z"), tx.ModelError, "motion expects real numbers, got 'z'"),
        (
            lambda: Loose("j", motion=np.eye(6)[0], actuation_basis="z"),
            tx.ModelError,
            "actuation_basis expects real numbers",
        ),
        (lambda: Flat("j", motion=np.eye(6)[0]).transform, tx.ShapeError, r"its placement with shape \(4, 4\)"),
        (two_of_one_name, tx.ModelError, "(?s)two States named 'h_position'.*named after the joint"),
        (lambda: JOINTS["ball"][0].screws_in(2.0 * np.eye(4)), tx.ModelError, r"pose T to be a pose \[R p; 0 1\]"),
        (lambda: JOINTS["hinge"][0].actuation(None), tx.ModelError, "actuation of a joint expects the wrench F"),
        (lambda: Loose("j", motion=np.eye(3)), tx.ShapeError, r"motion with shape \(6, k\).*got \(3, 3\)"),
        (
            lambda: Loose("j", motion=np.eye(6)[0], actuation_basis=np.eye(6)[1]),
            tx.ModelError,
            "actuation_basis must satisfy",
        ),
        (lambda: Loose("j", motion=np.eye(6)[0], actuation_basis=np.eye(6)[:, :2]), tx.ShapeError, "shape of motion"),
        (lambda: Mismatched("j", motion=np.eye(6)), tx.ModelError, "group of dimension 6.*got SO3 of dimension 3"),
        (lambda: JOINTS["hinge"][0].actuation(np.ones(3)), tx.ShapeError, r"wrench F with shape \(6,\), got \(3,\)"),
        (lambda: JOINTS["hinge"][0].reaction(1.0), tx.ShapeError, r"wrench F with shape \(6,\), got \(\)"),
        (lambda: JOINTS["ball"][0].wrench(1.0), tx.ShapeError, r"tau with shape \(3,\), got \(\)"),
        (lambda: JOINTS["ball"][0].screws_in(np.eye(3)), tx.ShapeError, r"pose T with shape \(4, 4\), got \(3, 3\)"),
    ],
)
def test_what_has_no_meaning_is_refused(build: Any, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        build()


def test_the_length_of_an_axis_does_not_matter() -> None:
    for length in (1e-300, 3.0, 1e300):
        axis = joints.Revolute("h", axis=np.array([2.0, 0.0, -1.0]) * length).axis
        np.testing.assert_allclose(axis, np.array([2.0, 0.0, -1.0]) / np.sqrt(5.0), rtol=1e-15)
