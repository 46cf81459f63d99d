"""The options of an integration: one record for `integrate`, `integrate_phases`, `Phase` and `simulator`, with its
checks.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import instance, listed, real_array
from ..errors import InputError
from ..expr import Inputs, State
from ..groups import Group
from ..jax_inside import is_traced, is_tracing
from ..system.dynamics import Dynamics, need_compiled
from ..system.inputs import cast, is_finite, need_representable, precision
from .charts.chart import Ambient
from .controls import ByName, OfTime, Signals, controls_of
from .events.conditions import EventConditions, event_conditions
from .loop.adaptive_steps import AdaptiveSteps
from .loop.fixed_steps import FixedSteps, equal_steps
from .method import Method, Stepper
from .methods.interpolant import Between
from .methods.projected import need_start_on_manifold, projected
from .methods.rkmk import RKMK
from .step_control import FINEST, StepControl, Stops, Tolerances, direction_of, limits_of, span_of
from .tableaus import DOP853, RK4
from .times import check_saves, filled, with_saves

First = TypeVar("First")
Second = TypeVar("Second")
Result = TypeVar("Result")
P = ParamSpec("P")

#: The default methods of fixed and of adaptive steps, and the default step control.
_FIXED, _ADAPTIVE, _CONTROL = RKMK(RK4), RKMK(DOP853, Ambient()), StepControl()


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class StepOptions:
    """Options of steps, with the meaning that `tx.integrate` documents."""

    dt: Any = None
    steps: int | None = None
    rtol: Any = None
    atol: Any = None
    method: Method | None = None
    control: StepControl | None = None

    def over(self, shared: StepOptions) -> dict[str, Any]:
        """The fields by name; fields that are None have the values of `shared`."""
        fields = [field.name for field in dataclasses.fields(StepOptions)]
        values = {name: getattr(self, name) for name in fields}
        return {name: getattr(shared, name) if value is None else value for name, value in values.items()}


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FlightOptions(StepOptions):
    """The options that the integration of one phase and of several phases have in common."""

    t0: Any = 0.0
    u: Any = None
    params: Mapping[str, Any] | None = None
    save_at: Any = None
    between: Between = Between.STEP
    dense: bool = False
    throw: bool = True
    progress: Any = None


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Options(FlightOptions):
    """The options of `tx.integrate`."""

    t1: Any
    jumps: Any = None
    event: Any = None
    max_crossings: Any = None

    @property
    def adaptive(self) -> bool:
        """Whether tolerances choose the steps."""
        return self.rtol is not None or self.atol is not None


def with_options(
    record: Callable[P, Any],
) -> Callable[[Callable[[First, Second, Any], Result]], Callable[Concatenate[First, Second, P], Result]]:
    """Turn a function of two arguments and a record into one of two arguments and the fields of the record."""

    def decorate(function: Callable[..., Any]) -> Any:
        *leading, _ = inspect.signature(function).parameters.values()
        names = [parameter.name for parameter in leading]

        @functools.wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            try:
                first = [*arguments[: len(names)], *(named[name] for name in names[len(arguments) :])]
                fields = {name: value for name, value in named.items() if name not in names}
                options = record(*arguments[len(names) :], **fields)
                assert len(fields) == len(named) - max(len(names) - len(arguments), 0)
            except (TypeError, KeyError, AssertionError):
                try:
                    signature.bind(*arguments, **named)
                except TypeError as error:
                    raise TypeError(_call_error(function.__name__, signature, arguments, named, error)) from None
                raise
            return function(*first, options)

        result = inspect.signature(function).return_annotation
        parameters = [*leading, *inspect.signature(record).parameters.values()]
        parameters.sort(key=lambda parameter: (parameter.kind, parameter.default is not parameter.empty))
        signature = inspect.Signature(parameters, return_annotation=result)
        call.__signature__ = signature  # type: ignore[attr-defined]
        del call.__wrapped__  # its arguments are others
        return call

    return decorate


def _call_error(
    name: str, signature: inspect.Signature, arguments: Sequence[Any], named: Mapping[str, Any], error: TypeError
) -> str:
    """The message of a call that does not match the signature, with the arguments that are expected."""
    options = [p.name for p in signature.parameters.values() if p.kind is p.KEYWORD_ONLY]
    leading = [p for p in signature.parameters if p not in options]
    if len(arguments) > len(leading):
        return (
            f"{name}() expects {len(leading)} positional arguments ({', '.join(leading)}), got {len(arguments)}.\n"
            f"  fix: pass the others by name: {', '.join(options)}"
        )
    unknown = [key for key in named if key not in signature.parameters]
    return f"{name}() {error}; it expects {listed(options, unknown[0])}" if unknown else f"{name}() {error}"


class Plan(NamedTuple):
    """A checked integration."""

    stepper: Stepper
    steps: AdaptiveSteps | FixedSteps
    x: dict[str, Any]  # the prepared start
    t0: Any
    ts: Any  # (n,) the saved times, or the end
    traced: bool  # whether any of it is traced


def plan_of(dynamics: Any, x0: Any, options: Options) -> Plan:
    """The checked plan of the arguments of `integrate`. Raises its errors before the integration starts."""
    if not isinstance(dynamics, Dynamics):
        need_compiled("integrate", dynamics)
    method = _method_of(dynamics, options)
    need_flag("dense", options.dense)
    instance("between", options.between, Between, "tx.Between.STEP or tx.Between.POLYNOMIAL", InputError)
    instance("control", options.control, StepControl | None, "tx.StepControl(...)", InputError)
    span = span_of(options.t0, options.t1, options.dt)
    controls = controls_of(options.u)
    inputs = _inputs_of(dynamics, x0, options, controls)
    dtype = inputs.dtype
    if span is not None:
        need_representable("t1", np.asarray(span[1]), dtype)
        if isinstance(controls, ByName):
            controls.check_span(min(span), max(span))
    signals, x = controls.prepared(inputs.u, dtype), dict(inputs.x)
    events, conditions = _event_conditions(dynamics, options, inputs, signals)
    times = (options.t0, options.t1, options.dt, options.rtol, options.atol, options.jumps, options.save_at)
    traced = is_traced((signals, inputs.u, inputs.params, x, times, conditions))
    if traced and isinstance(signals, OfTime):
        signals = signals.opened(jnp.asarray(inputs.t))
    direction, inward = direction_of(options.t0, options.t1, dtype), options.jumps is not None
    params = dict(inputs.params)
    stepper = Stepper(dynamics, method, signals, params, within=True, inward=inward, direction=direction)
    # From here on times are those of the clock of the loop over steps, which goes forward.
    array: Any = np if span else jnp
    start, end = (direction * array.asarray(t, dtype) for t in (options.t0, options.t1))
    span = span and (float(direction) * span[0], float(direction) * span[1])
    saves, count = None, np.asarray(0)
    if options.save_at is not None:
        pad = not traced and not is_tracing()
        saves = _saves_of(options, span, direction, end, sum(value.size for value in x.values()) if pad else None)
        count = np.asarray(len(options.save_at))
    limits = limits_of(start, end, options.jumps, signals, direction)
    steps: AdaptiveSteps | FixedSteps
    if options.adaptive:
        steps = _adaptive_steps(dynamics, method, options, Stops.of(limits, start, saves, count), start, events)
        if method.solves:
            stepper = dataclasses.replace(stepper, tolerances=steps.tolerances)
    else:
        polynomial = options.between if options.between is Between.POLYNOMIAL else None
        for name, value in (("control", options.control), ("between", polynomial)):
            if value is not None:
                raise InputError(f"{name} applies to adaptive steps: pass rtol and atol in place of dt or steps")
        steps, number = equal_steps(start, end, span, options, limits, traced or options.dense, events)
        steps = steps if saves is None else with_saves(steps, number, saves, span, count)
    ends = [options.t1] if options.save_at is None else options.save_at
    ts = (jnp if is_traced(ends) else np).asarray(ends, dtype)
    return Plan(stepper, steps, x, inputs.t, ts, traced)


def _method_of(dynamics: Dynamics, options: Options) -> Method:
    method = options.method
    if method is None:
        method = _ADAPTIVE if options.adaptive else _FIXED
    instance("method", method, Method, "an object like tx.RKMK(tx.tableaus.RK4)", InputError)
    if dynamics.system.corrections:
        method = projected(method)
    method.check(dynamics)
    return method


def _inputs_of(dynamics: Dynamics, x0: Any, options: Options, controls: Signals) -> Inputs:
    places = ("t0", "x0", "u(t)" if isinstance(controls, OfTime) else "u", "params")
    dtype = precision(x0, options.params)
    u = _controls_at_start(dynamics, controls, options.t0, dtype)
    inputs = dynamics.functions.prepare(options.t0, x0, u, options.params, names=places, on_host=True)
    _check_start(dynamics, inputs, places)
    if dynamics.system.corrections:
        need_start_on_manifold(dynamics, inputs)
    return inputs


def _event_conditions(
    dynamics: Dynamics, options: Options, inputs: Inputs, signals: Signals
) -> tuple[EventConditions | None, list[Any] | None]:
    if options.event is not None:
        return event_conditions(dynamics, options.event, inputs, signals, options.max_crossings)
    if options.max_crossings is not None:
        raise InputError(
            "max_crossings applies to events that do not end the integration, but there is no event.\n"
            "  fix: leave it out, or pass event=tx.Event(condition, terminal=False)"
        )
    return None, None


def _saves_of(options: Options, span: Any, direction: Any, end: Any, width: int | None) -> Any:
    """The saved times on the clock of the loop; with the width of a row, known ones are padded."""
    known = check_saves(options.save_at, None if span is None else (float(options.t0), float(options.t1)))
    saves = (jnp if is_traced((direction, options.save_at)) else np).asarray(options.save_at)
    # In the precision of the argument, which says how exact they are.
    saves = saves if saves.dtype.kind == "f" else saves.astype(end.dtype)
    saves = direction.astype(saves.dtype) * saves
    if not known or width is None:
        return saves
    # Polynomials are evaluated up to the time of the loop: never at infinity, the padding.
    return filled(saves, np.inf if options.between is Between.POLYNOMIAL else end, width)


def _adaptive_steps(
    dynamics: Dynamics, method: Method, options: Options, stops: Stops, start: Any, events: EventConditions | None
) -> AdaptiveSteps:
    if options.steps is not None:
        raise InputError(
            "steps selects fixed steps, but rtol or atol selects adaptive steps.\n  fix: leave one of them out"
        )
    _ = method.error_order  # a method without an error estimate says so here
    if options.between is Between.POLYNOMIAL:
        method.need_polynomial()
    dt, dtype = options.dt, start.dtype
    if dt is not None:
        need_representable("dt", real_array("dt", dt), dtype)
    first = (jnp if is_traced(dt) else np).asarray(0.0 if dt is None else dt, dtype)
    tolerances = tolerances_of(dynamics, options.rtol, options.atol, dtype)
    control = options.control or _CONTROL
    return AdaptiveSteps(start, first, stops, tolerances, control, options.dense, options.between, events)


def need_flag(name: str, value: Any) -> None:
    """Raise InputError for a value that is not True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"{name} must be True or False, got {value!r}")


