"""Trees as text and back."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from test_saved import Doubled, again

import twistax as tx
import twistax.mechanics
from twistax.expr import Expr, all_nodes, leaves_of
from twistax.expr.functions.function import Call
from twistax.groups import SpecialOrthogonal
from twistax.system.export.saved import read_nodes, write_nodes


def copied(roots: list[Expr]) -> list[Expr]:
    """The roots, written and read."""
    arrays: list[Any] = []
    written, places = write_nodes(roots, arrays)
    nodes = read_nodes(json.loads(json.dumps(written, allow_nan=False)), arrays)
    return [nodes[places[id(root)]] for root in roots]


def test_every_node_comes_back() -> None:
    """The examples of all node classes."""
    assert twistax.mechanics  # its nodes are among them
    # A call of a user's function holds code, which files do not.
    roots = [example.expr for node in all_nodes() if node is not Call for example in node.example()]
    assert len(roots) > 200
    for root, loaded in zip(roots, copied(roots), strict=True):
        assert loaded.key() == root.key(), root
        assert loaded.shape == root.shape
        assert len(list(leaves_of(loaded))) == len(list(leaves_of(root)))  # what is shared stays so


def test_a_folded_matrix_keeps_its_structure() -> None:
    x = tx.State("x", shape=(6,))
    matrix = tx.lie.SE3Adjoint(tx.pose(position=[1.0, 2.0, 3.0], euler=[0.1, 0.2, 0.3])).canonicalize()
    assert isinstance(matrix, tx.Constant)
    assert matrix.folded_from is not None
    product = matrix @ x
    (loaded,) = copied([product])
    assert loaded.canonicalize().key() == product.canonicalize().key() != product.key()


def test_deep_trees() -> None:
    node: Expr = tx.State("x")
    for _ in range(700):
        node = tx.Sin(node) + node
    (loaded,) = copied([node])
    assert loaded.key() == node.key()


@dataclasses.dataclass(frozen=True)
class OwnRotations(SpecialOrthogonal):
    """SO(3) under another name."""

    tag: str = "own"


def test_nodes_and_groups_of_ones_own(tmp_path: Path) -> None:
    x, R = tx.State("x"), tx.State("R", group=OwnRotations("mine"))
    loaded = again(tx.compile(tx.System(rates={x: Doubled(x, by=3.0), R: tx.Constant(np.ones(3))})), tmp_path)
    assert isinstance(loaded.system.rates["x"], Doubled)
    assert loaded.system.states[1].group == OwnRotations("mine")
    assert float(loaded(0.0, {"x": 2.0, "R": np.eye(3)})["x"]) == 6.0
