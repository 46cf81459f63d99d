"""The stored ends: found again in extended precision, by SciPy, and where there is one by a formula."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scene_oracles import about, rotation_angle, scipy_solution
from scene_references import REFERENCES, extrapolated, main
from scipy import special

from twistax.scenes import SCENES, check_cases, free_rotation, heavy_top, spring_bodies

#: Extended precision is a double on some machines.
EXTENDED = np.finfo(np.longdouble).eps < 1e-18
#: Those that are not stiff.
SMOOTH = [name for name, reference in REFERENCES.items() if reference.fastest is None]


def test_every_scene_without_a_closed_form_is_here() -> None:
    assert set(REFERENCES) == {name for name, scene in SCENES.items() if scene.exact is None}


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow) if n in ("spring-bodies", "spinning-satellite") else n for n in SMOOTH],
)
def test_the_stored_end_is_what_the_command_finds(name: str) -> None:
    """With two thirds of the steps the stored digits were found with."""
    # Round-off turns the satellite by more.
    bar = 2e-13 if name == "spinning-satellite" else 1e-15
    assert SCENES[name].error(REFERENCES[name].end(SCENES[name])) < (bar if EXTENDED else 1e3 * bar)


#: How much a solution in doubles may lose: the bodies on springs amplify an error some hundred times.
LOSSES = {
    "heavy-top": 5e-12,
    "rocket": 1e-12,
    "low-orbit": 1e-12,
    "spinning-satellite": 1e-9,
    "spring-bodies": 2e-11,
    "tumbling-brick": 1e-12,
}


#: Among the slow tests.
LONG = ("spinning-satellite", "spring-bodies")


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in LONG else n for n in SMOOTH])
def test_another_integrator_ends_there_too(name: str) -> None:
    scene = SCENES[name]
    end = scipy_solution(lambda t, y: REFERENCES[name].rates(t, y, scene.params), scene.start, 0.0, scene.duration)
    assert scene.error(end) < LOSSES[name]


def test_extrapolation_has_order_sixteen() -> None:
    """y'' = -y, in steps that leave an error far above round-off."""
    start = np.array([1, 0], np.longdouble)

    def error(steps: int) -> float:
        end = extrapolated(lambda t, y: np.array([y[1], -y[0]]), start, 24.0, steps)
        return float(np.linalg.norm(np.float64(end - [np.cos(np.longdouble(24)), -np.sin(np.longdouble(24))])))

    assert np.log2(error(12) / error(24)) == pytest.approx(16.0, abs=0.5)


def test_the_heavy_top_by_elliptic_functions() -> None:
    """u = cos(lean) by Jacobi's sn; precession and spin are integrals of functions of u. No equation is stepped."""
    (J1, _, J3), weight = heavy_top.INERTIA, heavy_top.MOMENT
    scene = SCENES["heavy-top"]
    w0, lean = scene.start["w"], 0.6
    u0, spin = np.cos(lean), J3 * w0[2]
    vertical = J1 * w0[1] * np.sin(lean) + spin * u0
    energy = 0.5 * J1 * (w0[0] ** 2 + w0[1] ** 2) + weight * u0

    # u'^2 = 2 / J1 (energy - weight u)(1 - u^2) - ((vertical - spin u) / J1)^2 = 2 weight / J1 (u - a)(u - b)(u - c)
    cubic = np.polymul([-2.0 * weight / J1, 2.0 * energy / J1], [-1.0, 0.0, 1.0])
    cubic = np.polysub(cubic, np.polymul([-spin / J1, vertical / J1], [-spin / J1, vertical / J1]))
    a, b, c = np.sort(np.roots(cubic).real)
    assert -1.0 < a < u0 < b < 1.0 < c
    rate, m = np.sqrt(0.5 * weight / J1 * (c - a)), (b - a) / (c - a)
    # Leaning further at the start: u falls, so that sn and cn have opposite signs.
    phase = -special.ellipkinc(np.arcsin(np.sqrt((u0 - a) / (b - a))), m)

    def cosine(t: Any) -> Any:
        return a + (b - a) * special.ellipj(rate * t + phase, m)[0] ** 2

    nodes, weights = np.polynomial.legendre.leggauss(20)
    edges = np.linspace(0.0, scene.duration, 201)
    half = 0.5 * (edges[1] - edges[0])
    ts = (0.5 * (edges[:-1] + edges[1:]))[:, None] + half * nodes
    u = cosine(ts)
    precession = (vertical - spin * u) / (J1 * (1.0 - u**2))
    turned = half * np.sum(precession @ weights)
    spun = half * np.sum((w0[2] - precession * u) @ weights)

    lean = np.arccos(cosine(scene.duration))
    upright, nodal = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    R = about(upright, turned) @ about(nodal, lean) @ about(upright, spun)
    assert rotation_angle(scene.end["R"], R) < 1e-12
    sn, cn, dn, _ = special.ellipj(rate * scene.duration + phase, m)
    leaning = -2.0 * (b - a) * rate * sn * cn * dn / np.sin(lean)
    swinging = (vertical - spin * np.cos(lean)) / (J1 * np.sin(lean))
    w = about(upright, spun).T @ np.array([leaning, swinging, 0.0]) + [0.0, 0.0, w0[2]]
    np.testing.assert_allclose(scene.end["w"], w, atol=1e-12)


