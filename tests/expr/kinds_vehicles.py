"""Right models of bodies in the air, in space and in water, whose leaves all say what they are."""

from typing import Any

import numpy as np
from kinds_models import (
    DOWN,
    G,
    Inertia,
    Point,
    Pose,
    Rates,
    Rotation,
    Twist,
    Vector,
    Wrench,
    attitude,
    cross,
    fixed,
    inertia,
    inputs,
    lie,
    number,
    numbers,
    solve,
    spatial_inertia,
    state,
    vector,
)

import twistax as tx

norm = tx.linalg.Norm
LAST = tx.ANGULAR_FIRST


def point(name: str, frame: str = "world") -> tx.State:
    return tx.State(name, shape=(3,), kind=Point(frame))


def place(name: str, value: Any, frame: str = "body") -> tx.Parameter:
    return tx.Parameter(name, value=value, kind=Point(frame))


def pose(name: str = "g", to: str = "world", source: str = "body", **more: Any) -> tx.State:
    return tx.State(name, group=tx.SE3, kind=Pose(to, source), **more)


def twist(name: str = "V", frame: str = "body", against: str = "world") -> tx.State:
    return tx.State(name, shape=(6,), kind=Twist(frame, of=frame, relative_to=against))


def wrench(name: str = "W", frame: str = "body", on: str = "") -> tx.Control:
    return tx.Control(name, shape=(6,), kind=Wrench(frame, on or frame))


def table(name: str, value: Any) -> tx.Parameter:
    return tx.Parameter(name, value=value, unit="1")


def angular_first_body() -> Rates:
    g, V = pose(order=LAST), twist()
    value = np.diag([0.1, 0.2, 0.3, 2.0, 2.0, 2.0])
    value[0, 4] = value[4, 0] = 0.1
    M, W, far = tx.Parameter("M", value=value, kind=Inertia("body")), wrench(), wrench("far", "world", on="body")
    carried = lie.SE3AdjointDual(lie.Inverse(g), order=LAST) @ far
    return {g: V, V: solve(M, W + carried - lie.AdjointDual(V, M @ V, order=LAST))}


def angular_first_parts() -> Rates:
    g, V, m, J = pose(order=LAST), twist(), number("m", 2.0, "kg"), inertia()
    force, torque = inputs("force", "N", "world"), inputs("torque", "N m", "body")
    v, w = lie.linear(V, order=LAST), lie.angular(V, order=LAST)
    push = force / m + G * DOWN
    turning = solve(J, torque - cross(w, J @ w))
    return {g: V, V: lie.twist(linear=g[:3, :3].T @ push - cross(w, v), angular=turning, order=LAST)}


def body_by_parts() -> Rates:
    g, V, m, J = pose(), twist(), number("m", 2.0, "kg"), inertia()
    W = wrench()
    v, w = lie.linear(V), lie.angular(V)
    moving = lie.linear(W) / m - cross(w, v) + G * (g[:3, :3].T @ DOWN)
    return {g: V, V: lie.twist(linear=moving, angular=solve(J, lie.angular(W) - cross(w, J @ w)))}


def momentum_in_the_world() -> Rates:
    p, R, m, J = point("p"), attitude(), number("m", 2.0, "kg"), inertia()
    P, L = vector("P", "N s", "world"), vector("L", "N m s", "world")
    force, arm = inputs("force", "N", "world"), place("arm", [0.1, 0.2, -0.3])
    return {p: P / m, R: solve(J, R.T @ L), P: force + m * G * DOWN, L: cross(R @ arm, force)}


def offset_body_at_its_origin() -> Rates:
    """The centre of mass beside the origin, forces about the centre."""
    g, V, m, J = pose(), twist(), number("m", 2.0, "kg"), inertia()
    c, W = place("c", [0.1, -0.2, 0.3]), wrench()
    f, tau, w, v = lie.linear(W), lie.angular(W), lie.angular(V), lie.linear(V)
    turning = solve(J, tau - cross(c, f) - cross(w, J @ w))
    moving = f / m - cross(w, v + cross(w, c)) - cross(turning, c)
    return {g: V, V: lie.twist(linear=moving, angular=turning)}


