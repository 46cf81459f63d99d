"""Names and units of the entries of a mechanism's states and motors, by its joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..expr import Constant, State
from .kinematic_tree import KinematicTree
from .screws import turns_of
from .tree import Segment

Labels = dict[str, list[tuple[str, str]]]


def labels_of(mechanism: KinematicTree, driven: Sequence[int]) -> Labels:
    """The labels of q, qd and tau: names of joints, with an axis for joints with several degrees of freedom; units m
    and rad, and their rates.
    """
    freedoms, places = [("", "")] * mechanism.dofs, list[tuple[str, str]]()
    for segment in mechanism.segments:
        if segment.link.mimic is not None or not segment.freedoms:
            continue
        pairs = _of_joint(segment)
        for i, pair in zip(segment.freedoms, pairs, strict=True):
            freedoms[i] = pair
        places += pairs if segment.coordinates is not None else []
    force = {"m": "N", "rad": "N m", "SI": "SI"}
    labels = {
        "qd": [(name, f"{unit}/s" if unit != "SI" else unit) for name, unit in freedoms],
        "tau": [(freedoms[i][0], force[freedoms[i][1]]) for i in driven],
    }
    q = mechanism.q if isinstance(mechanism.q, State) else mechanism.q.get("q")
    if isinstance(q, State) and q.shape == (len(places),):
        labels["q"] = places
    return {name: pairs for name, pairs in labels.items() if pairs}


def _of_joint(segment: Segment) -> list[tuple[str, str]]:
    joint = segment.link.joint
    turns = turns_of(joint.motion_subspace)
    if turns is None or not isinstance(joint.motion_subspace, Constant):
        return [(joint.name, "SI")]
    H = np.asarray(joint.motion_subspace.value)
    if joint.dofs == 1:
        return [(joint.name, "rad" if turns[0] else "m")]
    axes = ["xyz"[int(np.argmax(np.abs(column[3:] if turn else column[:3])))] for column, turn in zip(H.T, turns)]
    return [(f"{joint.name} {axis}", "rad" if turn else "m") for axis, turn in zip(axes, turns)]
