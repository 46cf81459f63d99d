"""Differential controllers: beside pink and a quadratic program, within limits, in programs of JAX, in C."""

import dataclasses
import shutil
import subprocess
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints_of_every_kind import mimicking_tree
from mechanics_oracles import pose

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.errors import InputError, ModelError
from twistax.mechanics import (
    CenterOfMassTask,
    DifferentialController,
    Drive,
    FrameTask,
    Link,
    Mechanism,
    PositionTask,
    PostureTask,
    StepStatus,
    joints,
    signed_distance,
)
from twistax.view import Sphere

EXAMPLES = Path(__file__).parents[2] / "examples"
HOME = np.array([0.0, -0.4, 0.0, -2.0, 0.0, 1.6, 0.8])


def panda() -> tuple[Mechanism, np.ndarray]:
    """The arm, and a pose of its flange that it can reach from HOME."""
    arm = mechanics.load(EXAMPLES / "panda.urdf")
    T = np.array(evaluated(arm.pose("flange"), {"q": HOME}))
    T[:3, 3] += [0.05, 0.02, -0.1]
    return arm, T


def slide(**limits: float) -> Mechanism:
    drive = Drive(lower=limits.get("lower"), upper=limits.get("upper"), speed=limits.get("speed"))
    return Mechanism([Link(joints.Prismatic("slide", (1.0, 0.0, 0.0)), None, np.eye(4), drive=drive)])


def test_velocities_of_pink() -> None:
    pin = pytest.importorskip("pinocchio", reason="pinocchio is not installed")
    pink = pytest.importorskip("pink", reason="pink is not installed")
    arm, T = panda()
    model = pin.buildModelFromUrdf(str(EXAMPLES / "panda.urdf"))
    dt, center = 0.01, np.array([0.1, 0.1, 0.4])
    weight = [2.0, 1.0, 1.0, 0.5, 0.3, 0.5]
    for q in (HOME, HOME + 0.3):
        tasks = [FrameTask("link7", T, weight=weight, gain=30.0, damping=1e-2), CenterOfMassTask(center, gain=10.0)]
        tasks.append(PostureTask(HOME, weight=0.1, gain=5.0))
        ours = DifferentialController(arm, tasks, dt=dt)({"q": q})
        configuration = pink.Configuration(model, model.createData(), q)
        frame = pink.tasks.FrameTask("link7", weight[:3], weight[3:], lm_damping=1e-2, gain=30.0 * dt)
        com, posture = pink.tasks.ComTask(cost=1.0, gain=10.0 * dt), pink.tasks.PostureTask(cost=0.1, gain=5.0 * dt)
        frame.set_target(pin.SE3(T)), com.set_target(center), posture.set_target(HOME)
        theirs = pink.solve_ik(configuration, [frame, com, posture], dt, solver="daqp")
        assert ours.status == StepStatus.SOLVED
        assert np.abs(np.asarray(ours.qd) - theirs).max() < 1e-6
        assert np.abs(theirs).max() > 0.5


def test_the_velocities_are_the_optimum_of_the_stated_program() -> None:
    """Beside SciPy's bounded least squares, for joints of every kind; the floating base among them."""
    from scipy.optimize import lsq_linear

    tree, rng, dt = mimicking_tree().mechanism, np.random.default_rng(2), 0.02
    width = tree.q["q"].shape[0]
    x = {"q": rng.uniform(-1.0, 1.0, size=width), "root_position": pose(rng), "ball_position": pose(rng)[:3, :3]}
    frame, posture = FrameTask("tool", pose(rng), gain=2.0), PostureTask(np.zeros(width), weight=0.3, gain=1.0)
    controller = DifferentialController(tree, [frame, posture], dt=dt, speed=0.4, regularization=1e-6)
    step = controller(x)
    parts = [task.jacobian(tree) for task in (frame, posture)], [task.error(tree) for task in (frame, posture)]
    (J, S), (e, f) = evaluated(list(map(list, parts)), x)
    above, below = (np.asarray(m) for m in controller.space.margins({k: jnp.asarray(v) for k, v in x.items()}, float))
    low, high = (np.clip(0.5 * m / dt, -0.4, 0.4) for m in (above, below))
    rows = np.vstack([J, 0.3 * S, 1e-3 * np.eye(tree.dofs)])
    right = np.concatenate([2.0 * e, 0.3 * f, np.zeros(tree.dofs)])
    best = lsq_linear(rows, right, (-low, high), method="bvls", tol=1e-14)
    assert step.status == StepStatus.SOLVED
    assert np.abs(np.asarray(step.qd) - best.x).max() < 1e-6
    assert np.sum(np.abs(np.abs(best.x) - 0.4) < 1e-9) > 0  # limits are active


