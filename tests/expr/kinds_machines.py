"""Right models of machines, vehicles on the ground and processes, whose leaves all say what they are."""

from kinds_models import (
    DOWN,
    G,
    Point,
    Rates,
    attitude,
    controls,
    cross,
    dot,
    fixed,
    inertia,
    inputs,
    lie,
    number,
    numbers,
    solve,
    spatial_inertia,
    state,
    states,
    vector,
)
from kinds_vehicles import norm, place, pose, twist, wrench

import twistax as tx


def cart_and_pole_by_a_matrix() -> Rates:
    """Cart and pole in a common unit: the place of the cart over the length."""
    x, q, u, s = state("x", "1"), state("q", "rad"), state("u", "1/s"), state("s", "rad/s")
    M, m, length, F = number("M", 2.0, "kg"), number("m", 0.3, "kg"), number("length", 0.5, "m"), inputs("F", "N")
    matrix = length**2 * tx.Block([[M + m, m * tx.Cos(q)], [m * tx.Cos(q), m]])
    forces = tx.Concat(F * length + m * length**2 * s**2 * tx.Sin(q), -m * G * length * tx.Sin(q))
    rate = solve(matrix, forces)
    return {x: u, q: s, u: rate[0], s: rate[1]}


def rotary_pendulum() -> Rates:
    a, b, u, v = state("a", "rad"), state("b", "rad"), state("u", "rad/s"), state("v", "rad/s")
    I, m, L, l = number("I", 0.02, "kg m2"), number("m", 0.1, "kg"), number("L", 0.2, "m"), number("l", 0.15, "m")
    tau, c = inputs("tau", "N m"), number("c", 0.01, "N m s")
    one = I + m * L**2 + m * l**2 * tx.Sin(b) ** 2
    both, other = m * L * l * tx.Cos(b), m * l**2
    f1 = tau - c * u - 2 * m * l**2 * u * v * tx.Sin(b) * tx.Cos(b) + m * L * l * v**2 * tx.Sin(b)
    f2 = m * l**2 * u**2 * tx.Sin(b) * tx.Cos(b) - m * G * l * tx.Sin(b)
    det = one * other - both**2
    return {a: u, b: v, u: (other * f1 - both * f2) / det, v: (one * f2 - both * f1) / det}


def ball_and_beam() -> Rates:
    x, v, q, s = state("x", "m"), state("v", "m/s"), state("q", "rad"), state("s", "rad/s")
    m, I, r, J = numbers("m 0.1 kg, I 1e-4 kg m2, r 0.02 m, J 0.03 kg m2")
    tau = inputs("tau", "N m")
    return {
        x: v,
        v: m * (x * s**2 - G * tx.Sin(q)) / (m + I / r**2),
        q: s,
        s: (tau - 2 * m * x * v * s - m * G * x * tx.Cos(q)) / (J + m * x**2),
    }


def crane() -> Rates:
    x, v, length, rope, q, s = states("x m, v m/s, length m, rope m/s, q rad, s rad/s")
    a, b = controls("a m/s2, b m/s2")
    damping, tau = numbers("damping 0.1 1/s, tau 1.0 s")
    return {
        x: v,
        v: a - v / tau,
        length: rope,
        rope: b,
        q: s,
        s: -(a * tx.Cos(q) + G * tx.Sin(q) + 2 * rope * s) / length - damping * s,
    }


def quarter_car() -> Rates:
    z, w, u, v = state("z", "m"), state("w", "m"), state("u", "m/s"), state("v", "m/s")
    M, m, k, c, tyre = numbers("M 300.0 kg, m 40.0 kg, k 2e4 N/m, c 1500.0 N s/m, tyre 2e5 N/m")
    road = inputs("road", "m")
    push = k * (w - z) + c * (v - u)
    return {z: u, w: v, u: push / M - G, v: (tyre * (road - w) - push) / m - G}


def half_car() -> Rates:
    z, pitch, u, s = state("z", "m"), state("pitch", "rad"), state("u", "m/s"), state("s", "rad/s")
    m, I, a, b, k, c = numbers("m 900.0 kg, I 1400.0 kg m2, a 1.2 m, b 1.5 m, k 3e4 N/m, c 2e3 N s/m")
    front = -k * (z - a * tx.Sin(pitch)) - c * (u - a * s * tx.Cos(pitch))
    rear = -k * (z + b * tx.Sin(pitch)) - c * (u + b * s * tx.Cos(pitch))
    return {z: u, pitch: s, u: (front + rear) / m - G, s: (b * rear - a * front) * tx.Cos(pitch) / I}


