"""Derivatives of a user's function: forward, reverse, and by differences of its values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import number, short
from ..errors import InputError
from ..progress import watching
from .laws import STENCIL, Check, difference_quotient, flat

#: The step relative to the argument, and the share of a derivative that it resolves, by precision.
_BY_DIFFERENCES = {np.dtype(np.float64): (1e-3, 1e-6), np.dtype(np.float32): (5e-2, 1e-2)}
#: Forward and reverse derivatives differ by so many round-offs.
_ROUND_OFFS = 1e4
_DIRECTIONS = 2


@watching("check_gradients")
def check_gradients(
    function: Callable[..., Any], *arguments: Any, tolerance: float | None = None, step: float | None = None
) -> None:
    r"""Check that the derivatives of a JAX function are those of its values.

    For random directions v of each array x among the arguments and random weights w of the results y,
    the forward derivative $J v$ of `jax.jvp` must agree with the difference quotient of fourth order,
    $sum_k c_k y(x + k h v) / h$, and the reverse derivative of `jax.vjp` with it: $(J^T w)^T v = w^T (J v)$.

    Arguments are changed entry by entry. To check derivatives by a pose, pass its tangent:
    `check_gradients(lambda d: f(g @ tx.lie.se3.exp(d)), np.zeros(6))`.

    Args:
        function: of pytrees of arrays, which returns a pytree of arrays; smooth near the arguments.
        arguments: where derivatives are taken. Real arrays of any shape are checked; integers, booleans and other
            leaves are constants. With x64 off they are single precision.
        tolerance: of the difference quotient, relative to the largest derivative; by default 1e-6, in single precision
            1e-2.
        step: h, relative to the size of the array, at least 1; by default 1e-3, in single precision 5e-2.
    Raises:
        LawError: derivatives disagree, are not finite, or are not defined. The message names the array.
        InputError: no argument is a real array; a tolerance or a step that is not positive.

    Units: those of the arguments and results.

    Example: `tx.testing.check_gradients(lambda x: jnp.sin(x).sum(), np.ones(3))`.
    """
    for name, value in (("tolerance", tolerance), ("step", step)):
        if value is not None:
            number(f"check_gradients: {name}", value, "above zero", lambda size: size > 0.0)
    leaves, structure = jax.tree_util.tree_flatten_with_path(arguments)
    values = [jnp.asarray(leaf) if _is_real(leaf) else leaf for _, leaf in leaves]
    places = [k for k, value in enumerate(values) if isinstance(value, jax.Array)]
    if not places:
        raise InputError(
            f"check_gradients expects real arrays among the arguments, got {short(arguments)}.\n"
            "  fix: check_gradients(f, x): write 1.0 for 1"
        )
    check = Check(f"the function {getattr(function, '__name__', type(function).__name__)!r}")
    for place in places:
        path = leaves[place][0]
        of_one = _of_one(function, values, place, structure)
        _check_one(
            check, f"arguments[{path[0].idx}]{jax.tree_util.keystr(path[1:])}", of_one, values[place], tolerance, step
        )


def _is_real(leaf: Any) -> bool:
    return isinstance(leaf, (float, np.ndarray, np.floating, jax.Array)) and jnp.issubdtype(
        jnp.result_type(leaf), jnp.floating
    )


def _of_one(function: Callable[..., Any], values: list[Any], place: int, structure: Any) -> Callable[..., jax.Array]:
    """All results in one vector, as a function of one array; results that are not real have no derivative."""

    def of_one(x: jax.Array) -> jax.Array:
        arguments = jax.tree.unflatten(structure, [*values[:place], x, *values[place + 1 :]])
        results = jax.tree.map(jnp.asarray, function(*arguments))
        return flat([leaf for leaf in jax.tree.leaves(results) if jnp.issubdtype(leaf.dtype, jnp.floating)])

    return of_one


def _check_one(
    check: Check, name: str, function: Callable[..., jax.Array], x: jax.Array, tolerance: Any, step: Any
) -> None:
    """The laws for one array."""
    usual_step, usual_tolerance = _BY_DIFFERENCES.get(x.dtype, _BY_DIFFERENCES[np.dtype(np.float32)])
    h = (step or usual_step) * max(1.0, float(jnp.abs(x).max(initial=0.0)))
    rng, dtype = np.random.default_rng(0), x.dtype
    fix = "look at custom derivatives and at kinks near the argument, or give step= for functions of another scale"
    for _ in range(_DIRECTIONS):
        v = jnp.asarray(rng.uniform(-1.0, 1.0, x.shape), dtype)
        with check.running(f"it has forward and reverse derivatives by {name}", fix):
            y, forward = jax.jvp(function, (x,), (v,))
            w = jnp.asarray(rng.uniform(-1.0, 1.0, y.shape), y.dtype)
            (reverse,) = jax.vjp(function, x)[1](w)
            moved = [function(x + k * h * v) for k in STENCIL]
        finite = bool(jnp.isfinite(forward).all() and jnp.isfinite(reverse).all())
        message = f"jvp gives {short(np.asarray(forward))} and vjp {short(np.asarray(reverse))}"
        check.holds(f"derivatives by {name} are finite", finite, message, fix)
        quotient = difference_quotient(moved, h)
        eps = float(jnp.finfo(y.dtype).eps)
        size = float(jnp.abs(forward).max(initial=0.0)) + float(np.abs(quotient).max(initial=0.0))
        round_off = 4.0 * eps * float(jnp.abs(y).max(initial=0.0)) / h
        allowed = (tolerance or usual_tolerance) * size + round_off
        check.close(f"the derivative by {name} is that of the values", forward, quotient, allowed, fix)
        one, other = float(jnp.vdot(reverse, v)), float(jnp.vdot(w, forward))
        near = _ROUND_OFFS * eps * (float(jnp.vdot(jnp.abs(w), jnp.abs(forward))) + abs(one))
        check.close(f"reverse = forward by {name}", one, other, near, fix)
