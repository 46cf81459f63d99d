"""The solution of an integration: states, counts, dense output, and the status."""

from __future__ import annotations

import dataclasses
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import listed, real_array
from ...errors import InputError, IntegrationError
from ...groups.columns import Column
from ...jax_inside import is_traced
from ...plots import Pictured, draw
from ...progress import watching
from ...system.dynamics import Arrays
from ...system.labels import declared_labels
from ...units import same_unit, seconds
from ..charts.coordinates import Blocks
from ..events.crossings import CrossingRows
from ..loop.outcome import Result, Trail
from ..loop.unreached import nan_unless
from ..method import Stepper, jitted

if TYPE_CHECKING:
    from ...view import Scene


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Stats:
    """Counts of an integration; `stats.steps` and `stats["steps"]` are the same.

    Attributes:
        steps: steps tried, accepted and rejected together.
        accepted, rejected: the number of accepted steps, and of steps repeated with a smaller length.
        rhs_evaluations: the number of evaluations of the right-hand side, including those for saved times between
            steps.
    """

    steps: Any
    accepted: Any
    rejected: Any
    rhs_evaluations: Any

    def __getitem__(self, name: str) -> Any:
        if name not in self.__dict__:
            raise InputError(f"stats has no {name!r}; the counts are: {listed(self.__dict__, name)}")
        return self.__dict__[name]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Crossings:
    """The roots of event conditions that did not end the integration, in the order of their times.

    Under `jit` and `vmap` the arrays have `max_crossings` rows; rows from `count` on are NaN.

    Attributes:
        ts: (n,) times in s.
        xs: states by name, leading axis n.
        events: (n,) index of the event in `event=`; -1 in unused rows.
        directions: (n,) 1 if the condition rises along the integration, -1 if it falls; 0 in unused rows.
        count: number of crossings.
    """

    ts: jax.Array
    xs: Arrays
    events: jax.Array
    directions: jax.Array
    count: Any

    @classmethod
    def of(cls, rows: CrossingRows) -> Crossings:
        """The crossings of a rollout, without the unused rows if numbers are known."""
        if is_traced(rows):
            return cls(rows.ts, rows.xs, rows.which, rows.directions, rows.used)
        count = int(rows.used)
        columns = (rows.ts, rows.xs, rows.which, rows.directions)
        ts, xs, which, directions = jax.device_put(jax.tree.map(lambda a: np.asarray(a)[:count], columns))
        return cls(ts, xs, which, directions, count)


class Dense(NamedTuple):
    """Dense output: the starts of all steps, and the stepper.

    Between two starts, the state is computed by one shorter step of the same method, so it stays in its group and is as
    accurate as the saved states. An interpolating polynomial would have a lower order and leave the group.
    """

    stepper: Stepper
    trail: Trail


def _between() -> Callable[[Stepper, Trail, jax.Array], Arrays]:
    def states(stepper: Stepper, trail: Trail, ts: jax.Array) -> Arrays:
        stored, ts = stepper.stored, stepper.clock(ts)
        last = jnp.maximum(trail.steps - 1, 0)
        before = jnp.searchsorted(trail.t, ts, side="right").astype(last.dtype) - 1
        k = jnp.clip(before, 0, last)

        def state(t: jax.Array, start: jax.Array, y: Blocks) -> Arrays:
            return stored.value(stepper.advance(start, y, t - start))

        values = jax.vmap(state)(ts, trail.t[k], jax.tree.map(lambda a: a[k], trail.y))
        start, end = trail.t[0], trail.t[trail.steps]
        return nan_unless((ts >= start - _room(start, end)) & (ts <= end + _room(start, end)), values)

    return states