def test_a_frame_arrives_and_the_rest_keeps_its_posture() -> None:
    arm, T = panda()
    controller = DifferentialController(arm, [FrameTask("flange"), PostureTask(HOME, weight=1e-3)], dt=0.01)
    x, step = {"q": HOME}, None
    for _ in range(40):
        step = controller(x, {"flange_pose": T}, warm=step)
        assert step.status == StepStatus.SOLVED
        assert np.all(np.abs(step.qd) <= arm.qd.max + 1e-9)
        x = step.x
    assert np.linalg.norm(step.errors[0]) < 1e-5
    assert step.iterations == 0  # from the start of the step before
    assert np.abs(evaluated(arm.pose("flange"), x) - T).max() < 1e-5
    moved = controller(x, {"flange_pose": T, "posture": HOME + 0.1})
    assert np.allclose(moved.errors[1], HOME + 0.1 - x["q"])


def test_limits_of_acceleration_stop_an_arm_at_a_constraint() -> None:
    """A fast arm of two links in a plane stops at a wall, and leaves it if it starts behind it."""
    out = tx.pose(position=[1.0, 0.0, 0.0])
    arm = Mechanism(
        [
            Link(joints.Revolute("first", (0.0, 0.0, 1.0)), None, np.eye(4), drive=Drive(speed=3.0)),
            Link(joints.Revolute("second", (0.0, 0.0, 1.0)), None, out, parent="first", drive=Drive(speed=3.0)),
            Link(joints.Fixed("tip"), None, out, parent="second"),
        ]
    )
    wall = {"wall": arm.pose("tip")[0, 3] <= 1.5}
    tasks = [PositionTask("tip", np.array([1.9, 0.3, 0.0]), gain=4.0), PostureTask(np.zeros(2), weight=1e-3)]
    controller = DifferentialController(arm, tasks, dt=1e-3, constraints=wall, acceleration=8.0)
    for start, seconds in ((np.array([1.2, 1.0]), 2.0), (np.array([0.3, 0.5]), 2.0)):
        x, qd, over, statuses, speeds = {"q": start}, np.zeros(2), [], [], []
        for _ in range(int(1000 * seconds)):
            step = controller(x, qd=qd)
            over.append(float(step.constraints[0])), statuses.append(int(step.status)), speeds.append(qd)
            x, qd = step.x, np.asarray(step.qd)
        if over[0] < 0.0:
            assert max(over) < 1e-5
            assert set(statuses) == {StepStatus.SOLVED}
        else:
            assert statuses[0] == StepStatus.OVERRUN
        assert abs(over[-1]) < 1e-3  # it stands at the wall
        assert statuses[-1] == StepStatus.SOLVED
        assert np.abs(np.diff(speeds, axis=0)).max() <= 8e-3 + 1e-9


