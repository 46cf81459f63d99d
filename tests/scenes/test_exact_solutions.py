"""Closed forms against solutions by SciPy, 30-digit arithmetic and momentum balance."""

import itertools
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from scene_oracles import about, rotation_angle, scipy_solution, spinning, tumbling
from scene_references import REFERENCES

from twistax.scenes import SCENES, free_rotation, heavy_top, offset_tumble

R0 = about((1.0, 0.0, 0.0), 0.6)
#: Extended precision is a double on some machines.
EXTENDED = np.finfo(np.longdouble).eps < 1e-18


@pytest.mark.parametrize(
    ("name", "rates", "windows", "bar"),
    [
        ("euler-top", spinning((1.0, 2.0, 3.0)), [(0.0, 7.3), (0.0, 20.0), (11.0, 20.0)], 1e-12),
        ("symmetric-body", spinning((1.0, 1.0, 1.5)), [(0.0, 7.3), (0.0, 20.0)], 1e-12),
        # A relative error of 1e-16 in the rate turns by 1e-13 rad/s.
        ("fast-spin", spinning((1.0, 1.0, 1.5)), [(0.0, 0.1), (9.9, 10.0)], 1e-10),
        ("offset-tumble", tumbling(offset_tumble.CENTER, offset_tumble.INERTIA), [(0.0, 4.1), (0.0, 10.0)], 1e-12),
    ],
)
def test_the_closed_form_solves_the_equations(name: str, rates: Any, windows: Any, bar: float) -> None:
    scene = SCENES[name]
    assert scene.error(scene.start, t=0.0) < 1e-15
    for t0, t1 in windows:
        assert scene.error(scipy_solution(rates, scene.truth(t0), t0, t1), t=t1) < bar


@pytest.mark.parametrize("J", list(itertools.permutations((1.0, 2.0, 2.9))))
def test_any_order_of_moments_and_any_start(J: Any) -> None:
    """Both sides of the separatrix, both senses, starts anywhere in the period, nearly steady spins."""
    for w in (
        [2.0, 0.0, 1.5],
        [-2.0, 0.3, 1.5],
        [0.4, -2.5, -0.7],
        [0.3, -0.1, -2.0],
        [1e-9, 2.0, 1e-7],
        [0.0, 0.0, 2.0],
    ):
        body = free_rotation.TriaxialBody(np.array(J), R0, np.array(w))
        if np.argsort(J)[1] == np.argmax(np.abs(w)) and min(np.abs(w)) < 1e-3:
            continue  # tends to the unstable spin
        truth = scipy_solution(spinning(J), {"R": R0, "w": np.array(w)}, 0.0, 6.0)
        R, rate = body.at(6.0)
        assert rotation_angle(truth["R"], R) < 1e-12
        np.testing.assert_allclose(rate, truth["w"], rtol=0.0, atol=1e-12)


