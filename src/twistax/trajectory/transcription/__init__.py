from ...expr.moved import earlier_classes

__getattr__ = earlier_classes(__name__)
