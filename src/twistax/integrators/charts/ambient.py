"""Plain numbers: quaternions and positions that are added to, put back to length one once a step."""

from __future__ import annotations

import dataclasses

from ...groups import SpecialEuclidean, quaternions
from ...groups.arrays import Components, add, scale
from .coordinates import Chart, Coordinates, StoredPose, StoredRotation, unit

__all__ = ["Ambient"]


class _Rotation(StoredRotation):
    def move(self, y: Components, z: Components) -> Components:
        return add(y, z)

    def slope(self, z: Components, moved: Components, omega: Components) -> Components:
        return quaternions.rate(moved, omega)

    def first_slope(self, y: Components, omega: Components) -> Components:
        return quaternions.rate(y, omega)

    def deviation(self, e: Components, after: Components) -> Components:
        return _turn(e, after)

    def settle(self, moved: Components) -> Components:
        return unit(moved)


class _Pose(StoredPose):
    def move(self, y: Components, z: Components) -> Components:
        return add(y, z)

    def slope(self, z: Components, moved: Components, omega: Components) -> Components:
        return (*quaternions.rate(moved[:4], omega[3:]), *quaternions.rotate(moved[:4], omega[:3]))

    def first_slope(self, y: Components, omega: Components) -> Components:
        return self.slope((), y, omega)

    def deviation(self, e: Components, after: Components) -> Components:
        return (*e[4:], *_turn(e[:4], after[:4]))

    def settle(self, moved: Components) -> Components:
        return (*unit(moved[:4]), *moved[4:])


def _turn(e: Components, q: Components) -> Components:
    """The rotation vector of a small difference e of quaternions near q: 2 Im(q^-1 e)."""
    conjugate = (q[0], *scale(-1.0, q[1:]))
    return scale(2.0, quaternions.product(conjugate, e)[1:])


@dataclasses.dataclass(frozen=True)
class Ambient(Chart):
    """Quaternion and position as plain numbers, q' = q (0, w) / 2 and p' = R(q) v; q is put to length one once a step.

    The cheapest chart, and as accurate as the others where nothing is stiff. Between the start of a step and its end
    the quaternion leaves the sphere by the error of the stages. No turn is too far for it to notice: a step that is too
    long is as wrong as the tableau makes it.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), section IV.4 (projection methods).
    """

    def for_rotation(self) -> Coordinates:
        return _Rotation()

    def for_pose(self, group: SpecialEuclidean) -> Coordinates:
        return _Pose(group)
