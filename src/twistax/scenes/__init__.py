"""Physical test cases: their systems and initial states, and for those in `SCENES` the exact solutions.

Importing builds nothing: the system of a scene is built and compiled when it is first read.
"""

from .check_cases import TUMBLING_BRICK
from .free_bodies import EULER_TOP, FAST_SPIN, SYMMETRIC_BODY
from .heavy_top import HEAVY_TOP, LONG_HEAVY_TOP
from .low_orbit import LOW_ORBIT, SPINNING_SATELLITE
from .offset_tumble import OFFSET_TUMBLE
from .rocket import ROCKET
from .scene import Scene
from .spring_bodies import SPRING_BODIES
from .stiff import actuator_lag, stiff_attitude, stiff_joint

#: The scenes with a known answer, by name.
SCENES: dict[str, Scene] = {
    scene.name: scene
    for scene in (
        EULER_TOP,
        SYMMETRIC_BODY,
        HEAVY_TOP,
        OFFSET_TUMBLE,
        FAST_SPIN,
        ROCKET,
        LOW_ORBIT,
        SPRING_BODIES,
        TUMBLING_BRICK,
        stiff_attitude.STIFF_ATTITUDE,
        actuator_lag.ACTUATOR_LAG,
        stiff_joint.STIFF_JOINT,
        LONG_HEAVY_TOP,
        SPINNING_SATELLITE,
    )
}
