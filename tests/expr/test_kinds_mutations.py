"""Right models are accepted; one-place mutations that units or axes show are refused.

Signs and factors without unit, which no check of kinds can see, are told apart by the symmetry of models
(`kinds_symmetry.py`), not by what the check says.
"""

import random
from collections import Counter
from collections.abc import Iterable
from typing import Any

import pytest
from kinds_machines import MACHINES
from kinds_models import MODELS
from kinds_mutants import Mutant, mutants
from kinds_spacecraft import SPACECRAFT
from kinds_symmetry import Model
from kinds_vehicles import VEHICLES

import twistax as tx

RIGHT = (*MODELS, *VEHICLES, *SPACECRAFT, *MACHINES)


@pytest.mark.parametrize("build", RIGHT, ids=lambda build: build.__name__)
def test_a_right_model_is_accepted(build: Any) -> None:
    assert isinstance(tx.System(rates=build()), tx.System)


def symmetric(build: Any) -> None:
    """A right model is the same in other units, and in other axes of at least one frame if it has vectors."""
    model = Model(build)
    assert len(model.changes) >= 4
    for state, rate in model.rates.items():
        assert not model.sees(state, rate), (model.name, state.name)


def test_a_right_model_is_the_same_in_other_units_and_axes() -> None:
    for build in (MODELS[1], MACHINES[0]):
        symmetric(build)


def test_right_models_are_the_same_in_other_units_and_axes() -> None:
    for build in RIGHT:
        symmetric(build)


def refused_of_visible(drawn: Iterable[Mutant]) -> tuple[Counter[str], Counter[str], list[str]]:
    """By mutation: how many are visible, and how many of these are refused; and those that are not."""
    visible, refused, passed = Counter[str](), Counter[str](), list[str]()
    for mutant in drawn:
        if mutant.visible:
            visible[mutant.what] += 1
            refused[mutant.what] += mutant.refused
            if not mutant.refused:
                passed.append(f"{mutant.what}: {mutant.text}")
    return visible, refused, passed


def test_mutants_of_one_model_are_refused() -> None:
    rng = random.Random(4)
    visible, refused, passed = refused_of_visible(mutants(Model(MODELS[1]), lambda: rng.random() < 0.5))
    assert visible.total() > 20
    assert refused.total() >= 0.95 * visible.total(), passed


def test_mutants_of_all_models_are_refused() -> None:
    rng = random.Random(5)
    drawn = (mutant for build in RIGHT for mutant in mutants(Model(build), lambda: rng.random() < 0.06))
    visible, refused, passed = refused_of_visible(drawn)
    print(f"\n{visible.total()} mutants", dict(visible), dict(refused), *passed, sep="\n")
    assert visible.total() > 800
    assert refused.total() >= 0.97 * visible.total(), passed
