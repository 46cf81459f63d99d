"""Regressors against Pinocchio's, base parameters by the rank of its regressor, and inertias by their ten numbers."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from joints_of_every_kind import free_tree, mimicking_tree
from mechanics_oracles import Cloud, body_of
from scipy.spatial.transform import Rotation
from test_editing import inputs, near, random_state

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.errors import ModelError, ShapeError
from twistax.mechanics import Drive, Link, Mechanism, SpatialInertia, joints

EXAMPLES = Path(__file__).parents[2] / "examples"


def both_sides(mechanism: Mechanism) -> dict[str, tx.Expr]:
    qdd = tx.State("qdd", (mechanism.dofs,))
    regressor = mechanics.inverse_dynamics_regressor(mechanism, qdd=qdd)
    tau = mechanics.inverse_dynamics(mechanism, qdd=qdd)
    return {"tau": tau, "Y": regressor.matrix, "theta": regressor.parameters}


@pytest.mark.parametrize("path", [EXAMPLES / "panda.urdf", EXAMPLES / "arm.urdf"], ids=lambda path: path.stem)
def test_as_pinocchio_has_it(path: Path) -> None:
    pytest.importorskip("pinocchio", reason="pinocchio is not installed (extra twistax[peers])")
    robot, state, Y, theta = of_pinocchio(path)
    values = evaluated(both_sides(robot), state)
    near(values["Y"], Y[0])
    near(values["theta"], theta)
    base_parameters_agree(robot, Y, theta)


@pytest.mark.slow
def test_base_parameters_of_public_robots() -> None:
    """Those of example-robot-data with at most twelve freedoms, 22 and more."""
    pytest.importorskip("pinocchio", reason="pinocchio is not installed (extra twistax[peers])")
    from test_models_pinocchio import BROKEN, ROBOTS

    count = 0
    for path in sorted(ROBOTS.rglob("*.urdf")):
        if path.name not in BROKEN and 0 < mechanics.load(path, physical=False, quarter_turns=0.0).dofs <= 12:
            robot, _, Y, theta = of_pinocchio(path)
            base_parameters_agree(robot, Y, theta, 1e-7)  # as coefficients that count as zero
            count += 1
    assert count >= 22 or not ROBOTS.is_dir()


def of_pinocchio(path: Path) -> tuple[Mechanism, dict[str, Any], np.ndarray, np.ndarray]:
    """A mechanism, a state, and Pinocchio's regressors (count, n, p) and parameters; the first is at that state."""
    import pinocchio as pin
    from test_models_pinocchio import Pair

    pair, rng, count = Pair(path, False), np.random.default_rng(0), 60
    robot, model, data, G = pair.ours, pair.model, pair.model.createData(), pair.G
    ours, theirs = pair.states(rng, count)
    qd, qdd = rng.normal(size=(2, count, robot.dofs))
    order = np.concatenate([10 * (pair.joint(name).id - 1) + np.arange(10) for name in robot.joints])
    pairs = zip(theirs, qd, qdd, strict=True)
    Y = [G.T @ pin.computeJointTorqueRegressor(model, data, q, G @ v, G @ a)[:, order] for q, v, a in pairs]
    theta = np.concatenate([inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]])[order]
    return robot, {**{k: x[0] for k, x in ours.items()}, "qd": qd[0], "qdd": qdd[0]}, np.array(Y), theta


def base_parameters_agree(robot: Mechanism, Y: np.ndarray, theta: np.ndarray, bound: float = 1e-10) -> None:
    """The rank is that of Pinocchio's regressor, and the combinations give its forces."""
    W, base = Y.reshape(-1, len(theta)), mechanics.base_parameters(robot, drives=[])
    assert base.rank == np.linalg.matrix_rank(W, tol=1e-9 * np.linalg.norm(W, 2))
    near(W[:, list(base.columns)] @ (base.combinations @ theta), W @ theta, bound)


@pytest.mark.parametrize("make", [free_tree, mimicking_tree])
def test_of_joints_of_every_kind(make: Any) -> None:
    tree = make().mechanism
    tree = tree.replace(drives={name: Drive(armature=0.3) for name in ("root", "table", "hinge", "slide")})
    state = inputs(tree, *random_state(tree)) | {"qdd": np.random.default_rng(4).normal(size=tree.dofs)}
    values = evaluated(both_sides(tree), state)
    near(values["Y"] @ values["theta"], values["tau"], 1e-12)


