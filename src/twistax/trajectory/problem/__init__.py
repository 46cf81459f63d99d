"""What a problem states: phases, objective, conditions, constraints, and how it is solved."""

from ...expr.moved import earlier_classes

__getattr__ = earlier_classes(__name__)
