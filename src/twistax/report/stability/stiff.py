"""Steps far longer than the fastest time constant of a system, and rotations of more than a full turn in a step."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...integrators import Method
from ...scenes import SCENES, Scene, actuator_lag, stiff_attitude
from ...scenes.scene import about, rotation_angle
from ..figures.derivatives import fourth_order, weighted_end
from ..harness.expected import Expected, at_most, between, ends, simulated
from ..harness.measurement import MeasuredCase, Section, quick, slow
from ..harness.rows import plain

_HOLD, _LAG, _JOINT = stiff_attitude.STIFF_ATTITUDE, actuator_lag.ACTUATOR_LAG, SCENES["stiff-joint"]
_RADAU, _GAUSS = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5), tx.ImplicitRKMK(tx.tableaus.GAUSS_LEGENDRE6)
_DOP853, _TSIT5 = tx.RKMK(tx.tableaus.DOP853), tx.RKMK(tx.tableaus.TSIT5)
_NAMES: dict[Method, str] = {_RADAU: "Radau IIA 5", _GAUSS: "Gauss-Legendre 6", _DOP853: "DOP853"}


def _end(scene: Scene, of: Scene, method: Method = _RADAU, **options: Any) -> dict[str, Any]:
    """The end of a scene, integrated with the compiled system of another that differs in parameters alone."""
    sol = simulated(of.dynamics, scene.start, t1=scene.duration, params=scene.params, method=method, **options)
    return {name: value[-1] for name, value in sol.xs.items()}


def _error(scene: Scene, of: Scene, **options: Any) -> float:
    return scene.error(_end(scene, of, **options))


def _held(rate: float, what: str, method: Method, expected: Expected, **how: Any) -> MeasuredCase:
    """The error of the attitude hold at a rate, rad; one system, so that every rate is the same compiled program."""
    what, scene = f"rate {plain(rate)}/s, {what}", stiff_attitude.scene(rate)
    return quick(what, _NAMES[method], expected, _error, scene, _HOLD, method=method, **how)


def _long(rate: float, dt: float, method: Method, expected: Expected, slow: bool = False) -> MeasuredCase:
    what, line = f"steps of {dt:g} s: step x rate {plain(rate * dt)}", f"{_NAMES[method]}, steps of {dt:g} s"
    return _held(rate, what, method, expected, slow=slow, place=(line, rate * dt), dt=dt)


def _order_at(rate: float) -> float:
    scene = stiff_attitude.scene(rate)
    return float(np.log2(_error(scene, _HOLD, dt=0.1) / _error(scene, _HOLD, dt=0.05)))


def _slow(what: str, expected: Expected, *how: Any, **options: Any) -> MeasuredCase:
    return slow(what, "Radau IIA 5", expected, *how, **options)


_FINE, _MANY_STEPS = "rtol 1e-8", {"rtol": 1e-8, "control": tx.StepControl(max_steps=10**6)}

STIFF: Section = [
    "An L-stable method steps over what has died out: its steps follow the slow motion, however fast the rest.",
    *(_held(rate, "rtol 1e-8", _RADAU, at_most(1e-8), rtol=1e-8) for rate in stiff_attitude.RATES),
    "The error is that of the slow motion; it does not grow with the rate.",
    *(_long(rate, 0.05, _RADAU, at_most(1e-7), slow=True) for rate in stiff_attitude.RATES),
    *(_long(rate, 1.0, _RADAU, at_most(1e-3), slow=True) for rate in stiff_attitude.RATES),
    "Inside of its region of stability an explicit method is as accurate as its order makes it.",
    *(_long(rate, 5e-3, _DOP853, at_most(1e-8)) for rate in (1e2, 1e3)),
    "Outside of its region of stability every step multiplies what should die out, until it overflows.",
    *(_long(rate, 5e-3, _DOP853, ends(tx.Result.NON_FINITE)) for rate in (1e4, 1e8)),
    "An explicit method that chooses its steps stays right, with steps of 1e-8 s, and runs out of them.",
    _held(1e8, "rtol 1e-8", _DOP853, ends(tx.Result.MAX_STEPS), slow=True, rtol=1e-8),
    "Stiffness may lower the order to that of the stages, 3; on this one it stays at 5.",
    _slow("rate 1e8/s, order seen between steps of 0.1 and 0.05 s", between(4.0), _order_at, 1e8),
    "Gauss methods are A-stable but do not damp: what should die out stays as large as it was, and no larger.",
    _held(1e8, "steps of 0.05 s", _GAUSS, at_most(1.0), slow=True, dt=0.05),
    "A pose with lags of its own: the same L-stable steps.",
    *(
        _slow(f"actuators with a lag of {plain(lag)} s, {_FINE}", at_most(1e-7), _error, scene, _LAG, rtol=1e-8)
        for lag, scene in ((lag, actuator_lag.scene(lag)) for lag in actuator_lag.LAGS)
    ),
    "Every error of 1e-8 in a position is a pull of 1 N: the hardest of these, and the error says so.",
    _slow(f"two bodies on a joint of 1e8 N/m, {_FINE}", at_most(1e-5), _error, _JOINT, _JOINT, **_MANY_STEPS),
]

_RUNS = [(rate, tol) for rate in stiff_attitude.RATES for tol in (1e-4, 1e-6, 1e-8, 1e-10)]


def _off(rate: float, reference: Any = None, **steps: Any) -> float:
    """The largest difference of an entry of the attitude hold."""
    scene = stiff_attitude.scene(rate)
    end, wanted = _end(scene, _HOLD, **steps), reference or scene.reference or {}
    return max(float(np.abs(np.asarray(end[name]) - value).max()) for name, value in wanted.items())


def order_seen(rate: float) -> float:
    """The slope of log error over log step with some numbers of equal steps."""
    counts, scene = (32, 45, 64, 90) if rate == 1.0 else (40, 80, 160), stiff_attitude.scene(rate)
    reference = scene.reference or _end(scene, _HOLD, _TSIT5, rtol=3e-14)
    errors = [_off(rate, reference, steps=count) for count in counts]
    return float(-np.polyfit(np.log(counts), np.log(errors), 1)[0])


def _gradient() -> float:
    """Reverse mode, by the start and log k, against differences, relative to the largest entry, the worst of all."""
    options: dict[str, Any] = {"rtol": 1e-11, "atol": 1e-11, "control": tx.StepControl(max_steps=2048)}

    def cost(z: jax.Array, rate: jax.Array) -> jax.Array:
        return weighted_end(_HOLD, z[:6], t1=1.0, method=_RADAU, params={"k": rate * jnp.exp(z[6])}, **options)

    run, gradient, worst = jax.jit(cost), jax.jit(jax.grad(cost)), []
    for rate in map(jnp.asarray, stiff_attitude.RATES):
        reverse, wanted = gradient(jnp.zeros(7), rate), fourth_order(functools.partial(run, rate=rate), 7, 2e-3)
        worst.append(float(jnp.abs(reverse - wanted).max() / jnp.abs(reverse).max()))
    return float(np.max(worst))


_ALL = "rates 1e2 to 1e8, rtol 1e-4 to 1e-10, 28 runs: error over tolerance, worst"
_SLOPES = "gradient against differences, rates 1e2 to 1e8: worst"

STIFFNESS: Section = [
    _slow(_ALL, at_most(1.0), lambda: max(_off(rate, rtol=tol) / tol for rate, tol in _RUNS)),
    quick("five steps of 1 s at rate 1e8: error", "Radau IIA 5", at_most(0.05), _off, 1e8, steps=5),
    _slow("order at rate 1, equal steps", between(4.8, 5.2), order_seen, 1.0),
    _slow(_SLOPES, at_most(1e-6), _gradient),
    "Where the rate times the step is neither small nor large the order is lower, as that of the stages is 3.",
    *(_slow(f"order at rate {plain(rate)}", between(), order_seen, rate) for rate in (1e2, 1e3, 1e4, 1e5)),
]

#: The body turns at 1 rad/s about an axis that leans by LEAN rad and goes round in the body at ROUND rad/s.
LEAN, ROUND = 0.3, 0.05
_STEPS = 20
_POLYNOMIALS = "polynomials (the default)"
_METHODS = {
    _POLYNOMIALS: _DOP853,
    "closed form": tx.RKMK(tx.tableaus.DOP853, tx.charts.Exponential()),
    "quaternion": tx.RKMK(tx.tableaus.DOP853, tx.charts.Ambient()),
    "Magnus 6": tx.Magnus(6),
}
#: Turns in a step, rad, and the largest error after 20 of them, rad, some ten times what was seen; None where the
#: chart ends.
_TURNS = (0.1, 0.5, 1.0, 2.0, 3.0, 3.3, 4.0, 5.0, 6.0, 7.0)
_BARS: dict[str, tuple[float | None, ...]] = {
    _POLYNOMIALS: (1e-14, 2e-11, 1e-8, 6e-6, 7e-5, *5 * (None,)),
    "closed form": (1e-14, 1e-12, 2e-10, 1e-7, 5e-6, 2e-5, 4e-4, 2e-2, np.pi, None),
    "quaternion": (1e-14, 1e-10, 5e-8, 3e-5, 1e-3, 2e-3, 1e-2, 6e-2, 0.2, 0.3),
    "Magnus 6": (1e-11, 1e-7, 8e-6, 6e-4, 3e-3, 6e-3, 6e-2, 0.4, np.pi, None),
}


@functools.cache
def _coning() -> tx.Dynamics:
    R, t = tx.State("R", group=tx.SO3), tx.Time()
    side = np.sin(LEAN)
    return tx.compile(tx.System(rates={R: tx.Concat(side * tx.Cos(ROUND * t), side * tx.Sin(ROUND * t), np.cos(LEAN))}))


def exact(t: float) -> Any:
    """R(t) = Exp(t (w(0) + n)) Exp(-t n), n = ROUND e_z: in axes that go round with it, the axis stands still."""
    steady = np.array([np.sin(LEAN), 0.0, np.cos(LEAN) + ROUND])
    size = np.linalg.norm(steady)
    return about(steady / size, size * t) @ about((0.0, 0.0, 1.0), -ROUND * t)


def _turned(label: str, duration: float, **steps: Any) -> float:
    sol = simulated(_coning(), {"R": np.eye(3)}, t1=duration, method=_METHODS[label], **steps)
    return rotation_angle(exact(duration), np.asarray(sol.xs["R"][-1]))


def _why(label: str, bar: float | None) -> str:
    if bar is None:
        most = "half a turn" if label == _POLYNOMIALS else "a full turn"
        return f"Exponential coordinates hold {most} in a step; beyond, it ends and the message names the turn."
    if label == "quaternion":
        return "Plain numbers have no edge: a step that is too long is as wrong as the tableau makes it, in the group."
    if bar == np.pi:
        return "So near to a full turn the coordinates all but end: the answer is wrong, as a smaller step would show."
    return "The coordinates hold the step; the error is that of the method, as for any long step."


def _turn(label: str, turn: float, bar: float | None) -> MeasuredCase:
    what, by = f"{turn:g} rad a step, {_STEPS} steps", label if label == "Magnus 6" else f"DOP853, {label}"
    expected = ends(tx.Result.NON_FINITE, before=0.0) if bar is None else at_most(bar, "rad")
    return quick(what, by, expected, _turned, label, _STEPS * turn, steps=_STEPS, place=(label, turn))


_AGAIN = "200 rad, rtol 1e-9, first step of 7 s"

TURNING: Section = [
    *(
        item
        for label, bars in _BARS.items()
        for turn, bar in zip(_TURNS, bars, strict=True)
        for item in (_why(label, bar), _turn(label, turn, bar))
    ),
    "Steps chosen by tolerances are taken back where the chart ends, and made shorter.",
    quick(_AGAIN, "DOP853", at_most(1e-7, "rad"), _turned, _POLYNOMIALS, 200.0, rtol=1e-9, dt=7.0),
]
