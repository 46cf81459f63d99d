"""Right models whose leaves all say what they are: the states with their rates, by name."""

from typing import Any

import numpy as np

import twistax as tx

lie, solve, cross, dot = tx.lie, tx.linalg.Solve, tx.linalg.Cross, tx.linalg.Dot
Vector, Point, Twist, Wrench = tx.FreeVector, tx.Point, tx.Twist, tx.Wrench
Rotation, Pose, Inertia, Momentum = tx.kinds.Rotation, tx.kinds.Pose, tx.kinds.Inertia, tx.kinds.Momentum
Rates = dict[tx.State, Any]

#: Masses, lengths and the like, by their unit.
G = tx.Parameter("gravity", value=9.81, unit="m/s2")
DOWN = tx.Constant([0.0, 0.0, -1.0], kind=Vector("world"), unit="1")


def state(name: str, unit: str = "", **more: Any) -> tx.State:
    return tx.State(name, unit=unit or None, **more)


def vector(name: str, unit: str, frame: str) -> tx.State:
    return tx.State(name, shape=(3,), kind=Vector(frame), unit=unit)


def inputs(name: str, unit: str, frame: str = "") -> tx.Control:
    return tx.Control(name, shape=(3,), kind=Vector(frame), unit=unit) if frame else tx.Control(name, unit=unit)


def number(name: str, value: float, unit: str) -> tx.Parameter:
    return tx.Parameter(name, value=value, unit=unit)


def numbers(text: str) -> list[tx.Parameter]:
    """Parameters by name, value and unit, as in "m 2.0 kg, I 0.4 kg m2"."""
    parts = (part.split(" ", 2) for part in text.split(", "))
    return [number(name, float(value), unit) for name, value, unit in parts]


def states(text: str) -> list[tx.State]:
    """States by name and unit, as in "x m, v m/s"."""
    return [state(*part.split(" ", 1)) for part in text.split(", ")]


def controls(text: str) -> list[tx.Control]:
    """Controls by name and unit."""
    return [inputs(*part.split(" ", 1)) for part in text.split(", ")]


def fixed(name: str, value: Any, unit: str, frame: str) -> tx.Parameter:
    return tx.Parameter(name, value=np.asarray(value, float), kind=Vector(frame), unit=unit)


def attitude(name: str = "R", to: str = "world", source: str = "body") -> tx.State:
    return tx.State(name, group=tx.SO3, kind=Rotation(to, source))


def inertia(name: str = "J", frame: str = "body") -> tx.Parameter:
    return tx.Parameter(
        name, value=np.array([[0.3, 0.01, 0.02], [0.01, 0.4, 0.03], [0.02, 0.03, 0.5]]), kind=Inertia(frame)
    )


def spatial_inertia(name: str = "M", frame: str = "body") -> tx.Parameter:
    entries = np.diag([2.0, 2.0, 2.0, 0.1, 0.2, 0.3])
    entries[0, 4] = entries[4, 0] = 0.1
    return tx.Parameter(name, value=entries, kind=Inertia(frame))


def free_rotation() -> Rates:
    R, w, J, torque = attitude(), vector("w", "rad/s", "body"), inertia(), inputs("torque", "N m", "body")
    return {R: w, w: solve(J, torque - cross(w, J @ w))}


def free_body_se3() -> Rates:
    g, V, M = (
        tx.State("g", group=tx.SE3, kind=Pose("world", "body")),
        tx.State("V", shape=(6,), kind=Twist("body")),
        spatial_inertia(),
    )
    W, far = tx.Control("W", shape=(6,), kind=Wrench("body")), tx.Control("far", shape=(6,), kind=Wrench("world"))
    return {g: V, V: solve(M, W + lie.SE3AdjointDual(lie.Inverse(g)) @ far - lie.AdjointDual(V, M @ V))}


def free_body_momentum() -> Rates:
    g, h, M = (
        tx.State("g", group=tx.SE3, kind=Pose("world", "body")),
        tx.State("h", shape=(6,), kind=Momentum("body")),
        spatial_inertia(),
    )
    force = tx.Control("force", shape=(3,), kind=Vector("world"), unit="N")
    push = lie.wrench(force=g[:3, :3].T @ force, torque=np.zeros(3))
    return {g: solve(M, h), h: push - lie.AdjointDual(solve(M, h), h)}


