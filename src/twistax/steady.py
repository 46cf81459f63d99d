"""Steady motion on the manifold: find it within bounds, and take the linear system about it.

free = {"g": None, "V": None, "throttle": (0.0, 1.0)}
level = tx.trim(dynamics, x, u, free=free, fixed=["altitude", "ned_velocity"], zero=["ned_velocity", "attitude"])
level.saturated, level.linear(outputs=["airspeed"]).modes()
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .checks import number, reals, short, whole
from .errors import InputError
from .groups import Euclidean
from .linear_system import LinearSystem, entries, known
from .lowering import Dynamics, compile
from .lowering.dynamics import need_compiled
from .precision import in_double
from .trajectory import linearize

__all__ = ["Trim", "trim"]

Array = np.ndarray
Values = Mapping[str, Any]


@dataclasses.dataclass(frozen=True)
class Trim:
    """A steady motion, or the nearest that was found.

    Attributes:
        dynamics: the system.
        t: the time.
        x, u, params: states, controls and parameters by name, in double precision.
        found: whether everything asked for holds within the tolerance.
        residual: what is left of it: of a fixed output its distance from the value, of what is to be zero its rate.
        saturated: entries of free values that lie on a bound, such as "throttle" or "V[2]".
        steps: how many were taken.
    """

    dynamics: Dynamics
    t: float
    x: dict[str, Array]
    u: dict[str, Array]
    params: dict[str, Array]
    found: bool
    residual: dict[str, Array]
    saturated: tuple[str, ...]
    steps: int

    def __repr__(self) -> str:
        what = "found" if self.found else "NOT found"
        return f"Trim({what} in {self.steps} steps; {self._left()}; saturated: {', '.join(self.saturated) or 'none'})"

    def _left(self) -> str:
        name, left = max(self.residual.items(), key=lambda item: np.max(np.abs(item[1]), initial=0.0))
        return f"most is left of {name!r}, {np.max(np.abs(left), initial=0.0):.1e}"

    def linear(self, outputs: Iterable[str] = ()) -> LinearSystem:
        """The linear system about it: d' = A d + B du, dy = C d + D du.

        d is the right perturbation x (+) d with the transport along the motion, as `tx.trajectory.linearize` has it.

        Args:
            outputs: which of the system's, by name.
        Raises: InputError for an unknown output.
        """
        names = list(outputs)
        known("linear: an output", names, self.dynamics.system.outputs)
        group, n = self.dynamics.group, self.dynamics.dimension
        controls = {leaf.name: leaf.shape for leaf in self.dynamics.controls}
        reduced = _with_outputs(self.dynamics, names)

        def values(z: jax.Array) -> jax.Array:
            u = _split(z[n:], controls)
            found = reduced.outputs(self.t, group.retract(self.x, z[:n]), u, self.params)
            return jnp.concatenate([jnp.zeros(0), *(found[name].reshape(-1) for name in names)])

        with in_double():
            around = linearize(self.dynamics, self.t, self.x, self.u, self.params)
            at = jnp.concatenate([jnp.zeros(n), *(jnp.ravel(self.u[name]) for name in controls)])
            slope = np.asarray(jax.jacfwd(values)(at)) if names else np.zeros((0, at.size))
            y = {name: self.dynamics.system.outputs[name].shape for name in names}
            states = {name: (factor.dimension,) for name, factor in group.factors.items()}
            scalars = {name for name, factor in group.factors.items() if getattr(factor, "shape", None) == ()}
            return LinearSystem(
                np.asarray(around.A),
                np.asarray(around.B),
                slope[:, :n],
                slope[:, n:],
                entries({name: () if name in scalars else shape for name, shape in states.items()}),
                entries(controls),
                entries(y),
            )


def trim(
    dynamics: Dynamics,
    x: Values,
    u: Values | None = None,
    params: Values | None = None,
    *,
    free: Iterable[str] | Mapping[str, Any],
    zero: Iterable[str],
    fixed: Iterable[str] | Mapping[str, Any] = (),
    t: Any = 0.0,
    tolerance: float = 1e-9,
    most_steps: int = 100,
    throw: bool = True,
) -> Trim:
    """A steady motion near a start, by least squares in the tangent space, within bounds.

    Args:
        dynamics: the compiled system.
        x, u, params: the start; all controls that are read must be given.
        free: names of states, controls and parameters that may change; of those with limits, (low, high) by name, which
            may be arrays. A state on a group is free in its tangent space and has no limits.
        zero: what shall not change: names of states, whose rates vanish, or of outputs, whose derivative along the
            motion does.
        fixed: outputs that are held: by name at a value, or names alone, at their value at the start.
        t: the time.
        tolerance: of residuals, in their units; relative for fixed values above 1.
        most_steps: after which it gives up.
        throw: False returns what was found where the residuals stay above the tolerance.
    Raises:
        InputError: no steady motion is found: it says what is left and what is saturated; an unknown or doubled name; a
            start that does not fit, or is outside of the limits.
        ModelError: the system is not compiled.
    """
    need_compiled("trim", dynamics)
    number("trim: tolerance", tolerance, "a positive number", lambda value: 0.0 < value < np.inf)
    whole("trim: most_steps", most_steps)
    number("trim: t", t, "a finite number of s")
    with in_double():
        found = _Search(dynamics, float(t), (x, u or {}, params or {}), free, zero, fixed).run(tolerance, most_steps)
    if throw and not found.found:
        raise InputError(
            f"trim: no steady motion is found: {found!r}.\n"
            "  fix: free more, widen the bounds that are saturated, or start nearer; throw=False returns the nearest"
        )
    return found


class _Search:
    """The unknowns about a start, z, which is zero there, and the residuals as a function of them."""

    def __init__(
        self,
        dynamics: Dynamics,
        t: float,
        start: tuple[Values, Values, Values],
        free: Iterable[str] | Mapping[str, Any],
        zero: Iterable[str],
        fixed: Iterable[str] | Mapping[str, Any],
    ) -> None:
        self.dynamics, self.t, self.group = dynamics, t, dynamics.group
        for name, each in zip(("x", "u", "params"), start):
            if not isinstance(each, Mapping):
                raise InputError(f"trim: {name} must be a dict from names to arrays, got {short(each)}")
        double = [{name: reals(f"trim: {name}", value, InputError) for name, value in each.items()} for each in start]
        inputs = dynamics._functions.prepare(t, *double)
        given = (inputs.x, inputs.u, inputs.params)
        self.start = tuple({name: np.asarray(value, float) for name, value in each.items()} for each in given)
        for place, given_names in (("free", free), ("zero", zero), ("fixed", fixed)):
            if isinstance(given_names, str) or not isinstance(given_names, Iterable):
                raise InputError(f"trim: {place} expects a list of names, got {short(given_names)}")
        self.zero, self.fixed = list(zero), list(fixed)
        if not self.zero and not self.fixed:
            raise InputError("trim: zero and fixed have no names: it needs something to be met")
        states, outputs = self.group.factors, dynamics.system.outputs
        known("trim: free", limits := dict(free if isinstance(free, Mapping) else dict.fromkeys(free)), self._sizes())
        known("trim: zero", self.zero, {**states, **outputs})
        known("trim: fixed", self.fixed, outputs)
        self.outputs = _with_outputs(dynamics, {*self.fixed, *(n for n in self.zero if n not in states)})
        self.free = [name for name in self._sizes() if name in limits]
        self.low, self.high = self._limits(limits)
        held = self._held(dict.fromkeys(self.fixed, 0.0))(self.start)
        wanted = fixed if isinstance(fixed, Mapping) else held
        self.wanted = {name: self._value(name, wanted[name], held[name]) for name in self.fixed}
        sizes = {name: np.maximum(1.0, np.abs(value)) for name, value in self.wanted.items()}
        rates = [np.ones(self._count(name)) for name in self.zero]
        self.size = np.concatenate([*(np.ravel(sizes[name]) for name in self.fixed), *rates])

    def _sizes(self) -> dict[str, int]:
        """Unknowns of each state, control and parameter."""
        sizes = {name: factor.dimension for name, factor in self.group.factors.items()}
        return sizes | {name: value.size for each in self.start[1:] for name, value in each.items()}

    def _count(self, name: str) -> int:
        factors = self.group.factors
        return factors[name].dimension if name in factors else int(np.prod(self.dynamics.system.outputs[name].shape))

    def _value(self, name: str, value: Any, held: Any) -> Array:
        array = reals(f"trim: fixed[{name!r}]", value, InputError)
        if array.shape != held.shape or not np.isfinite(array).all():
            raise InputError(f"trim: fixed[{name!r}] expects finite numbers of shape {held.shape}, got {short(value)}")
        return array

    def _limits(self, limits: Mapping[str, Any]) -> tuple[Array, Array]:
        """Of the unknowns, which are changes."""
        rows: list[tuple[Array, Array]] = []
        for name in self.free:
            value = next(each[name] for each in self.start if name in each)
            factor = self.group.factors.get(name)
            if limits[name] is None:
                rows.append((np.full(self._sizes()[name], -np.inf), np.full(self._sizes()[name], np.inf)))
                continue
            if factor is not None and not isinstance(factor, Euclidean):
                raise InputError(f"trim: free[{name!r}] has no limits, as a state on {factor.name}: give None")
            place = f"trim: free[{name!r}]"
            try:
                low, high = (np.broadcast_to(reals(place, end, InputError), value.shape) for end in limits[name])
            except (TypeError, ValueError) as error:
                raise InputError(f"{place} expects (low, high) or None, got {short(limits[name])}") from error
            if not ((low <= value) & (value <= high)).all():
                raise InputError(f"trim: the start of {name!r} is outside of its limits: {short(value)}")
            rows.append((np.ravel(low - value), np.ravel(high - value)))
        return tuple(np.concatenate([np.zeros(0), *side]) for side in zip(*rows))  # type: ignore[return-value]

    def at(self, z: Any) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        """States, controls and parameters of the unknowns."""
        x, u, params = (dict(each) for each in self.start)
        tangent, place = dict.fromkeys(self.group.factors, None), 0
        for name in self.free:
            part = z[place : place + self._sizes()[name]]
            place += part.size
            if name in tangent:
                tangent[name] = part
                continue
            holder = u if name in u else params
            holder[name] = holder[name] + jnp.reshape(part, np.shape(holder[name]))
        zeros = {name: jnp.zeros(factor.dimension) for name, factor in self.group.factors.items()}
        d = jnp.concatenate([zeros[name] if part is None else part for name, part in tangent.items()])
        return self.group.retract(x, d), u, params

    def _held(self, wanted: Mapping[str, Any]) -> Callable[[Any], dict[str, Any]]:
        def values(point: Any) -> dict[str, Any]:
            found = self.outputs.outputs(self.t, *point) if wanted else {}
            return {name: found[name] - value for name, value in wanted.items()}

        return values

    def residual(self, z: Any) -> jax.Array:
        """What is left of fixed values and rates, one after another."""
        point = self.at(z)
        x, u, params = point
        held = self._held(self.wanted)(point)
        rates = self.dynamics(self.t, x, u, params)
        motion = jnp.concatenate([jnp.reshape(rates[name], -1) for name in self.group.factors])
        rates = dict(rates)
        if moving := [name for name in self.zero if name not in self.group.factors]:

            def along(s: jax.Array) -> dict[str, jax.Array]:
                found = self.outputs.outputs(self.t + s, self.group.retract(x, s * motion), u, params)
                return {name: found[name] for name in moving}

            rates.update(jax.jvp(along, (jnp.zeros(()),), (jnp.ones(()),))[1])
        parts = [*(held[name] for name in self.fixed), *(rates[name] for name in self.zero)]
        return jnp.concatenate([jnp.zeros(0), *(jnp.reshape(part, -1) for part in parts)])

    def run(self, tolerance: float, most: int) -> Trim:
        """Levenberg-Marquardt with linear least squares in a box."""
        from scipy.optimize import lsq_linear

        z = np.zeros(self.low.size)
        residual = jax.jit(lambda z: self.residual(z) / self.size)
        slope = jax.jit(jax.jacfwd(lambda z: self.residual(z) / self.size))
        left, damping, steps = np.asarray(residual(z)), 1e-3, 0
        while steps < most and np.max(np.abs(left), initial=0.0) > tolerance and damping < 1e10 and z.size:
            steps += 1
            J = np.asarray(slope(z))
            widths = np.linalg.norm(J, axis=0)
            scale = np.diag(np.where(widths > 0.0, widths, 1.0))
            while damping < 1e10:
                rows = np.vstack([J, np.sqrt(damping) * scale])
                room = np.minimum(self.low - z, -1e-300), np.maximum(self.high - z, 1e-300)
                step = lsq_linear(rows, np.concatenate([-left, np.zeros(z.size)]), room, tol=1e-14).x
                trial = np.clip(z + step, self.low, self.high)
                after = np.asarray(residual(trial))
                if np.isfinite(after).all() and after @ after < left @ left:
                    z, left, damping = trial, after, max(0.03 * damping, 1e-15)
                    break
                damping *= 10.0
        x, u, params = ({name: np.asarray(v, float) for name, v in each.items()} for each in self.at(z))
        near = 1e-9 * np.maximum(1.0, np.minimum(self.high - self.low, 1e300))
        names = entries({name: self._shape(name) for name in self.free})
        on_bound = (z - self.low <= near) | (self.high - z <= near)
        counts = {name: self._count(name) for name in (*self.fixed, *self.zero)}
        parts = np.split(left * self.size, np.cumsum(list(counts.values()))[:-1])
        return Trim(
            self.dynamics,
            self.t,
            x,
            u,
            params,
            bool(np.max(np.abs(left), initial=0.0) <= tolerance),
            dict(zip(counts, parts)),
            tuple(name for name, there in zip(names, on_bound) if there),
            steps,
        )

    def _shape(self, name: str) -> tuple[int, ...]:
        factor = self.group.factors.get(name)
        if factor is not None and not isinstance(factor, Euclidean):
            return (factor.dimension,)
        return next(np.shape(each[name]) for each in self.start if name in each)


def _split(flat: jax.Array, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, jax.Array]:
    found, place = {}, 0
    for name, shape in shapes.items():
        size = int(np.prod(shape))
        found[name] = flat[place : place + size].reshape(shape)
        place += size
    return found


def _with_outputs(dynamics: Dynamics, names: Iterable[str]) -> Dynamics:
    """The same system with some of its outputs, so that no others are computed."""
    wanted = [name for name in dynamics.system.outputs if name in set(names)]
    return compile(dynamics.system, outputs=wanted, bake=dynamics.baked, backend=dynamics.backend)
