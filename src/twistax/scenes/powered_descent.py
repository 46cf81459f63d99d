"""Powered descent of a rocket stage with six degrees of freedom, written with the public API.

World frame: z up, origin on the pad. Body frame: at the centre of mass, z towards the nose. SI units, rad. The stage is
a rigid body that loses mass through its engine; the atmosphere is neglected. The moments of inertia are constant, and
the centre of mass does not move in the body.
"""

import dataclasses
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

import twistax as tx

#: Standard gravity as rounded in this case, m/s2; also turns specific impulse into exhaust speed.
G0 = 9.81

Array = NDArray[Any]
Vector = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Lander:
    """The stage and its limits."""

    mass: float = 30_000.0  # at the start, kg
    dry_mass: float = 22_000.0  # without propellant, kg
    inertia: Vector = (4e6, 4e6, 1e5)  # principal moments about the centre of mass, kg m2
    engine: Vector = (0.0, 0.0, -14.0)  # where the thrust acts, in body axes from the centre of mass, m
    min_thrust: float = 320e3  # N; the engine cannot be shut down
    max_thrust: float = 800e3  # N
    specific_impulse: float = 282.0  # s
    max_gimbal: float = np.deg2rad(10.0)  # angle between the thrust and the body's z axis, rad
    max_tilt: float = np.deg2rad(80.0)  # angle between the body's z axis and the vertical, rad
    max_rate: float = np.deg2rad(60.0)  # size of the angular velocity, rad/s
    glide_slope: float = np.deg2rad(70.0)  # half opening of the approach cone over the pad, from the vertical, rad
    flight_time: tuple[float, float] = (8.0, 20.0)  # its limits, s


@dataclasses.dataclass(frozen=True)
class Start:
    """The start of the descent."""

    height: float = 900.0  # above the pad, m
    offset: tuple[float, float] = (400.0, 150.0)  # horizontal, from the pad, (x, y), m
    velocity: Vector = (-60.0, -20.0, -100.0)  # in the world frame, m/s
    tilt: float = np.deg2rad(60.0)  # the body is turned from upright by this angle, rad,
    tilt_axis: Vector = (-0.2, -1.0, 0.0)  # about this world axis
    righting: float = np.deg2rad(4.6)  # angular velocity about the same axis, back towards upright, rad/s

    @property
    def axis(self) -> Array:
        """The tilt axis, (3,), of length 1."""
        return np.array(self.tilt_axis) / np.linalg.norm(self.tilt_axis)

    @property
    def position(self) -> Array:
        """Position of the centre of mass, (3,), m."""
        return np.array([*self.offset, self.height])


@dataclasses.dataclass(frozen=True)
class Limit:
    """One limit of the flight, on an output of the system."""

    name: str  # what a reader calls it
    output: str
    bound: float  # the value allowed, in the output's unit
    sign: float  # +1 for an upper limit, -1 for a lower one
    unit: str  # of what readers see
    factor: float  # how many of them a unit of the output is

    @property
    def slack(self) -> float:
        """The tolerance, in `unit`, by which a flight may exceed the limit between nodes: 1 %, or 0.5 m on the cone."""
        return float(0.01 * abs(self.bound) * self.factor or 0.5)

    @property
    def relation(self) -> str:
        return "<=" if self.sign > 0.0 else ">="

    @property
    def shown(self) -> str:
        """The bound in `unit`."""
        return f"{self.bound * self.factor:,.5g}"

    def margin(self, values: Any) -> Array:
        """The distance of values to the limit, in `unit`; negative if they exceed it."""
        return np.asarray(self.sign * (self.bound - np.asarray(values)) * self.factor)


