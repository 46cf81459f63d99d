"""Nodes for Lie groups and their algebras."""

from .adjoint import Adjoint, AdjointAction, AdjointDual, CoadjointAction, SE3Adjoint, SE3AdjointDual, SO3Adjoint
from .attitude import EulerAngles, EulerRotation, euler, pose, quaternion, rotation, translation
from .base import AngularPart, JoinedParts, LinearPart, Reorder, angular, linear, twist, wrench
from .elements import (
    Act,
    AxisRotation,
    Compose,
    Hat,
    Inverse,
    Pose,
    SE3Exp,
    SE3Log,
    SO3Exp,
    SO3Log,
    Vee,
)
from .jacobians import LeftJacobian, LeftJacobianInverse, RightJacobian, RightJacobianInverse

#: The parts of a six-vector are nodes that `angular`, `linear`, `twist` and `wrench` make.
# fmt: off
__all__ = [
    "Act", "Adjoint", "AdjointAction", "AdjointDual", "AxisRotation", "CoadjointAction", "Compose", "EulerAngles",
    "EulerRotation", "Hat", "Inverse", "LeftJacobian", "LeftJacobianInverse", "Pose", "Reorder",
    "RightJacobian", "RightJacobianInverse", "SE3Adjoint", "SE3AdjointDual", "SE3Exp", "SE3Log", "SO3Adjoint", "SO3Exp",
    "SO3Log", "Vee", "angular", "euler", "linear", "quaternion", "rotation", "translation", "twist", "wrench",
]
# fmt: on
