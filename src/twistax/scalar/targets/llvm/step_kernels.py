"""Steps of loops as kernels: integrations, loops of JAX, and steps that are differentiated."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

import jax

from ....jax_inside import backends
from ...array_primitive import KernelOfArrays
from ...backends import ANY_SIZE, MOST_STORED, XLA, Shapes, Step, StepCompiler, pure
from ...graph import TooLarge
from ...jax_primitive import PLATFORMS, Derived, Differentiable, call_program
from ...loops import Looped, MakeKernel, Repeated, Ring, decides, repeating
from ...program import Rows, ScalarProgram
from .arrays.body import ArrayBody, CalledLoops, array_form
from .code import NotNative
from .iterations import Iterations
from .kernel_body import NATIVE_LIMITS, native_form
from .loop import LoopBody
from .machine_code import installed


@dataclasses.dataclass(frozen=True)
class StepKernels(StepCompiler):
    """Steps as kernels, or as scalar programs if they have no native form."""

    scalars: XLA
    runner: Any  #: makes the kernels

    def repeated(self, step: Step, shapes: Shapes, state: int, row: Step | None = None) -> Repeated | Looped | None:
        program = self._whole_step(step, shapes)
        if program is None:
            return None if row is not None else self._loop_of_matrices(step, shapes, state)
        record = program.restricted(program.outputs[state + decides(program.types[state:]) :])
        form, row_form = native_form(program), None
        if record.outputs and row is not None:
            outputs = zip(record.outputs, record.types, strict=True)
            shapes_of_record = [jax.ShapeDtypeStruct(array.shape, dtype) for array, dtype in outputs]
            row_program = self._whole_step(row, [*shapes_of_record, shapes_of_record[0]])
            if row_program is None:
                return None
            row_form = native_form(row_program)
        return Repeated(
            form, state, functools.partial(self.runner.built, Iterations, form, (state, row_form)), row_form
        )

    def _loop_of_matrices(self, step: Step, shapes: Shapes, state: int) -> Looped | None:
        """A step on matrices that is repeated within one kernel; in batches each step is one."""
        alone = self.of_matrices(step, shapes)
        if alone is None:
            return None
        function = repeating(functools.partial(call_program, alone), state)
        together = self.of_matrices(function, [shapes[0], *shapes], True)
        if together is None:
            return None
        results = [(shape.shape, shape.dtype) for shape in (*shapes[len(shapes) - state :], shapes[0])]
        return Looped(function, results, lambda single, platform: together.kernel(1, platform) if single else None)

    def looped(self, step: Step, shapes: Shapes, ring: Ring) -> MakeKernel | None:
        if max((math.prod(array.shape) for array in shapes), default=0) > self.scalars.widest:
            return None
        program = self._whole_step(step, shapes)
        if program is None:
            return None
        form = native_form(program)

        def kernel(single: bool, platform: str) -> Rows | None:
            rows = self.runner.built(LoopBody, form, (ring,), single, platform)
            return None if rows is None else functools.partial(rows, length=ring.length or 0)

        return kernel

    def differentiable(self, step: Step, shapes: Shapes) -> Differentiable | None:
        program = self._whole_step(step, shapes)
        if program is None:
            return self.of_matrices(step, shapes) or self.scalars.steps().differentiable(step, shapes)
        program.graph.largest = ANY_SIZE
        return Derived(program, None, self.runner)

    def of_matrices(self, function: Step, shapes: Shapes, terminates: bool = False) -> KernelOfArrays | None:
        closed = pure(function, shapes, MOST_STORED) if installed() else None
        return None if closed is None else self.runner.arrays(closed, self.scalars.checked, terminates)

    def constant(self, function: Step, shapes: Shapes) -> KernelOfArrays | None:
        program = self.of_matrices(function, shapes, True)
        if program is not None:
            form = array_form(program.program, self.scalars.checked, True)
            make = functools.partial(self.runner.built, ArrayBody, form, (), True, "cpu")
            program.inside_kernels = CalledLoops(form, make)
        return program

    def shared(self, function: Step, shapes: Shapes) -> Derived | None:
        program = self._whole_step(function, shapes)
        return None if program is None else Derived(program, None, dataclasses.replace(self.runner, least=0))

    def _whole_step(self, step: Step, shapes: Shapes) -> ScalarProgram | None:
        """The program of a step that has a native form, all stages unrolled; None: it has none, or no kernels run."""
        # Without kernels an unrolled step takes long to compile and runs no faster.
        if not installed() or not set(backends()).issubset(PLATFORMS):
            return None
        closed = pure(step, shapes)
        if closed is None:
            return None
        try:
            # A step contains more than the evaluation of its rates.
            program = self.scalars.scalars(closed, 4 * self.scalars.largest // 3, NATIVE_LIMITS)
            native_form(program)
        except (NotNative, TooLarge):
            return None
        return program
