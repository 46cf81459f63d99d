"""Rates that are too fast for explicit steps, and the implicit transcription that takes their place."""

from __future__ import annotations

import numpy as np

from ..integrators import tableaus
from ..solver.kernels import Argument
from .staged import Staged
from .transcribed import Given, Point
from .transcription import Collocation

#: The product of an eigenvalue of the rates and a step above which RK4 is not stable.
#: Source: Hairer and Wanner, Solving ordinary differential equations II (1996), section IV.2.
LARGEST = 2.8
#: The transcription that is tried then: it damps what is fast.
IMPLICIT, IMPLICIT_NAME = Collocation(tableaus.RADAU_IIA5), "Collocation(tx.tableaus.RADAU_IIA5)"


def stiffness(staged: Staged, point: Point, given: Given) -> float:
    """The largest product of an eigenvalue of the rates' Jacobian, at a node, and a substep; of explicit phases."""
    staged.set_given(given)
    data, most, border = staged.numbers.vector(given), 0.0, np.asarray(point.border)
    for part, segment in zip(staged.parts, staged.transcribed.segments):
        own, phase, here = part.shooting, part.phase, segment.of(point)
        if phase.method.implicit:
            continue
        count, us = own.intervals, np.asarray(here.us)
        eta = np.zeros((count, own.n))
        arguments = {
            Argument.Z: np.concatenate([eta, us, np.tile(border, (count, 1))], axis=1),
            Argument.SHARE: phase.starts[:, None],
            Argument.BASE: part.point.joined(here.xs, 1)[:-1],
            Argument.DATA: data[None],
        }
        slopes = phase.kernels.rate.kernels[1](count, own.n * own.size, arguments)
        slopes = slopes.reshape(count, own.n, own.size)[:, :, : own.n]
        steps = (phase.widths / phase.method.substeps)[:, None, None]
        known = slopes[np.isfinite(slopes).all(axis=(1, 2))] * steps[np.isfinite(slopes).all(axis=(1, 2))]
        most = max(most, float(np.abs(np.linalg.eigvals(known)).max(initial=0.0)))
    return most
