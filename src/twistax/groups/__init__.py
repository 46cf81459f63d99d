"""Lie groups on plain arrays: the numeric maps of SO(3) and SE(3), and groups of one interface for states."""

from twistax.groups import se3, so3
from twistax.groups.euclidean import Euclidean
from twistax.groups.group import Group
from twistax.groups.order import ANGULAR_FIRST, LINEAR_FIRST, Order
from twistax.groups.pose import euler, pose, quaternion, quaternion_product, rotation_from_quaternion
from twistax.groups.product import Product
from twistax.groups.special import SE3, SO3, SpecialEuclidean, SpecialOrthogonal
from twistax.groups.tangent import tangent_grad

__all__ = [
    "ANGULAR_FIRST",
    "LINEAR_FIRST",
    "SE3",
    "SO3",
    "Euclidean",
    "Group",
    "Order",
    "Product",
    "SpecialEuclidean",
    "SpecialOrthogonal",
    "euler",
    "pose",
    "quaternion",
    "quaternion_product",
    "rotation_from_quaternion",
    "se3",
    "so3",
    "tangent_grad",
]
