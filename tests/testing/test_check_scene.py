"""`check_scene` runs over every scene of the package, found by itself, and sees each error that makes one wrong."""

import dataclasses
import importlib
import pkgutil
from typing import Any

import numpy as np
import pytest

import twistax as tx
import twistax.scenes
from twistax.scenes import SCENES, Scene
from twistax.testing import LawError, check_scene

#: How those are integrated that the default of `check_scene` does not suit: they are stiff, or make much of round-off.
OPTIONS: dict[str, dict[str, Any]] = {
    "spring-bodies": {"tolerance": 1e-7},
    "spinning-satellite": {"tolerance": 1e-6},
    "long-heavy-top": {"dt": 0.01, "tolerance": 1e-7},
    "stiff-attitude": {"stiff": True, "dt": 0.02},
    "actuator-lag": {"stiff": True, "dt": 0.02, "tolerance": 1e-5},
    "stiff-joint": {"stiff": True, "dt": 1e-3, "tolerance": 1e-6},
}


def every_scene() -> dict[str, Scene]:
    """The scenes that a module of twistax.scenes has under a name in capitals."""
    names = [found.name for found in pkgutil.walk_packages(twistax.scenes.__path__, "twistax.scenes.")]
    values = [item for name in names for item in vars(importlib.import_module(name)).items()]
    return {value.name: value for name, value in values if isinstance(value, Scene) and name.isupper()}


def test_every_scene_of_a_module_is_in_the_list() -> None:
    scenes = every_scene()
    assert set(scenes) == set(SCENES)
    assert set(OPTIONS) <= set(scenes)


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_keeps_the_laws(name: str) -> None:
    check_scene(SCENES[name], **OPTIONS.get(name, {}))


TOP = SCENES["symmetric-body"]


def shifted(t: float) -> dict[str, Any]:
    """Right at the start and wrong after it."""
    return {name: value * (1.0 + 1e-6 * t * (name == "w")) for name, value in TOP.exact(t).items()}  # type: ignore[misc]


def with_another(x: dict[str, Any]) -> dict[str, Any]:
    return {**TOP.start, **x}


def whirled() -> tx.System:
    """With an output that does not stay."""
    system = TOP.build()
    w = next(state for state in system.states if state.name == "w")
    return tx.System(rates=system.rates, outputs={**system.outputs, "first": w[0]})


BROKEN = [
    ({"exact": shifted}, r"x'\(t\) = f\(t, x\(t\)\) for the closed form.*look at 'R'"),
    ({"start": with_another({"w": 2.0 * TOP.start["w"]})}, "the closed form begins at the start"),
    ({"exact": None, "reference": with_another({})}, "the end is where the system leads"),
    ({"exact": None, "reference": {"w": TOP.start["w"]}}, "end has all states"),
    ({"start": with_another({"w": np.zeros(4)})}, "start has the shapes of the states"),
    ({"invariants": ("nonsense",)}, "invariants are outputs of the system"),
    ({"build": whirled, "invariants": ("first",)}, "first stays as it is"),
]


@pytest.mark.parametrize(("change", "words"), BROKEN, ids=[words[:24] for _, words in BROKEN])
def test_an_error_is_seen(change: dict[str, Any], words: str) -> None:
    with pytest.raises(LawError, match=f"(?s){words}"):
        check_scene(dataclasses.replace(TOP, **change))


@pytest.mark.usefixtures("unchecked")
def test_what_is_no_scene_is_refused() -> None:
    with pytest.raises(tx.InputError, match="check_scene expects a scene"):
        check_scene("euler-top")  # type: ignore[arg-type]
