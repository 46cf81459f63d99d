"""Nodes of Lie groups and their algebras."""

from .adjoint import Adjoint, AdjointAction, AdjointDual, CoadjointAction, SE3Adjoint, SE3AdjointDual, SO3Adjoint
from .axis import AxisRotation
from .jacobians import LeftJacobian, LeftJacobianInverse, RightJacobian, RightJacobianInverse
from .maps import SE3Exp, SE3Log, SO3Exp, SO3Log
from .parts import AngularPart, JoinedParts, LinearPart, Reorder, angular, linear, twist, wrench
from .transforms import Act, Compose, Hat, Inverse, Pose, Vee

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
    "twist",
    "wrench",
]
