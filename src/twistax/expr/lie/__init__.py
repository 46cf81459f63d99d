"""Nodes of Lie groups and their algebras."""

from .actions import AdjointAction, CoadjointAction
from .adjoint import Adjoint, AdjointDual, SE3Adjoint, SE3AdjointDual, SO3Adjoint
from .axis import AxisRotation
from .jacobians import LeftJacobian, LeftJacobianInverse, RightJacobian, RightJacobianInverse
from .maps import SE3Exp, SE3Log, SO3Exp, SO3Log
from .parts import AngularPart, JoinedParts, LinearPart, Reorder, angular, linear, twist, wrench
from .transforms import Act, Compose, Hat, Inverse, Pose, Vee, rotation, translation

__all__ = [
    "Act",
    "Adjoint",
    "AdjointAction",
    "AdjointDual",
    "AngularPart",
    "AxisRotation",
    "CoadjointAction",
    "Compose",
    "Hat",
    "Inverse",
    "JoinedParts",
    "LeftJacobian",
    "LeftJacobianInverse",
    "LinearPart",
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
