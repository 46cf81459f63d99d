"""The laws of a scene: its initial state, its exact solution and its equations describe the same motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from ..errors import InputError
from ..integrators import RKMK, ImplicitRKMK
from ..integrators.tableaus import DOP853, RADAU_IIA9
from ..progress import watching
from .laws import STENCIL, STEP, Check, difference_quotient


@watching("check_scene")
def check_scene(scene: Any, *, stiff: bool = False, tolerance: float = 1e-8, **options: Any) -> None:
    """Check that the exact solution of a scene is the motion of its system from its initial state.

    It checks that start, end, params and invariants have the names and shapes of the system, and that elements are in
    their groups; that a closed form begins at the start and has the rates of the system, $x'(t) = f(t, x(t))$, at times
    in between; that an integration conserves the invariants, and ends at the exact solution, in the scene's units.

    Args:
        scene: a `twistax.scenes.Scene`.
        stiff: whether to integrate by Radau IIA 9 in place of DOP853.
        tolerance: tolerance of the final state, as measured by `scene.error`, and of invariants relative to their size.
        options: options of `scene.integrate`; rtol = atol = 1e-10 by default.
    Raises:
        LawError: a law is violated. The message names the law, the values and the likely cause.
        InputError: `scene` is not a scene.
    Example: `tx.testing.check_scene(SCENES["euler-top"])`.
    """
    if not all(hasattr(scene, name) for name in ("build", "start", "duration", "error", "integrate")):
        raise InputError(f"check_scene expects a scene such as SCENES['euler-top'], got {scene!r}")
    check = Check(f"the scene {scene.name!r}")
    with jax.enable_x64(True):
        _check_names(check, scene)
        if scene.exact is not None and (scene.u is None or isinstance(scene.u, Mapping)):
            _check_closed_form(check, scene)
        arguments = options or {"rtol": 1e-10, "atol": 1e-10}
        method = ImplicitRKMK(RADAU_IIA9) if stiff else RKMK(DOP853)
        times = np.linspace(0.0, scene.duration, 5)
        solution = scene.integrate(**{"method": method, "save_at": times, **arguments})
        end = {name: np.asarray(values[-1]) for name, values in solution.xs.items()}
        off = scene.error(end)
        message = f"the integration ends {off:.3g} from it, where {tolerance:g} is allowed"
        check.holds(
            "the end is where the system leads", off <= tolerance, message, "look at build, start, and the truth"
        )
        _check_invariants(check, scene, solution, tolerance)


def _check_names(check: Check, scene: Any) -> None:
    system, fix = scene.system, "give the names that the system has"
    states = {state.name: state for state in system.states}
    for what, values in (("start", scene.start), ("end", scene.end)):
        message = f"got {sorted(values)} for {sorted(states)}"
        check.holds(f"{what} has all states", set(values) == set(states), message, fix)
        for name, value in values.items():
            message = f"{name!r} has shape {np.shape(value)} for {states[name].shape}"
            check.holds(f"{what} has the shapes of the states", np.shape(value) == states[name].shape, message, fix)
            group = states[name].group
            defect = 0.0 if group.flat else group.known_defect(np.asarray(value, float))
            check.close(f"{what} is in its group", defect, 0.0, 1e-9, f"look at {name!r} of {what}")
    parameters = {parameter.name for parameter in system.parameters}
    message = f"got {sorted(scene.params)} for {sorted(parameters)}"
    check.holds("params are those of the system", set(scene.params) <= parameters, message, fix)
    unknown = sorted(set(scene.invariants) - set(system.outputs))
    check.holds("invariants are outputs of the system", not unknown, f"there is no output {unknown}", fix)
    for word in ("name", "title", "summary", "source"):
        check.holds(f"a scene has a {word}", getattr(scene, word), "it is empty", f"give {word}=")


def _check_closed_form(check: Check, scene: Any) -> None:
    """Its beginning, and its rates at times along the way, by differences."""
    groups = {state.name: state.group for state in scene.system.states}
    exact = lambda t: {name: np.asarray(value, float) for name, value in scene.exact(t).items()}  # noqa: E731
    for name, value in exact(0.0).items():
        start = np.asarray(scene.start[name])
        size = max(1.0, np.abs(start).max(initial=0.0))
        check.close("the closed form begins at the start", value, start, 1e-12 * size, f"look at {name!r} of exact(0)")
    for share in (0.1, 0.37, 0.9):
        t = share * scene.duration
        here = exact(t)
        rates = scene.dynamics(t, here, scene.u, dict(scene.params) or None)
        # So short that fast motion is smooth in a step.
        fastest = max(1.0, *(float(np.abs(np.asarray(rate)).max(initial=0.0)) for rate in rates.values()))
        near = [exact(t + i * STEP / fastest) for i in STENCIL]
        for name, group in groups.items():
            rate = np.asarray(group.entry_rate(jax.numpy.asarray(here[name]), rates[name]))
            slope = difference_quotient([x[name] for x in near]) * fastest
            size = max(1.0, np.abs(rate).max(initial=0.0), np.abs(here[name]).max(initial=0.0) * fastest)
            law = "x'(t) = f(t, x(t)) for the closed form"
            check.close(law, slope, rate, 1e-8 * size, f"look at {name!r} of exact and of build", {"t": t})


def _check_invariants(check: Check, scene: Any, solution: Any, tolerance: float) -> None:
    for name in scene.invariants:
        values = np.asarray(solution.outputs[name])
        size = max(1.0, np.abs(values).max(initial=0.0))
        fix = f"look at the output {name!r}, or leave it out of invariants"
        first = np.broadcast_to(values[:1], values.shape)
        check.close(f"{name} stays as it is", values, first, 10.0 * tolerance * size, fix)
