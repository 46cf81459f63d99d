"""Joints as screws: what a joint lets move, what drives it, and what its bearing carries. One file a joint."""

from .fixed import Fixed
from .free import Free
from .joint import Joint
from .prismatic import Prismatic
from .revolute import Revolute
from .screws import Screws
from .spherical import Spherical

__all__ = ["Fixed", "Free", "Joint", "Prismatic", "Revolute", "Screws", "Spherical"]
