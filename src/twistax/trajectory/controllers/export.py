"""A controller as C99 code: the solver's core, the functions of the problem, and the controller's three calls."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...checks import number, path_of, whole
from ...progress import watching
from ...scalar.targets.c import CType
from ...solver.exported.kernel_code import array
from ...solver.exported.phase_code import PhaseCode
from ...solver.exported.precision import CodePrecision
from ...solver.sources import controller_core
from ...system.export import CFiles
from ...system.export.c99 import check_name, real_type, write_files
from ...system.export.c_code import mark
from ..strategy.measure import COST
from .gains import GAINS_CURVATURE, GAINS_LEAST
from .memory import ControllerMemory
from .plan_units import BARRIER_LEAST, BARRIER_MOST, BARRIER_SHARE
from .rehearsal import drawn_states, rehearsed

#: Of iterates at which the test program gives up, relative to their largest entry.
_TOLERANCES = {"float64": 1e-9, "float32": 5e-3}

#: Which iterates are compared in single precision.
_OF_SINGLE = (
    "\n * Plans are compared where Python solved the problem: iterates before a solution differ by more than rounding."
)

#: Bytes of memory that a controller may use for a faster solve.
MEMORY = 256 * 1024


class ControllerCode:
    """The C code of a controller with its present plan."""

    def __init__(self, controller: Any, name: str, memory: int, real: CType) -> None:
        self._controller, self._name, self._real = controller, name, real
        self._precision, self._literal = CodePrecision(real), real.literal
        self._solve, self._staged = controller.prepared, controller.staged
        self._transcription = self._staged.transcription
        self._stages = self._transcription.stages
        self._phases, data = PhaseCode(self._transcription, real), len(controller.data.numbers)
        shared, size = self._phases.shared_widths, self._precision.bytes
        self._memory = ControllerMemory(self._solve, self._transcription, shared, size, data, memory)
        size_of_plan = np.abs(self._solve.v / controller.units.size).max(initial=0.0)
        self._options = self._precision.options(self._solve.options, float(size_of_plan))
        self._node, self._controls = controller.first_node, controller.first_controls
        point = self._staged.parts[0].point
        states = controller.part.phase.dynamics.states
        self._states = [(state.name, point.places(state.name)) for state in states]
        self._params = self._parameters()

    def files(self, folder: Path, x: Sequence[Mapping[str, Any]], tolerance: float) -> tuple[CFiles, dict[Path, str]]:
        """Paths of the files, with their texts."""
        name = self._name
        files = CFiles(folder / f"{name}.h", folder / f"{name}.c", folder / f"{name}_test.c")
        test = self._filled("controller_test.c.in", **self._test(x, tolerance))
        header = self._filled("controller.h.in", **self._header())
        source = self._filled("controller.c.in", **self._source())
        texts = {files.header: header, files.source: re.sub(r"\btwx_", f"{name}_core_", source), files.test: test}
        return files, texts

    def _filled(self, template: str, **parts: Any) -> str:
        text = Path(__file__).with_name(template).read_text()
        return Template(text).substitute(mark=mark(), name=self._name, **self._precision.words, **parts)

    # ---- header file -------------------------------------------------------------------------------------------------

    def _header(self) -> dict[str, Any]:
        sizes = self._memory.sizes
        listed = lambda pairs: ", ".join(f"{name} {shape}" for name, shape in pairs) or "none"  # noqa: E731
        dynamics = self._controller.part.phase.dynamics
        options = self._solve.options
        return {
            **sizes,
            **self._memory.counts,
            "states": listed((state.name, state.shape) for state in dynamics.states),
            "controls": listed(self._controls.shapes.items()),
            "parameters": listed((name, np.shape(values)) for name, (values, _) in self._params.items()),
            "layout": self._layouts(),
            "error": f"{COST * self._options['tolerance']:.0e}",
            "violation": f"{self._options['violation']:.0e}",
            "bytes": self._memory.bytes,
            "iterations": int(options.iterations),
            "restoration": int(options.restoration_iterations),
            **self._phases.work(self._stages.parameters),
            "prepare_arguments": "".join(f", const {self._real.name} *{_c(f'p_{name}')}" for name in self._params),
            **self._arguments,
            "state_tangents": self._tangents,
            "side": self._side,
            "gains_bytes": self._precision.bytes * (sizes["variables"] + sizes["rows"] + self._tangents * self._side),
            **self._shift_texts(),
        }

    def _layouts(self) -> str:
        """Where the plan of each phase stands in z."""
        problem, first, lines = self._controller.problem, self._stages.first_point, list[str]()
        for k, (name, phase) in enumerate(zip(problem.names, problem.parts)):
            part = self._staged.parts[k]
            stride = part.point.size + part.shooting.m
            states = [f"{n} {part.point.places(n)[0]}" for n, shape in part.point.shapes.items() if 0 not in shape]
            controls = [f"{n} {c.start + part.point.size}" for n, c in part.shooting.local.controls.slices.items()]
            place = f"{phase.nodes} nodes from z[{first[part.stages.start]}] on, {stride} entries each"
            lines.append(f" *   {'' if problem.alone else f'{name}: '}{place}: {', '.join([*states, *controls])}")
        return "\n".join([*lines, *self._durations()])

    def _durations(self) -> list[str]:
        """Where free durations stand in z."""
        names, after = self._staged.border.names, len(self._solve.z) - len(self._solve.v)
        return [f" *   {names[k]}: z[{v + after}]" for k, v in enumerate(self._duration_columns()) if v >= 0]

    def _duration_columns(self) -> Array:
        """The index in v of the duration of each phase, -1 for a fixed one."""
        border = self._staged.border
        columns = len(self._solve.v) - border.unknowns + np.cumsum(border.unknown) - 1
        return np.where(border.unknown, columns, -1)[: border.phases].astype(np.int32)

    @property
    def _tangents(self) -> int:
        """The number of tangents of the measured states."""
        return int(self._node.n)

    @property
    def _side(self) -> int:
        """The count of numbers of a right-hand side of the linearised first-order conditions."""
        solve = self._solve
        return len(solve.v) + len(solve.lam) + len(solve.s) + len(solve.ye) + 1

    @property
    def _arguments(self) -> dict[str, str]:
        """Arguments of a C function, each preceded by a comma."""
        return {
            "state_arguments": self._state_arguments,
            "control_results": "".join(f", {self._real.name} *{_c(f'u_{name}')}" for name in self._controls.shapes),
            "gain_results": "".join(f", {self._real.name} *{_c(f'k_{name}')}" for name in self._controls.shapes),
            "gain_arguments": "".join(
                f", const {self._real.name} *{_c(f'k_{name}')}" for name in self._controls.shapes
            ),
        }

    @property
    def _state_arguments(self) -> str:
        return "".join(f", const {self._real.name} *{_c(f'x_{name}')}" for name, _ in self._states)

    def _shift_texts(self) -> dict[str, str]:
        """What the header says of the shift, and its call in the test program."""
        name = self._name
        if self._controller.moves_on is None:
            none = f" * A solve starts from the last plan as it is. {name}_durations sets durations that remain"
            return {"shift_convention": none, "shift_declaration": "", "shift_call": ""}
        return {
            "shift_convention": f" *   {name}_shift      the plan moves on by one interval",
            "shift_declaration": f"void {name}_shift({name}_controller *c);\n",
            "shift_call": f"    {name}_shift(&controller);\n",
        }

    # ---- source file ------------------------------------------------------------------------------------------------

    def _core(self) -> str:
        """The core, with the sizes of intervals as constants if all phases have the same."""
        phase, stages = self._transcription.phases[0], self._stages
        sizes = {(other.n, other.m, len(other.method.b)) for other in self._transcription.phases}
        if len(sizes) > 1:
            return controller_core(self._precision.is_single)
        return controller_core(
            self._precision.is_single,
            states=phase.n,
            controls=phase.m,
            parameters=stages.parameters,
            inequalities=sum(stages.inequalities),
            equalities=sum(stages.equalities),
            stages=len(phase.method.b),
        )

    def _source(self) -> dict[str, Any]:
        sizes, staged = self._memory.sizes, self._staged
        phase, point = self._transcription.phases[0], staged.parts[0].point
        units, constants = self._controller.units, self._constants()
        empty = {name for name, values in constants.items() if not np.size(values)}
        texts = [array(name, np.asarray(a), self._real) for name, a in constants.items() if name not in empty]
        every = ["lower", "upper", "v", "s", "lambda", "y", "ye", "zl", "zu", "data"]
        loaded = [name for name in every if f"start_{name}" not in empty]
        texts += [f"#define {name} NULL\n" for name in ("unit_rows", "unit_equalities") if name in empty]
        return {
            **sizes,
            "core": self._core(),
            "constants": "\n".join([self._phases.text, *texts]),
            "options": ", ".join(self._literal(value) for value in self._options.values()),
            "phases": len(self._transcription.phases),
            "stages": len(self._stages.states),
            "parameters": self._stages.parameters,
            "states": phase.n,
            "measured": self._tangents,
            "intervals": phase.intervals,
            "point": point.size,
            "measured_point": self._node.size,
            "cost_unit": self._literal(units.cost),
            "load": "\n".join(f"  memcpy(c->{name}, start_{name}, sizeof start_{name});" for name in loaded),
            "prepare": self._prepare(),
            "prepare_arguments": "".join(f", const {self._real.name} *{_c(f'p_{name}')}" for name in self._params),
            **self._arguments,
            **self._memory.layout,
            "scratch": self._memory.scratch,
            "curvature": self._literal(self._precision.at_least(GAINS_CURVATURE, 32.0)),
            "least_distance": self._literal(self._precision.at_least(GAINS_LEAST, 8.0)),
            **self._of_controls(),
            "read_state": "\n".join(
                f"  memcpy(x + {places[0]}, {_c(f'x_{name}')}, sizeof(real) * {len(places)});"
                for name, places in self._states
            ),
            "share": self._literal(BARRIER_SHARE),
            "least": self._literal(self._precision.at_least(BARRIER_LEAST, 8.0)),
            "most": self._literal(BARRIER_MOST),
            "sign": self._literal(self._controller.problem.sign),
            "cost_share": self._literal(COST),
            "shifts": int(self._controller.moves_on is not None),
            "last": int(self._stages.first[-1]),
            "gather_rows": self._gather_rows(empty),
        }

    def _of_controls(self) -> dict[str, str]:
        """Statements for the first controls."""
        every = list(zip(map(_c, self._controls.shapes), self._controls.of_each))
        return {
            "write_gains": "\n".join(
                f"    for (int j = 0; j < {size}; j++) k_{name}[j * MEASURED + i] = m->sides[i][{column} + j];"
                for name, (_, column, size) in every
            ),
            "write_corrected": "\n".join(
                f"  corrected_control(c, k_{name}, step, {point}, {column}, {size}, u_{name});"
                for name, (point, column, size) in every
            ),
            "write_controls": "\n".join(
                f"  memcpy(u_{name}, c->z + {point}, sizeof(real) * {size});" for name, (point, _, size) in every
            ),
        }

    def _gather_rows(self, empty: set[str]) -> str:
        """Statements of the shift for rows, and for the rates of continuous controls."""
        kinds, shift = (("rows", "s"), ("rows", "y"), ("equalities", "ye")), self._controller.moves_on
        if shift is None:
            return ""
        lines = [
            f"  gather(c->{name}, later_{kind}, {self._memory.sizes[kind]}, scratch);"
            for kind, name in kinds
            if f"later_{kind}" not in empty
        ]
        return "\n".join([*lines, *(f"  c->z[{a}] = c->v[{b}] = 0;" for a, b in shift.resting.T)])

    def _constants(self) -> dict[str, Any]:
        """Arrays by their names in C: the present plan, units, sizes of stages, memory of phases, and indices of the
        shift.
        """
        solve, staged, stages = self._solve, self._staged, self._stages
        phases, units, shift = self._transcription.phases, self._controller.units, self._controller.moves_on
        flat = -np.ones(self._memory.sizes["variables"], np.int32)
        flat[staged.plain[1]] = staged.plain[0]
        after = lambda sizes: np.cumsum([0, *sizes])[:-1].astype(np.int32)  # noqa: E731
        constants = {
            "start_z": solve.z,
            **{f"start_{name}": getattr(solve, name) for name in ("lower", "upper")},
            "start_v": solve.v,
            "start_s": solve.s,
            "start_lambda": solve.lam,
            "start_y": solve.y,
            "start_ye": solve.ye,
            "start_zl": solve.zl,
            "start_zu": solve.zu,
            "start_data": self._controller.data.numbers,
            "unit_v": units.size,
            "unit_rows": units.row_size,
            "unit_equalities": units.equality_size,
            "largest_step": self._controller.largest_step,
            "stage_states": np.array(stages.states, np.int32),
            "stage_controls": np.array(stages.controls, np.int32),
            "stage_inequalities": np.array(stages.inequalities, np.int32),
            "stage_equalities": np.array(stages.equalities, np.int32),
            "stage_points": np.array(stages.point_states or stages.states, np.int32),
            "window_of": np.array(self._memory.windows, np.int32),
            "work_of": after(self._memory.work),
            "slopes_of": after(slopes.size for slopes in self._transcription.cost_slopes),
            "node_rows_of": np.array([phase.node_rows[0] if phase.node_rows[1] else 0 for phase in phases], np.int32),
            "numbers_of": np.array([phase.of_phase for phase in phases], np.int32),
            "durations_of": self._staged.numbers.duration_places[:, 0].astype(np.int32),
            "duration_at": self._duration_columns(),
            "flat_of": flat,
            "flat_entry": flat[: phases[0].n],
        }
        if shift is not None:
            later = {"z": shift.points, "v": shift.variables, "defects": shift.defects, "rows": shift.rows}
            later["equalities"] = shift.equalities
            constants |= {f"later_{name}": places.astype(np.int32) for name, places in later.items()}
        return constants

    def _parameters(self) -> dict[str, tuple[Array, Array]]:
        """Values, and the position of each entry in the data; parameters with a value for each node have several
        columns.
        """
        numbers, values = self._staged.numbers, self._controller.params
        params = {name: (values[name], numbers.places([name], [])) for name in numbers.names}
        for k, phase in enumerate(self._controller.problem.parts):
            for name in phase.by_node.leaves:
                params[name] = (values[name], phase.by_node.places(name) + numbers.node_rows(k)[0])
        return params

    def _prepare(self) -> str:
        lines = []
        for name, (values, places) in self._params.items():
            pointer = _c(f"p_{name}")
            if places.ndim == 1:
                first = int(places[0]) if places.size else 0
                lines.append(f"  if ({pointer}) memcpy(c->data + {first}, {pointer}, sizeof(real) * {values.size});")
                continue
            nodes, width = len(values), values[0].size
            (here, after), stride = places[0], int(places[1, 0] - places[0, 0])
            lines += [
                f"  for (int k = 0; {pointer} && k < {nodes}; k++) {{",
                f"    memcpy(c->data + {here} + {stride} * k, {pointer} + {width} * k, sizeof(real) * {width});",
                f"    memcpy(c->data + {after} + {stride} * k, {pointer} + {width} * (k < {nodes - 1} ? k + 1 : k), "
                f"sizeof(real) * {width});",
                "  }",
            ]
        return "\n".join(lines)

    # ---- test program -----------------------------------------------------------------------------------------------

    def _test(self, states: Sequence[Mapping[str, Any]], tolerance: float) -> dict[str, Any]:
        """The iterates of the Python controller, whose state is restored afterwards."""
        expected = rehearsed(self._controller, states)
        columns = {name: np.array([np.ravel(x[name]) for x in states], float) for name, _ in self._states}
        data = [array(_c(f"measured_{name}"), values, self._real) for name, values in columns.items()]
        names = ("expected_z", "expected_lambda", "iterations", "statuses")
        double = not self._precision.is_single
        data += [array(n, values, self._real) for n, values in zip(names, expected) if n != "iterations" or double]
        sizes = {name: values.shape[1] for name, values in columns.items()}
        results = {name: size for name, (_, _, size) in zip(self._controls.shapes, self._controls.of_each)}
        declared = " ".join(f"{self._real.name} {_c(f'u_{name}')}[{size}];" for name, size in results.items())
        arguments = [f"{_c(f'measured_{name}')} + {size} * k" for name, size in sizes.items()]
        arguments += [_c(f"u_{name}") for name in results]
        return {
            "points": len(self._solve.z),
            "defects": len(self._solve.lam),
            **self._shift_texts(),
            "calls": len(states),
            "tolerance": f"{tolerance:.0e}",
            "allowed": self._literal(tolerance),
            "fabs": f"fabs{self._real.suffix}",
            "iterations_differ": "report.iterations != iterations[k] || " if double else "",
            "compared": "1" if double else "statuses[k] == 0",
            "which": "" if double else _OF_SINGLE,
            "data": "\n".join(data),
            "call": f"{declared}\n    {self._name}_feedback(&controller, {', '.join(arguments)}, NULL, NULL, &report);",
        }


def _c(name: str) -> str:
    """A name in C, with underscores in place of characters that C does not allow."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name)


@watching("export")
def write_controller(
    controller: Any,
    directory: str | Path,
    name: str,
    dtype: Any,
    memory: int,
    *,
    states: Sequence[Mapping[str, Any]] | None,
    tolerance: float | None,
) -> CFiles:
    """Implements `Controller.to_c`, which documents the arguments."""
    check_name(name)
    whole("memory", memory, 0)
    real = real_type(dtype)
    allowed = _TOLERANCES[real.dtype.name] if tolerance is None else tolerance
    number("tolerance", allowed, "a finite number that is not negative", lambda size: 0.0 <= size < np.inf)
    folder, code = path_of("directory", directory), ControllerCode(controller, name, memory, real)
    files, texts = code.files(folder, drawn_states(controller) if states is None else states, allowed)
    write_files(folder, texts)
    return files
