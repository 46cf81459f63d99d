"""Every scene, integrated: it ends where it must, and keeps what it must."""

from typing import Any

import numpy as np
import pytest
from scene_oracles import scipy_solution
from scene_references import REFERENCES

import twistax as tx
from twistax.scenes import SCENES, Scene, spring_bodies

METHOD = tx.RKMK(tx.tableaus.DOP853)

#: Step in s, largest error, and largest change of an invariant in its unit, all some ten times what round-off leaves:
#: 1.5e4 rad are turned in the fast spin, and the bodies on springs amplify what is lost.
BARS = {
    "euler-top": (0.02, 2e-13, 1e-13),
    "symmetric-body": (0.02, 2e-13, 1e-13),
    "heavy-top": (0.01, 2e-13, 1e-13),
    "offset-tumble": (0.02, 2e-13, 1e-12),
    "fast-spin": (1e-4, 2e-11, 1e-8),
    "rocket": (0.02, 2e-12, 0.0),
    "low-orbit": (10.0, 2e-13, 1e-3),
    "spring-bodies": (0.01, 2e-12, 1e-12),
    "tumbling-brick": (0.1, 2e-13, 0.0),
    "long-heavy-top": (0.01, 1e-9, 1e-11),
    "spinning-satellite": (0.4, 2e-9, 1e-3),
}


def end_of(solution: tx.Solution) -> dict[str, Any]:
    return {name: np.asarray(value[-1]) for name, value in solution.xs.items()}


def changes(scene: Scene, x: dict[str, Any]) -> float:
    """The largest change of an invariant since the start."""
    before = scene.dynamics.outputs(0.0, scene.start, scene.u, scene.params)
    after = scene.dynamics.outputs(scene.duration, x, scene.u, scene.params)
    return max((float(np.max(np.abs(after[n] - before[n]))) for n in scene.invariants), default=0.0)


@pytest.mark.parametrize("name", BARS)
def test_the_end_is_reached_and_invariants_hold(name: str) -> None:
    scene, (dt, error, change) = SCENES[name], BARS[name]
    end = end_of(scene.integrate(dt=dt, method=METHOD))
    assert scene.error(end) < error
    assert changes(scene, end) <= change
    # The same loop: a coarser solution is worse, so that the bars above are no accident of the error's definition.
    assert scene.error(end_of(scene.integrate(dt=12.0 * dt, method=METHOD))) > 2.0 * error


def test_every_scene_is_integrated_here_or_is_stiff() -> None:
    stiff = {name for name, reference in REFERENCES.items() if reference.fastest is not None}
    assert {*BARS, *stiff} == set(SCENES)


def test_other_numbers_of_bodies_on_springs() -> None:
    two = spring_bodies.scene(2)
    end = end_of(two.integrate(dt=0.02, method=METHOD))
    truth = scipy_solution(lambda t, y: REFERENCES["spring-bodies"].rates(t, y, {}), two.start, 0.0, two.duration)
    for name, value in truth.items():
        np.testing.assert_allclose(end[name], value, rtol=0.0, atol=1e-10)
    assert changes(two, end) < 1e-11
    with pytest.raises(tx.InputError, match="no truth is known"):
        two.error(end)
    with pytest.raises(tx.InputError, match="count must be 2 or more, got 1"):
        spring_bodies.system(1)


def test_options_reach_the_integrator() -> None:
    scene = SCENES["euler-top"]
    solution = scene.integrate(t1=4.0, dt=0.02, method=METHOD, save_at=np.array([1.0, 4.0]))
    for i, t in enumerate((1.0, 4.0)):
        assert scene.error({name: value[i] for name, value in solution.xs.items()}, t=t) < 1e-13