def test_the_euler_top_in_thirty_digits() -> None:
    """Angular velocity by Jacobi's functions, the turn about the momentum by quadrature, in mpmath."""
    with mp.workdps(30):
        J, w0 = [mp.mpf(j) for j in (1, 2, 3)], [mp.mpf(2), mp.mpf(0), mp.mpf("1.5")]
        energy = sum(j * w**2 for j, w in zip(J, w0))
        L = mp.sqrt(sum((j * w) ** 2 for j, w in zip(J, w0)))
        p = mp.sqrt((J[2] - J[1]) * (L**2 - energy * J[0]) / (J[0] * J[1] * J[2]))
        m = (J[1] - J[0]) * (energy * J[2] - L**2) / ((J[2] - J[1]) * (L**2 - energy * J[0]))
        sizes = [2, mp.sqrt((energy * J[2] - L**2) / (J[1] * (J[2] - J[1]))), mp.mpf("1.5")]

        def rate(t: Any) -> list[Any]:
            return [a * mp.ellipfun(f, p * t, m=m) for a, f in zip(sizes, ("cn", "sn", "dn"))]

        def turning(t: Any) -> Any:
            """The component along the momentum of the turning of the plane of momentum and axis 3."""
            a, b, _ = rate(t)
            return L * (J[0] * a**2 + J[1] * b**2) / ((J[0] * a) ** 2 + (J[1] * b) ** 2)

        period = 2 * mp.ellipk(m) / p
        turn = mp.quad(turning, mp.linspace(0, period, 5))
        whole = int(20 / period)
        turn = whole * turn + mp.quad(turning, mp.linspace(0, 20 - whole * period, 5))
        end = rate(20)
        n0, n1 = (np.array([float(j * w / L) for j, w in zip(J, ws)]) for ws in (w0, end))
        angle = float(mp.fmod(turn, 2 * mp.pi))

    def towards(n: Any) -> Any:
        """Axes z along the momentum and x across it and axis 3."""
        x = np.array([-n[1], n[0], 0.0]) / np.hypot(n[0], n[1])
        return np.array([x, np.cross(n, x), n])

    R = R0 @ towards(n0).T @ about((0.0, 0.0, 1.0), angle) @ towards(n1)
    truth = SCENES["euler-top"].end
    assert rotation_angle(R, truth["R"]) < 1e-14
    np.testing.assert_allclose(truth["w"], [float(w) for w in end], rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("name", ["symmetric-body", "fast-spin"])
def test_the_symmetric_body_in_thirty_digits(name: str) -> None:
    """Two exponentials of matrices, however fast."""
    scene = SCENES[name]
    with mp.workdps(30):
        w = [mp.mpf(float(x)) for x in scene.start["w"]]

        def turned(vector: Any, t: Any) -> Any:
            x, y, z = (v * t for v in vector)
            angle = mp.sqrt(x * x + y * y + z * z)
            hat = mp.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]]) / angle
            return mp.eye(3) + mp.sin(angle) * hat + (1 - mp.cos(angle)) * hat * hat

        L = [w[0], w[1], mp.mpf("1.5") * w[2]]
        own = turned([0, 0, -w[2] / 2], scene.duration)
        R = mp.matrix(scene.start["R"].tolist()) * turned(L, scene.duration) * own
        rate = own.T * mp.matrix(w)
    assert rotation_angle(np.array(R.tolist(), float), scene.end["R"]) < 3e-15
    np.testing.assert_allclose(scene.end["w"], np.array(rate.tolist(), float)[:, 0], rtol=0.0, atol=1e-14)


def test_a_sphere_like_spin_needs_no_wobble() -> None:
    """Equal moments: a steady turn about the momentum."""
    w = np.array([0.3, -0.2, 0.5])
    R, rate = free_rotation.SymmetricBody(2.0, 2.0, R0, w).at(3.0)
    size = np.linalg.norm(w)
    np.testing.assert_allclose(R, R0 @ about(w / size, 3.0 * size), atol=1e-15)
    np.testing.assert_allclose(rate, w, atol=1e-15)


def test_the_centre_of_mass_goes_straight() -> None:
    scene = SCENES["offset-tumble"]
    places = []
    for t in (0.0, 2.5, 5.0):
        g = scene.truth(t)["g"]
        places.append(g[:3, 3] + g[:3, :3] @ offset_tumble.CENTER)
    np.testing.assert_allclose(places[1], 0.5 * (places[0] + places[2]), atol=1e-14)
    assert np.linalg.norm(places[2] - places[0]) > 1.0


# ---- the heavy top ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_the_heavy_top_from_any_lean_and_phase(seed: int) -> None:
    rng = np.random.default_rng(seed)
    z = (0.0, 0.0, 1.0)
    R0 = about(z, rng.uniform(-3, 3)) @ about((1.0, 0.0, 0.0), rng.uniform(0.2, 2.8)) @ about(z, rng.uniform(-3, 3))
    w0 = rng.normal(size=3) * [1.0, 1.0, 6.0]
    truth = scipy_solution(lambda t, y: REFERENCES["heavy-top"].rates(t, y, {}), {"R": R0, "w": w0}, 0.0, 5.0)
    R, w = heavy_top.LagrangeTop(heavy_top.INERTIA[0], heavy_top.INERTIA[2], heavy_top.MOMENT, R0, w0).at(5.0)
    assert rotation_angle(truth["R"], R) < 1e-12
    np.testing.assert_allclose(w, truth["w"], rtol=0.0, atol=1e-12)


