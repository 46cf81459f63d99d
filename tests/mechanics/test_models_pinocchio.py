"""Mechanisms from URDF against Pinocchio, where that is installed; and every robot of example-robot-data at hand."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from twistax import mechanics
from twistax.expr import leaves_of
from twistax.mechanics import ALIGNED, BODY, WORLD, Mechanism

pin = pytest.importorskip("pinocchio", reason="pinocchio is not installed (extra twistax[peers])")

EXAMPLES, OWN = Path(__file__).parents[2] / "examples", Path(__file__).parent / "models"
ROBOTS = Path(pin.__file__).parents[4] / "share" / "example-robot-data" / "robots"
#: Not models: a fragment to be included, and a follower of a joint that is not in the file.
BROKEN = {"ur3.urdf", "alex_psyonic_hands.urdf"}


class Pair:
    """A mechanism, Pinocchio's model of the same file, and which of its numbers are ours."""

    def __init__(self, path: Path, floating: bool) -> None:
        self.ours: Mechanism = mechanics.load(path, floating=floating, physical=False, quarter_turns=0.0)
        roots = [pin.JointModelFreeFlyer()] if floating else []
        self.model = pin.buildModelFromUrdf(str(path), *roots)
        self.data = self.model.createData()
        # Pinocchio has the followers as joints of their own: its velocities are G times ours.
        self.G = np.zeros((self.model.nv, self.ours.dofs))
        for segment in self.ours.segments:
            joint = self.joint(segment.link.joint.name)
            ratio = 1.0 if segment.link.mimic is None else segment.link.mimic.ratio
            for k, i in enumerate(segment.freedoms):
                self.G[joint.idx_v + k, i] = ratio

    def joint(self, name: str) -> Any:
        return self.model.joints[self.model.getJointId("root_joint" if name == "root" else name)]

    def states(self, rng: np.random.Generator, count: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Random positions: ours, and Pinocchio's."""
        width = max((s.coordinates.stop for s in self.ours.segments if s.coordinates is not None), default=0)
        ours: dict[str, np.ndarray] = {"q": rng.uniform(-2.0, 2.0, size=(count, width))}
        theirs = np.tile(pin.neutral(self.model), (count, 1))
        for segment in self.ours.segments:
            name, joint = segment.link.joint.name, self.joint(segment.link.joint.name)
            if segment.link.joint.group is not None:
                free = np.stack([pin.SE3.Random().homogeneous for _ in range(count)])
                ours[f"{name}_position"] = free
                theirs[:, joint.idx_q : joint.idx_q + 7] = [pin.SE3ToXYZQUAT(pin.SE3(T)) for T in free]
                continue
            q, mimic = ours["q"][:, segment.coordinates], segment.link.mimic
            if mimic is not None:
                q = mimic.ratio * q + mimic.offset
            if joint.nq == 2:  # without limits
                q = np.concatenate([np.cos(q), np.sin(q)], axis=1)
            if joint.nq == 4:  # in a plane
                q = np.concatenate([q[:, :2], np.cos(q[:, 2:]), np.sin(q[:, 2:])], axis=1)
            theirs[:, joint.idx_q : joint.idx_q + joint.nq] = q
        return ({name: value for name, value in ours.items() if value.shape[1]}, theirs)


def near(found: np.ndarray, expected: np.ndarray, bound: float = 1e-11) -> None:
    scale = max(float(np.max(np.abs(expected), initial=0.0)), 1e-3)
    assert np.max(np.abs(found - expected), initial=0.0) <= bound * scale


def compared(path: Path, floating: bool, count: int, seed: int = 0) -> None:
    pair = Pair(path, floating)
    robot, model, data, G = pair.ours, pair.model, pair.data, pair.G
    if not robot.dofs:
        return
    frames = sorted({robot.segments[-1].link.name, robot.links[-1].name})
    x, n = tx.State("x", (robot.dofs,)), robot.dofs
    wanted: dict[str, tx.Expr] = {
        "rnea": mechanics.inverse_dynamics(robot, qdd=x),
        "crba": mechanics.mass_matrix(robot),
        "gravity": mechanics.gravity_forces(robot),
        "momentum": mechanics.centroidal_momentum(robot),
        "centroidal": mechanics.centroidal_matrix(robot),
        "com": mechanics.center_of_mass(robot),
        "kinetic": mechanics.kinetic_energy(robot),
        "potential": mechanics.potential_energy(robot),
    }
    massive = True
    try:
        wanted["aba"] = mechanics.forward_dynamics(robot, tau=x)
    except tx.ModelError as error:
        assert "carries no mass" in str(error)  # noqa: PT017
        massive = False
    for name in frames:
        wanted[f"{name} pose"] = robot.pose(name)
        for axes in (BODY, WORLD, ALIGNED):
            wanted[f"{name} J {axes}"] = mechanics.frame_jacobian(robot, name, axes=axes)
            wanted[f"{name} rate {axes}"] = mechanics.frame_jacobian_rate(robot, name, axes=axes)
    rng = np.random.default_rng(seed)
    pin.seed(seed)
    ours, theirs = pair.states(rng, count)
    ours["qd"], ours["x"] = rng.normal(size=(2, count, n))
    values = {leaf.name: ours[leaf.name] for leaf in leaves_of(*wanted.values()) if leaf.name in ours}
    found = jax.jit(jax.vmap(lambda each: tx.lower(wanted)(0.0, each)))(values)
    found = {name: np.asarray(value) for name, value in found.items()}
    kinds = {BODY: pin.LOCAL, WORLD: pin.WORLD, ALIGNED: pin.LOCAL_WORLD_ALIGNED}
    for k in range(count):
        q, v, a = theirs[k], G @ ours["qd"][k], G @ ours["x"][k]
        near(found["rnea"][k], G.T @ pin.rnea(model, data, q, v, a))
        M = np.triu(pin.crba(model, data, q))
        M = G.T @ (M + np.triu(M, 1).T) @ G
        near(found["crba"][k], M)
        near(found["gravity"][k], G.T @ pin.computeGeneralizedGravity(model, data, q))
        if massive:
            # Accelerations are as uncertain as the mass matrix is ill-conditioned: what they need is compared, against
            # the size of the terms it is summed from.
            back = G.T @ pin.rnea(model, data, q, v, G @ found["aba"][k]) - ours["x"][k]
            terms = np.abs(M) @ np.abs(found["aba"][k]) + np.abs(ours["x"][k])
            assert np.max(np.abs(back)) <= 1e-11 * np.max(terms)
        pin.computeCentroidalMomentum(model, data, q, v)
        near(found["momentum"][k], data.hg.vector)
        near(found["centroidal"][k], pin.computeCentroidalMap(model, data, q) @ G)
        near(found["com"][k], pin.centerOfMass(model, data, q))
        near(found["kinetic"][k], pin.computeKineticEnergy(model, data, q, v))
        near(found["potential"][k], pin.computePotentialEnergy(model, data, q))
        pin.computeJointJacobians(model, data, q)
        pin.computeJointJacobiansTimeVariation(model, data, q, v)
        pin.framesForwardKinematics(model, data, q)
        for name in frames:
            at = model.getFrameId(name, pin.FrameType.BODY)
            near(found[f"{name} pose"][k], data.oMf[at].homogeneous)
            for axes, kind in kinds.items():
                near(found[f"{name} J {axes}"][k], pin.getFrameJacobian(model, data, at, kind) @ G)
                near(found[f"{name} rate {axes}"][k], pin.getFrameJacobianTimeVariation(model, data, at, kind) @ G)


@pytest.mark.parametrize(("path", "floating"), [(EXAMPLES / "arm.urdf", False), (OWN / "hand.urdf", True)])
def test_small_models(path: Path, floating: bool, unchecked: None) -> None:
    compared(path, floating, count=3)


@pytest.mark.slow
@pytest.mark.skipif(not ROBOTS.is_dir(), reason="example-robot-data is not installed: pip install example-robot-data")
@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("path", sorted(ROBOTS.glob("*/*/*.urdf")), ids=lambda path: path.stem)
def test_every_robot(path: Path, floating: bool, unchecked: None) -> None:
    if path.name in BROKEN:
        with pytest.raises(tx.ModelError, match=path.name):
            mechanics.load(path)
        return
    if not floating and "<joint" not in path.read_text():
        assert any("no joint moves" in note for note in mechanics.load(path).notes)
        return
    compared(path, floating, count=20)
