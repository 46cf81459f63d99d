"""Phases joined at events and times, against exact flights: bouncing balls, dropped stages, turning bodies."""

import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.integrators import method

h, v, R = tx.State("h"), tx.State("v"), tx.State("R", group=tx.SO3)
pull, kept = tx.Parameter("pull", value=9.81), tx.Parameter("kept", value=0.8)
SPIN = np.array([0.3, -0.5, 1.2])
GROUND = tx.Event(h, direction=False)
START = {"h": 5.0, "v": 0.0, "R": np.eye(3)}
BOUNCE = {v: -kept * v, h: 0.0}
TIMES = np.linspace(0.0, 3.0, 31)


@functools.cache
def ball() -> tx.Dynamics:
    """Falls and turns; the energy is the same along an arc."""
    return tx.compile(tx.System({h: v, v: -pull, R: SPIN}, {"energy": pull * h + 0.5 * v * v}))


@functools.cache
def point() -> tx.Dynamics:
    """The same without the turning."""
    return tx.compile(tx.System({h: v, v: -pull}, {"energy": pull * h + 0.5 * v * v}))


def bounces(count: int, dynamics: tx.Dynamics) -> tuple[list[tx.Phase], list[dict]]:
    return [tx.Phase(dynamics, duration=10.0, event=GROUND)] * count, [BOUNCE] * (count - 1)


TOLD: list[tuple[float, float]] = []


@functools.cache
def flown() -> tx.PhasedSolution:
    phases, links = bounces(3, ball())
    told = lambda t, share: TOLD.append((t, share))  # noqa: E731
    return tx.integrate_phases(phases, START, links, rtol=1e-9, save_at=TIMES, progress=told)


