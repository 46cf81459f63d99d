"""A compiled system with noise and measurements: the functions that all filters need, on prepared arguments."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import listed
from ..errors import InputError, ModelError
from ..expr import Control, Expr, Noise, State, leaves_of, substitute
from ..integrators import RKMK, VectorField
from ..linear.discretize import Controls, method_of, step_derivatives, value_and_jacobian
from ..linear.linearize import around
from ..scalar.backends import JAX
from ..scalar.kernel_function import KernelFunction
from ..system.dynamics import Arrays, Dynamics, compile, need_compiled
from ..system.inputs import Values, precision
from ..system.system import System
from .measurement import Measurement
from .prediction.process_noise import NoiseDiscretization, VanLoan
from .records import controls_on, jumps_of
from .update import LinearMeasurement


class OperatingPoint(NamedTuple):
    """The prepared arguments of rates and measurements."""

    t: jax.Array
    x: Arrays
    u: Arrays
    params: Arrays

    def moved(self, **fields: Any) -> OperatingPoint:
        """The same point with other values of some arguments."""
        return self._replace(**fields)


class Sensitivity(NamedTuple):
    """A measurement at a point: its value h, its derivative H with respect to right perturbations of the state, and the
    covariance R of errors.
    """

    value: jax.Array
    H: jax.Array
    R: jax.Array


class StochasticModel:
    """The compiled system $x' = f(t, x, u, w, p)$ with noise w, and measurements.

    Attributes:
        dynamics: the compiled system, in which noise is zero.
        measurements: by name.
        group, dimension: group and dimension of the state.
        method: the integration method of the mean.
        noise: the discretisation of continuous noise.
    """

    def __init__(
        self, dynamics: Dynamics, measurements: Iterable[Measurement], method: Any, noise: NoiseDiscretization | None
    ) -> None:
        need_compiled("a filter", dynamics)
        self.noise = VanLoan() if noise is None else noise
        if not isinstance(self.noise, NoiseDiscretization):
            raise ModelError(f"noise expects VanLoan() or Trapezoidal(), got {noise!r}")
        self.dynamics, self.group, self.dimension = dynamics, dynamics.group, dynamics.dimension
        self.method: RKMK = method_of(method)
        self.measurements = _by_name(measurements)
        system = dynamics.system
        self.process = system.noises
        in_measurements = {noise.name: noise for m in self.measurements.values() for noise in m.noises}
        for leaf in self.process:
            if leaf.name in in_measurements:
                raise ModelError(
                    f"Noise {leaf.name!r} is in rates and in a measurement: the filter assumes that these "
                    "are independent.\n  fix: use a Noise with another name in the measurement"
                )
        noises = [*self.process, *in_measurements.values()]
        controls = {noise.key(): noise.as_control() for noise in noises}
        outputs: dict[str, Expr] = {_density(noise): noise.density for noise in noises}
        for name, measurement in self.measurements.items():
            outputs[name] = substitute(measurement.value, controls)
            if measurement.covariance is not None:
                outputs[_covariance(name)] = measurement.covariance
        declared = [*system.controls, *controls.values()]
        for name, measurement in self.measurements.items():
            _need_known(name, outputs[name], measurement, dynamics, [leaf.name for leaf in declared])
        noisy = System(
            rates={state: substitute(system.rates[state.name], controls) for state in system.states},
            outputs=outputs,
            controls=declared,
        )
        known = {parameter.name for parameter in noisy.parameters}
        bake = {name: value for name, value in dynamics.baked.items() if name in known}
        self.noisy = compile(noisy, bake=bake, backend=dynamics.backend)
        self._zeros = {noise.name: noise.shape for noise in noises}
        self.noise_names = tuple(self._zeros)
        self.controls = Controls(dynamics.controls)
        self._kernels = dict[Any, Callable[..., Any]]()

    @functools.cached_property
    def in_arrays(self) -> StochasticModel:
        """The model with all functions as operations of JAX, of which kernels and C are made."""
        dynamics = Dynamics(self.dynamics.functions.run_by(JAX()))
        return StochasticModel(dynamics, self.measurements.values(), self.method, self.noise)

    def _kernel(self, name: str, *fixed: Any) -> Any:
        """A method of the model in arrays as a kernel, with these first arguments."""
        if (name, *fixed) not in self._kernels:
            method = functools.partial(getattr(self.in_arrays, name), *fixed)
            self._kernels[name, *fixed] = KernelFunction(method, self.dynamics.backend)
        return self._kernels[name, *fixed]

    def matrices(self, function: Callable[..., Any], **fixed: Any) -> Any:
        """A function of matrices as a kernel of its own, with these keyword arguments."""
        key = function, *fixed.items()
        if key not in self._kernels:
            of_rest = functools.partial(function, **fixed)
            self._kernels[key] = KernelFunction(of_rest, self.dynamics.backend, of_matrices=True)
        return self._kernels[key]

    # ---- arguments ---------------------------------------------------------------------------------------------------

    def prepared(
        self, t: Any, x: Values, u: Values | None, params: Values | None, rates: bool, measurements: Iterable[str]
    ) -> OperatingPoint:
        """The arguments, checked and cast; what rates and these measurements read must be there."""
        u, controls = dict(u or {}), {leaf.name: leaf for leaf in self.dynamics.controls}
        for name in u:
            if name not in controls:
                raise InputError(f"unknown key {name!r} in u; the controls are: {listed(controls, name)}")
        dtype = precision(x, u, params, {"t": t})
        functions = self.noisy.functions.with_outputs(self.names(rates, measurements))
        reads = ("rates", "outputs") if rates else ("outputs",)
        required = set().union(*(functions.reads[family] for family in reads))
        for name, leaf in controls.items():
            if name in required and name not in u:
                raise InputError(
                    f"Control {name!r} is missing in u; the controls are: {listed(controls)}.\n"
                    f"  fix: pass u={{{name!r}: ...}} of shape {leaf.shape}"
                )
        inputs = functions.prepare(t, x, self.with_zeros(u, dtype), params, reads=reads)
        used = {name: value for name, value in inputs.u.items() if name in controls}
        return OperatingPoint(inputs.t, dict(inputs.x), used, dict(inputs.params))

    # ---- what stands between two times of a run ----------------------------------------------------------------------

    def jumps(self, u: Any) -> list[np.ndarray]:
        """The times at which a step must end because controls jump."""
        return jumps_of(u)

    def stage_controls(self, u: Any, ts: np.ndarray, x0: Arrays, dtype: Any) -> Any:
        """The controls of the intervals that end at the times of a run, with a leading axis of times."""
        return controls_on(u, ts, dtype)

    # ---- the state between measurements ------------------------------------------------------------------------------

    def step(self, point: OperatingPoint, h: jax.Array) -> tuple[Arrays, jax.Array, jax.Array]:
        """The mean after h seconds with constant controls, the transition matrix and the covariance of the noise.

        Covariances are in the tangent space at the mean: P -> Phi P Phi^T + Q.
        """
        x1, transition = self._kernel("transition")(point, h)
        return x1, transition, self.process_noise(point, x1, transition, h)

    def transition(self, point: OperatingPoint, h: jax.Array) -> tuple[Arrays, jax.Array]:
        """The mean after h seconds with constant controls, and the transition matrix."""
        t, x, u, params = point
        flat = self.controls.join(u, t.dtype)
        x1, transition, *_ = step_derivatives(self.dynamics, self.method, t, x, flat, h, params)
        return x1, transition

    def moved(self, point: OperatingPoint, h: jax.Array) -> Arrays:
        """The mean after h seconds."""
        field = VectorField(self.dynamics, lambda _: point.u, point.params)
        increment = self.method.increment(field, point.t, point.x, h)
        return self.group.retract(point.x, self.group.join(increment))

    def process_noise(self, point: OperatingPoint, x1: Arrays, transition: jax.Array, h: jax.Array) -> jax.Array:
        """The covariance (n, n) of the noise between a point and the state x1 h seconds later."""
        if not self.process:
            return jnp.zeros((self.dimension, self.dimension), point.t.dtype)
        local = {f: self._kernel("local_noise", f)(point, x1, h) for f in self.noise.fractions}
        covariance: jax.Array = self.matrices(self._discretized)(local, transition, h)
        return covariance

    def _discretized(self, local: dict[float, Any], transition: jax.Array, h: jax.Array) -> jax.Array:
        """The covariance of the noise of a step, from F and $G W G^T$ at fractions of it."""
        return self.noise.covariance(local.__getitem__, transition, h)

    def local_noise(
        self, fraction: float, point: OperatingPoint, x1: Arrays, h: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """F and $G W G^T$ at the start, the middle or the end of a step."""
        x = {0.0: point.x, 1.0: x1}.get(fraction)
        if x is None:
            x = self.group.retract(point.x, fraction * self.group.difference(point.x, x1))
        at = point.moved(t=point.t + fraction * h, x=x)
        F, G = self.linearized(at)
        return F, G @ self.intensity(at, self.process) @ G.T

    def linearized(self, point: OperatingPoint) -> tuple[jax.Array, jax.Array]:
        """F and G of $d' = F d + G w$, with d the right perturbation of the state."""
        n, m = self.dimension, self.controls.dimension
        value, slopes = around(self.noisy, ())(point.t, point.x, self.with_zeros(point.u, point.t.dtype), point.params)
        size = sum(int(np.prod(noise.shape)) for noise in self.process)
        return slopes[:n, :n] - self.group.ad(value[:n]), slopes[:n, n + m : n + m + size]

    def intensity(self, point: OperatingPoint, noises: Iterable[Noise]) -> jax.Array:
        """The intensity W of white noise, in squares of densities: a block for each noise."""
        noises = list(noises)
        values = self.outputs([_density(noise) for noise in noises], point)
        roots = [_square(values[_density(noise)], int(np.prod(noise.shape))) for noise in noises]
        return jax.scipy.linalg.block_diag(*(root @ root.T for root in roots))

    # ---- measurements ------------------------------------------------------------------------------------------------

    def measured(self, name: str, point: OperatingPoint) -> jax.Array:
        """The value of a measurement without noise."""
        return self.outputs([name], point)[name]

    def residual(self, name: str, point: OperatingPoint, z: jax.Array) -> LinearMeasurement:
        """The residual of a value z, linearised."""
        measured: LinearMeasurement = self._kernel("linearized_residual", name)(point, z)
        return measured

    def linearized_residual(self, name: str, point: OperatingPoint, z: jax.Array) -> LinearMeasurement:
        """The residual of a value z with H and R."""
        value, H, R = self.sensitivity(name, point)
        return LinearMeasurement(point.x, self.measurements[name].group.difference(value, z), H, R)

    def sensitivity(self, name: str, point: OperatingPoint) -> Sensitivity:
        """The value of a measurement, its derivative with respect to the state and the covariance of its errors."""
        measurement, n, dtype = self.measurements[name], self.dimension, point.t.dtype
        group, m = measurement.group, measurement.group.dimension
        h = self.measured(name, point)
        sizes = {noise.name: int(np.prod(noise.shape)) for noise in measurement.noises}

        def moved(z: jax.Array) -> jax.Array:
            noise, start = {}, n
            for leaf in measurement.noises:
                noise[leaf.name] = z[start : start + sizes[leaf.name]].reshape(leaf.shape)
                start += sizes[leaf.name]
            shifted = point.moved(x=self.group.retract(point.x, z[:n]), u={**point.u, **noise})
            return group.difference(h, self.measured(name, shifted)).reshape(m)

        _, slopes = value_and_jacobian(moved, jnp.zeros(n + sum(sizes.values()), dtype))
        R = jnp.zeros((m, m), dtype)
        if measurement.covariance is not None:
            value = self.outputs([_covariance(name)], point)[_covariance(name)]
            R = value if value.ndim == 2 else jnp.diag(jnp.broadcast_to(value.reshape(-1), (m,)))
        if measurement.noises:
            assert measurement.period is not None
            V = slopes[:, n:]
            R = R + V @ self.intensity(point, measurement.noises) @ V.T / measurement.period
        return Sensitivity(h, slopes[:, :n], R)

    # ---- values ------------------------------------------------------------------------------------------------------

    def outputs(self, names: list[str], point: OperatingPoint) -> Arrays:
        """Outputs of the system with noise."""
        functions = self.noisy.functions.with_outputs(names)
        return functions.as_written("outputs", point.t, point.x, self.with_zeros(point.u, point.t.dtype), point.params)

    def names(self, rates: bool, measurements: Iterable[str]) -> list[str]:
        """The names of the outputs that rates and these measurements need."""
        noises, names = list(self.process) if rates else [], []
        for name in measurements:
            measurement = self.measurements[name]
            noises += measurement.noises
            names += [name] if measurement.covariance is None else [name, _covariance(name)]
        return [*names, *map(_density, noises)]

    def with_zeros(self, u: Mapping[str, Any], dtype: Any) -> dict[str, Any]:
        """The controls of the system with noise, in which noise without a value is zero."""
        return {**{name: jnp.zeros(shape, dtype) for name, shape in self._zeros.items()}, **u}


