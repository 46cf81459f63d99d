"""Which public models load, and whether their dynamics are those of Pinocchio and MuJoCo.

    python tests/mechanics/model_survey.py FOLDER ...

prints the table of docs/model_files.md. Each folder holds a package, for example by `pip install --no-deps --target
FOLDER robosuite`. With `--details` it also prints a line for every file that does not load or does not agree.
"""

import argparse
import collections
import contextlib
import dataclasses
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any
from xml.parsers import expat

# Thousands of small programs are compiled and each runs twice.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true")

import jax
import numpy as np
from mujoco_models import mujoco_model

import twistax as tx
from twistax import mechanics
from twistax.mechanics import Mechanism

#: Largest difference, relative to the magnitudes of what is compared, at which two models agree.
BOUND = 1e-12
#: Random states of each model.
STATES = 2
COLUMNS = ("load as they are", "load as their error says", "agree", "differ", "are refused")
#: Of files whose meshes are missing, so that no peer loads them: MuJoCo compiles them without.
MORE = "agree without meshes"


# ---- peers -----------------------------------------------------------------------------------------------------------


@dataclasses.dataclass
class Reference:
    """What a peer says of a state: positions for our functions, the map G of our velocities to the peer's and its rate
    times them, mass matrix, bias forces and the placements of bodies by name."""

    q: dict[str, np.ndarray]
    G: np.ndarray
    drift: np.ndarray
    mass: np.ndarray
    bias: np.ndarray
    poses: dict[str, np.ndarray]


def vector_of(robot: Mechanism, rng: np.random.Generator) -> np.ndarray:
    width = max((s.coordinates.stop for s in robot.segments if s.coordinates is not None), default=0)
    return rng.uniform(-1.5, 1.5, size=width)


def place_of(segment: Any, vector: np.ndarray) -> np.ndarray:
    """The coordinates of a joint, those of a follower from its leader's."""
    q, mimic = vector[segment.coordinates], segment.link.mimic
    return q if mimic is None else mimic.ratio * q + mimic.offset