def arcs(times: np.ndarray, height: float, pull: float, kept: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The heights of a bouncing ball, after an impact those of the next arc, and the times of impacts."""
    fall = np.sqrt(2.0 * height / pull)
    lengths = [fall, *(2.0 * fall * kept**k for k in range(1, count))]
    ends = np.cumsum(lengths)
    found = height - 0.5 * pull * times**2
    for k in range(1, count):
        s, speed = times - ends[k - 1], pull * fall * kept**k
        found = np.where(s >= 0.0, speed * s - 0.5 * pull * s * s, found)
    return found, ends


def test_a_ball_bounces_at_known_times_on_known_arcs() -> None:
    found = flown()
    heights, ends = arcs(TIMES, 5.0, 9.81, 0.8, 3)
    assert found.result is tx.Result.EVENT
    assert [phase.event for phase in found.phases] == [0, 0, 0]
    np.testing.assert_allclose([phase.ts[-1] for phase in found.phases], ends, rtol=1e-12)
    np.testing.assert_allclose(found.ts, TIMES)
    np.testing.assert_allclose(found.xs["h"], heights, atol=1e-10)
    np.testing.assert_allclose(found.xs["R"][-1], tx.lie.so3.exp(3.0 * SPIN), atol=1e-9)
    energies = np.array([9.81 * 5.0 * 0.64**k for k in range(3)])
    np.testing.assert_allclose(found.outputs["energy"], energies[np.searchsorted(ends, TIMES)], rtol=1e-9)
    np.testing.assert_allclose(list(found.durations.values()), np.diff(ends, prepend=0.0), rtol=1e-12)
    assert found.stats.steps == sum(phase.stats.steps for phase in found.phases)
    # Rows of a phase begin after the jump and end before the next.
    second = found["phase 1"]
    np.testing.assert_allclose([second.ts[0], second.ts[-1]], ends[:2], rtol=1e-12)
    np.testing.assert_allclose(second.xs["v"][0], -0.8 * found.phases[0].xs["v"][-1], rtol=1e-14)
    np.testing.assert_allclose(found.starts[1]["v"], second.xs["v"][0])


@pytest.mark.parametrize(
    ("how", "derivative"),
    [
        # RK4 is exact on these arcs.
        ({"steps": 40}, jax.jacrev),
        pytest.param({"steps": 40}, jax.jacfwd, marks=pytest.mark.slow),
        pytest.param({"rtol": 1e-10}, jax.jacrev, marks=pytest.mark.slow),
        pytest.param({"rtol": 1e-10}, jax.jacfwd, marks=pytest.mark.slow),
    ],
)
def test_derivatives_through_impacts_are_those_of_the_exact_flight(how: dict, derivative: Any) -> None:
    """Of the last impact's time, of states at a time before and after the first impact, of the last speed."""
    phases, links = bounces(2, point())

    def ends(q: jax.Array) -> tuple[jax.Array, jax.Array]:
        start, params = {"h": q[0], "v": 0.0 * q[0]}, {"pull": q[1], "kept": q[2]}
        found = tx.integrate_phases(phases, start, links, **how, params=params, save_at=[0.4, 1.9])
        values = jnp.array([found.phases[1].ts[-1], *found.xs["h"], found.phases[1].xs["v"][-1]])
        return values, values

    def exact(q: np.ndarray) -> np.ndarray:
        heights, times = arcs(np.array([0.4, 1.9]), *q, 2)
        return np.array([times[1], *heights, -np.sqrt(2.0 * q[0] * q[1]) * q[2]])

    q, e = np.array([5.0, 9.81, 0.8]), 1e-6
    want = np.stack([(exact(q + d) - exact(q - d)) / (2.0 * e) for d in e * np.eye(3)], axis=1)
    slopes, values = jax.jit(derivative(ends, has_aux=True))(q)
    np.testing.assert_allclose(values, exact(q), rtol=1e-9)
    np.testing.assert_allclose(slopes, want, rtol=1e-6, atol=1e-8)


@functools.cache
def stage() -> tx.Dynamics:
    """A rocket in free space, thrust along its axis while it turns about it."""
    u, mass, flow, exhaust = tx.State("u"), tx.State("mass"), tx.Parameter("flow"), tx.Parameter("exhaust")
    return tx.compile(tx.System({u: exhaust * flow / mass, mass: -flow}))


def test_stages_add_up_to_the_rocket_equation() -> None:
    """Tsiolkovsky: the sum of c log(m0/m1); a drift between, and a drop by a function of parameters."""
    system, (_, mass) = stage(), stage().states
    left = tx.Parameter("left", value=30.0)
    phases = [
        tx.Phase(system, name="first", t1=40.0, params={"flow": 2.0, "exhaust": 2500.0}),
        tx.Phase(system, name="drift", duration=5.0, params={"flow": 0.0}),
        tx.Phase(system, name="second", duration=99.0, event=tx.Event(mass <= 10.0), params={"flow": 1.0}),
    ]
    links = [lambda t, x, params: {"mass": x["mass"] - params["left"]}, {"mass": mass - 0.0 * left - 1.0}]
    params = {"exhaust": 3000.0, "left": 20.0}
    found = tx.integrate_phases(phases, {"u": 0.0, "mass": 150.0}, links, params=params, rtol=1e-10)
    speed = 2500.0 * np.log(150.0 / 70.0) + 3000.0 * np.log(49.0 / 10.0)
    np.testing.assert_allclose(found.xs["u"], [speed], rtol=1e-10)
    np.testing.assert_allclose(found["second"].ts, [45.0 + 39.0], rtol=1e-12)
    assert found.names == ("first", "drift", "second")


def test_a_phase_may_be_another_system_on_another_group() -> None:
    """A body that turns lets go of a pose: its start is built from the rotation by an expression."""
    g, rate = tx.State("g", group=tx.SE3), tx.State("rate", shape=(6,))
    free = tx.compile(tx.System({g: rate, rate: np.zeros(6)}))
    twist = np.array([1.0, 0.0, 0.0, *SPIN])
    links = [{g: tx.pose(position=tx.Concat(0.0, 0.0, h), rotation=R), rate: twist}]
    phases = [tx.Phase(ball(), duration=10.0, event=GROUND), tx.Phase(free, duration=0.5)]
    found = tx.integrate_phases(phases, START, links, rtol=1e-9)
    fall = np.sqrt(10.0 / 9.81)
    begin = np.eye(4)
    begin[:3, :3] = tx.lie.so3.exp(fall * SPIN)
    np.testing.assert_allclose(found.phases[1].xs["g"][-1], begin @ tx.lie.se3.exp(0.5 * twist), atol=1e-8)
    assert found.xs == {}
    with pytest.raises(tx.ModelError, match=r"links\[0\] has no value for 'g'"):
        tx.integrate_phases(phases, START, rtol=1e-9)


def test_phases_alike_compile_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """`Cache.get` makes every function over steps; other parameters, durations and starts make no new one."""
    dynamics = tx.compile(tx.System({h: v, v: -pull}))
    made, real = [], jax.jit
    monkeypatch.setattr(method.jax, "jit", lambda f, **how: made.append(f) or real(f, **how))
    one, loops = tx.Phase(dynamics, duration=10.0, event=GROUND), dynamics.functions.loops
    start = {"h": 1.0, "v": 0.0}
    tx.integrate_phases([one], start, rtol=1e-8)
    count, kinds = len(made), len(loops.values())
    assert count > 0
    other = tx.Phase(dynamics, duration=9.0, event=GROUND, params={"pull": 3.0}, name="other")
    links = [{"v": 4.0, "h": 0.0}, {"v": 2.0, "h": 0.0}]
    tx.integrate_phases([one, other, other], start, links, rtol=1e-8)
    assert len(made) == count
    assert len(loops.values()) == kinds
    sizes = [own._cache_size() for own in loops.values() if hasattr(own, "_cache_size")]
    assert sizes
    assert max(sizes) == 1


def test_a_batch_has_its_own_times_and_one_grid() -> None:
    phases, links = bounces(2, point())

    @jax.jit
    @jax.vmap
    def fly(height: jax.Array) -> tx.PhasedSolution:
        return tx.integrate_phases(
            phases, {"h": height, "v": 0.0}, links, steps=40, save_at=TIMES, params={"pull": 9.81}
        )

    # The third falls for longer than its phase may take.
    heights = np.array([5.0, 2.0, 600.0])
    found = fly(heights)
    assert found.result.tolist() == [tx.Result.EVENT, tx.Result.EVENT, tx.Result.NO_EVENT]
    assert found.ts.shape == (3, 31)
    for k, height in enumerate(heights[:2]):
        want, ends = arcs(TIMES, height, 9.81, 0.8, 2)
        np.testing.assert_allclose(found.phases[1].ts[k, -1], ends[-1], rtol=1e-12)
        np.testing.assert_allclose(found.xs["h"][k], np.where(ends[-1] >= TIMES, want, np.nan), atol=1e-9)
        energies = 9.81 * height * np.where(ends[0] > TIMES, 1.0, 0.64)
        np.testing.assert_allclose(found.outputs["energy"][k], np.where(ends[-1] >= TIMES, energies, np.nan))
    np.testing.assert_allclose(found.xs["h"][2], 600.0 - 0.5 * 9.81 * TIMES**2)
    assert np.isnan(found.phases[1].xs["h"][2]).all()


def test_a_phase_that_fails_is_named() -> None:
    blown = tx.compile(tx.System({h: h * h, v: 0.0}))
    first, second = tx.Phase(point(), duration=0.3, name="drop"), tx.Phase(blown, duration=5.0, name="blow up")
    with pytest.raises(tx.IntegrationError, match=r"^phase 1, 'blow up': "):
        tx.integrate_phases([first, second], {"h": 5.0, "v": 0.0}, rtol=1e-9)
    late = tx.Phase(point(), duration=0.2, event=GROUND, name="late")
    with pytest.raises(
        tx.IntegrationError, match=r"^phase 1, 'late': no event occurred before the latest end of the phase, t = 0\.5 s"
    ):
        tx.integrate_phases([first, late, late], {"h": 5.0, "v": 0.0}, rtol=1e-9)
    found = tx.integrate_phases([first, late, late], {"h": 5.0, "v": 0.0}, rtol=1e-9, throw=False)
    assert found.result is tx.Result.NO_EVENT
    assert found.names == ("drop", "late")
    np.testing.assert_allclose(found.xs["h"], [5.0 - 0.5 * 9.81 * 0.25])


def test_how_far_phases_are_is_told_as_a_share_of_all() -> None:
    end = float(flown().ts[-1]), float(flown().phases[-1].ts[-1])
    times, shares = np.array(TOLD).T
    assert (np.diff(times) >= 0.0).all()
    assert (np.diff(shares) >= 0.0).all()
    assert (times[-1], shares[-1]) == (end[1], 1.0)
    assert 0.0 < shares[0] <= 1.0 / 3.0


def test_tables_and_pictures_have_the_rows_of_all_phases(tmp_path: Path) -> None:
    flown().to_csv(tmp_path / "flight.csv")
    header, *rows = (tmp_path / "flight.csv").read_text().splitlines()
    assert header.split(",")[:4] == ["t [s]", "phase", "h", "v"]
    assert len(rows) == len(TIMES) + 5  # two at each join, one at the end; the first is a saved time
    numbers = np.array([row.split(",") for row in rows], float)
    assert (np.diff(numbers[:, 0]) >= 0.0).all()
    assert sorted(set(numbers[:, 1])) == [0.0, 1.0, 2.0]
    (axes, *_) = flown().plot(["h"]).axes
    curve = np.asarray(axes.lines[0].get_xydata())
    assert np.isnan(curve[:, 1]).sum() == 2  # gaps at the joins
    assert np.nanmin(curve[:, 1]) > -1e-9


@pytest.mark.slow
def test_dense_phases_are_known_everywhere() -> None:
    phases, links = bounces(3, point())
    found = tx.integrate_phases(phases, {"h": 5.0, "v": 0.0}, links, rtol=1e-9, dense=True)
    heights, _ = arcs(TIMES, 5.0, 9.81, 0.8, 3)
    np.testing.assert_allclose(found.evaluate(TIMES)["h"], heights, atol=1e-8)
    with pytest.raises(tx.InputError, match="those of the flight, got 9"):
        found.evaluate(9.0)


@pytest.mark.parametrize(
    ("phases", "links", "more", "message"),
    [
        ([], None, {}, "expects a list of tx.Phase"),
        ([{}], None, {}, "phase 0: a phase expects duration or t1, got neither"),
        ([{"duration": 1.0, "t1": 2.0}], None, {}, "got both"),
        ([{"duration": -1.0}], None, {}, "phase 0: the phase ends at -1, before its start"),
        ([{"duration": 1.0}] * 2, [], {}, "links expects a list of length 1"),
        ([{"duration": 1.0}] * 2, [{"w": 1.0}], {}, r"links\[0\] names 'w'"),
        ([{"duration": 1.0}] * 2, [{v: tx.Control("F")}], {}, "reads Control 'F'"),
        ([{"duration": 1.0}] * 2, [{v: np.ones(3) * h}], {}, r"expects shape \(\)"),
        ([{"duration": 1.0}] * 2, [{R: 2.0 * R}], {}, "phase 1: .*not an element of SO3"),
        ([{"duration": 1.0}], None, {"params": {"weight": 1.0}}, "unknown key 'weight' in params"),
        ([{"duration": 1.0}], None, {"u": {"F": 1.0}}, "unknown key 'F' in u"),
        ([{"duration": 1.0}], None, {"save_at": [-1.0]}, "save_at must lie inside"),
    ],
)
def test_what_makes_no_sense_is_refused(phases: list, links: Any, more: dict, message: str) -> None:
    given = [tx.Phase(ball(), **own) for own in phases]
    with pytest.raises(tx.TwistaxError, match=message):
        tx.integrate_phases(given, START, links, **{"rtol": 1e-9, **more})
