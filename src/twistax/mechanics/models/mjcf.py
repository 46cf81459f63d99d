"""Mechanisms from MJCF, by MuJoCo's compiler.

The joints of a body are in series. With T the body's pose in its parent, p_i the translation to the anchor of a joint
and J_i its motion, the body is at

    T p_1 J_1(q_1 - ref_1) p_1^-1 p_2 J_2(q_2 - ref_2) p_2^-1 ...

Here each joint has a separate link, and the body's frame is fixed to the last one. Positions have the same meaning as
in MuJoCo.

Source: the pages of https://mujoco.readthedocs.io, modeling and computation.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...expr import Expr
from ...expr.lie import Compose
from ...system import free_name
from ..arguments import matrix
from ..drives import Drive
from ..joints import Fixed, Free, Joint, Prismatic, Revolute, Spherical
from ..loops import Loop
from ..tree import Link
from ..writers.written import UNLIMITED
from .choices import Choices
from .looks import looks_of_mjcf
from .mjcf_equalities import Closure, Equalities, Place
from .mjcf_file import Compiled, compiler
from .xml_file import Element

_UNIT = np.eye(4)


@dataclasses.dataclass(frozen=True)
class _Servo:
    """The force of an actuator on its joint: gear u - stiffness q + offset - damping q', and a rotor."""

    gear: float = 1.0
    stiffness: float = 0.0
    offset: float = 0.0
    damping: float = 0.0
    armature: float = 0.0
    limits: tuple[float, float] | None = None


