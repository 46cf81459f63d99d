"""The laws of a group's derivatives, and of its accuracy in single precision."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..groups import Group
from ..jax_inside import quick_compile
from .group_samples import Sample, turned
from .laws import STENCIL, STEP, Check, difference_quotient, flat

_BY_DIFFERENCES = 2e-9
#: Round-offs of single precision that a quantity may be off, as a share of its size.
_SINGLE = 100.0 * float(np.finfo(np.float32).eps)
#: How large lengths are where they are large, in m: an orbit.
_FAR = 7e6


def _in_steps(group: Group, a: Any, b: Any) -> dict[str, Any]:
    """The functions in a step of an integrator; their second derivatives enter those of an integration."""
    applied = group.right_jacobian_inv_apply(a, b)
    return {"exp": group.exp(a), "retract": group.retract(group.exp(b), a), "right_jacobian_inv_apply": applied}


def _smooth(group: Group, a: Any, b: Any) -> dict[str, Any]:
    """The functions that are smooth everywhere, of a tangent a and a second one."""
    g, h = group.exp(a), group.exp(b)
    return _in_steps(group, a, b) | {
        "compose": group.compose(h, g),
        "inverse": group.inverse(g),
        "Ad": group.Ad(g),
        "ad": group.ad(a),
        "left_jacobian": group.left_jacobian(a),
        "left_jacobian_inv": group.left_jacobian_inv(a),
        "normalize": group.normalize(g),
        "tighten": group.tighten(g),
    }


def check_derivatives(check: Check, group: Group, samples: Sequence[Sample]) -> None:
    """First and second derivatives along a line: forward, reverse, and by differences. Raises LawError for a
    violation.
    """
    places, bending = _places(group, _smooth), _places(group, _in_steps)
    stacked = [np.stack([getattr(sample, name) for sample in samples]) for name in "dfe"]
    across = np.random.default_rng(1).normal(size=max(place.stop for place in places.values()))
    with check.running("its maps have derivatives", "write them in jax.numpy, without Python branches"):
        batch = _along_lines(group, across, *stacked)
    for i, sample in enumerate(samples):
        values = {kind: np.asarray(value[i]) for kind, value in batch.items()}
        for name, place in places.items():
            bend = values["bend"][bending[name]] if name in bending else None
            _check_one(check, name, values["values"][:, place], values["slopes"][:, place], bend, sample)
        size = max(1.0, np.abs(across).max() * np.abs(values["slopes"]).max())
        fix = "look at custom derivatives, and at Python branches"
        forward, reverse = across @ values["slopes"][0], values["gradient"] @ sample.e
        check.close("reverse is forward", reverse, forward, 1e-11 * size * len(across), fix, sample.at)
        if sample.in_reach:
            fix = "look at log: where it divides by an angle or takes a root, its derivative must stay finite"
            for kind in ("forward", "reverse", "second"):
                expected = np.zeros_like(sample.e) if kind == "second" else sample.e
                law = f"Log(Exp(d)) = d has that {kind} derivative"
                check.close(law, values[kind], expected, 1e-9, fix, sample.at)


def _along_lines(group: Group, across: np.ndarray, a: Any, b: Any, e: Any) -> dict[str, Any]:
    """Values and slopes of all smooth functions at a + s e, for s = 0 and the steps; at s = 0 the others too."""
    everything = lambda d, b: flat(_smooth(group, d, b))  # noqa: E731

    def slope(d: Any, b: Any, e: Any) -> Any:
        return jax.jvp(lambda d: everything(d, b), (d,), (e,))

    def beside(d: Any, b: Any, e: Any) -> dict[str, Any]:
        in_steps = lambda d: flat(_in_steps(group, d, b))  # noqa: E731
        _, bend = jax.jvp(lambda d: jax.jvp(in_steps, (d,), (e,))[1], (d,), (e,))
        (gradient,) = jax.vjp(lambda d: everything(d, b), d)[1](jnp.asarray(across, d.dtype))
        return {"bend": bend, "gradient": gradient, **_of_log(group, d, e)}

    compiled = lambda f: jax.jit(f, compiler_options=quick_compile(0))  # noqa: E731
    points = a[:, None] + np.array([0.0, *(i * STEP for i in STENCIL)])[None, :, None] * e[:, None]
    values, slopes = compiled(jax.vmap(jax.vmap(slope, (0, None, None))))(points, b, e)
    return {"values": values, "slopes": slopes, **compiled(jax.vmap(beside))(a, b, e)}


def _of_log(group: Group, a: Any, e: Any) -> dict[str, Any]:
    """The derivatives of Log(Exp(a)) along e."""
    again = lambda d: group.log(group.exp(d))  # noqa: E731
    slope = lambda d: jax.jvp(again, (d,), (e,))[1]  # noqa: E731
    rows = jax.vmap(jax.vjp(again, a)[1])(jnp.eye(group.dimension, dtype=a.dtype))[0]
    return {"forward": slope(a), "reverse": rows @ e, "second": jax.jvp(slope, (a,), (e,))[1]}


def _places(group: Group, of: Any) -> dict[str, slice]:
    """Where each entry of a dict is in the vector that `flat` makes of it."""
    structure = jax.eval_shape(lambda a: of(group, a, a), jax.ShapeDtypeStruct((group.dimension,), float))
    sizes = {name: sum(leaf.size for leaf in jax.tree.leaves(structure[name])) for name in sorted(structure)}
    ends = np.cumsum([0, *sizes.values()])
    return {name: slice(first, last) for name, first, last in zip(sizes, ends[:-1], ends[1:], strict=True)}


def _check_one(
    check: Check, name: str, values: np.ndarray, slopes: np.ndarray, bend: np.ndarray | None, sample: Sample
) -> None:
    near = "near zero too, where a division by an angle or a root has none" if name != "normalize" else "not by an SVD"
    fix = f"look at the derivatives of {name}, {near}"
    size = max(1.0, np.abs(values[0]).max(initial=0.0), np.abs(slopes[0]).max(initial=0.0))
    law = f"the derivative of {name} is that of its values"
    check.close(law, slopes[0], difference_quotient(values[1:]), _BY_DIFFERENCES * size, fix, sample.at)
    if bend is None:
        return
    size = max(size, np.abs(bend).max(initial=0.0))
    law = f"the second derivative of {name} is that of its derivatives"
    check.close(law, bend, difference_quotient(slopes[1:]), _BY_DIFFERENCES * size, fix, sample.at)


# ---- single precision ------------------------------------------------------------------------------------------------


def check_single_precision(check: Check, group: Group, seed: int) -> None:
    """The maps in single precision against those in double precision, near zero and with lengths of an orbit. Raises
    LawError for a violation.
    """
    rng, n = np.random.default_rng(seed + 1), group.dimension
    draw = lambda: rng.uniform(-1.0, 1.0, n)  # noqa: E731
    drawn = {"zero": 0.0 * draw(), "1e-4": 1e-4 * draw(), "1e-3": 1e-3 * draw(), "1e-2": 1e-2 * draw()}
    drawn |= {"ordinary": draw(), "near half a turn": turned(group, draw(), np.pi - 1e-3)}
    both = jax.jit(lambda a, b: _single(group, a, b), compiler_options=quick_compile(0))
    for label, d in drawn.items():
        for length in (1.0, _FAR):
            sizes = np.where(group.sized | group.flat, length, 1.0)
            a, b = (np.float32(sizes * values) for values in (d, draw()))
            singles, doubles = both(a, b), both(a.astype(float), b.astype(float))
            for name, double in doubles.items():
                if name == "log" and "turn" in label:
                    continue
                _compare(check, group, name, singles[name], double, sizes, {f"d ({label}, float32)": a, "e": b})


def _single(group: Group, a: Any, b: Any) -> dict[str, Any]:
    values = _smooth(group, a, b)
    g = values["exp"]
    slope = jax.jvp(group.exp, (a,), (b,))[1]
    return values | {"log": group.log(g), "the derivative of exp": slope}


def _compare(
    check: Check, group: Group, name: str, single: Any, double: Any, sizes: np.ndarray, at: dict[str, Any]
) -> None:
    """Each entry against the size of its kind: a matrix of tangents has entries of size s_i / s_j."""
    fix = f"look at {name} in single precision: differences of near numbers, or Python floats of NumPy that promote"
    law = f"{name} in single precision is that in double, to 100 round-offs"
    if isinstance(group.shape, dict) and not hasattr(double, "shape"):
        for key, factor in group.factors.items():  # type: ignore[attr-defined]
            factor_sizes = sizes[group.slices[key]]  # type: ignore[attr-defined]
            _compare(check, factor, name, single[key], double[key], factor_sizes, at)
        return
    single, double = np.asarray(single), np.asarray(double)
    check.holds(law, single.dtype == np.float32, f"{name} gives {single.dtype}", fix)
    if double.shape == (len(sizes), len(sizes)) and name in ("Ad", "ad", "left_jacobian", "left_jacobian_inv"):
        units = sizes[:, None] / sizes[None, :]
    elif name in ("right_jacobian_inv_apply", "log"):
        units = sizes
    else:
        units = _units(group, double)
    size = np.abs(double / units).max(initial=1.0) * units
    check.close(law, single, double, _SINGLE * size, fix, at)


def _units(group: Group, element: np.ndarray) -> np.ndarray:
    """The size of each entry of an element: of a part with a length that of the part, else 1."""
    if group.flat:
        return np.full(element.shape, np.abs(element).max(initial=1.0))
    units = np.ones(element.shape)
    for part in group.parts:
        if part.sized:
            units[part.place] = np.abs(element[part.place]).max(initial=1.0)
    return units