def rotation(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A random rotation matrix and its quaternion w, x, y, z."""
    w, x, y, z = quaternion = (lambda a: a / np.linalg.norm(a))(rng.normal(size=4))
    v = np.array([x, y, z])
    S = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return (w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * S, quaternion


class Pinocchio:
    """A model in URDF as Pinocchio reads it."""

    def __init__(self, path: Path, floating: bool) -> None:
        import pinocchio as pin

        self.pin = pin
        roots = [pin.JointModelFreeFlyer()] if floating else []
        self.model = pin.buildModelFromUrdf(str(path), *roots)
        self.data = self.model.createData()

    def at(self, robot: Mechanism, rng: np.random.Generator, qd: np.ndarray) -> Reference:
        pin, model, data = self.pin, self.model, self.data
        G, theirs, vector = np.zeros((model.nv, robot.dofs)), pin.neutral(model), vector_of(robot, rng)
        ours: dict[str, np.ndarray] = {"q": vector} if vector.size else {}
        for segment in robot.segments:
            name, grouped = segment.link.joint.name, segment.link.joint.group is not None
            # Pinocchio calls the joint of the root "root_joint".
            joint = model.joints[model.getJointId("root_joint" if segment is robot.segments[0] and grouped else name)]
            G[joint.idx_v + np.arange(joint.nv), segment.freedoms] = segment.ratio
            if grouped:
                T = np.eye(4)
                T[:3, :3], T[:3, 3] = rotation(rng)[0], rng.normal(size=3)
                ours[f"{name}_position"] = T
                theirs[joint.idx_q :][:7] = pin.SE3ToXYZQUAT(pin.SE3(T))
                continue
            q = place_of(segment, vector)
            turn = {2: q, 4: q[2:]}.get(joint.nq)
            if turn is not None:  # without limits; or in a plane
                q = np.concatenate([q[:-1] if joint.nq == 4 else q[:0], np.cos(turn), np.sin(turn)])
            theirs[joint.idx_q :][: joint.nq] = q
        M = np.triu(pin.crba(model, data, theirs))
        bias = pin.rnea(model, data, theirs, G @ qd, np.zeros(model.nv))
        pin.framesForwardKinematics(model, data, theirs)
        bodies = [(f.name, k) for k, f in enumerate(model.frames) if f.type == pin.FrameType.BODY]
        poses = {name: np.array(data.oMf[k].homogeneous) for name, k in bodies if name in robot.frames}
        return Reference(ours, G, np.zeros(model.nv), M + np.triu(M, 1).T, np.array(bias), poses)


class Mujoco:
    """A model as MuJoCo reads it, without constraints, medium and compensated gravity, which the notes list."""

    def __init__(self, path: Path, within: Path | None = None) -> None:
        import mujoco

        self.mujoco = mujoco
        if within is None:
            self.model = mujoco.MjModel.from_xml_path(str(path))
        else:
            self.model = mujoco_model(path, within)
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self.model.opt.density = self.model.opt.viscosity = 0.0
        self.model.body_gravcomp[:] = 0.0
        self.data = mujoco.MjData(self.model)

    def name(self, kind: str, i: int) -> str:
        return getattr(self.model, kind)(i).name or f"{kind}_{i}"

    def at(self, robot: Mechanism, rng: np.random.Generator, qd: np.ndarray) -> Reference:
        model, data, kinds = self.model, self.data, self.mujoco.mjtJoint
        G, drift, theirs = np.zeros((model.nv, robot.dofs)), np.zeros(model.nv), np.array(model.qpos0)
        vector = vector_of(robot, rng)
        ours: dict[str, np.ndarray] = {"q": vector} if vector.size else {}
        for j in range(model.njnt):
            segment, v, q = robot.segment_of(self.name("joint", j)), model.jnt_dofadr[j], model.jnt_qposadr[j]
            kind, at = model.jnt_type[j], list(segment.freedoms)
            G[v + np.arange(len(at)), at] = segment.ratio
            if kind == kinds.mjJNT_FREE:
                T = np.eye(4)
                T[:3, :3], theirs[q + 3 : q + 7] = rotation(rng)
                T[:3, 3] = theirs[q : q + 3] = rng.normal(size=3)
                ours[f"{segment.link.joint.name}_position"] = T
                G[np.ix_(range(v, v + 3), at[:3])] = T[:3, :3]
                drift[v : v + 3] = T[:3, :3] @ np.cross(qd[at[3:]], qd[at[:3]])
            elif kind == kinds.mjJNT_BALL:
                ours[f"{segment.link.joint.name}_position"], theirs[q : q + 4] = rotation(rng)
            else:
                theirs[q] = place_of(segment, vector)[0]
        data.qpos, data.qvel = theirs, G @ qd
        self.mujoco.mj_forward(model, data)
        M = np.zeros((model.nv, model.nv))
        self.mujoco.mj_fullM(model, data, M)
        poses = {}
        for i in range(1, model.nbody):
            if self.name("body", i) in robot.frames:
                T = np.eye(4)
                T[:3, :3], T[:3, 3] = data.xmat[i].reshape(3, 3), data.xpos[i]
                poses[self.name("body", i)] = T
        return Reference(ours, G, drift, M, np.array(data.qfrc_bias), poses)


def placements(robot: Mechanism, names: Iterable[str]) -> dict[str, Any]:
    """The poses of frames, of expressions that they share."""
    segments, at = robot.poses(), {name: robot.frame(name) for name in names}
    return {name: f.T if f.segment < 0 else segments[f.segment] @ f.T for name, f in at.items()}


def difference(robot: Mechanism, peer: Pinocchio | Mujoco) -> float:
    """The largest difference of mass matrix, bias forces and placements, relative to the magnitudes of each."""
    rng, worst = np.random.default_rng(0), 0.0
    function: Any = None
    for _ in range(STATES):
        qd = rng.normal(size=robot.dofs)
        reference = peer.at(robot, rng, qd)
        if function is None:
            wanted = placements(robot, reference.poses)
            if robot.dofs:
                wanted |= {"mass ": mechanics.mass_matrix(robot), "bias ": mechanics.bias_forces(robot)}
            function = tx.lower(wanted)
        state = {**reference.q, "qd": qd} if robot.dofs else {}
        values = {name: np.asarray(value) for name, value in function(0.0, state).items()}
        reach = max((np.abs(T[:3, 3]).max() for T in reference.poses.values()), default=0.0)
        for name, T in reference.poses.items():
            apart = np.abs(values[name] - T)
            apart[:3, 3] /= max(reach, 1e-3)
            worst = max(worst, apart.max())
        if robot.dofs:
            G = reference.G
            M, bias = G.T @ reference.mass @ G, G.T @ (reference.bias + reference.mass @ reference.drift)
            # The units of the freedoms cancel: entries by the roots of the diagonal.
            unit = np.sqrt(np.diag(M))
            unit = np.where(unit > 0.0, unit, 1.0)
            worst = max(worst, np.abs((values["mass "] - M) / np.outer(unit, unit)).max())
            # Forces that cancel are compared with those of accelerations of one.
            forces = max(np.abs(bias / unit).max(), unit.max())
            worst = max(worst, np.abs((values["bias "] - bias) / unit).max() / forces)
    return float(worst)


# ---- files -----------------------------------------------------------------------------------------------------------


def kind_of(path: Path) -> str | None:
    """URDF or MJCF by the root element, None for something else."""
    root = list[str]()
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda tag, _: root.append(tag)
    with contextlib.suppress(expat.ExpatError):
        parser.Parse(path.read_bytes().lstrip(), True)
    return {"robot": "URDF", "mujoco": "MJCF"}.get(next(iter(root), ""))


def models_in(folder: Path) -> Iterator[tuple[Path, str]]:
    for path in sorted(p for p in folder.rglob("*") if p.suffix in (".urdf", ".xml") and p.is_file()):
        kind = kind_of(path)
        if kind is not None:
            yield path, kind


def attempt(function: Any, *arguments: Any, **options: Any) -> Any:
    """The result, or the text of the error."""
    try:
        return function(*arguments, **options)
    except (tx.ModelError, ValueError, RuntimeError, KeyError) as error:
        return str(error)


def peers_of(path: Path, kind: str, floating: bool) -> list[Any]:
    """Those that load the file."""
    tried = [attempt(Pinocchio, path, floating)] if kind == "URDF" else []
    # MuJoCo reads URDF too; there the root is at rest.
    if not tried or isinstance(tried[0], str):
        tried.append(attempt(Mujoco, path))
    return [peer for peer in tried if not isinstance(peer, str)]


@dataclasses.dataclass
class Verdict:
    """What became of a file: one of the columns' names, or why it is not counted."""

    what: str
    detail: str = ""
    how: str = ""


def verdict_on(path: Path, kind: str, package: Path) -> Verdict:
    peers = peers_of(path, kind, floating=False)
    robot = attempt(mechanics.load, path, within=package, quarter_turns=0.0)
    if isinstance(robot, str) and ("there is no <body>" in robot or "there is no <link>" in robot):
        return Verdict("no model")
    if not peers:
        return without_meshes(path, kind, package, robot)
    how, why, options = COLUMNS[0], "", dict[str, Any]()
    while isinstance(robot, str):
        more = {"floating": True} if "floating=True" in robot else {"physical": False} if "physical={" in robot else {}
        if not more or more.items() <= options.items():
            return Verdict("are refused", robot.splitlines()[0], "are refused")
        options, how, why = options | more, COLUMNS[1], robot.splitlines()[0]
        robot = attempt(mechanics.load, path, within=package, quarter_turns=0.0, **options)
    if options.get("floating"):
        peers = peers_of(path, kind, floating=True)
    worst = difference(robot, peers[0])
    if isinstance(peers[0], Pinocchio) and not options.get("floating"):
        free = attempt(mechanics.load, path, quarter_turns=0.0, **{**options, "floating": True})
        if not isinstance(free, str):  # a root may have no mass where it is at rest
            worst = max(worst, difference(free, Pinocchio(path, floating=True)))
    return Verdict("agree" if worst <= BOUND else "differ", f"{worst:.1e} {why}", how)


def without_meshes(path: Path, kind: str, package: Path, robot: Any) -> Verdict:
    """Of a file that no peer loads: MuJoCo's view of it without its looks, where that is enough."""
    if isinstance(robot, str) or kind != "MJCF":
        return Verdict("no peer loads")
    worst = difference(robot, Mujoco(path, package))
    return Verdict(MORE if worst <= BOUND else "differ", f"{worst:.1e}")


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Without what libraries write to the standard error."""
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(null)
        os.close(kept)


def main(arguments: list[str]) -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--details", action="store_true")
    parser.add_argument("--without", help="name of a folder whose files are left out")
    options = parser.parse_args(arguments)
    counts = collections.defaultdict[tuple[str, str], collections.Counter[str]](collections.Counter)
    for folder in options.folders:
        for path, kind in models_in(folder):
            if options.without in path.parts:
                continue
            with quiet():
                verdict = verdict_on(path, kind, folder)
            counts[folder.name, kind][verdict.what] += 1
            if verdict.how and verdict.how != verdict.what:
                counts[folder.name, kind][verdict.how] += 1
            if options.details and verdict.what not in ("no model", "no peer loads", MORE):
                print(path.relative_to(folder), verdict.what, verdict.how, verdict.detail, sep=" | ", flush=True)
    print(f"\n| package | format | models | {' | '.join((*COLUMNS, MORE))} |\n|---|---|{'---|' * (2 + len(COLUMNS))}")
    for (package, kind), count in counts.items():
        models = count["agree"] + count["differ"] + count["are refused"]
        row = [package, kind, models, *(count[name] for name in (*COLUMNS, MORE))]
        print(f"| {' | '.join(map(str, row))} |", dict(count) if options.details else "")


if __name__ == "__main__":
    main(sys.argv[1:])
