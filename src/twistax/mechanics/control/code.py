"""A differential controller as C99 code: the functions of its quadratic program, the solver's core, and one function to
call.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

import jax.numpy as jnp
import numpy as np

from ...checks import number, path_of
from ...errors import InputError
from ...scalar.targets.c import c_type
from ...solver.sources import squares_core
from ...solver.squares import LeastSquares
from ...system.dynamics import compile
from ...system.export import CFiles
from ...system.export.c99 import check_name, write_files
from ...system.export.c_code import CCode, identifiers, mark, numbers
from ...system.export.programs import Exporter, Port
from ...system.system import System
from ..mechanism_system import kinematics

#: The arrays of a problem, in the order of `squares.h`.
_PARTS = ("J", "w", "r", "damping", "A", "b", "C", "row_lower", "row_upper", "lower", "upper")
_REAL = c_type(np.dtype(float))


class _DifferentialCode:
    """The generator of a controller's files."""

    def __init__(self, controller: Any, name: str) -> None:
        self._controller, self._name = controller, name
        mechanism = controller.mechanism
        places = mechanism.positions("to_c", None)
        motion: dict[Any, Any] = {**kinematics(mechanism, places, mechanism.qd), mechanism.qd: np.zeros(mechanism.dofs)}
        read = {f"part {k}": part for k, part in enumerate(controller.expressions)}
        self.exporter = Exporter(compile(System(rates=motion, outputs=read)).functions, np.dtype(float))
        self.solver: LeastSquares = controller.solver
        shapes = self.solver.shapes
        self._ports = [Port("output", part, shapes[part]) for part in _PARTS]
        self._offsets = dict(zip(_PARTS, np.cumsum([0, *(port.size for port in self._ports)]), strict=False))
        self._ports.append(Port("output", "overrun", (mechanism.dofs,)))
        self.rows = self.exporter.function("problem", self._ports, self._problem, {})
        self._names = identifiers([*self.exporter.arguments, *self.rows.results])

    def point(self, x: Any, targets: Any, qd: Any) -> tuple[Any, ...]:
        """The arguments (t, x, u, params) of a step."""
        rates = np.zeros(self._controller.mechanism.dofs) if qd is None else qd
        names = [leaf.name for leaf in self._controller.controls]
        u, params = ({k: v for k, v in targets.items() if (k in names) == control} for control in (True, False))
        return 0.0, {**x, "qd": rates}, u, params

    def _problem(self, t: Any, x: Any, u: Any, params: Any) -> list[Any]:
        controller = self._controller
        settings = {name: jnp.asarray(value) for name, value in controller.settings.arrays.items()}
        positions = {name: value for name, value in x.items() if name != "qd"}
        qd = x["qd"] if controller.settings.limits_acceleration else None
        parts, bounds, _, _ = controller.problem(positions, u, params, qd, settings)
        return [*(jnp.asarray(part) for part in parts), bounds.overrun]

    @property
    def arguments(self) -> list[tuple[Port, str]]:
        """The arrays that a step reads, with their names in C."""
        return [(port, self._names[port]) for port in self.exporter.arguments[1:]]

    @property
    def _functions(self) -> str:
        """The function that computes the quadratic program, after its declaration."""
        code = CCode(f"{self._name}_rows", self.exporter, [self.rows], self._names, _REAL)
        return code.header() + code.source().replace(f'#include "{self._name}_rows.h"\n', "")

    def texts(self, files: CFiles, steps: Sequence[Any], tolerance: float) -> dict[Path, str]:
        """The texts of the files."""
        freedoms, solver = self._controller.mechanism.dofs, self.solver
        head = "".join(f", const double *{name}" for _, name in self.arguments)
        start = solver.problem_size - solver.start_size
        shared = {"mark": mark(), "name": self._name, "freedoms": freedoms, "arguments": head}
        sizes = {"problem": solver.problem_size, "result": solver.start_size + 3, "workspace": solver.workspace_size}
        header = self._filled(
            "differential.h.in",
            **shared,
            **sizes,
            joints=", ".join(dict.fromkeys(self._controller.space.joints)),
            period=_REAL.literal(self._controller.settings.arguments["dt"]),
            bytes=8 * sum(sizes.values()),
        )
        kept = {port.name for port in self.rows.results}
        into = [f"p + {self._offsets[part]}" for part in _PARTS if part in kept] + ["overrun"]
        source = self._filled(
            "differential.c.in",
            **shared,
            core=squares_core(),
            functions=self._functions,
            sizes=", ".join(str(size) for size in solver.sizes),
            values="".join(f", {name}" for _, name in self.arguments),
            parts=", ".join(into),
            lower=self._offsets["lower"],
            upper=self._offsets["upper"],
            problem_start=start,
            start_size=solver.start_size,
        )
        test = self._filled("differential_test.c.in", **shared, **self._test(steps, tolerance))
        return {files.header: header, files.source: re.sub(r"\btwx_", f"{self._name}_core_", source), files.test: test}

    def _filled(self, template: str, **parts: Any) -> str:
        return Template(Path(__file__).with_name(template).read_text()).substitute(**parts)

    def _test(self, steps: Sequence[Any], tolerance: float) -> dict[str, Any]:
        controller, before = self._controller, None
        defaults = {leaf.name: leaf.value for leaf in controller.parameters}
        rows: dict[str, list[Any]] = {name: [] for _, name in self.arguments}
        expected, statuses = [], []
        for x, targets, qd in steps:
            before = controller(x, targets, qd=qd, warm=before)
            _, positions, u, params = self.point(x, targets, qd)
            values = {"x": positions, "u": u, "params": {**defaults, **params}}
            for port, name in self.arguments:
                rows[name].append(np.ravel(values[port.kind][port.name]))
            expected.append(np.asarray(before.qd))
            statuses.append(int(before.status))
        data = [numbers(name, np.array(values, float), _REAL) for name, values in rows.items() if np.size(values)]
        data.append(numbers("expected", np.array(expected), _REAL))
        data.append(f"static const int statuses[] = {{{', '.join(map(str, statuses))}}};\n")
        pointers = [f"{name} + k * {port.size}" if port.size else "NULL" for port, name in self.arguments]
        return {
            "calls": len(steps),
            "data": "".join(data),
            "values": "".join(f", {pointer}" for pointer in pointers),
            "tolerance": f"{tolerance:.0e}",
            "largest": _REAL.literal(max(float(np.abs(expected).max()), 1e-300)),
        }


def write_differential(
    controller: Any, directory: str | Path, *, name: str, states: Sequence[tuple[Any, ...]] | None, tolerance: float
) -> CFiles:
    """Implements `DifferentialController.to_c`, which documents the arguments."""
    check_name(name)
    number("tolerance", tolerance, "a finite number that is not negative", lambda size: 0.0 <= size < math.inf)
    folder, code = path_of("directory", directory), _DifferentialCode(controller, name)
    if states is None:
        if controller.controls:
            raise InputError("to_c expects states and targets for the test program, states=[(x, targets), ...]")
        drawn = controller.space.random(np.random.default_rng(0), 3)
        states = [({key: value[k] for key, value in drawn.items()},) for k in range(3)]
    steps = [(*state, *((None, {}, None)[len(state) :])) for state in states]
    files = CFiles(folder / f"{name}.h", folder / f"{name}.c", folder / f"{name}_test.c")
    texts = code.texts(files, [(x, targets or {}, qd) for x, targets, qd in steps], tolerance)
    write_files(folder, texts)
    return files