def quadrotor_of_rotors() -> Rates:
    g, V, M, m = pose(), twist(), spatial_inertia(), number("m", 2.0, "kg")
    axis = fixed("axis", [0.05, 0.0, 1.0], "1", "body")
    drag = number("drag", 0.016, "m")
    force, torque = m * G * (g[:3, :3].T @ DOWN), None
    for k in range(2):
        arm, thrust = place(f"arm{k}", [0.1 * k - 0.05, 0.1, 0.0]), inputs(f"thrust{k}", "N")
        lift = axis * thrust
        force = force + lift
        about = cross(arm, lift) + drag * lift if k else cross(arm, lift) - drag * lift
        torque = about if torque is None else torque + about
    return {g: V, V: solve(M, lie.wrench(force=force, torque=torque) - lie.AdjointDual(V, M @ V))}


def motors() -> Rates:
    """One axis with two propellers that have spins of their own."""
    q, rate = state("q", "rad"), state("rate", "rad/s")
    s1, s2 = state("s1", "rad/s"), state("s2", "rad/s")
    k, kd, arm = number("k", 0.02, "kg m"), number("kd", 0.001, "kg m2"), number("arm", 0.3, "m")
    I, Ir, t1, t2 = number("I", 0.4, "kg m2"), number("Ir", 0.002, "kg m2"), inputs("t1", "N m"), inputs("t2", "N m")
    return {
        q: rate,
        rate: arm * (k * s1**2 - k * s2**2) / I,
        s1: (t1 - kd * s1**2) / Ir,
        s2: (t2 - kd * s2 * s2) / Ir,
    }


def attitude_control() -> Rates:
    R, w, J = attitude(), vector("w", "rad/s", "body"), inertia()
    goal = tx.State("goal", group=tx.SO3, kind=Rotation("world", "target"))
    wd, P, D = vector("wd", "rad/s", "target"), number("P", 2.0, "N m"), number("D", 0.7, "N m s")
    off = R.T @ goal
    error = w - off @ wd
    return {
        R: w,
        goal: wd,
        wd: -wd / number("tau", 3.0, "s"),
        w: solve(J, P * lie.SO3Log(off) - D * error - cross(w, J @ w)),
    }


def gimballed_thrust() -> Rates:
    """A rocket in a plane and out of it: the thrust is turned by two angles."""
    m, R, w, J = state("m", "kg"), attitude(), vector("w", "rad/s", "body"), inertia()
    p, v = point("p"), vector("v", "m/s", "world")
    a, b, T, Isp = inputs("a", "rad"), inputs("b", "rad"), inputs("T", "N"), number("Isp", 280.0, "s")
    engine = place("engine", [0.1, 0.0, -14.0])
    x, y, z = (fixed(n, e, "1", "body") for n, e in zip("xyz", np.eye(3), strict=True))
    f = T * (x * tx.Sin(a) * tx.Cos(b) + y * tx.Sin(b) + z * tx.Cos(a) * tx.Cos(b))
    return {
        m: -T / (Isp * G),
        p: v,
        v: R @ f / m + G * DOWN,
        R: w,
        w: solve(J, cross(engine, f) - cross(w, J @ w)),
    }


def aircraft_in_its_plane() -> Rates:
    V, path, alpha, q = state("V", "m/s"), state("path", "rad"), state("alpha", "rad"), state("q", "rad/s")
    x, h = state("x", "m"), state("h", "m")
    m, I, S, c = number("m", 900.0, "kg"), number("I", 1300.0, "kg m2"), number("S", 16.0, "m2"), number("c", 1.5, "m")
    rho, T, flap = number("rho", 1.2, "kg/m3"), inputs("T", "N"), inputs("flap", "rad")
    lift = tx.Linterp(alpha, [0.0, 0.5, 1.0, 2.0], table("lift", [0.2, 1.4, 1.1, 0.3]))
    drag = table("drag", 0.03) + table("k", 0.05) * lift**2
    moment = table("m0", 0.04) - table("ma", 0.6) * alpha - table("mf", 1.1) * flap - table("mq", 8.0) * q * c / V
    load = rho * V**2 * S / 2
    turning = (load * lift + T * tx.Sin(alpha)) / (m * V) - G * tx.Cos(path) / V
    return {
        V: (T * tx.Cos(alpha) - load * drag) / m - G * tx.Sin(path),
        path: turning,
        alpha: q - turning,
        q: load * c * moment / I,
        x: V * tx.Cos(path),
        h: V * tx.Sin(path),
    }