def _controls_at_start(dynamics: Dynamics, controls: Signals, t0: Any, dtype: Any) -> Mapping[str, Any]:
    """The controls at t0, for the check of names and shapes; those of a function are cached."""
    if isinstance(controls, ByName):
        return controls.sample(t0)
    plain = not controls.inputs and jax.tree_util.all_leaves([controls.function])
    if is_tracing() or not plain:
        return controls.sample(jnp.asarray(t0, dtype))
    loops, key = dynamics.functions.loops, (_controls_at_start, controls.function, np.dtype(dtype))
    return loops.get(key, lambda: controls.sample(jnp.asarray(t0, dtype)))


def _check_start(dynamics: Dynamics, inputs: Inputs, places: Sequence[str]) -> None:
    """Raise InputError where known values of the start are not finite, or rotations and poses not in their groups."""
    for place, values in zip(places[1:], (inputs.x, inputs.u, inputs.params), strict=True):
        for name, value in values.items():
            if not is_finite(value):
                raise InputError(f"{place}[{name!r}] expects finite numbers, got {np.asarray(value)}")
    for name, group in dynamics.group.factors.items():
        need_element(name, group, inputs.x[name])


def need_element(name: str, group: Group, value: Any, place: str = "x0") -> None:
    """Raise InputError for a known start of a state that is not an element of its group."""
    if group.flat or is_traced(value):
        return
    defect = group.known_defect(np.asarray(value))
    tolerance = 1e-6
    if defect > tolerance:  # jnp.finfo takes long
        tolerance = max(tolerance, 1e3 * float(jnp.finfo(value.dtype).eps))
    if defect > tolerance:
        raise InputError(
            f"{place}[{name!r}] is not an element of {group.name}: off by {defect:.3g}, "
            f"where {tolerance:.0e} is allowed"
            + (
                " (the rotation's R'R - I, and the last row of a pose).\n"
                "  fix: build poses with tx.pose(...), or take the nearest element with "
                f"tx.{group.name}.normalize(g)"
                if group.rigid
                else ".\n  fix: take the nearest element, that which normalize of the group gives"
            )
        )