def quaternion_body() -> Rates:
    q = tx.State("q", shape=(4,), kind=Rotation("world", "body"))
    w, J, torque = vector("w", "rad/s", "body"), inertia(), inputs("torque", "N m", "world")
    return {q: tx.spatial.SSMP(w) @ q / 2, w: solve(J, tx.spatial.QDCM(q).T @ torque - cross(w, J @ w))}


def quadrotor() -> Rates:
    p, v = tx.State("p", shape=(3,), kind=Point("world")), vector("v", "m/s", "world")
    R, w, J, m = attitude(), vector("w", "rad/s", "body"), inertia(), number("m", 1.3, "kg")
    thrust, torque = inputs("thrust", "N"), inputs("torque", "N m", "body")
    up = fixed("up", [0.0, 0.1, 1.0], "1", "body")
    return {p: v, v: R @ up * thrust / m + DOWN * G, R: w, w: solve(J, torque - cross(w, J @ w))}


def quadrotor_drag() -> Rates:
    p, v = tx.State("p", shape=(3,), kind=Point("world")), vector("v", "m/s", "body")
    R, w, J, m = attitude(), vector("w", "rad/s", "body"), inertia(), number("m", 1.3, "kg")
    thrust, arm = inputs("thrust", "N", "body"), tx.Parameter("arm", value=[0.1, 0.0, 0.2], kind=Point("body"))
    drag, wind = number("drag", 0.2, "kg/s"), fixed("wind", [1.0, 2.0, 0.3], "m/s", "world")
    air = v - R.T @ wind
    return {
        p: R @ v,
        v: (thrust - drag * air) / m + R.T @ DOWN * G - cross(w, v),
        R: w,
        w: solve(J, cross(arm, thrust) - cross(w, J @ w)),
    }


def rocket() -> Rates:
    m, p, v = state("m", "kg"), tx.State("p", shape=(3,), kind=Point("world")), vector("v", "m/s", "world")
    thrust, exhaust = inputs("thrust", "N", "world"), number("exhaust", 2400.0, "m/s")
    rho, area, drag = number("rho", 1.2, "kg/m3"), number("area", 0.7, "m2"), number("drag", 0.5, "1")
    air = rho * area * drag * tx.linalg.Norm(v) * v / 2
    return {m: -tx.linalg.Norm(thrust) / exhaust, p: v, v: (thrust - air) / m + DOWN * G}


def gimballed_rocket() -> Rates:
    m, R, w, J = state("m", "kg"), attitude(), vector("w", "rad/s", "body"), inertia()
    p, v = tx.State("p", shape=(3,), kind=Point("world")), vector("v", "m/s", "world")
    thrust, exhaust = inputs("thrust", "N", "body"), number("exhaust", 2400.0, "m/s")
    engine = tx.Parameter("engine", value=[0.1, 0.0, -2.0], kind=Point("body"))
    return {
        m: -tx.linalg.Norm(thrust) / exhaust,
        p: v,
        v: R @ thrust / m + DOWN * G,
        R: w,
        w: solve(J, cross(engine, thrust) - cross(w, J @ w)),
    }


def wheels() -> Rates:
    R, w, J = attitude(), vector("w", "rad/s", "body"), inertia()
    wheel, torque = vector("wheel", "N m s", "body"), inputs("torque", "N m", "body")
    field, dipole = fixed("field", [2.0, 1.0, 3.0], "kg/s2", "world"), inputs("dipole", "m2", "body")
    return {
        R: w,
        w: solve(J, cross(dipole, R.T @ field) - torque - cross(w, J @ w + wheel)),
        wheel: torque,
    }


def one_wheel() -> Rates:
    R, w, J, spin = attitude(), vector("w", "rad/s", "body"), inertia(), state("spin", "rad/s")
    axis, rotor, torque = (
        fixed("axis", [0.6, 0.0, 0.8], "1", "body"),
        number("rotor", 0.05, "kg m2"),
        inputs("torque", "N m"),
    )
    rate = solve(J, -axis * torque - cross(w, J @ w + axis * rotor * spin))
    return {R: w, w: rate, spin: torque / rotor - dot(axis, rate)}