def wheel_with_slip() -> Rates:
    v, s = state("v", "m/s"), state("s", "rad/s")
    m, I, r, load = numbers("m 300.0 kg, I 1.2 kg m2, r 0.3 m, load 3e3 N")
    brake = inputs("brake", "N m")
    B, C, D = number("B", 10.0, "1"), number("C", 1.9, "1"), number("D", 1.0, "1")
    slip = (r * s - v) / tx.Max(v, number("least", 0.1, "m/s"))
    force = load * D * tx.Sin(C * tx.Atan(B * slip))
    return {v: force / m, s: -(r * force + brake) / I}


def wind_turbine() -> Rates:
    s, twist_angle, g = state("s", "rad/s"), state("twist", "rad"), state("g", "rad/s")
    I, Ig, k, c = numbers("I 4.0 kg m2, Ig 0.5 kg m2, k 80.0 N m, c 0.5 N m s")
    rho, radius, ratio = numbers("rho 1.2 kg/m3, radius 1.3 m, ratio 9.0 1")
    wind, load = controls("wind m/s, load N m")
    tip = s * radius / wind
    share = tx.Linterp(tip, [0.0, 1.0, 3.0], tx.Parameter("share", value=[0.0, 0.2, 0.44], unit="1"))
    gain = rho * tx.Constant(3.14159, unit="1") * radius**3 * share * wind**2 / (2 * tip)
    shaft = k * twist_angle + c * (s - g / ratio)
    return {s: (gain - shaft) / I, twist_angle: s - g / ratio, g: (shaft / ratio - load) / Ig}


def tank() -> Rates:
    h, T = state("h", "m"), state("T", "K")
    area, hole = numbers("area 1.1 m2, hole 0.02 m2")
    flow, warm = controls("flow m3/s, warm K")
    return {h: (flow - hole * tx.Sqrt(2 * G * h)) / area, T: flow * (warm - T) / (area * h)}


def gas_spring() -> Rates:
    x, v = state("x", "m"), state("v", "m/s")
    m, area, p0, x0, outer, power = numbers("m 4.0 kg, area 0.01 m2, p0 3e5 Pa, x0 0.4 m, outer 1e5 Pa, power 1.4 1")
    pressure = p0 * (x0 / x) ** power
    return {x: v, v: (pressure - outer) * area / m - G}


def heat_exchanger() -> Rates:
    a, b = state("a", "K"), state("b", "K")
    ca, cb, k, outer, area = numbers("ca 3e3 J/K, cb 5e3 J/K, k 12.0 W/K, outer 300.0 K, area 0.5 m2")
    source = inputs("source", "W")
    sigma = number("sigma", 5.67e-8, "kg s-3 K-4")
    return {a: (source - k * (a - b)) / ca, b: (k * (a - b) - sigma * area * (b**4 - outer**4)) / cb}


def soft_ground() -> Rates:
    p, v, m = tx.State("p", shape=(3,), kind=Point("world")), vector("v", "m/s", "world"), number("m", 2.0, "kg")
    up = fixed("up", [0.0, 0.0, 1.0], "1", "world")
    k, c, mu, slip = numbers("k 1e3 N/m, c 0.4 s/m, mu 0.7 1, slip 0.01 m/s")
    depth, sinking = number("height", 2.0, "m") - dot(up, p), -dot(up, v)
    normal = k * tx.Max(depth, 0.0) * tx.Max(1 + c * sinking, 0.0)
    along = v - up * dot(up, v)
    friction = -mu * normal * along / tx.Sqrt(dot(along, along) + slip**2)
    return {p: v, v: (up * normal + friction) / m + G * DOWN}