def tolerances_of(dynamics: Dynamics, rtol: Any, atol: Any, dtype: Any) -> Tolerances:
    """The tolerances, checked if they are known. Raises InputError for invalid ones."""
    if rtol is None:
        raise InputError("atol requires rtol.\n  fix: pass both, e.g. rtol=1e-9, atol=1e-9")
    relative = _numbers("rtol", rtol, dtype)
    if relative.shape != ():
        raise InputError(f"rtol must be one number, got shape {relative.shape}; atol may be a dict by state")
    finest = FINEST * float(jnp.finfo(dtype).eps)
    if not is_traced(rtol):
        if not 0.0 <= float(rtol) < np.inf:
            raise InputError(f"rtol must be a positive number, got {float(rtol):g}.\n  fix: e.g. rtol=1e-6")
        if float(rtol) < finest:
            precise = (
                'use float64: jax.config.update("jax_enable_x64", True) before anything else, and x0 in double '
                "precision, or "
            )
            precise = precise if np.dtype(dtype) == np.float32 else ""
            raise InputError(
                f"rtol = {float(rtol):g} is below {finest:.1e}, ten times the round-off of {np.dtype(dtype).name}.\n"
                f"  fix: {precise}pass a larger rtol"
            )
    atol = rtol if atol is None else atol
    names = [state.name for state in dynamics.states]
    by_state = atol if isinstance(atol, Mapping) else dict.fromkeys(names, atol)
    for name in by_state:
        if name not in names:
            raise InputError(f"atol names {name!r}, which is not a state; the states are: {listed(names, name)}")
    for name in names:
        if name not in by_state:
            raise InputError(f"atol has no entry for state {name!r}.\n  fix: atol={{..., {name!r}: 1e-9}}")
    return Tolerances(
        relative,
        {state.name: _absolute(state, by_state[state.name], dtype) for state in dynamics.states},
        {
            s.name: _by_deviation(s, _numbers(f"scale of state {s.name!r}", s.scale, dtype))
            for s in dynamics.states
            if s.scale is not None
        },
    )