def system(vehicle: Lander | None = None) -> tx.System:
    """The stage as a system: states g (pose), V (body twist), m (mass); control T (thrust in body axes, N).

    Newton-Euler with spatial inertia M = diag(m, m, m, J), M V' = F - ad*_V(M V), and m' = -|T| / (Isp g0).
    Outputs, SI and rad: thrust, gimbal, tilt, rate, cone (how far inside the approach cone, m, measured level), mass.
    """
    v = vehicle or Lander()
    pose, twist = tx.kinds.Pose("world", "stage"), tx.Twist("stage", of="stage", relative_to="world")
    g = tx.State("g", group=tx.SE3, scale=[100.0, 100.0, 100.0, 0.5, 0.5, 0.5], kind=pose)
    V = tx.State("V", shape=(6,), scale=[50.0, 50.0, 50.0, 0.3, 0.3, 0.3], kind=twist)
    m = tx.State("m", min=v.dry_mass, scale=3000.0, unit="kg")
    T = tx.Control("T", shape=(3,), scale=v.max_thrust, kind=tx.FreeVector("stage"), unit="N")

    R, p, thrust = g[:3, :3], g[:3, 3], tx.linalg.Norm(T)
    weight = R.T @ np.array([0.0, 0.0, -G0]) * m
    F = tx.lie.wrench(force=T + weight, torque=tx.linalg.Cross(np.array(v.engine), T))
    M = tx.Concat(m, m, m, np.array(v.inertia))
    rate = tx.linalg.Norm(tx.lie.angular(V))
    cone = np.tan(v.glide_slope) * p[2] - tx.linalg.Norm(p[:2])

    return tx.System(
        rates={g: V, V: (F - tx.lie.AdjointDual(V, M * V)) / M, m: -thrust / (v.specific_impulse * G0)},
        outputs={
            "thrust": thrust,
            "gimbal": tx.Atan2(tx.linalg.Norm(T[:2]), T[2]),
            "tilt": tx.Atan2(tx.linalg.Norm(R[:2, 2]), R[2, 2]),
            "rate": rate,
            "cone": cone,
            "mass": m,
        },
        constraints={
            "most thrust": thrust <= v.max_thrust,
            "least thrust": thrust >= v.min_thrust,
            "gimbal": thrust * np.cos(v.max_gimbal) <= T[2],
            "tilt": R[2, 2] >= np.cos(v.max_tilt),
            "rate": rate <= v.max_rate,
            "inside the cone": cone >= 0.0,
        },
    )


def limits(vehicle: Lander | None = None) -> list[Limit]:
    """Every limit of the flight in customary units."""
    v = vehicle or Lander()
    degrees = float(np.rad2deg(1.0))
    return [
        Limit("most thrust", "thrust", v.max_thrust, 1.0, "kN", 1e-3),
        Limit("least thrust", "thrust", v.min_thrust, -1.0, "kN", 1e-3),
        Limit("gimbal", "gimbal", v.max_gimbal, 1.0, "deg", degrees),
        Limit("tilt", "tilt", v.max_tilt, 1.0, "deg", degrees),
        Limit("rate", "rate", v.max_rate, 1.0, "deg/s", degrees),
        Limit("inside the cone", "cone", 0.0, -1.0, "m", 1.0),
        Limit("dry mass", "mass", v.dry_mass, -1.0, "kg", 1.0),
    ]


def initial(start: Start, vehicle: Lander) -> dict[str, Any]:
    """The state at the start, by name."""
    (pose,) = _poses(start, np.ones(1))
    # The tilt axis has the same coordinates in the world and in the body.
    twist = np.concatenate([pose[:3, :3].T @ np.array(start.velocity), -start.righting * start.axis])
    return {"g": pose, "V": twist, "m": vehicle.mass}


def guess(start: Start, vehicle: Lander, nodes: int, final_time: float) -> dict[str, Any]:
    """A guess: a straight line to the pad with constant speed and attitude rate, at 60 % of full thrust."""
    share = np.linspace(1.0, 0.0, nodes)
    poses = _poses(start, share)
    linear = np.einsum("kji,kj->ki", poses[:, :3, :3], share[:, None] * np.array(start.velocity))
    angular = np.broadcast_to(-start.tilt / final_time * start.axis, (nodes, 3))
    thrust = np.array([0.0, 0.0, 0.6 * vehicle.max_thrust])
    burnt = thrust[2] / (vehicle.specific_impulse * G0) * final_time * (1.0 - share)
    return {
        "g": poses,
        "V": np.concatenate([linear, angular], axis=1),
        "m": np.maximum(vehicle.mass - burnt, vehicle.dry_mass),
        "T": thrust,
    }


def _poses(start: Start, share: Array) -> Array:
    """Poses between upright on the pad (share 0) and the start (share 1), (n, 4, 4)."""
    return np.asarray(_pose(share[:, None] * start.position, share[:, None] * start.tilt * start.axis))


@jax.jit
@jax.vmap
def _pose(position: jax.Array, turn: jax.Array) -> jax.Array:
    return tx.pose(position=position, rotation=tx.lie.so3.exp(turn))


def problem(
    dynamics: Any, start: Start | None = None, vehicle: Lander | None = None, *, nodes: int = 25, **options: Any
) -> tx.trajectory.Problem:
    """Land on the pad, upright and at rest, with the largest possible remaining mass. The heading is free.

    Args:
        dynamics: `tx.compile(system(vehicle))`.
        options: passed on to `tx.trajectory.Problem`.
    """
    start, vehicle = start or Start(), vehicle or Lander()
    g, V, m = dynamics.states
    final_time = 13.0
    return tx.trajectory.Problem(
        dynamics,
        objective=tx.Maximize(m),
        nodes=nodes,
        final_time=vehicle.flight_time,
        final_time_guess=final_time,
        initial=initial(start, vehicle),
        final=[{V: np.zeros(6)}, g[:3, 3] == 0.0, g[:2, 2] == 0.0],
        guess=guess(start, vehicle, nodes, final_time),
        **options,
    )