def foot_on_soft_ground() -> Rates:
    """A body whose corner touches a soft ground: the force at the corner as a wrench on the body."""
    g, V, M = pose(), twist(), spatial_inertia()
    corner, up, k = (
        place("corner", [0.2, 0.1, -0.3]),
        fixed("up", [0.0, 0.0, 1.0], "1", "world"),
        number("k", 1e3, "N/m"),
    )
    R, height = g[:3, :3], number("height", 5.0, "m")
    place_of = lie.Act(g, corner)
    speed = R @ (lie.linear(V) + cross(lie.angular(V), corner))
    push = k * tx.Max(height - dot(up, place_of), 0.0) * up - number("c", 3.0, "N s/m") * speed
    at_body = R.T @ push
    return {
        g: V,
        V: solve(M, lie.wrench(force=at_body, torque=cross(corner, at_body)) - lie.AdjointDual(V, M @ V)),
    }


def hopper() -> Rates:
    x, z, u, v = state("x", "m"), state("z", "m"), state("u", "m/s"), state("v", "m/s")
    m, k, rest = number("m", 2.0, "kg"), number("k", 300.0, "N/m"), number("rest", 3.0, "m")
    leg = tx.Sqrt(x**2 + z**2)
    push = tx.Where(leg <= rest, k * (rest - leg), 0 * k * rest)
    return {x: u, z: v, u: push * x / (leg * m), v: push * z / (leg * m) - G}


def elastic_joint() -> Rates:
    q, motor, s, r = state("q", "rad"), state("motor", "rad"), state("s", "rad/s"), state("r", "rad/s")
    I, B, k, m, l, N = numbers("I 0.4 kg m2, B 0.02 kg m2, k 40.0 N m, m 2.0 kg, l 0.4 m, N 50.0 1")
    tau = inputs("tau", "N m")
    spring = k * (motor / N - q)
    return {q: s, motor: r, s: (spring - m * G * l * tx.Sin(q)) / I, r: (tau - spring / N) / B}


def lead_screw() -> Rates:
    x, v = state("x", "m"), state("v", "m/s")
    pitch, I, m, coulomb, soft = numbers("pitch 0.01 m, I 1e-3 kg m2, m 20.0 kg, coulomb 4.0 N, soft 0.01 m/s")
    tau = inputs("tau", "N m")
    return {x: v, v: (tau / pitch - coulomb * tx.Tanh(v / soft)) / (m + I / pitch**2)}


def train() -> Rates:
    x, v = state("x", "m"), state("v", "m/s")
    m, rolling, drag = numbers("m 4e5 kg, rolling 0.002 1, drag 9.0 kg/m")
    F = inputs("F", "N")
    slope = tx.Linterp(
        x / number("grid", 1.0, "m"), [0.0, 1.0, 3.0], tx.Parameter("slopes", value=[0.0, 0.3, 0.1], unit="1")
    )
    return {x: v, v: (F - drag * v**2) / m - G * (rolling + tx.Sin(tx.Atan(slope)))}


def acrobot_with_friction() -> Rates:
    a, b, u, v = state("a", "rad"), state("b", "rad"), state("u", "rad/s"), state("v", "rad/s")
    I1, I2, m1, m2 = numbers("I1 0.5 kg m2, I2 0.4 kg m2, m1 1.0 kg, m2 0.7 kg")
    l, c1, c2, tau = number("l", 0.6, "m"), number("c1", 0.3, "m"), number("c2", 0.4, "m"), inputs("tau", "N m")
    f1, f2 = number("f1", 0.1, "N m s"), number("f2", 0.2, "N m s")
    both = m2 * l * c2 * tx.Cos(b)
    d11, d12, d22 = I1 + I2 + m2 * l**2 + 2 * both, I2 + both, I2
    h = m2 * l * c2 * tx.Sin(b)
    p1 = -(m1 * G * c1 * tx.Sin(a) + m2 * G * (l * tx.Sin(a) + c2 * tx.Sin(a + b)))
    p2 = -m2 * G * c2 * tx.Sin(a + b)
    r1, r2 = p1 + h * v * (2 * u + v) - f1 * u, tau + p2 - h * u**2 - f2 * v
    det = d11 * d22 - d12 * d12
    return {a: u, b: v, u: (d22 * r1 - d12 * r2) / det, v: (d11 * r2 - d12 * r1) / det}