class Mjcf:
    """The links of an MJCF model, and notes on the rest of the file.

    Args:
        root: the element <mujoco>.
        choices: which numbers become Parameters.
        folder: the folder in which included files and meshes may be.
        quarter_turns: rotations whose entries differ by at most this from those of quarter turns are rounded.
    Attributes:
        links, base, gravity, driven, notes, shapes, collision, loops: for `Mechanism`.
    Raises: ModelError with file and line.
    """

    def __init__(self, root: Element, choices: Choices, *, quarter_turns: float, folder: Path) -> None:
        self.root, self.choices, self.quarter_turns = root, choices, quarter_turns
        self.mujoco = compiler(root)
        self._file = file = Compiled(root, folder)
        self.model = file.model
        self.notes = [*file.warnings, *(f"{kind}: {count}" for kind, count in sorted(file.left_out.items()))]
        self._looks, not_drawn = looks_of_mjcf(self.model, self.mujoco, self._rotation, file.drawn)
        if not_drawn:
            self.notes.append(f"geoms that are not drawn, meshes and planes: {not_drawn}")
        self.base, (self.shapes, self.collision) = self._name("body", 0), self._looks[0].values()
        self.base_body = None
        self.gravity = np.array(self.model.opt.gravity) * self._switched_on("GRAVITY")
        if self.model.nbody == 1:
            raise root.wrong("there is no <body>, so this is not a model of a mechanism")
        if not self.model.njnt:
            self.notes.append("there is no joint, so nothing moves")
        self._servos = self._actuators()
        equalities = Equalities(self.mujoco, self.model, self._name, set(self._servos))
        self._mimics = equalities.followers
        self.driven = [self._name("joint", j) for j in self._servos if j not in self._mimics]
        self.links = list[Link]()
        self._taken = {self._name("body", i) for i in range(self.model.nbody)}
        self._fixed = {self._name("joint", j) for j in range(self.model.njnt)}
        for i in range(1, self.model.nbody):
            self._add_body(i)
        for i in range(self.model.nsite):
            self._add_site(i)
        self.loops = [self._loop(closure) for closure in equalities.closures]
        self.notes += equalities.notes
        self._note_the_rest()

    def _name(self, kind: str, i: int) -> str:
        return getattr(self.model, kind)(i).name or f"{kind}_{i}"

    def _switched_on(self, what: str) -> bool:
        """Whether the <flag> of the file leaves a part of the dynamics enabled."""
        return not self.model.opt.disableflags & getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{what}")

    # ---- bodies ------------------------------------------------------------------------------------------------------

    def _add_body(self, i: int) -> None:
        model, name = self.model, self._name("body", i)
        above = int(model.body_parentid[i])
        parent = None if above == 0 else self._name("body", above)
        first = int(model.body_jntadr[i])
        joints = range(first, first + int(model.body_jntnum[i]))
        body = None
        if model.body_mass[i] > 0.0 or model.body_inertia[i].any():
            R = self._rotation(model.body_iquat[i])
            center, mass = np.array(model.body_ipos[i]) + 0.0, float(model.body_mass[i])
            element = self._file.element("body", model.body(i).name)
            body = self.choices.body(name, mass, center, R, np.diag(model.body_inertia[i]), element)
        R, p = self._rotation(model.body_quat[i]), np.array(model.body_pos[i]) + 0.0
        mount: Any = self.choices.origin(name, R, p)
        for j in joints:
            joint, before, after = self._joint(j)
            mount = before if isinstance(joint, Free) else _after(mount, before)
            last = j == joints[-1] and not (after - _UNIT).any()
            link_name = name if last else free_name(joint.name, self._taken)
            self._taken.add(link_name)
            carried, looks = (body, self._looks[i]) if last else (None, {})
            drive, mimic = self._drive(j), self._mimics.get(j)
            link = Link(joint, carried, mount, parent=parent, name=link_name, drive=drive, mimic=mimic, **looks)
            self.links.append(link)
            if last:
                return
            mount, parent = after, link_name
        self._add_fixed(name, body, mount, parent, **self._looks[i])

    def _add_fixed(self, name: str, body: Any, mount: Any, parent: str | None, **looks: Any) -> None:
        joint = free_name(f"{name} fixed", self._fixed)
        self._fixed.add(joint)
        self.links.append(Link(Fixed(joint), body, mount, parent=parent, name=name, **looks))

    def _add_site(self, i: int) -> None:
        if self.model.site(i).name:
            self._add_frame(self.model.site(i).name, Place.of_site(self.model, i))

    def _add_frame(self, wanted: str, place: Place) -> str:
        """A frame at a pose, and its name."""
        name = free_name(wanted, self._taken)
        self._taken.add(name)
        T = matrix(self._rotation(place.quaternion), place.position)
        self._add_fixed(name, None, T, None if place.body == 0 else self._name("body", place.body))
        return name

    def _loop(self, closure: Closure) -> Loop:
        ends = [self._add_frame(f"{closure.name} on {self._name('body', at.body)}", at) for at in closure.places]
        return closure.kind(closure.name, *ends)

    def _rotation(self, quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
        R = np.zeros(9)
        self.mujoco.mju_quat2Mat(R, np.asarray(quaternion, dtype=np.float64))
        near = np.round(R)
        exact = np.abs(R - near).max() <= self.quarter_turns
        # Values below round-off count as zero.
        return (near if exact else np.where(np.abs(R) < 1e-15, 0.0, R)).reshape(3, 3) + 0.0

    # ---- joints ------------------------------------------------------------------------------------------------------

    def _joint(self, j: int) -> tuple[Joint, NDArray[np.float64], NDArray[np.float64]]:
        """The joint, its pose in the body's current frame, and the next frame in the joint's frame."""
        kinds, model, name = self.mujoco.mjtJoint, self.model, self._name("joint", j)
        kind, axis, anchor = model.jnt_type[j], np.array(model.jnt_axis[j]), np.array(model.jnt_pos[j])
        if kind == kinds.mjJNT_FREE:
            return Free(name), _UNIT, _UNIT
        if kind == kinds.mjJNT_BALL:
            return Spherical(name), _shift(anchor), _shift(-anchor)
        reference = float(model.qpos0[model.jnt_qposadr[j]])
        chosen = self.choices.of(name, "axis", axis) if reference == 0.0 else axis
        if kind == kinds.mjJNT_SLIDE:
            return Prismatic(name, chosen), _shift(-reference * axis), _UNIT
        quaternion = np.zeros(4)
        self.mujoco.mju_axisAngle2Quat(quaternion, axis, -reference)
        back = matrix(self._rotation(quaternion), np.zeros(3))
        return Revolute(name, chosen), _shift(anchor) @ back, _shift(-anchor)

    def _single(self, j: int) -> bool:
        """Whether a joint is a slide or a hinge. (Members of MuJoCo's enumerations equal numbers, but numbers do not
        equal them.)
        """
        kinds = self.mujoco.mjtJoint
        return int(self.model.jnt_type[j]) in (int(kinds.mjJNT_SLIDE), int(kinds.mjJNT_HINGE))

    def _drive(self, j: int) -> Drive:
        model, name, at = self.model, self._name("joint", j), int(self.model.jnt_dofadr[j])
        single = self._single(j)
        servo = self._servos.get(j, _Servo())
        numbers = {
            "armature": float(model.dof_armature[at]),
            "damping": float(model.dof_damping[at]) * self._switched_on("DAMPER"),
            "friction": float(model.dof_frictionloss[at]) * self._switched_on("FRICTIONLOSS"),
            "stiffness": float(model.jnt_stiffness[j]) * self._switched_on("SPRING"),
        }
        options: dict[str, Any] = {what: self.choices.of(name, what, value) for what, value in numbers.items() if value}
        rest: Any = float(model.qpos_spring[model.jnt_qposadr[j]]) if single else 0.0
        if servo.stiffness:
            spring_stiffness = options.get("stiffness", 0.0)
            rest = (spring_stiffness * rest + servo.offset) / (spring_stiffness + servo.stiffness)
        for what in ("armature", "damping", "stiffness"):
            if getattr(servo, what):
                options[what] = options.get(what, 0.0) + getattr(servo, what)
        if single and model.jnt_limited[j] and self._switched_on("LIMIT"):
            bounds = zip(("lower", "upper"), map(float, model.jnt_range[j]), strict=True)
            options |= {what: bound for what, bound in bounds if abs(bound) < UNLIMITED}
        return Drive(rest=rest if "stiffness" in options else 0.0, gear=servo.gear, effort=servo.limits, **options)

    # ---- actuators ---------------------------------------------------------------------------------------------------

    def _actuators(self) -> dict[int, _Servo]:
        """For each joint, the actuator whose control is that of the joint."""
        model, servos = self.model, dict[int, _Servo]()
        for a in range(model.nu):
            j = int(model.actuator_trnid[a, 0])
            what = self._actuator(a)
            single = self._single(j)
            group = int(model.actuator_group[a])
            grouped_out = 0 <= group < 31 and model.opt.disableactuator >> group & 1
            if grouped_out or not self._switched_on("ACTUATION"):
                self.notes.append(f"{what}, which the file switches off")
            elif not self._is_linear(a):
                self.notes.append(f"{what}, whose force is not a linear function of control and motion")
            elif j in servos:
                self.notes.append(f"{what}: its joint has another one, whose control is used")
            elif single:
                servos[j] = self._servo(a, j)
                # MuJoCo has actuator delays since version 4.
                if delay := float(getattr(model, "actuator_delay", np.zeros(model.nu))[a]):
                    self.notes.append(f"{what}: the delay of its control, {delay:g} s")
            else:
                servos[j] = _Servo()
                self.notes.append(f"{what}: all torques of its joint are controls, without its gear and limits")
        return servos

    def _actuator(self, a: int) -> str:
        name, joint = self.model.actuator(a).name, self._name("joint", int(self.model.actuator_trnid[a, 0]))
        return f"actuator {name!r} of joint {joint!r}" if name else f"an actuator of joint {joint!r}"

    def _is_linear(self, a: int) -> bool:
        kinds, model = self.mujoco, self.model
        return (
            model.actuator_dyntype[a] == kinds.mjtDyn.mjDYN_NONE
            and model.actuator_gaintype[a] == kinds.mjtGain.mjGAIN_FIXED
            and int(model.actuator_biastype[a]) in (int(kinds.mjtBias.mjBIAS_NONE), int(kinds.mjtBias.mjBIAS_AFFINE))
            and not model.actuator_dampingpoly[a].any()
        )

    def _servo(self, a: int, j: int) -> _Servo:
        """The joint force g (k u + b_0 + b_1 g q + b_2 g q'), with the gear g and the gain k."""
        model, what = self.model, self._actuator(a)
        g, k = float(model.actuator_gear[a, 0]), float(model.actuator_gainprm[a, 0])
        bias = np.zeros(3)
        if model.actuator_biastype[a] == self.mujoco.mjtBias.mjBIAS_AFFINE:
            bias = np.array(model.actuator_biasprm[a, :3])
        low, high = -np.inf, np.inf
        if model.actuator_ctrllimited[a] and self._switched_on("CLAMPCTRL"):
            low, high = map(float, model.actuator_ctrlrange[a])
        if bias.any():
            if model.actuator_forcelimited[a] or model.jnt_actfrclimited[j]:
                self.notes.append(f"{what}: the limit of its force")
            if bias[1] > 0.0 or bias[2] > 0.0 or (bias[0] and not bias[1]):
                self.notes.append(f"{what}: its bias, which is not a spring or damper")
                bias = np.zeros(3)
        else:
            for limited, (least, most), per_control in (
                (model.actuator_forcelimited[a], model.actuator_forcerange[a], k),
                (model.jnt_actfrclimited[j], model.jnt_actfrcrange[j], k * g),
            ):
                if limited and per_control:
                    ends = sorted((float(least) / per_control, float(most) / per_control))
                    low, high = max(low, ends[0]), min(high, ends[1])
        limits = None if np.isinf([low, high]).all() else (low, high)
        return _Servo(
            gear=g * k,
            stiffness=-bias[1] * g * g,
            offset=bias[0] * g,
            damping=(float(model.actuator_damping[a]) * self._switched_on("DAMPER") - bias[2]) * g * g,
            armature=float(model.actuator_armature[a]) * g * g,
            limits=limits,
        )

    # ---- notes -------------------------------------------------------------------------------------------------------

    def _note_the_rest(self) -> None:
        model, kinds = self.model, self.mujoco.mjtJoint
        ball, free = (model.jnt_type == int(kind) for kind in (kinds.mjJNT_BALL, kinds.mjJNT_FREE))
        at = model.jnt_dofadr
        yields = getattr(model, "jnt_springyield", np.zeros(model.njnt)) != 0.0  # since version 4
        curved = model.jnt_stiffnesspoly.any(axis=1) | model.dof_dampingpoly[at].any(axis=1)
        counted = (
            ("contacts of geoms", int(((model.geom_contype | model.geom_conaffinity) != 0).sum())),
            ("cameras", model.ncam),
            ("lights", model.nlight),
            ("bodies with compensated gravity", int((model.body_gravcomp != 0.0).sum())),
            ("mocap bodies, which stay where they are", model.nmocap),
        )
        self.notes += [f"{kind}: {count}" for kind, count in counted if count]
        for what, joints in (
            ("the limit of the ball joint", ball & (model.jnt_limited != 0)),
            ("the spring of the free joint", free & (model.jnt_stiffness != 0.0)),
            ("the yield of the spring of joint", yields),
            ("what is not linear in spring and damper of joint", curved),
        ):
            self.notes += [f"{what} {self._name('joint', int(j))!r}" for j in np.flatnonzero(joints)]
        if model.opt.density or model.opt.viscosity or model.opt.wind.any():
            self.notes.append("the forces of the medium")
        if model.dof_frictionloss.any():
            self.notes.append("dry friction of joints is smooth here, see Drive")


def _shift(p: NDArray[np.float64]) -> NDArray[np.float64]:
    return matrix(np.eye(3), p)


def _after(mount: Any, before: NDArray[np.float64]) -> Any:
    return Compose(mount, before) if isinstance(mount, Expr) else mount @ before
