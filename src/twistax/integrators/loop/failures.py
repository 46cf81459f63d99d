"""The error of an integration that ended early: time, states, the likely cause and a remedy.

The message is computed by NumPy from the numbers of the integration, so it does not compile anything.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from ...errors import IntegrationError, ModelError
from ...jax_inside import is_traced
from ...scalar.targets.host import on_host
from ...system.dynamics import Arrays
from ...system.inputs import is_finite
from ..charts.chart import Exponential
from ..method import Stepper
from .loop import Steps
from .outcome import LoopOutcome, Result

#: A rotation by this in a step, in rad, is the likely cause of a failure: stages may rotate further than the start.
_FAR = 2.0


def numbers(tree: Any) -> Any:
    """The pytree in arrays of NumPy, without the tracing of derivatives around known numbers."""
    return jax.tree.map(np.asarray, jax.lax.stop_gradient(tree) if is_traced(tree) else tree)


def failure(stepper: Stepper, steps: Steps, outcome: LoopOutcome, x: dict[str, Any]) -> IntegrationError:
    """The error for an integration that ended early at the state x, or a table with one row. All arguments are known
    numbers.
    """
    x = {name: value.reshape(stepper.dynamics.group.factors[name].shape) for name, value in x.items()}
    result, t, h = Result(int(outcome.code)), float(stepper.clock(outcome.t)), float(outcome.h)
    last = "last state"
    if result is Result.NON_FINITE:
        last = "last finite state"
        what, cause, fix = _not_finite_end(stepper, steps, outcome, x)
    elif result is Result.NEWTON_FAILED:
        what = f"the equations of a step of {stepper.method.name} could not be solved at t = {t:.6g} s"
        cause, fix = (text.format(h=h) for text in steps.not_solved)
    elif result is Result.MAX_CROSSINGS:
        room = steps.events.room
        what = f"more than {room} crossings of events that do not end the integration, at t = {t:.6g} s"
        cause = "conditions that cross zero often, or chatter around it"
        fix = f"tx.integrate(..., max_crossings=...), which is {room}"
    else:
        errors = on_host(_errors, stepper, steps, outcome.t, outcome.h, x) or {}
        state = max(errors, key=lambda name: float(errors[name]), default=None)
        blame = f" at t = {t:.6g} s" + (f"; state {state!r} has the largest error" if state else "")
        if result is Result.MAX_STEPS:
            what = f"the integration used all {int(outcome.tried)} steps{blame}"
            cause = f"steps are {h:.3g} s there: tight tolerances, fast rates, or a stiff system"
            fix = "looser tolerances, or more steps: control=tx.StepControl(max_steps=...)"
        else:
            what = f"no step is small enough for the tolerances{blame}"
            cause = "a jump in the rates at this time, a singularity, or a large dtmin"
            fix = "list the times of jumps in jumps=..., or use looser tolerances"
    sizes = ", ".join(f"|{name}| = {_largest(value):.3g}" for name, value in x.items())
    return IntegrationError(
        f"{what}.\n  likely cause: {cause}\n  {last}: {sizes} (largest entries)\n"
        f"  fix: {fix}; throw=False keeps the solution up to here"
    )


def _errors(stepper: Stepper, steps: Steps, t: Any, h: Any, x: dict[str, Any]) -> dict[str, jax.Array]:
    return steps.errors_by_state(stepper.in_arrays, t, h, x)


def _rates(stepper: Stepper, t: Any, h: Any, x: dict[str, Any]) -> Arrays:
    return stepper.in_arrays.field(t, h)(t, x)


def _controls(stepper: Stepper, t: Any, h: Any) -> tuple[Arrays, Arrays]:
    during = stepper.field(t, h).controls
    return during(t), during(t + h)


def _end(stepper: Stepper, t: Any, h: Any, x: dict[str, Any]) -> Arrays:
    in_arrays = stepper.in_arrays
    return in_arrays.method.step(in_arrays.field(t, h), t, x, h)


def _not_finite_end(stepper: Stepper, steps: Steps, outcome: LoopOutcome, x: dict[str, Any]) -> tuple[str, str, str]:
    """The failure of a step from x whose end is not finite, its likely cause and the fix."""
    t, h = stepper.clock(outcome.t), stepper.clock(outcome.h)
    rates = on_host(_rates, stepper, t, h, x) or {}
    # The end may be finite and the rate there not. Equations of implicit steps are not solved here.
    end = None if stepper.method.solves else on_host(_end, stepper, t, h, x)
    bad = _not_finite(end or rates) or list(end or ())
    names = f"state {', '.join(map(repr, bad))}" if bad else "a state"
    what = f"{names} became infinite or NaN in the step from t = {float(t):.6g} s"
    bad_controls = [name for values in on_host(_controls, stepper, t, h) or () for name in _not_finite(values)]
    if bad_controls:
        cause = f"control {bad_controls[0]!r} is not finite there"
        return what, cause, "check u between the start and the end of this step"
    # Of states so large that squares and cubes of them overflow, rates are not to blame.
    huge = any(_largest(v) > float(np.finfo(v.dtype).max) ** 0.25 for v in x.values())
    if _not_finite(rates) and not huge:
        cause = f"the rate of {_not_finite(rates)[0]!r} is not finite there, e.g. a division by zero"
        return what, cause, "limit the argument of the expression, or end the integration before that state"
    turns = _turns(stepper, rates, h) if rates else {}
    far = max((name for name in turns if name in bad), key=turns.__getitem__, default=None)
    if far is not None and turns[far] > _FAR:
        cause = (
            f"{far!r} rotates by about {turns[far]:.3g} rad in this step of {abs(float(h)):.6g} s, too far for a step: "
            "exponential coordinates support half a turn as polynomials, a full turn in closed form"
        )
        return what, cause, "try a smaller dt, or tx.charts.Exponential() for up to a full turn"
    cause, fix = (text.format(h=abs(float(h))) for text in steps.too_long)
    return what, cause, fix


def _not_finite(values: Mapping[str, Any]) -> list[str]:
    return [name for name, value in values.items() if not is_finite(value)]


def _largest(value: Any) -> float:
    return float(np.abs(np.asarray(value)).max())


def _turns(stepper: Stepper, rates: dict[str, Any], h: Any) -> dict[str, float]:
    """The rotation angle, rad, of each rotation and pose during a step if its rate stays constant, in exponential
    coordinates.
    """
    angular = {}
    if isinstance(getattr(stepper.method, "chart", Exponential()), Exponential) and _has_coordinates(stepper):
        for name, group in stepper.dynamics.group.factors.items():
            if group.angular.any():
                angular[name] = np.asarray(rates[name])[group.angular]
    return {name: abs(float(h)) * float(np.linalg.norm(np.asarray(w))) for name, w in angular.items()}


def _has_coordinates(stepper: Stepper) -> bool:
    try:
        return bool(stepper.coordinates.parts)
    except ModelError:
        return False
