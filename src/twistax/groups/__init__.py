"""Lie groups on plain arrays: the numeric maps of SO(3) and SE(3), and groups with a common interface for states."""

from twistax.groups import se3, so3
from twistax.groups.euclidean import Euclidean
from twistax.groups.group import ElementPart, Group
from twistax.groups.pose import euler, pose, quaternion, quaternion_product, rotation_from_quaternion
from twistax.groups.product import Product
from twistax.groups.special import (
    ANGULAR_FIRST,
    LINEAR_FIRST,
    SE3,
    SO3,
    Order,
    SpecialEuclidean,
    SpecialOrthogonal,
    tangent_grad,
)
