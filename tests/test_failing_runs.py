"""No failing integration or solve ends the process; `failing_runs.py` runs a thousand of them."""

import pytest

from failing_runs import SETS, STRUCTURES, worker

FEW = ["pole, Radau", "root, fixed"]
#: Of every system one way; with three sets of numbers and both precisions sixty runs.
SAMPLE = [
    ["pole, chosen", "root, Radau, event", "wall, Radau, fixed", "lag, Radau", "logarithm, Radau"],
    ["spun, Radau", "falling, chosen", "singular, Radau, event", "tank, Radau", "solve, root"],
]


def check(structures: list[str], sets: list[int], x64: bool) -> None:
    lines, death = worker(structures, sets, x64, slopes=True, patience=1500.0)
    assert not death
    ends = [line for line in lines if line.startswith("end")]
    assert len(ends) == len(structures) * len(sets)
    assert [line for line in ends if "WRONG" in line] == []
    assert any("SUCCESS" not in line for line in ends)


def test_a_thousand() -> None:
    assert SETS * len(STRUCTURES) >= 990
    assert {name for part in SAMPLE for name in part} <= set(STRUCTURES)


def test_a_handful_of_failing_runs() -> None:
    check(FEW, [1, 2, 3], x64=False)


@pytest.mark.parametrize("x64", [True, False])
@pytest.mark.parametrize("part", range(len(SAMPLE)))
def test_sixty_failing_runs(part: int, x64: bool) -> None:
    check(SAMPLE[part], [5 * part + 1, 5 * part + 2, 5 * part + 3], x64)
