"""Linearisation in the tangent space, with names, modes and exports for control design."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import listed
from ..errors import InputError, ModelError
from ..progress import watching
from ..system.dynamics import Dynamics, need_compiled
from ..system.inputs import Values
from .discretize import Controls, value_and_jacobian
from .labels import entry, labels, needed, positions, tangent_shapes
from .modes import Mode, modes


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Linearization:
    """The linearised system $d' = A d + B du$, $dy = C d + D du$ about a trajectory x(t), with the neighbouring
    trajectory $x(t) (+) d$.

    Attributes:
        rate: the rates as one tangent vector, (n,).
        A: (n, n), rows and columns in the order of declaration of the states.
        B: (n, m), columns in the order of declaration of the controls, each in row-major order.
        C, D: (p, n), (p, m), rows are the requested outputs, each in row-major order.
        states, controls, outputs: names of the rows and columns, such as "V[3]".
    """

    rate: jax.Array
    A: jax.Array
    B: jax.Array
    C: jax.Array
    D: jax.Array
    states: tuple[str, ...] = dataclasses.field(metadata={"static": True})
    controls: tuple[str, ...] = dataclasses.field(metadata={"static": True})
    outputs: tuple[str, ...] = dataclasses.field(metadata={"static": True})

    def keep(
        self,
        states: Iterable[str] | None = None,
        controls: Iterable[str] | None = None,
        outputs: Iterable[str] | None = None,
    ) -> Linearization:
        """The subsystem with these states, controls and outputs, by "V", "V[3]" or "V[3:6]"; None keeps all.

        Omitted states and controls are set to zero. This is exact if the remaining ones do not depend on them, for
        example if the motion does not depend on the position over a flat Earth.

        Raises: InputError for an unknown name.
        """
        rows, columns, outs = (
            _kept(f"keep: {kind}", names, wanted)
            for kind, names, wanted in (
                ("states", self.states, states),
                ("controls", self.controls, controls),
                ("outputs", self.outputs, outputs),
            )
        )
        square, across = np.ix_(rows, rows), np.ix_(outs, rows)
        return Linearization(
            self.rate[np.asarray(rows, int)],
            self.A[square],
            self.B[np.ix_(rows, columns)],
            self.C[across],
            self.D[np.ix_(outs, columns)],
            *(tuple(names[i] for i in kept) for names, kept in zip(
                (self.states, self.controls, self.outputs), (rows, columns, outs)
            )),
        )  # fmt: skip

    def modes(self) -> list[Mode]:
        """The eigenvalues of A with their eigenvectors, fastest first; of each conjugate pair, the one with Im > 0.

        Raises: ModelError if A is not a single matrix of finite numbers.
        """
        return modes(self.A, self.states)

    def to_control(self) -> Any:
        """The linear system as a `control.StateSpace` of python-control, with the names of states, inputs and outputs.

        If no outputs were requested, the states are the outputs.

        Raises: ModelError: python-control is not installed (`pip install twistax[control]`).
        """
        try:
            import control
        except ImportError:
            raise ModelError(
                "to_control needs python-control.\n  fix: pip install 'twistax[control]', or use A, B, C and D"
            ) from None
        A, B, C, D = (np.asarray(matrix, np.float64) for matrix in (self.A, self.B, self.C, self.D))
        names = self.outputs
        if not names:
            C, D, names = np.eye(len(A)), np.zeros_like(B), self.states
        return control.ss(A, B, C, D, states=list(self.states), inputs=list(self.controls), outputs=list(names))


@watching("linearize")
def linearize(
    dynamics: Dynamics,
    t: Any,
    x: Values,
    u: Values | None = None,
    params: Values | None = None,
    *,
    outputs: Iterable[str] = (),
) -> Linearization:
    """The error dynamics of a system around a point, with right perturbations x (+) d.

    With the stacked body velocities $xi(t, x, u)$ of all states, the neighbour $x Exp(d)$ satisfies to first order

        $d' = (D xi - ad_xi) d + D_u xi du$,

    where $D xi = d xi(x Exp(d)) / dd$ at 0, and ad is zero for Euclidean parts. Units are those of the states per
    second.
    Source: Sola, Deray, Atchuthan, A micro Lie theory for state estimation in robotics (2018), sections on
    perturbations and on Jacobians of group actions; the ad term is the transport of d along the flow.

    Traceable: jit, vmap and further derivatives apply.

    Args:
        outputs: the outputs of C and D: names of outputs, "V", or entries of them, "V[3]", "V[3:6]".
    Raises:
        InputError: the errors of a call of the dynamics; an unknown output.
        ModelError: the system is not compiled.
    """
    need_compiled("linearize", dynamics)
    wanted = [outputs] if isinstance(outputs, str) else list(outputs)
    shapes = needed("linearize: outputs", wanted, output_shapes(dynamics))
    rows = positions("linearize: outputs", wanted, shapes)
    inputs = dynamics.functions.prepare(t, x, u, params, reads=("rates", "outputs") if wanted else ("rates",))
    n, m = dynamics.dimension, Controls(dynamics.controls).dimension
    value, slopes = around(dynamics, tuple(shapes))(inputs.t, dict(inputs.x), dict(inputs.u), dict(inputs.params))
    C = slopes[n:][np.asarray(rows, int)]
    return Linearization(
        value[:n],
        slopes[:n, :n] - dynamics.group.ad(value[:n]),
        slopes[:n, n : n + m],
        C[:, :n],
        C[:, n : n + m],
        labels(tangent_shapes(dynamics.group)),
        labels({leaf.name: leaf.shape for leaf in dynamics.controls}),
        tuple(np.array(labels(shapes))[rows].tolist()) if rows else (),
    )


def output_shapes(dynamics: Dynamics) -> dict[str, tuple[int, ...]]:
    """The shapes of all outputs of a system."""
    return {name: functions[0].shape for name, functions in dynamics.functions.families["outputs"].items()}


def around(
    dynamics: Dynamics, outputs: tuple[str, ...], with_rates: bool = False, params: tuple[str, ...] = ()
) -> Callable[..., tuple[jax.Array, jax.Array]]:
    """Rates of the states, outputs, and rates of the outputs along the motion, with their derivatives at a point.

    The function is cached with the system, and compiled once for each precision.

    Args:
        outputs: the outputs to compute, in the order of the system.
        with_rates: whether to compute the rates of the outputs, too, with constant controls.
        params: parameters with respect to which to differentiate.
    Returns:
        f(t, x, u, params) -> values (k,) and derivatives (k, n + m + size of params), with respect to right
        perturbations of the states, entries of controls and of these parameters.
    """

    def make() -> Callable[..., tuple[jax.Array, jax.Array]]:
        functions, group, controls = (
            dynamics.functions.with_outputs(outputs),
            dynamics.group,
            Controls(dynamics.controls),
        )

        def values(t: Any, x: Any, u: Any, p: Any) -> jax.Array:
            rates = functions.vector_field(t, x, u, p)
            velocity = jnp.concatenate([rates[name].reshape(-1) for name in group.factors])
            if not outputs:
                return velocity

            def seen(s: jax.Array) -> jax.Array:
                outputs = functions.evaluate("outputs", t + s, group.retract(x, s * velocity), u, p)
                return jnp.concatenate([outputs[name].reshape(-1) for name in functions.families["outputs"]])

            now = jnp.zeros((), velocity.dtype)
            both = jax.jvp(seen, (now,), (jnp.ones_like(now),)) if with_rates else (seen(now),)
            return jnp.concatenate([velocity, *both])

        def evaluate(t: Any, x: Any, u: Any, p: Any) -> tuple[jax.Array, jax.Array]:
            flat = controls.join(u, t.dtype)
            ends = np.cumsum([0, group.dimension, flat.size, *(p[name].size for name in params)])

            def moved(z: jax.Array) -> jax.Array:
                d, du, *dp = (z[a:b] for a, b in itertools.pairwise(ends))
                shifted = {name: p[name] + change.reshape(p[name].shape) for name, change in zip(params, dp)}
                return values(t, group.retract(x, d), controls.split(flat + du), {**p, **shifted})

            return value_and_jacobian(moved, jnp.zeros(ends[-1], t.dtype))

        return jax.jit(evaluate)

    return dynamics.functions.loops.get(("around", outputs, with_rates, params), make)


def _kept(place: str, present: Sequence[str], wanted: Iterable[str] | None) -> list[int]:
    """The rows of what is asked for; rows that an earlier `keep` left out are missing."""
    if wanted is None:
        return list(range(len(present)))
    shapes: dict[str, tuple[int, ...]] = {}
    for label in present:
        name, _, index = label.rstrip("]").partition("[")
        shapes[name] = (max(int(index) + 1, *shapes.get(name, (0,))),) if index else ()
    kept: list[int] = []
    for one in [wanted] if isinstance(wanted, str) else wanted:
        name, chosen = entry(place, one, shapes)
        wanted_labels = [label for i, label in enumerate(labels({name: shapes[name]})) if i in chosen]
        kept += [present.index(label) for label in wanted_labels if label in present]
    if len(set(kept)) < len(kept):
        raise InputError(f"{place} has a name twice: {listed(wanted)}")
    return kept