def _absolute(state: State, value: Any, dtype: Any) -> Any:
    """The allowed error of one state; for a state with rotation and position a pair (rotation, position)."""
    place, group = f"atol of state {state.name!r}", state.group
    is_pair = isinstance(value, (tuple, list)) and len(value) == 2 and not any(map(np.ndim, value))
    if is_pair and _is_pose(group):
        rotation, position = (_numbers(place, part, dtype) for part in value)
        stack: Any = jnp.stack if is_traced(value) else np.stack
        array = _by_deviation(state, stack([rotation if angular else position for angular in group.angular]))
    else:
        array = _numbers(place, value, dtype)
        shape = group.tangent_shape
        if array.shape not in ((), shape):
            pair = ", or the pair (rotation, position)" if _is_pose(group) else ""
            raise InputError(f"{place} expects a number or shape {shape}{pair}, got shape {array.shape}")
        array = _by_deviation(state, array) if array.shape else array
    # Not < 0, so that NaN is refused too.
    if not is_traced(array) and not (np.asarray(array) >= 0.0).all():
        raise InputError(f"{place} must not be negative, got {array}")
    return array


def _is_pose(group: Group) -> bool:
    return {part.unit for part in group.parts} == {"rad", "m"}


def _by_deviation(state: State, array: Any) -> Any:
    """Values by tangent entry, in the order of the state's deviations."""
    return state.group.to_linear_first(array.reshape(-1))


def _numbers(place: str, value: Any, dtype: Any) -> Any:
    array = real_array(place, value)
    if array.dtype == bool:
        raise InputError(f"{place} expects real numbers, got {value!r}")
    return cast(place, array, dtype, on_host=True)
