"""Nodes of Lie groups and their algebras."""

from .actions import AdjointAction, CoadjointAction
from .adjoint import Adjoint, AdjointDual, SE3Adjoint, SE3AdjointDual, SO3Adjoint
from .maps import (
    AxisRotation,
    LeftJacobian,
    LeftJacobianInverse,
    RightJacobian,
    RightJacobianInverse,
    SE3Exp,
    SE3Log,
    SO3Exp,
    SO3Log,
)
from .parts import AngularPart, JoinedParts, LinearPart, Reorder, angular, linear, twist, wrench  # noqa: F401  see below
from .transforms import Act, Compose, Hat, Inverse, Pose, Vee, rotation, translation

#: The parts of a six-vector are nodes that `angular`, `linear`, `twist` and `wrench` make.
__all__ = [
    "Act",
    "Adjoint",
    "AdjointAction",
    "AdjointDual",
    "AxisRotation",
    "CoadjointAction",
    "Compose",
    "Hat",
    "Inverse",
    "LeftJacobian",
    "LeftJacobianInverse",
    "Pose",
    "Reorder",
    "RightJacobian",
    "RightJacobianInverse",
    "SE3Adjoint",
    "SE3AdjointDual",
    "SE3Exp",
    "SE3Log",
    "SO3Adjoint",
    "SO3Exp",
    "SO3Log",
    "Vee",
    "angular",
    "linear",
    "rotation",
    "translation",
    "twist",
    "wrench",
]