def _by_name(measurements: Iterable[Measurement]) -> dict[str, Measurement]:
    if not isinstance(measurements, (Measurement, Iterable)):
        raise ModelError(f"a filter expects a list of tx.Measurement(...), got {measurements!r}")
    listed_measurements = [measurements] if isinstance(measurements, Measurement) else list(measurements)
    by_name: dict[str, Measurement] = {}
    for measurement in listed_measurements:
        if not isinstance(measurement, Measurement):
            raise ModelError(f"a filter expects tx.Measurement(...) as measurements, got {measurement!r}")
        if by_name.setdefault(measurement.name, measurement) is not measurement:
            raise ModelError(f"two measurements are named {measurement.name!r}; names must be unique within a filter")
    return by_name


def _need_known(name: str, value: Expr, measurement: Measurement, dynamics: Dynamics, controls: list[str]) -> None:
    states = [state.name for state in dynamics.states]
    for leaf in leaves_of(value, *(() if measurement.covariance is None else (measurement.covariance,))):
        if isinstance(leaf, State) and leaf.name not in states:
            raise ModelError(
                f"Measurement {name!r} reads the state {leaf.name!r}; the system has: {listed(states, leaf.name)}"
            )
        if isinstance(leaf, Control) and leaf.name not in controls:
            raise ModelError(
                f"Measurement {name!r} reads the control {leaf.name!r}; the system has: {listed(controls, leaf.name)}."
                "\n  fix: declare it in tx.System(..., controls=[...])"
            )


def _density(noise: Noise) -> str:
    return f"density of {noise.name}"


def _covariance(name: str) -> str:
    return f"covariance of {name}"


def _square(density: jax.Array, size: int) -> jax.Array:
    """A density as a matrix S with S S^T the intensity. A density (n, n) of one of n entries is a matrix already."""
    if density.shape == (size, size) and size > 0 and density.ndim == 2:
        return density
    return jnp.diag(jnp.broadcast_to(density.reshape(-1), (size,)))