def test_the_brick_turns_as_an_euler_top() -> None:
    scene, body = SCENES["tumbling-brick"], check_cases.CASES[2]
    top = free_rotation.TriaxialBody(np.array(body.inertia), scene.start["g"][:3, :3], np.array(body.rate))
    R, w = top.at(scene.duration)
    assert rotation_angle(R, scene.end["g"][:3, :3]) < 1e-14
    np.testing.assert_allclose(scene.end["V"][3:], w, rtol=0.0, atol=1e-15)


def test_the_brick_ends_where_the_published_simulations_do() -> None:
    """Two of them integrate finely enough; all agree on the fall."""
    end, published = SCENES["tumbling-brick"].end, {p.simulation: p for p in check_cases.CASES[2].published}
    np.testing.assert_allclose(end["V"][3:], published["04"].rate, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(end["g"][:3, 3], published["04"].position, rtol=0.0, atol=1e-4)


def test_the_rocket_loses_the_mass_it_burns() -> None:
    """The roll stands alone, since the moments about the other two axes are equal, and has a closed form."""
    end = SCENES["rocket"].end
    assert end["m"] == pytest.approx(1.0, abs=1e-15)
    # 0.1 m w' = 0.05 - 0.05 w + 0.01 w and m' = -0.1 are dw/ds = 5 - 4 w in s = ln(2 / m).
    assert end["V"][3] == pytest.approx(1.25 * (1.0 - 2.0**-4), abs=1e-15)


def test_the_springs_keep_what_they_must() -> None:
    """Energy and both momenta of the stored end, summed up body by body in NumPy."""

    def kept(x: Any) -> Any:
        energy, linear, angular = 0.0, np.zeros(3), np.zeros(3)
        before, after = spring_bodies.POINTS
        for i in range(4):
            g, V = x[f"g{i + 1}"], x[f"V{i + 1}"]
            m, J = spring_bodies.MASSES[i % 3], np.array(spring_bodies.MOMENTS[i % 3])
            R, p, v, w = g[:3, :3], g[:3, 3], V[:3], V[3:]
            energy += 0.5 * m * v @ v + 0.5 * w @ (J * w)
            linear = linear + m * R @ v
            angular = angular + np.cross(p, m * R @ v) + R @ (J * w)
            if i < 3:
                h = x[f"g{i + 2}"]
                d = np.linalg.norm(h[:3, :3] @ before + h[:3, 3] - R @ after - p)
                energy += 0.5 * spring_bodies.STIFFNESS * (d - spring_bodies.LENGTH) ** 2
        return np.concatenate([[energy], linear, angular])

    scene = SCENES["spring-bodies"]
    np.testing.assert_allclose(kept(scene.end), kept(scene.start), rtol=0.0, atol=1e-14)
    apart = scene.end["g2"][:3, 3] - scene.start["g2"][:3, 3]
    assert np.linalg.norm(apart) > 0.5


def test_the_command_prints_the_end(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(REFERENCES, "rocket", dataclasses.replace(REFERENCES["rocket"], steps=40))
    assert main(["rocket"]) == 0
    said, *lines = capsys.readouterr().out.splitlines()
    assert said.startswith("# rocket: 40 and 60 steps are")
    found = eval("{" + "\n".join(lines) + "}", {"np": np})
    assert SCENES["rocket"].error(found) < 1e-13


def test_the_command_knows_its_scenes(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["euler-top"])
    assert "no scene 'euler-top' here" in capsys.readouterr().err
