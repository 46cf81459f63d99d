"""Scenes in three dimensions, which `solution.show()` and `result.show()` make: bodies that move, arrows, shapes.

Nothing here needs more than NumPy and SciPy but `Scene.save` and `Scene.live`, which load viser, the extra `view`.
"""

from .animation import Arrow, Body
from .meshes import Mesh
from .scene import Scene
from .shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Shape, Sphere

__all__ = ["Arrow", "Body", "Box", "Capsule", "Cone", "Cylinder", "Ellipsoid", "Mesh", "Scene", "Shape", "Sphere"]
