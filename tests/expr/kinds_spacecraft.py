"""Right models of craft in orbit and beyond the air, whose leaves all say what they are."""

from kinds_models import (
    Momentum,
    Rates,
    attitude,
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
    vector,
)
from kinds_vehicles import norm, place, point, pose, twist, wrench

import twistax as tx


def detumbling() -> Rates:
    R, w, J = attitude(), vector("w", "rad/s", "body"), inertia()
    field, gain = fixed("field", [2.0, 1.0, 3.0], "kg/s2", "world"), number("gain", 0.3, "m2 s3/kg")
    b = R.T @ field
    return {R: w, w: solve(J, cross(gain * cross(b, w), b) - cross(w, J @ w))}


def control_moment_gyro() -> Rates:
    R, w, J, angle = attitude(), vector("w", "rad/s", "body"), inertia(), state("angle", "rad")
    h, speed = number("h", 0.8, "N m s"), inputs("speed", "rad/s")
    a, b = fixed("a", [1.0, 0.0, 0.0], "1", "body"), fixed("b", [0.0, 0.6, 0.8], "1", "body")
    along, across = a * tx.Cos(angle) + b * tx.Sin(angle), b * tx.Cos(angle) - a * tx.Sin(angle)
    return {R: w, angle: speed, w: solve(J, -h * speed * across - cross(w, J @ w + h * along))}


def gyro_with_bias() -> Rates:
    R, bias = attitude(), vector("bias", "rad/s", "body")
    measured, tau = inputs("measured", "rad/s", "body"), number("tau", 60.0, "s")
    up, seen, gain = fixed("up", [0.0, 0.1, 1.0], "1", "world"), inputs("seen", "1", "body"), number("gain", 0.4, "1/s")
    return {R: measured - bias + gain * cross(seen, R.T @ up), bias: -bias / tau}


def oblate_orbit() -> Rates:
    p, v, mu = point("p", "inertial"), vector("v", "m/s", "inertial"), number("mu", 3.9, "m3/s2")
    J2, radius = numbers("J2 0.3 1, radius 0.9 m")
    axis = fixed("axis", [0.0, 0.0, 1.0], "1", "inertial")
    d = norm(p)
    up = dot(axis, p) / d
    oblate = 3 * J2 * (radius / d) ** 2 / 2 * (p * (5 * up**2 - 1) - 2 * axis * up * d)
    return {p: v, v: mu / d**3 * (oblate - p)}


def relative_orbit() -> Rates:
    x, y, u, v = state("x", "m"), state("y", "m"), state("u", "m/s"), state("v", "m/s")
    n, ax, ay = number("n", 0.4, "rad/s"), inputs("ax", "m/s2"), inputs("ay", "m/s2")
    return {x: u, y: v, u: 3 * n**2 * x + 2 * n * v + ax, v: ay - 2 * n * u}


def docking() -> Rates:
    """Two craft: the pose of b in a, and the momentum of each."""
    T = pose("T_ab", "a", "b")
    Va, Vb, Ma, Mb = twist("Va", "a"), twist("Vb", "b"), spatial_inertia("Ma", "a"), spatial_inertia("Mb", "b")
    Wa, Wb, grip = wrench("Wa", "a"), wrench("Wb", "b"), wrench("grip", "b")
    return {
        T: Vb - lie.SE3Adjoint(lie.Inverse(T)) @ Va,
        Va: solve(Ma, Wa - lie.SE3AdjointDual(T) @ grip - lie.AdjointDual(Va, Ma @ Va)),
        Vb: solve(Mb, Wb + grip - lie.AdjointDual(Vb, Mb @ Vb)),
    }


def docking_by_poses() -> Rates:
    """Both craft in the world, a spring between a port of each."""
    ga, gb = pose("ga", "world", "a"), pose("gb", "world", "b")
    Va, Vb, Ma, Mb = twist("Va", "a"), twist("Vb", "b"), spatial_inertia("Ma", "a"), spatial_inertia("Mb", "b")
    pa, pb = place("pa", [0.3, 0.1, 0.0], "a"), place("pb", [-0.2, 0.0, 0.1], "b")
    k = number("k", 20.0, "N/m")
    T_ab = lie.Compose(lie.Inverse(ga), gb)
    pull = k * (lie.Act(T_ab, pb) - pa)
    on_a = lie.wrench(force=pull, torque=cross(pa, pull))
    back = -(T_ab[:3, :3].T @ pull)
    on_b = lie.wrench(force=back, torque=cross(pb, back))
    return {
        ga: Va,
        gb: Vb,
        Va: solve(Ma, on_a - lie.AdjointDual(Va, Ma @ Va)),
        Vb: solve(Mb, on_b - lie.AdjointDual(Vb, Mb @ Vb)),
    }


def line_of_sight() -> Rates:
    """A pursuer by proportional navigation."""
    r, v, speed = point("r", "inertial"), vector("v", "m/s", "inertial"), number("speed", 3.0, "m/s")
    N, aim = number("N", 4.0, "1"), vector("aim", "1", "inertial")
    turn = cross(r, v) / dot(r, r)
    return {r: v, v: -N * speed * cross(turn, r / norm(r)), aim: cross(turn, aim)}


def momentum_pair() -> Rates:
    """Momentum states of two bodies that push each other."""
    g, T = pose("g", "world", "a"), pose("T", "a", "b")
    ha = tx.State("ha", shape=(6,), kind=Momentum("a"))
    hb = tx.State("hb", shape=(6,), kind=Momentum("b"))
    Ma, Mb, push = spatial_inertia("Ma", "a"), spatial_inertia("Mb", "b"), wrench("push", "b")
    Va, Vb = solve(Ma, ha), solve(Mb, hb)
    return {
        g: Va,
        T: Vb - lie.SE3Adjoint(lie.Inverse(T)) @ Va,
        ha: -(lie.SE3AdjointDual(T) @ push) - lie.AdjointDual(Va, ha),
        hb: push - lie.AdjointDual(Vb, hb),
    }


def reentry() -> Rates:
    r, lon, V, path = state("r", "m"), state("lon", "rad"), state("V", "m/s"), state("path", "rad")
    mu, radius, rho0 = number("mu", 4.0, "m3/s2"), number("radius", 1.0, "m"), number("rho0", 1.2, "kg/m3")
    H = number("H", 0.7, "m")
    m, S, cd, cl = number("m", 5.0, "kg"), number("S", 0.8, "m2"), number("cd", 1.3, "1"), number("cl", 0.4, "1")
    bank = inputs("bank", "rad")
    rho = rho0 * tx.Exp(-(r - radius) / H)
    load = rho * V**2 * S / (2 * m)
    return {
        r: V * tx.Sin(path),
        lon: V * tx.Cos(path) / r,
        V: -load * cd - mu * tx.Sin(path) / r**2,
        path: load * cl * tx.Cos(bank) / V + (V / r - mu / (V * r**2)) * tx.Cos(path),
    }


SPACECRAFT = (
    detumbling,
    control_moment_gyro,
    gyro_with_bias,
    oblate_orbit,
    relative_orbit,
    docking,
    docking_by_poses,
    line_of_sight,
    momentum_pair,
    reentry,
)