def test_limits_of_acceleration_stop_a_joint_at_its_limit() -> None:
    controller = DifferentialController(
        slide(lower=-1.0, upper=0.5, speed=2.0), [PositionTask("slide")], dt=0.01, acceleration=3.0
    )
    x, qd, places, speeds, far = {"q": np.zeros(1)}, np.zeros(1), [], [], {"slide_position": np.array([9.0, 0.0, 0.0])}
    for _ in range(150):
        step = controller(x, far, qd=qd)
        assert step.status == StepStatus.SOLVED
        x, qd = step.x, np.asarray(step.qd)
        places.append(float(x["q"][0])), speeds.append(float(qd[0]))
    assert max(places) <= 0.5 + 1e-9
    assert places[-1] > 0.5 - 1e-4
    assert np.abs(np.diff(speeds)).max() <= 0.03 + 1e-9
    assert max(speeds) > 1.1  # close to sqrt(a d)
    late = controller({"q": np.array([0.49])}, far, qd=np.array([1.5]))
    assert late.status == StepStatus.OVERRUN
    assert np.asarray(late.overrun).tolist() == [True]
    assert late.joints == ("slide",)
    assert np.isclose(late.qd[0], 1.5 - 0.03)
    back = controller({"q": np.array([0.8])}, far, qd=np.zeros(1))
    assert back.qd[0] < 0.0  # beyond its limit


def test_other_weights_and_gains_compile_nothing() -> None:
    x = {"q": np.array([0.2])}
    to_zero, to_one = PostureTask(np.zeros(1), gain=3.0), PositionTask("slide", np.array([1.0, 0.0, 0.0]), gain=3.0)
    controller = DifferentialController(slide(), [to_zero, to_one], dt=0.01)
    assert np.isclose(controller(x).qd[0], 3.0 * (0.5 - 0.2))
    quick, heavy = dataclasses.replace(to_zero, gain=6.0), dataclasses.replace(to_one, weight=3.0)
    events: list[str] = []
    listen = lambda event, seconds, **_: events.append(event)  # noqa: E731
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        step = controller.replace(tasks=[quick, heavy])(x)
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    assert not [event for event in events if "compile" in event]
    assert np.isclose(step.qd[0], (6.0 * -0.2 + 9.0 * 3.0 * 0.8) / 10.0)
    assert np.isclose(controller(x).qd[0], 3.0 * (0.5 - 0.2))
    with pytest.raises(ModelError, match="another weight"):
        controller.replace(tasks=[heavy, quick])


def test_what_cannot_be_done_is_named() -> None:
    one = slide(speed=1.0)
    places = {"slide_position": np.array([1.0, 0.0, 0.0])}
    apart = DifferentialController(one, [PostureTask(np.zeros(1))], equalities=[PositionTask("slide")], dt=0.01)
    step = apart({"q": np.zeros(1)}, places)
    assert step.status == StepStatus.INFEASIBLE
    assert step.qd[0] == 0.0
    slow = apart.replace(dt=2.0)({"q": np.zeros(1)}, places)
    assert slow.status == StepStatus.SOLVED
    assert np.isclose(slow.qd[0], 0.5)
    lost = apart({"q": np.array([np.nan])}, places)
    assert lost.status == StepStatus.NOT_FINITE
    assert np.isfinite(lost.qd).all()


def test_a_constraint_is_approached_and_kept() -> None:
    """The hand of a Panda goes towards the middle of a ball and stays at a distance."""
    arm, T = panda()
    ball, clear = Sphere(0.03, at=T[:3, 3]), 0.02
    distance = signed_distance(Sphere(0.02), ball, arm.pose("flange"))
    controller = DifferentialController(
        arm,
        [PositionTask("flange", T[:3, 3]), PostureTask(HOME, weight=1e-2)],
        dt=0.01,
        constraints={"ball": distance >= clear},
    )
    x, step, gaps = {"q": HOME}, None, []
    for _ in range(120):
        step = controller(x, warm=step)
        assert step.status == StepStatus.SOLVED
        x = step.x
        gaps.append(clear - float(step.constraints[0]))
    assert min(gaps) > clear - 1e-4
    assert gaps[-1] < clear + 1e-3
    assert np.isclose(float(evaluated(distance, x)), gaps[-1], atol=1e-6)