def gyroscope_on_springs() -> Rates:
    R, w, J = attitude(), vector("w", "rad/s", "body"), inertia()
    stiffness = tx.Parameter("stiffness", value=[3.0, 4.0, 5.0], kind=tx.FreeVector("body"), unit="N m")
    damping = tx.Parameter("damping", value=[0.1, 0.2, 0.3], kind=tx.FreeVector("body"), unit="N m s")
    wheel = fixed("wheel", [0.0, 0.3, 1.0], "N m s", "body")
    return {R: w, w: solve(J, -stiffness * lie.SO3Log(R) - damping * w - cross(w, J @ w + wheel))}


def hand_on_an_arm() -> Rates:
    """A payload on a moving base: relative twist and the wrench across the grip."""
    base, hand = pose("base", "world", "base"), pose("hand", "base", "hand")
    Vb, rel = twist("Vb", "base"), twist("rel", "hand", "base")
    Mb, Mh = spatial_inertia("Mb", "base"), spatial_inertia("Mh", "hand")
    tau, Wb = wrench("tau", "hand"), wrench("Wb", "base")
    Vh = lie.SE3Adjoint(lie.Inverse(hand)) @ Vb + rel
    return {
        base: Vb,
        hand: rel,
        Vb: solve(Mb, Wb - lie.SE3AdjointDual(hand) @ tau - lie.AdjointDual(Vb, Mb @ Vb)),
        rel: solve(Mh, tau - lie.AdjointDual(Vh, Mh @ Vh)),
    }


def jet_boat() -> Rates:
    x, y, yaw = state("x", "m"), state("y", "m"), state("yaw", "rad")
    u, v, r = state("u", "m/s"), state("v", "m/s"), state("r", "rad/s")
    mu, mv, I = numbers("mu 300.0 kg, mv 400.0 kg, I 500.0 kg m2")
    du, dv, dr = numbers("du 80.0 kg/s, dv 120.0 kg/s, dr 300.0 N m s")
    T, angle, arm = inputs("T", "N"), inputs("angle", "rad"), number("arm", 2.0, "m")
    return {
        x: u * tx.Cos(yaw) - v * tx.Sin(yaw),
        y: u * tx.Sin(yaw) + v * tx.Cos(yaw),
        yaw: r,
        u: (T * tx.Cos(angle) + mv * v * r - du * u) / mu,
        v: (T * tx.Sin(angle) - mu * u * r - dv * v) / mv,
        r: (-arm * T * tx.Sin(angle) - (mv - mu) * u * v - dr * r) / I,
    }


def hanging_load() -> Rates:
    """A load below a quadrotor: the direction of the cable is a vector of length one."""
    p, v = tx.State("p", shape=(3,), kind=Point("world")), vector("v", "m/s", "world")
    q, w = vector("q", "1", "world"), vector("w", "rad/s", "world")
    m, load, length = numbers("m 1.0 kg, load 0.4 kg, length 0.8 m")
    F = inputs("F", "N", "world")
    pull = (dot(q, F) - m * length * dot(w, w)) / (m + load)
    return {p: v, v: pull * q + G * DOWN, q: cross(w, q), w: -cross(q, F) / (m * length)}


def separated_bodies() -> Rates:
    """Two points that attract each other and drag through a medium at rest."""
    a, b = (tx.State(name, shape=(3,), kind=Point("world")) for name in "ab")
    m, n = numbers("m 1.0 kg, n 2.0 kg")
    u, v = vector("u", "m/s", "world"), vector("v", "m/s", "world")
    c = number("c", 0.2, "kg/s")
    big = number("big", 0.6, "m3 kg-1 s-2")
    apart = b - a
    pull = big * m * n * apart / norm(apart) ** 3
    return {a: u, b: v, u: (pull - c * u) / m, v: -(pull + c * v) / n}


MACHINES = (
    cart_and_pole_by_a_matrix,
    rotary_pendulum,
    ball_and_beam,
    crane,
    quarter_car,
    half_car,
    wheel_with_slip,
    wind_turbine,
    tank,
    gas_spring,
    heat_exchanger,
    soft_ground,
    foot_on_soft_ground,
    hopper,
    elastic_joint,
    lead_screw,
    train,
    acrobot_with_friction,
    gyroscope_on_springs,
    hand_on_an_arm,
    jet_boat,
    hanging_load,
    separated_bodies,
)