def aircraft_with_tables() -> Rates:
    g, V, M, m = pose("g", "ned"), twist(), spatial_inertia(), number("m", 2.0, "kg")
    wind, rho = fixed("wind", [2.0, 1.0, 0.2], "m/s", "ned"), number("rho", 1.2, "kg/m3")
    S, b = number("S", 0.5, "m2"), number("b", 1.4, "m")
    heavy = tx.Constant([0.0, 0.0, 1.0], kind=Vector("ned"), unit="1")
    R, w = g[:3, :3], lie.angular(V)
    air = lie.linear(V) - R.T @ wind
    speed = norm(air)
    alpha, beta = tx.Atan2(air[2], air[0]), tx.Atan2(air[1], norm(tx.Concat(air[0], air[2])))
    load = rho * speed**2 * S / 2
    lift = tx.Linterp(alpha, [-1.0, 0.0, 1.0], table("lift", [-0.4, 0.2, 1.3]))
    side = tx.Linterp(beta, [-1.0, 0.0, 1.0], table("side", [0.4, 0.0, -0.4]))
    x, y, z = (fixed(n, e, "1", "body") for n, e in zip("xyz", np.eye(3), strict=True))
    force = load * (x * (lift * tx.Sin(alpha) - table("cd", 0.04)) + y * side - z * lift * tx.Cos(alpha))
    torque = load * b * (table("roll", 0.02) * x + table("pitch", -0.4) * y * alpha) - number("damp", 0.1, "N m s") * w
    weight = m * G * (R.T @ heavy)
    F = lie.wrench(force=force + weight + x * inputs("T", "N"), torque=torque)
    return {g: V, V: solve(M, F - lie.AdjointDual(V, M @ V))}


def glider() -> Rates:
    x, y, h = state("x", "m"), state("y", "m"), state("h", "m")
    V, path, heading = state("V", "m/s"), state("path", "rad"), state("heading", "rad")
    bank, lift, rho, S = inputs("bank", "rad"), inputs("lift", "1"), number("rho", 1.2, "kg/m3"), number("S", 4.0, "m2")
    m, cd, k = number("m", 10.0, "kg"), number("cd", 0.02, "1"), number("k", 0.06, "1")
    load = rho * S * V**2 / 2
    return {
        x: V * tx.Cos(path) * tx.Cos(heading),
        y: V * tx.Cos(path) * tx.Sin(heading),
        h: V * tx.Sin(path),
        V: -load * (cd + k * lift**2) / m - G * tx.Sin(path),
        path: load * lift * tx.Cos(bank) / (m * V) - G * tx.Cos(path) / V,
        heading: load * lift * tx.Sin(bank) / (m * V * tx.Cos(path)),
    }


def body_on_a_spring() -> Rates:
    """A spring from the world to a point of a body, as a wrench in world axes at the point, carried by Ad*."""
    g, V, M = pose(), twist(), spatial_inertia()
    port, anchor, k = (
        place("port", [0.3, 0.1, 0.0]),
        place("anchor", [0.0, 0.2, 0.5], "world"),
        number("k", 20.0, "N/m"),
    )
    force = k * (anchor - lie.Act(g, port))
    about = lie.wrench(force=force, torque=cross(g[:3, :3] @ port, force))
    turned = lie.Pose(rotation=g[:3, :3].T, position=np.zeros(3))
    return {g: V, V: solve(M, lie.SE3AdjointDual(turned) @ about - lie.AdjointDual(V, M @ V))}