def test_in_programs_of_jax_and_in_single_precision() -> None:
    arm, T = panda()
    controller = DifferentialController(arm, [FrameTask("flange"), PostureTask(HOME, weight=1e-2)], dt=0.01)
    q = HOME + 0.1 * np.random.default_rng(0).normal(size=(4, 7))
    batch = jax.jit(jax.vmap(lambda q: controller({"q": q}, {"flange_pose": T})))(q)
    for k in range(4):
        assert np.allclose(batch.qd[k], controller({"q": q[k]}, {"flange_pose": T}).qd, atol=1e-9)

    def run(q: Any, _: Any) -> Any:
        step = controller({"q": q}, {"flange_pose": T})
        return step.x["q"], step.status

    last, statuses = jax.lax.scan(run, jnp.asarray(HOME), None, length=30)
    assert np.all(statuses == StepStatus.SOLVED)
    assert np.abs(evaluated(arm.pose("flange"), {"q": last}) - T).max() < 1e-4
    small = controller({"q": q[0].astype(np.float32)}, {"flange_pose": T.astype(np.float32)})
    assert small.qd.dtype == np.float32
    assert np.allclose(small.qd, batch.qd[0], rtol=1e-3, atol=1e-3)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
def test_c_code_gives_the_velocities_of_python(tmp_path: Path) -> None:
    arm, T = panda()
    controller = DifferentialController(
        arm, [PositionTask("flange"), PostureTask(HOME, weight=0.1)], dt=0.01, acceleration=20.0
    )
    near, rest = {"flange_position": T[:3, 3]}, np.zeros(7)
    states = [({"q": HOME}, near, rest), ({"q": HOME + 0.1}, near, rest), ({"q": HOME}, near, 9.0 + rest)]
    files = controller.to_c(tmp_path, states=states)
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    build = ["gcc", *flags, str(files.source), str(files.test), "-lm", "-o", str(tmp_path / "test")]
    subprocess.run(build, check=True)
    result = subprocess.run([tmp_path / "test"], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout
    assert "status 1" in result.stdout  # the last one overruns its limits


def test_what_cannot_be_asked_for(unchecked: None) -> None:
    arm, T = panda()
    tasks = [FrameTask("flange")]
    controller = DifferentialController(arm, tasks, dt=0.01, acceleration=1.0)
    x, rest = {"q": HOME}, np.zeros(7)
    wrong: list[tuple[Any, str]] = [
        (lambda: DifferentialController(arm, [], dt=0.01), "expects tasks"),
        (lambda: DifferentialController(arm, ["flange"], dt=0.01), "expects tasks, such as FrameTask"),
        (lambda: DifferentialController(arm, tasks, dt=0.0), "dt"),
        (lambda: DifferentialController(arm, tasks, dt=0.01, speed=np.ones(3)), "speed expects positive numbers"),
        (
            lambda: DifferentialController(arm, tasks, dt=0.01, constraints=[arm.q[0] == 0.0]),
            "expects inequalities as constraints",
        ),
        (
            lambda: DifferentialController(arm, tasks, dt=0.01, constraints=[arm.qd[0] <= 0.0]),
            "expects expressions of positions",
        ),
        (lambda: controller(x, {}, qd=rest), "expects targets for 'flange_pose'"),
        (lambda: controller(x, {"hand": T}, qd=rest), "no target 'hand'"),
        (lambda: DifferentialController(arm, tasks[0], dt=0.01), "expects a list of tasks"),
        (lambda: controller({}, {"flange_pose": T}, qd=rest), "x expects 'q'"),
        (lambda: controller(HOME, {"flange_pose": T}, qd=rest), "x expects arrays by name"),
        (lambda: controller(x, T, qd=rest), "targets expects arrays by name"),
        (lambda: controller(x, {"flange_pose": "there"}, qd=rest), "flange_pose expects real numbers"),
        (lambda: controller({"q": HOME + 0j}, {"flange_pose": T}, qd=rest), "q expects real numbers"),
        (
            lambda: jax.grad(lambda q: controller({"q": q}, {"flange_pose": T}, qd=rest).qd[0])(HOME),
            "no derivatives in jax.grad",
        ),
        (lambda: controller(x, {"flange_pose": T}), "velocities qd"),
        (lambda: controller.to_c("none"), "expects states and targets"),
    ]
    for call, message in wrong:
        with pytest.raises((InputError, ModelError), match=message):
            call()
    assert controller({"q": HOME.tolist()}, {"flange_pose": T.tolist()}, qd=[0.0] * 7).status == StepStatus.SOLVED