def test_a_pendulum_by_hand() -> None:
    z, r = (0.0, 0.0, 1.0), 0.4
    body = SpatialInertia(mass=2.0, center_of_mass=(r, 0.0, 0.0), inertia=np.diag([0.01, 0.02, 0.03]))
    pendulum = Mechanism(
        [
            Link(
                joints.Revolute("hinge", z), body, np.eye(4), drive=Drive(damping=0.5, friction=0.2, friction_speed=0.1)
            )
        ],
        gravity=(0.0, -9.81, 0.0),
    )
    base = mechanics.base_parameters(pendulum)
    assert base.names == ("hinge.mx", "hinge.my", "hinge.Izz")
    assert base.without_effect[:2] == ("hinge.mass", "hinge.mz")
    assert base.rank == 3
    qdd = tx.State("qdd", (1,))
    whole = mechanics.inverse_dynamics_regressor(pendulum, qdd=qdd, drives=["armature", "damping", "friction"])
    assert whole.names[10:] == ("hinge.armature", "hinge.damping", "hinge.friction")
    state = {"q": np.array([0.3]), "qd": np.array([0.07]), "qdd": np.array([1.5])}
    Y = evaluated({"Y": whole.matrix}, state)["Y"][0]
    expected = [9.81 * np.cos(0.3), -9.81 * np.sin(0.3), 1.5, 1.5, 0.07, np.tanh(0.7)]
    near(Y[[1, 2, 9, 10, 11, 12]], np.array(expected))
    near(evaluated({"theta": whole.parameters}, {})["theta"][[0, 1, 9]], np.array([2.0, 0.8, 0.03 + 2.0 * r**2]))
    # A rotor and the inertia about the axis are one number.
    assert mechanics.base_parameters(pendulum, drives=["armature"]).names[-1] == "hinge.Izz + hinge.armature"


