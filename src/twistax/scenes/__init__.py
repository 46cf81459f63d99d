"""Physical cases: what they are made of, and for those in `SCENES` the true answer.

Importing builds nothing: a scene's system is made and compiled when it is first read.
"""

from .euler_top import EULER_TOP
from .scene import Scene
from .symmetric_body import FAST_SPIN, SYMMETRIC_BODY

__all__ = ["SCENES", "Scene"]

#: The scenes with a known answer, by name.
SCENES: dict[str, Scene] = {
    scene.name: scene
    for scene in (
        EULER_TOP,
        SYMMETRIC_BODY,
        FAST_SPIN,
    )
}