def gravity_gradient() -> Rates:
    R, w, J, mu = attitude(), vector("w", "rad/s", "body"), inertia(), number("mu", 3.9, "m3/s2")
    p, v = tx.State("p", shape=(3,), kind=Point("world")), vector("v", "m/s", "world")
    r = R.T @ p
    return {
        p: v,
        v: -mu * p / tx.linalg.Norm(p) ** 3,
        R: w,
        w: solve(J, 3 * mu * cross(r, J @ r) / tx.linalg.Norm(p) ** 5 - cross(w, J @ w)),
    }


def two_frames() -> Rates:
    """A body in a frame that turns with the Earth."""
    p = tx.State("p", shape=(3,), kind=Point("earth"))
    v, turn = vector("v", "m/s", "earth"), fixed("turn", [0.0, 0.1, 0.7], "rad/s", "earth")
    C, force, m = attitude("C", "earth", "body"), inputs("force", "N", "body"), number("m", 3.0, "kg")
    w = vector("w", "rad/s", "body")
    return {
        p: v,
        v: C @ force / m - 2 * cross(turn, v) - cross(turn, cross(turn, p)),
        C: w - C.T @ turn,
        w: w / number("tau", 2.0, "s"),
    }


def pendulum() -> Rates:
    q, s, length, m = state("q", "rad"), state("s", "rad/s"), number("length", 0.7, "m"), number("m", 1.1, "kg")
    damping, torque = number("damping", 0.1, "N m s"), inputs("torque", "N m")
    return {q: s, s: (torque - damping * s - m * G * length * tx.Sin(q)) / (m * length**2)}


def cart_pole() -> Rates:
    x, v, q, s = state("x", "m"), state("v", "m/s"), state("q", "rad"), state("s", "rad/s")
    M, m, length, F = number("M", 2.0, "kg"), number("m", 0.3, "kg"), number("length", 0.5, "m"), inputs("F", "N")
    push = (F + m * tx.Sin(q) * (length * s**2 + G * tx.Cos(q))) / (M + m * tx.Sin(q) ** 2)
    return {x: v, v: push, q: s, s: -(push * tx.Cos(q) + G * tx.Sin(q)) / length}


def double_pendulum() -> Rates:
    a, b, u, v = state("a", "rad"), state("b", "rad"), state("u", "rad/s"), state("v", "rad/s")
    l1, l2, m1, m2 = number("l1", 0.5, "m"), number("l2", 0.8, "m"), number("m1", 1.0, "kg"), number("m2", 0.7, "kg")
    below = m1 + m2 * tx.Sin(a - b) ** 2
    one = -(
        m2 * tx.Sin(a - b) * (l1 * u**2 * tx.Cos(a - b) + l2 * v**2)
        + G * ((m1 + m2) * tx.Sin(a) - m2 * tx.Sin(b) * tx.Cos(a - b))
    )
    other = (m1 + m2) * (l1 * u**2 + G * tx.Cos(a)) * tx.Sin(a - b) + m2 * l2 * v**2 * tx.Sin(a - b) * tx.Cos(a - b)
    return {a: u, b: v, u: one / (l1 * below), v: other / (l2 * below)}


def spherical_pendulum() -> Rates:
    R, w, J, m = attitude(), vector("w", "rad/s", "body"), inertia(), number("m", 2.0, "kg")
    centre = tx.Parameter("centre", value=[0.1, 0.2, -0.7], kind=Point("body"))
    return {R: w, w: solve(J, m * G * cross(centre, R.T @ DOWN) - cross(w, J @ w))}


def bicycle_car() -> Rates:
    x, y, yaw, v = state("x", "m"), state("y", "m"), state("yaw", "rad"), state("v", "m/s")
    steer, F = controls("steer rad, F N")
    wheelbase, m = numbers("wheelbase 2.5 m, m 1200.0 kg")
    drag = number("drag", 0.4, "kg/m")
    return {x: v * tx.Cos(yaw), y: v * tx.Sin(yaw), yaw: v * tx.Tan(steer) / wheelbase, v: (F - drag * v**2) / m}


def tyre_car() -> Rates:
    beta, yaw_rate, v = state("beta", "rad"), state("yaw_rate", "rad/s"), number("v", 20.0, "m/s")
    front, rear = number("front", 8e4, "N"), number("rear", 9e4, "N")
    a, b, m, I = number("a", 1.1, "m"), number("b", 1.4, "m"), number("m", 1200.0, "kg"), number("I", 2000.0, "kg m2")
    steer = inputs("steer", "rad")
    slip_front, slip_rear = steer - beta - a * yaw_rate / v, b * yaw_rate / v - beta
    return {
        beta: (front * slip_front + rear * slip_rear) / (m * v) - yaw_rate,
        yaw_rate: (a * front * slip_front - b * rear * slip_rear) / I,
    }


