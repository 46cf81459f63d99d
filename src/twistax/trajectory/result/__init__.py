"""Results of a solve: trajectories, their quality, dense rollouts, mesh refinement, plots."""

from ...expr.moved import earlier_classes

__getattr__ = earlier_classes(__name__)