def _need_solved(ts: jax.Array, states: Arrays) -> None:
    """Raise IntegrationError if the state at a time, in a step that was taken, is NaN."""
    unknown = [np.isnan(np.asarray(value)).reshape(len(ts), -1).any(axis=1) for value in states.values()]
    if (at := np.flatnonzero(np.any(unknown, axis=0))).size:
        raise IntegrationError(
            f"evaluate: the equations of the shorter step to t = {float(ts[at[0]]):.6g} s could not be solved.\n"
            "  likely cause: rates that are not smooth within the step\n"
            "  fix: name such times in jumps=..., so that steps end there, or smooth the expression"
        )


class AnySolution(ABC):
    """Base class of `Solution` and `PhasedSolution`: the result code, and the table export."""

    code: Any  # the number of a `Result`

    @property
    def result(self) -> Any:
        """The `Result`; for traced or batched solutions an array of codes, which can be compared with `Result`."""
        unknown = is_traced(self.code) or np.ndim(self.code) > 0
        return self.code if unknown else Result(int(self.code))

    @abstractmethod
    def _columns(self, layout: Any) -> list[Column]:
        pass

    def to_csv(self, path: Any, layout: Any = None) -> None:
        """Write a CSV table of the saved times: a header of names with units, then a row for each time, with all
        digits.

        For several phases it has the rows of all phases, a column with the number of the phase, and the columns that
        all phases have.

        Args:
            path: the file; an existing file is overwritten.
            layout: the columns: `tx.columns.Columns(units={"h": "m"}, rotations=tx.columns.EULER)`, or a
                custom `tx.columns.Layout`. By default time, states, controls and outputs, rotations as
                quaternions.
        Raises:
            InputError: a batch, or a traced solution; a unit of an unknown name; a path that cannot be written.
            ModelError: the layout has another type.
        """
        from .table_export import write_csv

        write_csv(self._columns(layout), path)

    def to_dataframe(self, layout: Any = None) -> Any:
        """The table of `to_csv` as a DataFrame of pandas. Raises ModelError where pandas is not installed."""
        from .table_export import frame_of

        return frame_of(self._columns(layout))


def need_one(what: str, solution: Solution) -> None:
    """Raise InputError for a solution that is traced or a batch."""
    if is_traced((solution.ts, solution.xs)):
        raise InputError(
            f"{what} expects numbers, got a solution that is traced, as inside of jit, vmap and grad.\n"
            "  fix: return the solution from the function, and use the returned one"
        )
    if np.ndim(solution.ts) != 1:
        raise InputError(
            f"{what} expects one solution, got a batch with times of shape {np.shape(solution.ts)}.\n"
            "  fix: jax.tree.map(lambda a: a[i], solution) is one of them"
        )


def times_to_evaluate(t: Any, dtype: Any) -> jax.Array:
    """The times at which a solution is evaluated, in its precision. Raises InputError for invalid times."""
    same_unit("evaluate: t", t, seconds)
    return jnp.asarray(real_array("evaluate: t", t), dtype)


def _room(start: Any, end: Any) -> Any:
    """The tolerance for times outside of a span, for rounding."""
    return 1e-6 * (end - start)


