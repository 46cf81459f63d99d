"""The equalities of MJCF: mimic joints and loop constraints.

MuJoCo enforces them by stiff springs (solref, solimp); here they are exact. A linear relation of two joints

    q_1 - ref_1 = c_0 + c_1 (q_2 - ref_2)

makes the first one mimic the second, or the joint that the second one mimics. `connect` becomes a `PointLoop`, `weld` a
`PoseLoop`. Other equalities are noted.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..loops import Loop, PointLoop, PoseLoop
from ..tree import Mimic

_STRAIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@dataclasses.dataclass(frozen=True)
class Place:
    """A frame on a body: its origin, and the quaternion of its axes."""

    body: int
    position: NDArray[np.float64]
    quaternion: NDArray[np.float64]

    @classmethod
    def of_site(cls, model: Any, i: int) -> Place:
        return cls(int(model.site_bodyid[i]), np.array(model.site_pos[i]), np.array(model.site_quat[i]))


@dataclasses.dataclass(frozen=True)
class Closure:
    """A loop constraint between two frames."""

    name: str
    kind: Callable[[str, str, str], Loop]
    places: tuple[Place, Place]


@dataclasses.dataclass(frozen=True)
class _Led:
    """The position of a joint: ratio times that of its leading joint, plus offset."""

    leader: int
    ratio: float = 1.0
    offset: float = 0.0


class Equalities:
    """The equality constraints of an MJCF model as mimic joints and loop constraints.

    Args:
        mujoco: the module `mujoco`.
        model: the compiled model.
        name: a function from ("joint" or "body", index) to the name.
        driven: the joints with actuators, which should lead and not mimic.
    Attributes:
        followers: by joint, the joint that it mimics.
        closures: loop constraints between frames of bodies that move relative to each other.
        notes: equalities that are neither.
    """

    def __init__(self, mujoco: Any, model: Any, name: Callable[[str, int], str], driven: set[int]) -> None:
        self._mujoco, self._model, self._name, self._driven = mujoco, model, name, driven
        self._led = dict[int, _Led]()
        self.closures, self.notes = list[Closure](), list[str]()
        off = mujoco.mjtDisableBit
        ignored = model.opt.disableflags & (int(off.mjDSBL_EQUALITY) | int(off.mjDSBL_CONSTRAINT))
        joint, *closures = (int(getattr(mujoco.mjtEq, f"mjEQ_{kind}")) for kind in ("JOINT", "CONNECT", "WELD"))
        for e in range(model.neq):
            what, kind = f"equality {self._called(e)!r}", int(model.eq_type[e])
            if ignored or not model.eq_active0[e]:
                self.notes.append(f"{what}, which the file switches off")
            elif kind == joint:
                self._follow(e, what)
            elif kind in closures:
                self._close(e, what)
            else:
                self.notes.append(f"{what}: its kind is not known")
        self.followers = {j: Mimic(name("joint", led.leader), led.ratio, led.offset) for j, led in self._led.items()}
        if self.followers or self.closures:
            self.notes.append("equalities are exact here: solref and solimp are not used")

    def _called(self, e: int) -> str:
        return self._model.equality(e).name or f"equality_{e}"

    def _follow(self, e: int, what: str) -> None:
        """Apply a linear relation of two joints: one of their leading joints now mimics the other."""
        model = self._model
        first, second = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        shift, ratio, *more = (float(c) for c in model.eq_data[e, :5])
        if second < 0 or any(more) or not ratio:
            self.notes.append(f"{what}, which is not a linear relation of two joints")
            return
        place = [float(model.qpos0[model.jnt_qposadr[j]]) for j in (first, second)]
        one, two = self._led.get(first, _Led(first)), self._led.get(second, _Led(second))
        if one.leader == two.leader:
            self.notes.append(f"{what}, whose joints are related by others already")
            return
        # In terms of the positions Q of the leading joints, the relation is a Q_1 = b Q_2 + c.
        a, b = one.ratio, ratio * two.ratio
        c = place[0] - one.offset + shift + ratio * (two.offset - place[1])
        follower, leader = one.leader, two.leader
        if follower in self._driven and leader not in self._driven:
            follower, leader, a, b, c = leader, follower, b, a, -c
        if follower in self._driven:
            self.notes.append(f"{what}: the actuator of {self._name('joint', follower)!r}, which follows")
        ratio, shift = b / a, c / a
        for joint, led in {**self._led, follower: _Led(follower)}.items():
            if led.leader == follower:
                self._led[joint] = _Led(leader, led.ratio * ratio, led.offset + led.ratio * shift)

    def _close(self, e: int, what: str) -> None:
        model, kinds = self._model, self._mujoco
        weld = int(model.eq_type[e]) == int(kinds.mjtEq.mjEQ_WELD)
        one, two = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        data = np.array(model.eq_data[e], dtype=np.float64)
        if int(model.eq_objtype[e]) == int(kinds.mjtObj.mjOBJ_SITE):
            places = Place.of_site(model, one), Place.of_site(model, two)
        elif weld:  # the anchor in the second body, then the pose of the second body in the first
            places = Place(one, data[3:6], data[6:10]), Place(two, data[:3], _STRAIGHT)
        else:
            places = Place(one, data[:3], _STRAIGHT), Place(two, data[3:6], _STRAIGHT)
        if self._carrier(places[0].body) == self._carrier(places[1].body):
            self.notes.append(f"{what}, between bodies that do not move against each other")
        else:
            self.closures.append(Closure(self._called(e), PoseLoop if weld else PointLoop, places))

    def _carrier(self, body: int) -> int:
        """The moving body to which a body is fixed."""
        return int(self._model.body_weldid[body])
