"""Tests for custom groups, joints, nodes, tableaus and scenes, the laws that each must satisfy, and for gradients.

The test suite of this package applies the same functions to all of its parts.
"""

from .gradients import check_gradients
from .groups import check_group
from .joints import check_joint
from .laws import LawError
from .nodes import check_node
from .scenes import check_scene
from .tableaus import check_tableau

__all__ = ["LawError", "check_gradients", "check_group", "check_joint", "check_node", "check_scene", "check_tableau"]
