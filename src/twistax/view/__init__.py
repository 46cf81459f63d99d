"""Scenes in three dimensions, made by `solution.show()` and `result.show()`: moving bodies, arrows, shapes.

This module needs only NumPy and SciPy, except `Scene.save` and `Scene.live`, which load viser, the extra `view`.
"""

from .animation import Arrow, Body
from .meshes import Mesh
from .scene import Scene
from .shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Shape, Sphere

__all__ = ["Arrow", "Body", "Box", "Capsule", "Cone", "Cylinder", "Ellipsoid", "Mesh", "Scene", "Shape", "Sphere"]
