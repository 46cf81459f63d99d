"""Pinocchio, called from Python."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...mechanics import Chain
from ..timing import Timed
from .case import Case, ForwardDynamics, InverseDynamics, numbers
from .contender import Contender
from .programs import CALLS, JACOBIAN, TINY, VALUE, Lacks, Quantity, Task

__all__ = ["Pinocchio"]

#: Three vectors to an array.
Call = Callable[[Any, Any, Any], NDArray[np.float64]]


class Pinocchio(Contender):
    name, colour = "Pinocchio", "C4"
    how = (
        "`pin.rnea`, `pin.aba` and their analytic derivatives, called from Python in a loop, point by point, also for "
        "loops and batches: what a call costs is part of every time and is not subtracted. A loop in C++ is faster."
    )
    packages = (("pin", "pinocchio"),)

    def task(self, case: Case, quantity: Quantity) -> Task:
        import pinocchio as pin

        if not isinstance(case, (InverseDynamics, ForwardDynamics)):
            raise Lacks("it has no function with quaternion rates")
        begin = time.perf_counter()
        model = _model(pin, case.chain)
        call = _calls(pin, model, model.createData()).get((type(case), quantity.name))
        if call is None:
            raise Lacks("it has Jacobians only")
        return _PinocchioTask(case, quantity.shape(case), call, time.perf_counter() - begin)


def _calls(pin: Any, model: Any, data: Any) -> dict[tuple[type[Case], str], Call]:
    def slopes_of_rnea(q: Any, qd: Any, qdd: Any) -> NDArray[np.float64]:
        pin.computeRNEADerivatives(model, data, q, qd, qdd)
        return np.concatenate([data.dtau_dq, data.dtau_dv], axis=1)

    def slopes_of_aba(q: Any, qd: Any, tau: Any) -> NDArray[np.float64]:
        pin.computeABADerivatives(model, data, q, qd, tau)
        return np.concatenate([data.ddq_dq, data.ddq_dv], axis=1)

    return {
        (InverseDynamics, VALUE.name): lambda q, qd, qdd: pin.rnea(model, data, q, qd, qdd),
        (ForwardDynamics, VALUE.name): lambda q, qd, tau: pin.aba(model, data, q, qd, tau),
        (InverseDynamics, JACOBIAN.name): slopes_of_rnea,
        (ForwardDynamics, JACOBIAN.name): slopes_of_aba,
    }


def _model(pin: Any, chain: Chain) -> Any:
    """The chain as a model of Pinocchio; all joints turn about z."""
    model, before = pin.Model(), 0
    for number, link in enumerate(chain.links):
        mount, body = numbers(link.mount), link.body
        before = model.addJoint(before, pin.JointModelRZ(), pin.SE3(mount[:3, :3], mount[:3, 3]), f"joint{number}")
        inertia = pin.Inertia(float(numbers(body.mass)), numbers(body.center_of_mass), numbers(body.inertia))
        model.appendBodyToJoint(before, inertia, pin.SE3.Identity())
    return model


class _PinocchioTask(Task):
    def __init__(self, case: Case, shape: tuple[int, ...], call: Call, seconds: float) -> None:
        self._case, self._shape, self._call, self._seconds = case, shape, call, seconds

    def single(self) -> Timed:
        call, arguments = self._call, [points[0] for points in self._case.points(1)]

        def calls() -> Any:
            for _ in range(CALLS):
                result = call(*arguments)
            return result

        return Timed(calls, CALLS, self._seconds)

    def loop(self, steps: int) -> Timed:
        call, start = self._call, [points[0] for points in self._case.points(1)]

        def steps_in_turn() -> Any:
            arguments = [each.copy() for each in start]
            for _ in range(steps):
                result = call(*arguments)
                fed = result.reshape(-1)
                for each in arguments:
                    each += TINY * fed[: each.size]
            return result

        return Timed(steps_in_turn, steps, self._seconds)

    def batch(self, count: int) -> Timed:
        call, points, out = self._call, self._case.points(count), np.zeros((count, *self._shape))

        def each_in_turn() -> Any:
            for i, arguments in enumerate(zip(*points, strict=True)):
                out[i] = call(*arguments)
            return out

        return Timed(each_in_turn, count, self._seconds)
