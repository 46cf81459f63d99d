"""Joints as screws: what a joint lets move, what drives it, and what its bearing carries."""

from .joint import Joint
from .kinds import Fixed, Free, Prismatic, Revolute, Spherical
from .screws import Screws

__all__ = ["Fixed", "Free", "Joint", "Prismatic", "Revolute", "Screws", "Spherical"]
