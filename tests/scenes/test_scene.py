"""A scene: its one number for an error, what it refuses, and what importing costs."""

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from scene_oracles import rotation_angle
from scipy.spatial.transform import Rotation

import twistax as tx
from twistax.scenes import SCENES, Scene

RNG = np.random.default_rng(4)


def rotation(vector: Any) -> np.ndarray:
    return Rotation.from_rotvec(vector).as_matrix()


def still() -> tx.System:
    """One state of every kind, at rest."""
    R, g, V = tx.State("R", group=tx.SO3), tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    q, m = tx.State("q", shape=(6,)), tx.State("m")
    return tx.System(rates={R: np.zeros(3), g: V, V: np.zeros(6), q: np.zeros(6), m: tx.Constant(0.0)})


TRUTH = {
    "R": rotation([0.3, -1.2, 0.7]),
    "g": tx.pose(position=[30.0, 40.0, 0.0], rotation=rotation([-2.0, 0.1, 0.4])),
    "V": np.array([3.0, 4.0, 0.0, 0.1, 0.2, 0.2]),
    "q": np.array([0.0, 0.0, 12.0, 0.0, 16.0, 0.0]),
    "m": 0.25,
}


def made(**changes: Any) -> Scene:
    given: dict[str, Any] = {
        "name": "still",
        "title": "",
        "summary": "",
        "source": "",
        "build": still,
        "start": TRUTH,
        "duration": 2.0,
        "reference": TRUTH,
    }
    return Scene(**{**given, **changes})


def changed(name: str, value: Any) -> dict[str, Any]:
    return {**TRUTH, name: value}


# ---- the error ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [1e-14, 1e-12, 1e-8, 1e-3, 1.0, 3.0, np.pi - 1e-9, np.pi])
def test_an_angle_is_resolved_at_every_size(angle: float) -> None:
    for _ in range(20):
        axis = RNG.normal(size=3)
        turned = TRUTH["R"] @ rotation(angle * axis / np.linalg.norm(axis))
        assert rotation_angle(TRUTH["R"], turned) == pytest.approx(angle, rel=1e-12, abs=8e-16)


def test_the_sense_of_a_turn_does_not_matter() -> None:
    for angle in (1e-12, 0.5, np.pi):
        there = rotation_angle(TRUTH["R"], TRUTH["R"] @ rotation([0.0, angle, 0.0]))
        back = rotation_angle(TRUTH["R"], TRUTH["R"] @ rotation([0.0, -angle, 0.0]))
        assert there == pytest.approx(back, abs=4e-16)


def test_leaving_the_group_is_an_error_too() -> None:
    assert rotation_angle(TRUTH["R"], 1.001 * TRUTH["R"]) == pytest.approx(1e-3 * np.sqrt(1.5), rel=1e-10)


def test_every_part_counts_with_its_own_size() -> None:
    scene = made()
    pose = np.array(TRUTH["g"])
    shifted, turned = pose.copy(), pose.copy()
    shifted[:3, 3] += [0.0, 0.0, 5e-3]
    turned[:3, :3] = pose[:3, :3] @ rotation([0.0, 2e-4, 0.0])
    assert scene.error(TRUTH) == 0.0
    assert scene.error(changed("R", TRUTH["R"] @ rotation([3e-12, 0.0, 0.0]))) == pytest.approx(3e-12, rel=1e-3)
    assert scene.error(changed("g", shifted)) == pytest.approx(5e-3 / 50.0)
    assert scene.error(changed("g", turned)) == pytest.approx(2e-4)
    # A twist has two sizes, 5 and 0.3, which counts as 1; six numbers that are no twist have one, 20.
    assert scene.error(changed("V", TRUTH["V"] + [0, 0, 1e-3, 0, 0, 0])) == pytest.approx(1e-3 / 5.0)
    assert scene.error(changed("V", TRUTH["V"] + [0, 0, 0, 0, 3e-3, 4e-3])) == pytest.approx(5e-3)
    assert scene.error(changed("q", TRUTH["q"] + [0, 0, 0, 0, 3e-3, 4e-3])) == pytest.approx(5e-3 / 20.0)
    assert scene.error(changed("m", 0.25 - 1e-6)) == pytest.approx(1e-6)


def test_the_largest_part_is_the_error() -> None:
    worse = {**TRUTH, "m": 0.25 + 1e-3, "q": TRUTH["q"] + 1e-6}
    assert made().error(worse) == pytest.approx(1e-3)


@pytest.mark.parametrize("name", ["R", "g", "V", "q", "m"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_lost_solution_has_no_small_error(name: str, bad: float) -> None:
    assert not made().error(changed(name, np.full(np.shape(TRUTH[name]), bad))) < np.inf


# ---- what is known, and what is refused --------------------------------------------------------------------------


def test_the_truth_is_known_where_it_was_given() -> None:
    scene = made(start=changed("m", 1.0))
    assert scene.end["m"] == 0.25
    assert scene.truth(0.0)["m"] == 1.0
    assert scene.error(changed("m", 1.0), t=0.0) == 0.0
    with pytest.raises(tx.InputError, match="known at 0 and 2 s"):
        scene.truth(1.0)
    moving = made(reference=None, exact=lambda t: changed("m", t))
    assert moving.end["m"] == 2.0
    assert moving.error(changed("m", 1.5), t=1.5) == 0.0


def test_a_scene_without_an_answer_says_so() -> None:
    with pytest.raises(tx.InputError, match="no truth is known"):
        _ = made(reference=None).end


def test_contradictions_are_refused() -> None:
    with pytest.raises(tx.InputError, match="exact solution and a reference"):
        made(exact=lambda t: TRUTH)
    for duration in (0.0, -1.0, np.nan):
        with pytest.raises(tx.InputError, match="positive number of s"):
            made(duration=duration)


def test_a_scene_cannot_be_changed_by_its_readers() -> None:
    with pytest.raises(ValueError, match="read-only"):
        SCENES["rocket"].start["V"][0] = 1.0


# ---- the list of scenes ------------------------------------------------------------------------------------------


def test_the_list() -> None:
    assert len(SCENES) == 14
    for name, scene in SCENES.items():
        assert scene.name == name == name.lower()
        assert all((scene.summary.endswith("."), scene.title, scene.source))
        assert set(scene.invariants) <= set(scene.system.outputs)
        assert {state.name for state in scene.system.states} == set(scene.start) == set(scene.end)
        assert set(scene.params) == {parameter.name for parameter in scene.system.parameters}


def test_importing_compiles_nothing_and_stays_light() -> None:
    code = (
        "import sys, jax.monitoring as m; seen = [];"
        "m.register_event_duration_secs_listener(lambda event, seconds, **k: seen.append(event));"
        "import twistax.scenes; print(seen, [n for n in ('scipy', 'diffrax', 'matplotlib') if n in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
    assert found == "[] []"
