"""Every node that OpenSCvx and twistax share, lowered by both: the values, and the verdicts of docs/openscvx.md.

The page is checked without OpenSCvx, the values where it is installed.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
import pytest
from openscvx_cases import (
    BASES,
    CASES,
    COMMON,
    DIFFERENT,
    NAMESAKES,
    NEW_IN_THE_NIGHTLY,
    OURS,
    WITHOUT_COUNTERPART,
    Case,
    Nodes,
)
from openscvx_lowering import is_nightly, openscvx, our_leaf, ours, theirs

import twistax as tx

PAGE = (Path(__file__).parents[2] / "docs" / "openscvx.md").read_text()
VERDICTS = ("same", "differs", "namesake", "none", "only here", "base")


# ---- the page -------------------------------------------------------------------------------------------------


def rows() -> Iterator[tuple[list[str], str]]:
    """(nodes, verdict) of every row whose second cell is a verdict."""
    for line in PAGE.splitlines():
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        if len(cells) > 1 and cells[1] in VERDICTS:
            yield re.findall(r"`(\w+)`", cells[0]), cells[1]


def listed(*verdicts: str) -> set[str]:
    return {name for names, verdict in rows() for name in names if verdict in verdicts}


def test_every_node_stands_on_the_page_once_with_the_verdict_of_the_cases() -> None:
    assert listed("same") == COMMON - DIFFERENT
    assert listed("differs") == DIFFERENT
    assert listed("none") == WITHOUT_COUNTERPART
    assert listed("namesake") == NAMESAKES
    assert listed("base") == BASES
    names = [name for found, _ in rows() for name in found]
    assert len(names) == len(set(names))


def test_every_case_can_be_built_here() -> None:
    """Without OpenSCvx too, so that a name that moves is seen where it is not installed."""
    for case in CASES:
        for build in (case.build, case.here or case.build):
            built = build(OURS, *(our_leaf(i.kind, i.name, i.shape) for i in case.inputs))
            assert isinstance(built.check_shape(), tuple)


def test_what_the_page_calls_common_or_ours_exists() -> None:
    nodes = {node.__name__ for node in tx.expr.all_nodes()}
    assert listed("same", "differs", "namesake", "only here") <= nodes
    assert not listed("none") & nodes
    assert all(issubclass(getattr(tx, name), tx.Expr) for name in listed("base"))


def test_the_page_tells_the_numbers() -> None:
    told = f"{len(COMMON)} nodes are common: {len(COMMON - DIFFERENT)} have the same values, {len(DIFFERENT)} differ"
    assert told in " ".join(PAGE.split())


# ---- the values -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def other() -> Nodes:
    return openscvx()


POINTS = [
    [{i.name: i.draw(rng, i.shape) for i in case.inputs} for case in CASES]
    for rng in map(np.random.default_rng, (1, 2, 3))
]

Results = dict[str, list[list[np.ndarray]]]


@pytest.fixture(scope="module")
def results(other: Nodes) -> Results:
    """By way of lowering, for every point the values of all cases. One compilation each."""
    ways = {
        "plain": [ours(case, case.build) for case in CASES],
        "here": [ours(case, case.here or case.build) for case in CASES],
        "there": [theirs(other, case) if is_there(case) else lambda values: 0.0 for case in CASES],
    }
    found: Results = {}
    # Their code mixes dtypes and ranks, which this suite forbids.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        for way, functions in ways.items():
            compiled = jax.jit(lambda point, functions=functions: [f(v) for f, v in zip(functions, point, strict=True)])
            found[way] = [[np.asarray(value) for value in compiled(point)] for point in POINTS]
    return found


def is_there(case: Case) -> bool:
    return is_nightly() or case.node not in NEW_IN_THE_NIGHTLY


def need(case: Case) -> None:
    if not is_there(case):
        pytest.skip(f"{case.node} is new in the nightly")


by_case = pytest.mark.parametrize("number", range(len(CASES)), ids=[f"{c.node}{i}" for i, c in enumerate(CASES)])


@by_case
def test_values_agree_as_stated(number: int, results: Results) -> None:
    case = CASES[number]
    need(case)
    for point in range(len(POINTS)):
        expected = case.as_there(results["here"][point][number])
        found = results["there"][point][number]
        assert found.shape == expected.shape
        assert found.dtype == expected.dtype
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


@by_case
def test_what_is_said_to_differ_does(number: int, results: Results) -> None:
    case = CASES[number]
    need(case)
    here, there = results["plain"][0][number], results["there"][0][number]
    alike = here.shape == there.shape and here.dtype == there.dtype and bool(np.allclose(here, there, atol=1e-9))
    assert alike == (not case.reason), case.reason


def test_every_node_of_theirs_is_accounted_for(other: Nodes) -> None:
    found, waiting = set(), [other.Expr]
    while waiting:
        cls = waiting.pop()
        waiting += cls.__subclasses__()
        if cls.__module__.startswith("openscvx.") and not cls.__name__.startswith("_"):
            found.add(cls.__name__)
    known = COMMON | NAMESAKES | WITHOUT_COUNTERPART | BASES
    assert found == (known if is_nightly() else known - NEW_IN_THE_NIGHTLY)