def planar_arm() -> Rates:
    a, b, u, v = state("a", "rad"), state("b", "rad"), state("u", "rad/s"), state("v", "rad/s")
    l1, l2, m1, m2 = number("l1", 0.5, "m"), number("l2", 0.8, "m"), number("m1", 1.0, "kg"), number("m2", 0.7, "kg")
    t1, t2 = inputs("t1", "N m"), inputs("t2", "N m")
    c = m2 * l1 * l2 * tx.Cos(b)
    h = m2 * l1 * l2 * tx.Sin(b)
    d11, d12, d22 = m1 * l1**2 + m2 * (l1**2 + l2**2) + 2 * c, m2 * l2**2 + c, m2 * l2**2
    f1, f2 = t1 + h * v * (2 * u + v), t2 - h * u**2
    det = d11 * d22 - d12**2
    return {a: u, b: v, u: (d22 * f1 - d12 * f2) / det, v: (d11 * f2 - d12 * f1) / det}


def arm_by_twists() -> Rates:
    """One link on a moving base: its twist by the adjoint of the base's."""
    base = tx.State("base", group=tx.SE3, kind=Pose("world", "base"))
    hand = tx.State("hand", group=tx.SE3, kind=Pose("base", "hand"))
    Vb, Vh = tx.State("Vb", shape=(6,), kind=Twist("base")), tx.State("Vh", shape=(6,), kind=Twist("hand"))
    Mb, Mh = spatial_inertia("Mb", "base"), spatial_inertia("Mh", "hand")
    Wb, Wh = tx.Control("Wb", shape=(6,), kind=Wrench("base")), tx.Control("Wh", shape=(6,), kind=Wrench("hand"))
    return {
        base: Vb,
        hand: Vh - lie.SE3Adjoint(lie.Inverse(hand)) @ Vb,
        Vb: solve(Mb, Wb - lie.SE3AdjointDual(hand) @ Wh - lie.AdjointDual(Vb, Mb @ Vb)),
        Vh: solve(Mh, Wh - lie.AdjointDual(Vh, Mh @ Vh)),
    }


def airship() -> Rates:
    g, V = tx.State("g", group=tx.SE3, kind=Pose("world", "body")), tx.State("V", shape=(6,), kind=Twist("body"))
    M, m = spatial_inertia(), number("m", 4.0, "kg")
    centre, thrust = tx.Parameter("centre", value=[0.1, 0.0, -0.4], kind=Point("body")), inputs("thrust", "N", "body")
    weight = m * G * (g[:3, :3].T @ DOWN)
    lift = lie.wrench(force=thrust + weight, torque=cross(centre, weight))
    return {g: V, V: solve(M, lift - lie.AdjointDual(V, M @ V))}


def spring_bodies() -> Rates:
    x, y, u, v = state("x", "m"), state("y", "m"), state("u", "m/s"), state("v", "m/s")
    m, n, k, c, rest = numbers("m 1.0 kg, n 2.0 kg, k 30.0 N/m, c 0.3 kg/s, rest 0.4 m")
    pull = k * (y - x - rest) + c * (v - u)
    return {x: u, y: v, u: pull / m, v: -pull / n}


def battery_car() -> Rates:
    x, v, energy = state("x", "m"), state("v", "m/s"), state("energy", "J")
    m, rolling, eta = numbers("m 900.0 kg, rolling 0.01 1, eta 0.9 1")
    F = inputs("F", "N")
    return {x: v, v: F / m - rolling * G, energy: -F * v / eta}


MODELS = (
    free_rotation,
    free_body_se3,
    free_body_momentum,
    quaternion_body,
    quadrotor,
    quadrotor_drag,
    rocket,
    gimballed_rocket,
    wheels,
    one_wheel,
    gravity_gradient,
    two_frames,
    pendulum,
    cart_pole,
    double_pendulum,
    spherical_pendulum,
    bicycle_car,
    tyre_car,
    planar_arm,
    arm_by_twists,
    airship,
    spring_bodies,
    battery_car,
)
