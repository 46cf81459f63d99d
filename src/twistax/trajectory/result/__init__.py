"""What a solve gives back: trajectories, how good they are, dense rollouts, finer meshes, pictures."""

from ...expr.moved import earlier_classes

__getattr__ = earlier_classes(__name__)