def need_within(ts: Any, start: Any, end: Any, span: str) -> None:
    """Raise InputError for times outside of a span, described by `span`, up to round-off."""
    (start, end), times = sorted((float(start), float(end))), np.ravel(ts)
    room = _room(start, end)
    outside = ~((times >= start - room) & (times <= end + room))
    if outside.any():
        wrong = float(times[int(np.argmax(outside))])
        raise InputError(f"evaluate expects times in [{start:g}, {end:g}] ({span}), got {wrong:g}")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Solution(AnySolution):
    """The states at the saved times. A pytree, so that jit, vmap and derivatives of an integration apply.

    Attributes:
        ts: (n,) saved times in s; without save_at only the final time.
        xs: states by name, leading axis n.
        stats: counts.
        code: the number of the `Result`.
        dense: the data for `evaluate`, with dense=True; else None.
        which: the number of the event that ended it, -1 for none; None without events.
        stepper: the method, the system and the inputs of the integration.
        at_start: (m,) for each event whether its condition was zero or beyond zero at the start; None without events.
        crossings: the `Crossings` of events that do not end the integration; None without such events.
    """

    ts: jax.Array
    xs: Arrays
    stats: Stats
    code: Any
    dense: Dense | None = None
    which: Any = None
    stepper: Any = None
    at_start: Any = None
    crossings: Crossings | None = None

    def __repr__(self) -> str:
        shapes = {name: np.shape(value) for name, value in {"ts": self.ts, **self.xs}.items()}
        try:
            ended = self.result if isinstance(self.result, Result) else "a batch, or traced"
        except (TypeError, ValueError):  # other leaves in the same pytree, such as those of jax.eval_shape and jax.jvp
            ended = "abstract values"
        return f"Solution({', '.join(f'{name} {shape}' for name, shape in shapes.items())}; {ended})"

    @property
    def last(self) -> Arrays:
        """The state in the last row, by name, for example as the start of the next integration.
        Batches are supported.
        """
        at = np.ndim(self.ts) - 1
        return {name: jnp.take(value, -1, axis=at) for name, value in self.xs.items()}

    @functools.cached_property
    def us(self) -> Arrays:
        """The controls by name at the saved times, leading axis n; at a jump the right-hand limit.

        At the end of a table that has no later value, it is the left-hand limit. Batches and calls inside of jit are
        supported.
        """
        from .outputs import controls_along

        return controls_along(self.stepper, self.ts)

    @functools.cached_property
    def outputs(self) -> Arrays:
        """The outputs of the system by name at the saved times, leading axis n; computed in one call when first read.

        Batches and calls inside of jit are supported. Rows that were not reached are NaN, like their states.

        Raises:
            InputError: an output reads a control or a parameter that was not passed to the integration.
        """
        from .outputs import outputs_along

        return outputs_along(self.stepper, self.ts, self.xs)

    @property
    def event(self) -> Any:
        """The number of the event that ended it, or None; for traced or mapped solutions an array, -1 for none."""
        if self.which is None or is_traced(self.which) or np.ndim(self.which) > 0:
            return self.which
        return int(self.which) if int(self.which) >= 0 else None

    @watching("evaluate")
    def evaluate(self, t: Any) -> Arrays:
        """The states by name at a time () or at times (n,), with a leading axis for the latter. Requires dense=True.

        Each state is computed by one shorter step of the same method from the start of its step, so it is in its group
        and as accurate as the saved states. It is also differentiable with respect to t.

        Raises:
            InputError: there is no dense output; times outside of the integration.
            IntegrationError: the equations of an implicit step to one of the times cannot be solved; inside `jit` its
                states are NaN.
        """
        if self.dense is None:
            raise InputError("this solution has no dense output.\n  fix: tx.integrate(..., dense=True)")
        trail = self.dense.trail
        ts = times_to_evaluate(t, trail.t.dtype)
        if ts.ndim > 1:
            raise InputError(f"evaluate expects a time or times with shape (n,), got shape {ts.shape}")
        if not is_traced((ts, trail)):
            known = np.asarray(self.dense.stepper.clock(trail.t))
            need_within(ts, known[0], known[int(trail.steps)], "the integrated span")
        states: Arrays = jitted(_between, self.dense.stepper, trail, ts.reshape(-1))
        if not is_traced(states):
            _need_solved(ts.reshape(-1), states)
        return {name: value[0] for name, value in states.items()} if ts.ndim == 0 else states

    @watching("plot")
    def plot(self, *names: Any, units: Mapping[str, str] | None = None) -> Any:
        """A matplotlib figure of the saved states over time, with poses as positions and Euler angles in deg.

        Entries of a mechanism are named by joint, with a panel for each unit.

        Args:
            names: names of the states, outputs and joints to draw, such as `plot("rpm", "panel")`; all states by
                default.
            units: units by name, such as {"v": "m/s"}; the default is the declared unit, else "SI", and "m" for
                positions. If the unit is known, {"qd": "rpm"} or {"panel": "deg"} converts from rad and rad/s, m and
                m/s.
        Raises:
            InputError: an unknown name, a unit of another quantity than the declared one, a single saved time, or a
                traced or batched solution.
            ModelError: matplotlib is not installed.
        """
        need_one("plot", self)
        if len(self.ts) < 2:
            raise InputError("plot expects two saved times or more, got one.\n  fix: tx.integrate(..., save_at=times)")
        ts, system = np.asarray(self.ts), None if self.stepper is None else self.stepper.dynamics.system
        outputs, labels, declared = (
            ([], {}, {}) if system is None else (list(system.outputs), system.labels, declared_labels(system))
        )

        def pieces(name: str) -> list[tuple[Any, Any]]:
            return [(ts, np.asarray(self.xs[name] if name in self.xs else self.outputs[name]))]

        return draw(Pictured(list(self.xs), outputs, pieces, labels, units, declared).panels(names))

    def show(self, path: Any = None, **choices: Any) -> Scene:
        """The motion in three dimensions: an animation in one HTML file that needs no network, with a time slider.

        Bodies are drawn to scale, and the size of the ground's squares is printed next to the time. Frames between
        saved times are interpolated: save enough times that no body rotates by half a turn in between.

        Args:
            path: of the HTML file; an existing file is overwritten. By default it is opened in a browser, or in a
                notebook.
            choices: the following options

                bodies: a mapping from states to shapes, `{"g": tx.view.Box((1.0, 2.0, 0.5))}`,
                    with one shape, several, or () for axes alone; a state is a pose, a rotation about the origin, or a
                    pair `("R", "p")` of a rotation and a position. Or a mechanism. By default the axes of every pose
                    and rotation.
                arrows: states, controls and outputs of shape (3,), or wrenches and twists (6,), to draw as arrows:
                    `{"T": tx.view.Arrow("g", at=engine)}`.
                shapes: fixed shapes: obstacles, cones, a ground.
                trails: names of bodies and frames whose path is drawn; those of poses by default.
                axes: names of bodies whose axes are drawn, x red, y green, z blue; those of states by default.
                up: (3,) the upward direction; z by default.
                seconds: duration of the animation; by default real time, from 2 to 20 s.
                follow: the name of a body or frame at the centre of the picture, which is then some
                    lengths of it wide; by default the picture shows the whole motion.
                caption: names of states, controls and outputs whose values are printed next to the time.
                ground: whether a plane is drawn below everything, with shadows; True by default.
                live: also serve it to a browser on this machine, with a slider; needs no file.
                opened: open it in a browser if there is no path; True by default.
        Returns:
            the scene, a `tx.view.Scene`, which can be saved, served and inspected.
        Raises:
            InputError: unknown names; shapes, arrows or bodies of another type; a single saved time; a
                traced or batched solution; a path that cannot be written.
            ModelError: viser, the extra `view`, is not installed.
        """
        from ...view.motion import Motion, shown

        need_one("show", self)
        if self.stepper is None:  # for a manually constructed solution only the states are known
            return shown(Motion(np.asarray(self.ts), self.xs), path, **choices)
        signals = (lambda: self.us, lambda: self.outputs)
        return shown(Motion(np.asarray(self.ts), self.xs, signals, self.stepper.params), path, **choices)

    def video(self, path: Any, *, size: tuple[int, int] = (1280, 720), **choices: Any) -> Path:
        """A video of the motion, such as `solution.video("flight.mp4", follow="g")`; see `tx.view.Scene.video`.

        Args:
            path, size: of the file, and width and height of its pictures in pixels.
            choices: those of `show`.
        Raises:
            InputError, ModelError: as `show` and `tx.view.Scene.video`.
        """
        return self.show(opened=False, **choices).video(path, size=size)

    def _columns(self, layout: Any) -> list[Column]:
        from .table_export import columns_of

        need_one("a table", self)
        return columns_of(self, layout)
