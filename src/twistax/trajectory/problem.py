"""An optimal-control problem on a compiled system, and the embedded optimiser's front."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..checks import callable_with, number, reals, whole
from ..errors import InputError, ModelError, TrajectoryError
from ..expr import Control, State
from ..integrators import RKMK
from ..lowering import Dynamics
from ..lowering.dynamics import need_compiled
from .discretize import method_of
from .guess import Scales, column_scales, control_guess, state_guess, user_guess
from .model import BorderedBand
from .optimizer import Callback, Optimizer
from .result import TrajectoryResult, best_result
from .statement import Objective, check_leaves, describe_path, end_values, final_rows, fixed_entries, split_final
from .transcription import Evaluation, Iterate, Transcription

#: The evaluation runs a few hundred times: a third less time to compile is worth more than the last optimisations.
_COMPILER: dict[str, bool | str] = {"xla_backend_optimization_level": "1"}

#: The final time may leave its limits during the search, but not below this share of the lower one.
_SHORTEST = 0.2


class Problem:
    """Find controls, states and final time that optimise an objective under a system's constraints.

    minimise J subject to x' = f(t, x, u), the system's constraints and the boxes of its leaves along the path,
    conditions at both ends, and limits of the final time. Controls are held over each of nodes - 1 equal intervals.
    Constraints on states are asked at the nodes and at the ends of the substeps between them.

    The problem is always solved in double precision, whatever the global setting.

    Args:
        dynamics: a compiled system.
        objective: `tx.Minimize(...)` or `tx.Maximize(...)`.
        nodes: number of state nodes, two or more.
        final_time: a number in s, or limits (low, high) to leave it free.
        initial: values by state or name, on top of the leaves' own; NaN or None entries are free.
        final: values likewise, or constraints on the final node such as `g[:3, 3] == 0`, or a list of both.
        params: values of the system's parameters; those left out take their own.
        guess: values by leaf or name, on top of the leaves' own: one, or one for each node (states) or interval
            (controls).
        final_time_guess: where a free final time starts; the middle of its limits unless given.
        method: an explicit RKMK method; RK4 if left out.
        substeps: its steps in an interval.

    Raises:
        ModelError: unknown names or values without meaning.
        ShapeError: a wrong shape.
        TrajectoryError: nodes, times or end values that cannot be.
        InputError: parameters without a value.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        objective: Any,
        *,
        nodes: Any = 25,
        final_time: Any,
        initial: Mapping[Any, Any] | None = None,
        final: Any = None,
        params: Mapping[str, Any] | None = None,
        guess: Mapping[Any, Any] | None = None,
        final_time_guess: Any = None,
        method: RKMK | None = None,
        substeps: int = 2,
    ) -> None:
        need_compiled("Problem", dynamics)
        if not isinstance(objective, Objective):
            raise ModelError(
                f"Problem expects tx.Minimize(...) or tx.Maximize(...) as objective, got {type(objective).__name__}"
            )
        whole("nodes", nodes, 2, TrajectoryError)
        whole("substeps", substeps, 1, TrajectoryError)
        for place, expr in (("the objective", objective.final), ("the running cost", objective.running)):
            if expr is not None:
                check_leaves(dynamics, place, expr, controls=expr is objective.running)
        self.dynamics, self.nodes = dynamics, int(nodes)
        self.objective: Objective = objective
        self.time_limits, self._time_guess = _times(final_time, final_time_guess)
        values, constraints = split_final(final)
        self.initial = end_values(dynamics.states, "initial", initial)
        self.final = end_values(dynamics.states, "final", values)
        self.final_rows = final_rows(dynamics, constraints)
        self._leaves: dict[str, State | Control] = {s.name: s for s in dynamics.states}
        self._leaves |= {c.name: c for c in dynamics.controls}
        self._lengths = {name: self.nodes - isinstance(leaf, Control) for name, leaf in self._leaves.items()}
        self._guess = user_guess(guess, self._leaves, self._lengths)
        self.method, self.substeps = method_of(method), int(substeps)
        self.transcription = Transcription(
            dynamics,
            objective,
            method=self.method,
            nodes=self.nodes,
            substeps=self.substeps,
            path=describe_path(dynamics),
            final=self.final_rows,
            time_limits=self.time_limits,
            fixed=frozenset(s.name for s in dynamics.states if fixed_entries(s, self.initial[s.name]).all()),
        )
        self.params = self._prepared(params)
        self._compiled: Callable[..., Evaluation] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_compiled": None}  # compiled anew in the other process

    # ---- solving ----------------------------------------------------------------------------------------------

    def solve(
        self,
        guess: Mapping[Any, Any] | None = None,
        *,
        guesses: int = 1,
        seed: int | None = None,
        callback: Callback | None = None,
        max_iterations: int = 600,
        tolerance: float = 1e-6,
    ) -> TrajectoryResult:
        """Optimise, from one guess or from several, and return the best result.

        Args:
            guess: values by leaf or name on top of the problem's own guess.
            guesses: how many tries. Without a seed the first starts from the guess itself.
            seed: perturb every try's guess. The same seed gives the same tries: every free entry of a state's tangent
                moves by 0.4 of its scale and every control by 0.15 (one standard deviation; controls are clipped to
                their boxes), a free final time by a sixth of its limits' distance (and stays within them).
            callback: called with (iteration, cost, violation) after each accepted step.
            max_iterations: evaluations a try may use.
            tolerance: largest violation that counts as none, each constraint measured in its scale.
        Raises:
            ModelError, ShapeError: a guess that does not fit.
            TrajectoryError: guesses, max_iterations or tolerance without meaning.
        """
        whole("guesses", guesses, 1, TrajectoryError)
        whole("max_iterations", max_iterations, 1, TrajectoryError)
        number("tolerance", tolerance, "above zero", lambda size: 0.0 < size < np.inf, TrajectoryError)
        if seed is not None:
            whole("seed", seed, 0, TrajectoryError)
        if callback is not None:
            callable_with("callback", callback, ["iteration", "cost", "violation"], TrajectoryError)
        with jax.enable_x64(True):
            begin = time.perf_counter()
            plain = self._start(self._guess | user_guess(guess, self._leaves, self._lengths))
            evaluate = self._evaluator(plain)
            compiled = time.perf_counter()
            optimizer = self._optimizer(evaluate, plain)
            outcomes = []
            sign = self.objective.sign
            report: Callback | None = None
            if callback is not None:
                report = lambda count, cost, violation: callback(count, sign * cost, violation)  # noqa: E731
            for attempt in range(guesses):
                start = plain
                if seed is not None or attempt > 0:
                    start = self._perturbed(evaluate, plain, np.random.default_rng([seed or 0, attempt]))
                outcomes.append(optimizer.run(start, max_iterations, tolerance, report))
            done = time.perf_counter()
        return best_result(self, outcomes, tolerance, compiled - begin, done - compiled)

    def _start(self, given: Mapping[str, Array]) -> Iterate:
        count = self.nodes - 1
        xs: dict[str, Any] = {
            s.name: state_guess(s, given.get(s.name), self.initial[s.name], self.final[s.name], self.nodes)
            for s in self.dynamics.states
        }
        us = [control_guess(c, given.get(c.name), count).reshape(count, -1) for c in self.dynamics.controls]
        flat = np.concatenate([np.zeros((count, 0)), *us], axis=1)
        return jax.tree.map(jnp.asarray, Iterate(xs, flat, np.asarray(self._time_guess)))

    def _evaluator(self, like: Iterate) -> Callable[[Iterate, Array], Evaluation]:
        """The compiled evaluation, NumPy out."""
        zero = jnp.zeros(self.nodes * self.transcription.block + 1)
        params = {name: jnp.asarray(value) for name, value in self.params.items()}
        if self._compiled is None:
            self._compiled = jax.jit(self.transcription.evaluate).lower(like, zero, params).compile(_COMPILER)
        compiled = self._compiled

        def evaluate(iterate: Iterate, step: Array) -> Evaluation:
            return jax.tree.map(np.asarray, compiled(jax.tree.map(jnp.asarray, iterate), jnp.asarray(step), params))

        return evaluate

    def _optimizer(self, evaluate: Callable[[Iterate, Array], Evaluation], plain: Iterate) -> Optimizer:
        t = self.transcription
        low, high = self.time_limits
        landmarks = self._landmarks(plain)
        block = column_scales(self._leaves, landmarks)
        time_scale = 0.5 * (high - low) if high > low else high
        lengths = np.concatenate([np.tile(block, self.nodes), [time_scale]])
        self._step_lengths, self._free = lengths, self._free_unknowns()
        columns = np.concatenate([block, block, [time_scale]])
        steps = (np.zeros(len(lengths)), self._random_step(np.random.default_rng(0)))
        samples = [evaluate(plain, step) for step in steps]
        finite = [s for s in samples if all(np.isfinite(v).all() for v in (s.rows, s.slopes, s.gradient))]
        scales = Scales.measured(columns, t.n, finite or samples[:1])
        return Optimizer(evaluate, BorderedBand(self.nodes, t.block, self._free), t, scales, _SHORTEST * low)

    def _landmarks(self, plain: Iterate) -> dict[str, list[Array]]:
        """The known values of every leaf: its box, its ends, its guess."""
        values: dict[str, list[Array]] = {}
        controls = self.transcription.controls.split(np.asarray(plain.us))
        for name, leaf in self._leaves.items():
            path = np.asarray(plain.xs[name] if name in plain.xs else controls[name])
            known = [leaf.min, leaf.max, self.initial.get(name), self.final.get(name), *path]
            values[name] = [np.asarray(value) for value in known if value is not None]
        return values

    def _free_unknowns(self) -> Array:
        t = self.transcription
        free = np.ones((self.nodes, t.block), bool)
        free[-1, t.n :] = False
        for node, ends in ((0, self.initial), (-1, self.final)):
            free[node, : t.n] = ~np.concatenate([fixed_entries(s, ends[s.name]) for s in self.dynamics.states])
        low, high = self.time_limits
        return np.append(free.ravel(), low < high)

    def _random_step(self, rng: np.random.Generator) -> Array:
        t = self.transcription
        states = np.append(np.tile(np.arange(t.block) < t.n, self.nodes), False)
        spread = np.where(states, 0.4, 0.15)
        step = np.where(self._free, rng.normal(size=spread.shape) * spread * self._step_lengths, 0.0)
        low, high = self.time_limits
        step[-1] = np.clip(self._time_guess + rng.normal() * (high - low) / 6.0, low, high) - self._time_guess
        return step

    def _perturbed(self, evaluate: Callable[..., Evaluation], plain: Iterate, rng: np.random.Generator) -> Iterate:
        moved = evaluate(plain, self._random_step(rng)).iterate
        us = np.array(moved.us)
        for leaf in self.dynamics.controls:
            part = us[:, self.transcription.controls.slices[leaf.name]]
            low = -np.inf if leaf.min is None else leaf.min.reshape(1, -1)
            high = np.inf if leaf.max is None else leaf.max.reshape(1, -1)
            part[:] = np.clip(part, low, high)
        return moved._replace(us=us)

    def _prepared(self, params: Mapping[str, Any] | None) -> dict[str, Array]:
        """All parameters as double-precision arrays; checks them on the way."""
        with jax.enable_x64(True):
            zeros_x = {s.name: np.zeros(s.shape) for s in self.dynamics.states}
            zeros_u = {c.name: np.zeros(c.shape) for c in self.dynamics.controls}
            families = ("rates", "constraints")
            inputs = self.dynamics._functions.prepare(0.0, zeros_x, zeros_u, params, reads=families)
            found = {name: np.asarray(value) for name, value in inputs.params.items()}
        for name, value in found.items():
            if not np.isfinite(value).all():
                raise InputError(f"params[{name!r}] expects finite numbers, got {value}")
        return found


def _times(final_time: Any, guess: Any) -> tuple[tuple[float, float], float]:
    """The limits of the final time and where it starts."""
    limits = reals("final_time", final_time, TrajectoryError)
    if limits.shape not in ((), (2,)):
        raise TrajectoryError(f"final_time must be a number or (low, high), got {final_time!r}")
    low, high = np.broadcast_to(limits, 2).tolist()
    if not (0.0 < low <= high < np.inf):
        raise TrajectoryError(f"final_time must be positive, finite and low <= high, got {final_time!r}")
    guess = 0.5 * (low + high) if guess is None else guess
    number("final_time_guess", guess, f"from {low:g} to {high:g}", lambda t: low <= t <= high, TrajectoryError)
    return (low, high), float(guess)
