"""A controller as C99 code: the solver's core, the functions of the problem, and the controller's three calls."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...checks import number, path_of, whole
from ...progress import watching
from ...scalar.targets.c import c_type
from ...solver.exported.kernel_code import array
from ...solver.exported.phase_code import LANES, PhaseCode
from ...solver.sources import constant, controller_core
from ...solver.transcription import NONE
from ...system.export import CFiles
from ...system.export.c99 import check_name, write_files
from ...system.export.c_code import mark
from ..strategy.measure import COST
from .barrier import BARRIER_LEAST, BARRIER_MOST, BARRIER_SHARE
from .gains import GAINS_CURVATURE, GAINS_LEAST
from .rehearsal import drawn_states, rehearsed

_REAL = c_type(np.dtype(float))

#: Bytes of memory that a controller may use for a faster solve.
MEMORY = 256 * 1024


class ControllerCode:
    """The C code of a controller with its present plan."""

    def __init__(self, controller: Any, name: str, memory: int) -> None:
        self._controller, self._name, self._memory = controller, name, memory
        self._solve, self._staged = controller.prepared, controller.staged
        self._stages = self._staged.transcription.stages
        self._phase = PhaseCode(self._staged.transcription, self._window)
        part = self._staged.parts[0]
        self._states = [(state.name, part.point.places(state.name)) for state in controller.part.dynamics.states]
        self._controls = controller.controls
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
        return Template(text).substitute(mark=mark(), name=self._name, **parts)

    # ---- sizes ------------------------------------------------------------------------------------------------------

    @property
    def _sizes(self) -> dict[str, int]:
        solve, stages = self._solve, self._stages
        sizes = {"points": solve.z, "variables": solve.v, "rows": solve.s, "defects": solve.lam, "equalities": solve.ye}
        counts = {name: max(1, len(values)) for name, values in sizes.items()}
        counts["parameters"] = stages.parameters
        return counts

    def _counts(self, window: int) -> dict[str, int]:
        sizes, transcription = self._sizes, self._staged.transcription
        work, scratch = transcription.phase_doubles(window)
        of_step = sizes["points"] + sizes["variables"] + sizes["rows"] + sizes["defects"] + sizes["equalities"]
        return {
            "data": max(1, len(self._controller.numbers)),
            "slopes": max(1, transcription.cost_slopes[0].size),
            "phase_work": work,
            "workspace": max(self._workspace(scratch), of_step),
        }

    @functools.cached_property
    def _window(self) -> int:
        """The number of intervals that are evaluated together: all if the memory suffices, which is faster; else as
        many as fit into the memory of the linear system.
        """
        window, phase = LANES, self._staged.transcription
        intervals = phase.phases[0].intervals
        if 8 * self._doubles(intervals) <= self._memory:
            return int(intervals)
        while window < intervals:
            scratch = phase.phase_doubles(window + LANES)[1]
            if self._workspace(scratch) > self._workspace(0):
                break
            window += LANES
        return window

    def _doubles(self, window: int) -> int:
        """The number of doubles that a controller needs."""
        per_name = {"points": 1, "variables": 5, "rows": 2, "defects": 1, "equalities": 1, "parameters": 0}
        of_sizes = sum(per_name[name] * count for name, count in self._sizes.items())
        return of_sizes + sum(self._counts(window).values())

    def _workspace(self, scratch: int) -> int:
        return self._solve.workspace_doubles(**self._layout, scratch=scratch)

    @property
    def _layout(self) -> dict[str, int]:
        """Properties of the core's memory layout besides sizes: with few iterations it needs neither a filter nor a
        watchdog.
        """
        options = self._solve.options
        rows, trigger = int(options.iterations) + 1, options.watchdog_trigger
        return {
            "filter_rows": min(rows, constant("work.h", "TWX_FILTER_ROWS")),
            "without_watchdog": int(not 0 < trigger < options.iterations),
        }

    def _header(self) -> dict[str, Any]:
        sizes = self._sizes
        sizes.pop("parameters")
        listed = lambda pairs: ", ".join(f"{name} {shape}" for name, shape in pairs) or "none"  # noqa: E731
        dynamics = self._controller.part.dynamics
        options = self._solve.options
        return {
            **sizes,
            **self._counts(self._window),
            "states": listed((state.name, state.shape) for state in dynamics.states),
            "controls": listed((name, shape) for name, (_, shape) in self._controls.items()),
            "parameters": listed((name, np.shape(values)) for name, (values, _) in self._params.items()),
            "bytes": 8 * self._doubles(self._window),
            "library": "log, log10, pow, sqrt, and those that the problem's functions call",
            "iterations": int(options.iterations),
            "restoration": int(options.restoration_iterations),
            **self._work(),
            "prepare_arguments": "".join(f", const double *{_c(f'p_{name}')}" for name in self._params),
            **self._arguments,
            "state_tangents": self._tangents,
            "side": self._side,
            "gains_bytes": 8 * (sizes["variables"] + sizes["rows"] + self._tangents * self._side),
        }

    @property
    def _tangents(self) -> int:
        return int(self._staged.transcription.phases[0].n)

    @property
    def _side(self) -> int:
        """The number of doubles of a right-hand side of the linearised first-order conditions."""
        solve = self._solve
        return len(solve.v) + len(solve.lam) + len(solve.s) + len(solve.ye) + 1

    @property
    def _arguments(self) -> dict[str, str]:
        """Arguments of a C function, each preceded by a comma."""
        return {
            "state_arguments": self._state_arguments,
            "control_results": "".join(f", double *{_c(f'u_{name}')}" for name in self._controls),
            "gain_results": "".join(f", double *{_c(f'k_{name}')}" for name in self._controls),
            "gain_arguments": "".join(f", const double *{_c(f'k_{name}')}" for name in self._controls),
        }

    @property
    def _state_arguments(self) -> str:
        return "".join(f", const double *{_c(f'x_{name}')}" for name, _ in self._states)

    def _work(self) -> dict[str, int]:
        """The number of scalar operations: those of the kernels, and those of matrix products from their sizes."""
        operations, (phase,) = self._phase.kernels.operations, self._staged.transcription.phases
        method, K = phase.method, phase.intervals
        stages, evaluated = method.substeps * len(method.b), method.weights != 0
        evaluated[: method.substeps + 1] |= (phase.path != NONE).any(axis=(0, 2))
        points = int(np.count_nonzero(evaluated))

        def rows(name: str) -> int:
            return stages if "_rate" in name else points if "_rows" in name else 1

        of_kernels = {name: count * rows(name) * (1 if "_node" in name else K) for name, count in operations.items()}
        values = sum(count for name, count in of_kernels.items() if not name.endswith(("slopes", "bends")))
        n, m, p = phase.n, phase.m, self._stages.parameters
        size = n + m + p
        products = K * stages * (4 * n * n * size + 4 * size * size * n)
        N = K + 1
        riccati = N * (2 * n * n * size + 2 * n * size * size + m**3 + 2 * m * size * size)
        riccati += 2 * size * size * (sum(self._stages.inequalities) + sum(self._stages.equalities))
        return {"functions": sum(of_kernels.values()) + products, "trial": values, "riccati": riccati}

    # ---- source file ------------------------------------------------------------------------------------------------

    def _core(self) -> str:
        phase, stages = self._staged.transcription.phases[0], self._stages
        return controller_core(
            states=phase.n,
            controls=phase.m,
            parameters=stages.parameters,
            inequalities=sum(stages.inequalities),
            equalities=sum(stages.equalities),
            stages=len(phase.method.b),
        )

    def _source(self) -> dict[str, Any]:
        sizes, solve, staged = self._sizes, self._solve, self._staged
        phase, point = staged.transcription.phases[0], staged.parts[0].point
        units, stages, constants = self._controller.units, self._stages, self._constants()
        empty = {name for name, values in constants.items() if not np.size(values)}
        texts = [array(name, np.asarray(a)) for name, a in constants.items() if name not in empty]
        every = ["lower", "upper", "v", "s", "lambda", "y", "ye", "zl", "zu", "data"]
        loaded = [name for name in every if f"start_{name}" not in empty]
        kinds = (("rows", "s"), ("rows", "y"), ("equalities", "ye"))
        gathers = [
            f"  gather(c->{name}, later_{kind}, {sizes[kind]}, scratch);"
            for kind, name in kinds
            if f"later_{kind}" not in empty
        ]
        texts += [f"#define {name} NULL\n" for name in ("unit_rows", "unit_equalities") if name in empty]
        return {
            **sizes,
            "core": self._core(),
            "constants": "\n".join([self._phase.text, *texts]),
            "options": ", ".join(_REAL.literal(getattr(solve.options, name)) for name, _ in solve.options._fields_),
            "states": phase.n,
            "intervals": phase.intervals,
            "point": point.size,
            "controls": phase.m,
            "node_rows": staged.numbers.node_rows(0)[0] if phase.node_rows[1] else 0,
            "cost_unit": _REAL.literal(units.cost),
            "load": "\n".join(f"  memcpy(c->{name}, start_{name}, sizeof start_{name});" for name in loaded),
            "prepare": self._prepare(),
            "prepare_arguments": "".join(f", const double *{_c(f'p_{name}')}" for name in self._params),
            **self._arguments,
            **self._layout,
            "scratch": self._staged.transcription.phase_doubles(self._window)[1],
            "curvature": _REAL.literal(GAINS_CURVATURE),
            "least_distance": _REAL.literal(GAINS_LEAST),
            "write_gains": "\n".join(
                f"    for (int j = 0; j < {part.stop - part.start}; j++) "
                f"{_c(f'k_{name}')}[j * STATES + i] = m->sides[i][STATES + {part.start} + j];"
                for name, (part, _) in self._controls.items()
            ),
            "write_corrected": "\n".join(
                f"  corrected_control(c, {_c(f'k_{name}')}, step, {part.start}, {part.stop - part.start}, "
                f"{_c(f'u_{name}')});"
                for name, (part, _) in self._controls.items()
            ),
            "read_state": "\n".join(
                f"  memcpy(x + {places[0]}, {_c(f'x_{name}')}, sizeof(double) * {len(places)});"
                for name, places in self._states
            ),
            "write_controls": "\n".join(
                f"  memcpy({_c(f'u_{name}')}, c->z + POINT + {part.start}, sizeof(double) * {part.stop - part.start});"
                for name, (part, _) in self._controls.items()
            ),
            "share": _REAL.literal(BARRIER_SHARE),
            "least": _REAL.literal(BARRIER_LEAST),
            "most": _REAL.literal(BARRIER_MOST),
            "sign": _REAL.literal(self._controller.problem.sign),
            "cost_share": _REAL.literal(COST),
            "last": int(stages.first[-1]),
            "gather_rows": "\n".join(gathers),
        }

    def _constants(self) -> dict[str, Any]:
        """Arrays by their names in C: the present plan, units, sizes of stages, and indices of the shift."""
        solve, staged, stages = self._solve, self._staged, self._stages
        phase, units, shift = staged.transcription.phases[0], self._controller.units, self._controller.moves_on
        flat = -np.ones(self._sizes["variables"], np.int32)
        flat[staged.plain[1]] = staged.plain[0]
        return {
            "start_z": solve.z,
            **{f"start_{name}": getattr(solve, name) for name in ("lower", "upper")},
            "start_v": solve.v,
            "start_s": solve.s,
            "start_lambda": solve.lam,
            "start_y": solve.y,
            "start_ye": solve.ye,
            "start_zl": solve.zl,
            "start_zu": solve.zu,
            "start_data": self._controller.numbers,
            "unit_v": units.size,
            "unit_rows": units.row_size,
            "unit_equalities": units.equality_size,
            "largest_step": self._controller.largest_step,
            "stage_states": np.array(stages.states, np.int32),
            "stage_controls": np.array(stages.controls, np.int32),
            "stage_inequalities": np.array(stages.inequalities, np.int32),
            "stage_equalities": np.array(stages.equalities, np.int32),
            "stage_points": np.array(stages.point_states or stages.states, np.int32),
            "flat_of": flat,
            "flat_entry": flat[: phase.n],
            "later_z": shift.points.astype(np.int32),
            "later_v": shift.variables.astype(np.int32),
            "later_defects": shift.defects.astype(np.int32),
            "later_rows": shift.rows.astype(np.int32),
            "later_equalities": shift.equalities.astype(np.int32),
        }

    def _parameters(self) -> dict[str, tuple[Array, Array]]:
        """Values, and the position of each entry in the data; parameters with a value for each node have several
        columns.
        """
        numbers, by_node = self._staged.numbers, self._controller.part.by_node
        placed = {name: values for name, values in self._controller.params.items() if name not in by_node.leaves}
        params = {name: (values, numbers.places([name], [])) for name, values in placed.items()}
        for name in by_node.leaves:
            params[name] = (self._controller.params[name], by_node.places(name) + numbers.node_rows(0)[0])
        return params

    def _prepare(self) -> str:
        lines = []
        for name, (values, places) in self._params.items():
            pointer = _c(f"p_{name}")
            if places.ndim == 1:
                first = int(places[0]) if places.size else 0
                lines.append(f"  if ({pointer}) memcpy(c->data + {first}, {pointer}, sizeof(double) * {values.size});")
                continue
            nodes, width = len(values), values[0].size
            (here, after), stride = places[0], int(places[1, 0] - places[0, 0])
            lines += [
                f"  for (int k = 0; {pointer} && k < {nodes}; k++) {{",
                f"    memcpy(c->data + {here} + {stride} * k, {pointer} + {width} * k, sizeof(double) * {width});",
                f"    memcpy(c->data + {after} + {stride} * k, {pointer} + {width} * (k < {nodes - 1} ? k + 1 : k), "
                f"sizeof(double) * {width});",
                "  }",
            ]
        return "\n".join(lines)

    # ---- test program -----------------------------------------------------------------------------------------------

    def _test(self, states: Sequence[Mapping[str, Any]], tolerance: float) -> dict[str, Any]:
        """The iterates of the Python controller, whose state is restored afterwards."""
        expected, iterations, statuses = rehearsed(self._controller, states)
        columns = {name: np.array([np.ravel(x[name]) for x in states], float) for name, _ in self._states}
        data = [array(_c(f"measured_{name}"), values) for name, values in columns.items()]
        data += [array("expected", expected), array("iterations", iterations), array("statuses", statuses)]
        sizes = {name: values.shape[1] for name, values in columns.items()}
        results = {name: columns.stop - columns.start for name, (columns, _) in self._controls.items()}
        declared = " ".join(f"double {_c(f'u_{name}')}[{size}];" for name, size in results.items())
        arguments = [f"{_c(f'measured_{name}')} + {size} * k" for name, size in sizes.items()]
        arguments += [_c(f"u_{name}") for name in results]
        return {
            "points": len(self._solve.z),
            "calls": len(states),
            "tolerance": f"{tolerance:.0e}",
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
    *,
    name: str,
    states: Sequence[Mapping[str, Any]] | None,
    tolerance: float,
    memory: int,
) -> CFiles:
    """Implements `Controller.to_c`, which documents the arguments."""
    check_name(name)
    whole("memory", memory, 0)
    number("tolerance", tolerance, "a finite number that is not negative", lambda size: 0.0 <= size < np.inf)
    folder, code = path_of("directory", directory), ControllerCode(controller, name, memory)
    files, texts = code.files(folder, drawn_states(controller) if states is None else states, tolerance)
    write_files(folder, texts)
    return files
