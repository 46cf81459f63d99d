"""Laws that every group, joint, node, tableau and scene keeps, for checks of custom parts.

The test suite of this package runs the same functions over everything that it has.
"""

from .groups import check_group
from .joints import check_joint
from .laws import LawError
from .nodes import check_node
from .scenes import check_scene
from .tableaus import check_tableau

__all__ = ["LawError", "check_group", "check_joint", "check_node", "check_scene", "check_tableau"]
