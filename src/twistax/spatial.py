"""Attitude on expressions: quaternions (w, x, y, z) and the matrices of rigid-body kinematics."""

from .expr.lie.spatial import QDCM, SSM, SSMP, Quaternion, QuaternionProduct

__all__ = ["QDCM", "SSM", "SSMP", "Quaternion", "QuaternionProduct"]