def test_data_that_determine_less() -> None:
    names = ("a", "b", "c", "d")
    W = np.array([[1.0, 2.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [1.0, 2.0, -0.5, 0.0]])
    base = mechanics.identifiable_combinations(W, names)
    assert base.names == ("a + 2 b", "c")
    assert base.without_effect == ("d",)
    assert base.columns == (0, 2)
    noisy = W + 1e-5 * np.random.default_rng(0).normal(size=W.shape)
    assert mechanics.identifiable_combinations(noisy, names).rank == 3
    assert mechanics.identifiable_combinations(noisy, names, tolerance=1e-3).rank == 2
    with pytest.raises(ModelError, match="a column for each of 3 names"):
        mechanics.identifiable_combinations(W, names[:3])
    with pytest.raises(ModelError, match="drives among"):
        mechanics.inverse_dynamics_regressor(mechanics.chain_models.panda(), drives=["gear"])


def test_masses_that_move_within_a_body_are_refused() -> None:
    x, v = tx.State("x"), tx.State("v")
    body = SpatialInertia(mass=2.0, center_of_mass=tx.Concat(x, 0.0, 0.0), inertia=np.eye(3), rates={x: v, v: -x})
    moving = Mechanism([Link(joints.Revolute("hinge", (0.0, 0.0, 1.0)), body, np.eye(4))])
    with pytest.raises(ModelError, match="masses move in the body of 'hinge'"):
        mechanics.inverse_dynamics_regressor(moving)


# ---- ten numbers of an inertia ---------------------------------------------------------------------------------------


def pseudo_inertia(cloud: Cloud) -> np.ndarray:
    """The sum of m r r^T with r = [x, y, z, 1] over point masses."""
    r = np.column_stack([cloud.points, np.ones(len(cloud.masses))])
    return np.einsum("i,ij,ik", cloud.masses, r, r)


def test_ten_numbers_are_the_cholesky_factor_of_the_pseudo_inertia() -> None:
    cloud = Cloud.random(np.random.default_rng(0), 7)
    x = mechanics.log_cholesky(body_of(cloud))
    U = np.exp(x[0]) * np.array(
        [[np.exp(x[1]), x[4], x[6], x[7]], [0, np.exp(x[2]), x[5], x[8]], [0, 0, np.exp(x[3]), x[9]], [0, 0, 0, 1.0]]
    )
    near(U @ U.T, pseudo_inertia(cloud))
    back = mechanics.physical_inertia(x)
    near(np.asarray(evaluated(back.matrix)), cloud.mass_matrix())


def test_every_vector_is_a_body() -> None:
    x = tx.Parameter("x", (10,))
    M = tx.lower(mechanics.physical_inertia(x).matrix)
    values = np.random.default_rng(1).normal(size=(200, 10))
    for matrix in np.asarray(jax.vmap(lambda value: M(0.0, {}, params={"x": value}))(values)):
        m, c = matrix[0, 0], np.array([matrix[2, 4], matrix[0, 5], matrix[1, 3]]) / matrix[0, 0]
        about_center = matrix[3:, 3:] - m * (c @ c * np.eye(3) - np.outer(c, c))
        small, middle, large = np.linalg.eigvalsh(about_center)
        assert m > 0.0
        assert small > 0.0
        assert large < small + middle + 1e-9 * large


def test_ten_numbers_and_their_derivatives_as_pinocchio_has_them() -> None:
    pin = pytest.importorskip("pinocchio", reason="pinocchio is not installed (extra twistax[peers])")
    x, rng = tx.Parameter("x", (10,)), np.random.default_rng(5)
    free = Mechanism([Link(joints.Free("root"), mechanics.physical_inertia(x), np.eye(4))])
    theta = tx.lower(mechanics.inverse_dynamics_regressor(free, qdd=np.zeros(6)).parameters)

    @jax.jit
    @jax.vmap
    def of(value: Any) -> Any:
        return theta(0.0, {}, params={"x": value})

    forward, reverse = (
        jax.jit(jax.vmap(slope(lambda value: of(value[None])[0]))) for slope in (jax.jacfwd, jax.jacrev)
    )
    values, h = 2.0 * rng.normal(size=(20, 10)), 1e-5 * np.eye(10)
    table = zip(values, of(values), forward(values), reverse(values), strict=True)
    for value, parameters, columns, rows in table:
        numbers = pin.LogCholeskyParameters(value)
        body, J = pin.Inertia.FromLogCholeskyParameters(numbers), numbers.calculateJacobian()
        near(parameters, body.toDynamicParameters(), 1e-14)
        near(columns, J, 1e-14)
        near(rows, J, 1e-14)
        near((of(value + h) - of(value - h)).T / 2e-5, J, 1e-8)
        assert np.linalg.eigvalsh(pin.PseudoInertia.FromInertia(body).toMatrix())[0] > 0.0


@pytest.mark.parametrize("mass", [1e-9, 1e6, 1e24])  # a dust grain, a ship, a planet
@pytest.mark.parametrize("length", [1e-4, 1e3])
def test_extreme_masses_there_and_back(mass: float, length: float) -> None:
    cloud = Cloud.random(np.random.default_rng(6), 7)
    unit = {name: np.asarray(evaluated(getattr(body_of(cloud), name))) for name in ("center_of_mass", "inertia")}
    body = SpatialInertia(
        mass=mass, center_of_mass=length * unit["center_of_mass"], inertia=mass * length**2 * unit["inertia"]
    )
    value = mechanics.log_cholesky(body)
    x = tx.Parameter("x", (10,), value=value)
    for numbers in (value, x):
        near(mechanics.log_cholesky(mechanics.physical_inertia(numbers)), value, 1e-14)
    inertia = tx.lower(mechanics.physical_inertia(x).inertia)(0.0, {}, params={"x": value.astype(np.float32)})
    assert inertia.dtype == np.float32
    near(inertia / (mass * length**2), unit["inertia"], 5e-6)


def test_a_payload_is_found_by_its_ten_numbers() -> None:
    # Gauss and Newton from a ball to the payload, through the forces of a motion.
    true = body_of(Cloud.random(np.random.default_rng(2), 6))
    ball = SpatialInertia(mass=1.0, inertia=0.5 * np.eye(3))
    x = tx.Parameter("x", (10,), value=mechanics.log_cholesky(ball))
    free = Mechanism([Link(joints.Free("root"), mechanics.physical_inertia(x), np.eye(4))])
    real = free.with_inertia({"root": true})
    qdd = tx.State("qdd", (6,))
    model, truth = (tx.lower(mechanics.inverse_dynamics(m, qdd=qdd)) for m in (free, real))
    rng = np.random.default_rng(3)
    states = {
        "qd": rng.normal(size=(8, 6)),
        "qdd": rng.normal(size=(8, 6)),
        "root_position": np.tile(np.eye(4), (8, 1, 1)),
    }
    tau = np.asarray(jax.vmap(lambda s: truth(0.0, s))(states)).ravel()

    @jax.jit
    def misfit(value: Any) -> Any:
        return jax.vmap(lambda s: model(0.0, s, params={"x": value}))(states).ravel() - tau

    value, slope = np.array(x.value), jax.jit(jax.jacfwd(misfit))
    for _ in range(30):
        r, J = np.asarray(misfit(value)), np.asarray(slope(value))
        step = np.linalg.lstsq(J, -r, rcond=None)[0]
        value = value + step * min(1.0, 1.0 / np.linalg.norm(step))
    near(value, mechanics.log_cholesky(true), 1e-8)


def test_what_has_no_ten_numbers() -> None:
    tilt = Rotation.from_rotvec([0.3, 0.4, 0.5]).as_matrix()
    foil = tilt @ np.diag([1.0, 1.0, 2.0 - 1e-16]) @ tilt.T  # flat up to round-off
    for tensor in (np.diag([1.0, 1.0, 2.0]), 0.5 * (foil + foil.T)):
        with pytest.raises(ModelError, match="a body that is not flat"):
            mechanics.log_cholesky(SpatialInertia(mass=1.0, inertia=tensor))
    with pytest.raises(ModelError, match="expects numbers as mass"):
        mechanics.log_cholesky(SpatialInertia(mass=tx.Parameter("m"), inertia=np.eye(3)))
    with pytest.raises(ShapeError, match=r"shape \(10,\)"):
        mechanics.physical_inertia(np.zeros(9))
