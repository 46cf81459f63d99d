"""A filter as C99 code: a prediction, and an update for each measurement."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import ModelError
from ..groups import Group
from ..progress import watching
from ..system.export import CFiles
from ..system.export.c99 import write_functions
from ..system.export.programs import TEST_STEP, ExportedFunction, Exporter, Port
from .filter import Filter
from .stochastic_model import OperatingPoint, StochasticModel


@watching("export")
def write_filter(kalman: Filter, directory: str | Path, *, name: str, dtype: Any, tolerance: float | None) -> CFiles:
    """Implements `ErrorStateKalman.to_c`, which documents the arguments."""
    model = kalman.model
    # As arrays all through: kernels have no form in C.
    in_arrays = kalman.in_arrays
    exporter = Exporter(in_arrays.model.noisy.functions, np.dtype(dtype), without=model.noise_names, loops=True)
    functions = [_prediction(in_arrays, exporter)]
    for measurement in model.measurements:
        functions.append(_update(in_arrays, exporter, measurement))
        if functions[-1].name in [function.name for function in functions[:-1]]:
            raise ModelError(
                f"two measurements would have the name {functions[-1].name} in C.\n  fix: rename {measurement!r}"
            )
    return write_functions(exporter, functions, directory, name=name, points=None, tolerance=tolerance)


def _covariance(model: StochasticModel) -> tuple[Port, Port, np.ndarray]:
    """The covariance before and after, and one for references."""
    n = model.dimension
    root = np.random.default_rng(1).normal(size=(n, n))
    before, after = (Port("P", when, (n, n)) for when in ("before", "after"))
    return before, after, 0.1 * (root @ root.T / n + np.eye(n))


def _states(model: StochasticModel) -> list[Port]:
    return [Port("next", state.name, state.shape) for state in model.dynamics.states]


def _prediction(kalman: Filter, exporter: Exporter) -> ExportedFunction:
    before, after, P0 = _covariance(kalman.model)
    states = _states(kalman.model)

    def predict(t: Any, x: Any, u: Any, params: Any, P: jax.Array, h: jax.Array) -> list[jax.Array]:
        prediction = kalman.propagated(OperatingPoint(t, x, u, params), P, h)
        return [*(prediction.x[port.name] for port in states), prediction.P]

    return exporter.function(
        "predict", [*states, after], predict, {before: P0, Port("h", "", ()): np.asarray(TEST_STEP)}
    )


def _update(kalman: Filter, exporter: Exporter, name: str) -> ExportedFunction:
    before, after, P0 = _covariance(kalman.model)
    states, group = _states(kalman.model), kalman.model.measurements[name].group

    def update(t: Any, x: Any, u: Any, params: Any, P: jax.Array, z: jax.Array) -> list[jax.Array]:
        updated = kalman.corrected(name, OperatingPoint(t, x, u, params), P, z, kalman.limits[name])
        return [*(updated.x[port.name] for port in states), updated.P, updated.nis]

    results = [*states, after, Port("nis", name, ())]
    identifier = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return exporter.function(
        f"update_{identifier}", results, update, {before: P0, Port("z", name, group.shape): _value(group)}
    )


def _value(group: Group) -> np.ndarray:
    """A measured value for references."""
    with jax.enable_x64(True):
        return np.asarray(group.exp(jnp.asarray(0.3 * np.random.default_rng(2).normal(size=group.dimension))))