def submarine() -> Rates:
    g, V, M, A = pose(), twist(), spatial_inertia(), spatial_inertia("A")
    m, displaced, rho = number("m", 4.0, "kg"), number("displaced", 0.004, "m3"), number("rho", 1000.0, "kg/m3")
    low, W = place("low", [0.0, 0.1, -0.2]), wrench()
    down = g[:3, :3].T @ DOWN
    weight, lift = m * G * down, -rho * displaced * G * down
    still = lie.wrench(force=weight + lift, torque=cross(low, weight))
    total = M + A
    return {g: V, V: solve(total, W + still - lie.AdjointDual(V, total @ V))}


def inertial_navigation() -> Rates:
    """Position and velocity in north-east-down axes that turn, from what an IMU measures."""
    C, v, p = attitude("C", "ned", "body"), vector("v", "m/s", "ned"), point("p", "ned")
    f, w = inputs("f", "m/s2", "body"), inputs("w", "rad/s", "body")
    earth, local = fixed("earth", [0.4, 0.0, -0.5], "rad/s", "ned"), fixed("local", [0.1, 0.2, 0.0], "rad/s", "ned")
    g = fixed("g", [0.0, 0.0, 9.8], "m/s2", "ned")
    return {C: w - C.T @ (earth + local), v: C @ f + g - cross(2 * earth + local, v), p: v - cross(local, p)}


def heavy_top() -> Rates:
    """Poisson's equations: the vertical seen from the body."""
    up, w, J = vector("up", "1", "body"), vector("w", "rad/s", "body"), inertia()
    m, c = number("m", 2.0, "kg"), place("c", [0.1, 0.2, 0.7])
    return {up: cross(up, w), w: solve(J, -m * G * cross(c, up) - cross(w, J @ w))}


def rolling_ball() -> Rates:
    p, w = point("p"), vector("w", "rad/s", "world")
    m, r, tau = number("m", 2.0, "kg"), number("r", 0.2, "m"), inputs("tau", "N m", "world")
    up = fixed("up", [0.0, 0.0, 1.0], "1", "world")
    return {p: r * cross(w, up), w: tau / (7 * m * r**2 / 5)}


def balloon() -> Rates:
    h, v, T = state("h", "m"), state("v", "m/s"), state("T", "K")
    m, vol, rho = number("m", 300.0, "kg"), number("vol", 2e3, "m3"), number("rho", 1.2, "kg/m3")
    cold, heat, burner = number("cold", 280.0, "K"), number("heat", 2e6, "J/K"), inputs("burner", "W")
    loss, drag = number("loss", 3e3, "W/K"), number("drag", 100.0, "kg/m")
    lift = rho * vol * G * (1 - cold / T)
    return {h: v, v: (lift - m * G - drag * v * tx.Abs(v)) / m, T: (burner - loss * (T - cold)) / heat}


def tethered_kite() -> Rates:
    p, v, m = point("p"), vector("v", "m/s", "world"), number("m", 2.0, "kg")
    area, rho = numbers("area 3.0 m2, rho 1.2 kg/m3")
    wind = fixed("wind", [8.0, 0.0, 0.5], "m/s", "world")
    k, rest, lift = number("k", 50.0, "N/m"), number("rest", 0.2, "m"), number("lift", 0.8, "1")
    air = wind - v
    load = rho * area * norm(air) / 2
    side = cross(air, cross(p, air)) / norm(cross(p, air))
    pull = k * tx.Max(norm(p) - rest, 0.0) * p / norm(p)
    return {p: v, v: (load * (air + lift * side) - pull) / m + G * DOWN}


VEHICLES = (
    angular_first_body,
    angular_first_parts,
    body_by_parts,
    momentum_in_the_world,
    offset_body_at_its_origin,
    quadrotor_of_rotors,
    motors,
    attitude_control,
    gimballed_thrust,
    aircraft_in_its_plane,
    aircraft_with_tables,
    glider,
    body_on_a_spring,
    submarine,
    inertial_navigation,
    heavy_top,
    rolling_ball,
    balloon,
    tethered_kite,
)