def test_the_heavy_top_against_extended_precision() -> None:
    """At the end of the short scene, which is found in another way; and its start."""
    short, long = SCENES["heavy-top"], SCENES["long-heavy-top"]
    assert short.error(long.truth(20.0)) < 1e-15
    assert short.error(long.truth(0.0), t=0.0) < 1e-15


def test_the_heavy_top_after_long_in_thirty_digits() -> None:
    """Jacobi's functions, and precession and spin by quadrature over one period, in mpmath."""
    scene = SCENES["long-heavy-top"]
    with mp.workdps(30):
        J1, J3, W = mp.mpf(heavy_top.INERTIA[0]), mp.mpf(heavy_top.INERTIA[2]), mp.mpf(heavy_top.MOMENT)
        n, w = ([mp.mpf(float(x)) for x in row] for row in (scene.start["R"][2], scene.start["w"]))
        spin, energy = J3 * w[2], J1 * (w[0] ** 2 + w[1] ** 2) / 2 + W * n[2]
        vertical = J1 * (n[0] * w[0] + n[1] * w[1]) + spin * n[2]
        # u'^2 = 2 / J1 (energy - W u)(1 - u^2) - ((vertical - spin u) / J1)^2
        cubic = [
            2 * W / J1,
            -2 * energy / J1 - (spin / J1) ** 2,
            2 * vertical * spin / J1**2 - 2 * W / J1,
            2 * energy / J1 - (vertical / J1) ** 2,
        ]
        a, b, c = sorted(mp.re(root) for root in mp.polyroots(cubic[::-1], maxsteps=200, extraprec=100, asc=True))
        rate, m = mp.sqrt(W / (2 * J1) * (c - a)), (b - a) / (c - a)
        # The top leans further at first, so that u falls.
        phase = -mp.ellipf(mp.asin(mp.sqrt((n[2] - a) / (b - a))), m)

        def cosine(t: Any) -> Any:
            return a + (b - a) * mp.ellipfun("sn", rate * t + phase, m=m) ** 2

        def precession(t: Any) -> Any:
            u = cosine(t)
            return (vertical - spin * u) / (J1 * (1 - u**2))

        period = 2 * mp.ellipk(m) / rate
        whole = int(mp.mpf(scene.duration) / period)
        rest = scene.duration - whole * period

        def over(f: Any) -> Any:
            return whole * mp.quad(f, mp.linspace(0, period, 5)) + mp.quad(f, mp.linspace(0, rest, 5))

        turned, seen = over(precession), over(lambda t: precession(t) * cosine(t))
        spun = w[2] * scene.duration - seen
        end = cosine(rest)
        angles = [float(mp.fmod(x, 2 * mp.pi)) for x in (turned, mp.acos(end), spun)]
        swinging = float(precession(rest) * mp.sqrt(1 - end**2))
        leaning = float(-mp.diff(cosine, rest) / mp.sqrt(1 - end**2))
    z = (0.0, 0.0, 1.0)
    R = about(z, angles[0]) @ about((1.0, 0.0, 0.0), angles[1]) @ about(z, angles[2])
    # Precession and spin begin at zero: the start leans about x.
    assert rotation_angle(scene.end["R"], R) < (1e-14 if EXTENDED else 1e-11)
    w_end = about(z, angles[2]).T @ np.array([leaning, swinging, 0.0]) + [0.0, 0.0, float(w[2])]
    np.testing.assert_allclose(scene.end["w"], w_end, rtol=0.0, atol=1e-14 if EXTENDED else 1e-11)
