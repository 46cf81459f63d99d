"""The laws of a Lie group of states: relations between its maps.

Sources: J. Sola, J. Deray, D. Atchuthan, A micro Lie theory for state estimation in robotics (2018), for Ad, ad and the
Jacobians; the series of the Jacobians is in W. Rossmann, Lie Groups (2002), section 1.2.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import expm

from ..errors import InputError
from ..groups import Group
from ..jax_inside import quick_compile
from ..progress import watching
from .group_derivatives import check_derivatives, check_single_precision
from .group_samples import Sample, turned
from .laws import STENCIL, STEP, Check, difference_quotient

#: How far a quantity of size one may be off in double precision, and a derivative by differences.
_EXACT, _BY_DIFFERENCES = 2e-13, 2e-9
_DRIFT, _ROUND_OFF = 1e-3, 1e-8


@watching("check_group")
def check_group(group: Group, *, seed: int = 0) -> None:
    """Check that a group satisfies the laws on which states, integrators and optimisers rely.

    It checks values, shapes and precision; $g e = g$, inverses and products; $Log(Exp(d)) = d$, $Exp(Log(g)) = g$;
    $g Exp(d) g^-1 = Exp(Ad_g d)$, $Ad_Exp(d) = exp(ad_d)$; the Jacobians by their series and by $Exp(d + e) =
    Exp(J_l e) Exp(d) = Exp(d) Exp(J_r e)$, and their inverses; retraction and difference; that drifted elements
    are detected and normalised; the parts and their units; first and second derivatives, forward, reverse and by
    finite differences. Tangents (n,) are zero, tiny, of size 1 and half a turn long; in single precision also lengths
    of 7e6 m. The error of every map may be up to 100 round-offs of its size.

    Args:
        group: an instance, such as `MyGroup()`.
        seed: seed of the random numbers.
    Raises:
        LawError: a law is violated. The message names the law, the values and the likely cause.
        InputError: `group` is not a group.
    Source: J. Sola, J. Deray, D. Atchuthan, A micro Lie theory for state estimation in robotics (2018).
    Example: `tx.testing.check_group(tx.SE3)`.
    """
    if not isinstance(group, Group):
        made = f".\n  fix: give an instance, {group.__name__}()" if isinstance(group, type) else ""
        raise InputError(f"check_group expects a group such as tx.SE3 or MyGroup(), got {group!r}{made}")
    check = Check(f"{type(group).__name__} {group.name!r}")
    with jax.enable_x64(True):
        _check_is_value(check, group)
        _check_shapes(check, group)
        if group.dimension == 0:
            return
        drawn = samples(group, seed)
        with check.running("its maps can be mapped over batches", "write them in jax.numpy, without Python branches"):
            values = _values(group, drawn)
        for sample, value in zip(drawn, values, strict=True):
            _check_products(check, sample, value)
            _check_adjoints(check, sample, value)
            _check_jacobians(check, sample, value)
            _check_drift(check, group, sample, value)
        _check_parts(check, group, drawn[5])
        check_derivatives(check, group, drawn)
        check_single_precision(check, group, seed)


def samples(group: Group, seed: int) -> list[Sample]:
    """Tangents that are zero, tiny and of size one, along a single entry, and about half a turn long."""
    rng, n = np.random.default_rng(seed), group.dimension
    draw = lambda: rng.uniform(-1.0, 1.0, n)  # noqa: E731
    sizes = {"zero": 0.0, "1e-12": 1e-12, "1e-6": 1e-6, "1e-3": 1e-3, "ordinary": 1.0}
    samples = [Sample(label, size * draw(), draw(), draw(), True) for label, size in sizes.items()]
    samples.append(Sample("ordinary", draw(), draw(), draw(), True))
    single = np.zeros(n)
    single[rng.integers(n)] = 0.7
    samples.append(Sample("one entry", single, draw(), draw(), True))
    for label, turn in (("near half a turn", np.pi - 1e-6), ("beyond half a turn", np.pi + 0.3)):
        samples.append(Sample(label, turned(group, draw(), turn), draw(), draw(), False))
    return samples


def _values(group: Group, drawn: list[Sample]) -> list[dict[str, Any]]:
    """All values in the laws, for each sample."""

    def one(a: jax.Array, b: jax.Array, c: jax.Array) -> dict[str, Any]:
        g, h, k = group.exp(a), group.exp(b), group.exp(c)
        back = group.inverse(g)
        steps = jnp.asarray([i * STEP for i in STENCIL], a.dtype)
        left = jax.vmap(lambda s: group.log(group.compose(group.exp(a + s * b), back)))(steps)
        right = jax.vmap(lambda s: group.log(group.compose(back, group.exp(a + s * b))))(steps)
        return {
            "g": g,
            "log": group.log(g),
            "exp log": group.exp(group.log(g)),
            "twice": (group.exp(2.0 * a), group.compose(g, g)),
            "inverse": (group.exp(-a), back),
            "neutral": (group.compose(g, back), group.compose(back, g), group.identity(a.dtype)),
            "unchanged": (group.compose(g, group.identity(a.dtype)), group.compose(group.identity(a.dtype), g)),
            "associated": (group.compose(group.compose(g, h), k), group.compose(g, group.compose(h, k))),
            "Ad": group.Ad(g),
            "conjugate": (group.exp(group.Ad(g) @ b), group.compose(group.compose(g, h), back)),
            "ad": group.ad(a),
            "bracket": group.bracket(a, b),
            "left": group.left_jacobian(a),
            "right": group.right_jacobian(a),
            "left inverse": group.left_jacobian_inv(a),
            "right inverse": group.right_jacobian_inv(a),
            "applied": group.right_jacobian_inv_apply(a, b),
            "left steps": left,
            "right steps": right,
            "retract": (group.retract(g, b), group.compose(g, h)),
            "difference": group.difference(g, group.retract(g, b)),
            "defect": group.defect(g),
            "normalize": group.normalize(g),
            "tighten": group.tighten(g),
        }

    stacked = [np.stack([getattr(sample, name) for sample in drawn]) for name in "def"]
    batch = _compiled(jax.vmap(one))(*stacked)
    return [jax.tree.map(lambda leaf, i=i: np.asarray(leaf[i]), batch) for i in range(len(drawn))]


def _compiled(f: Callable[..., Any]) -> Callable[..., Any]:
    return jax.jit(f, compiler_options=quick_compile(0))


def _vector(element: Any) -> np.ndarray:
    return np.concatenate([np.zeros(0), *(np.ravel(leaf) for leaf in jax.tree.leaves(element))])


def _same(check: Check, law: str, actual: Any, expected: Any, fix: str, at: Mapping[str, Any]) -> None:
    actual, expected = _vector(actual), _vector(expected)
    size = max(1.0, np.abs(expected).max(initial=0.0))
    check.close(law, actual, expected, _EXACT * size**2, fix, at)


def _check_is_value(check: Check, group: Group) -> None:
    fix = "make the class a frozen dataclass: @dataclasses.dataclass(frozen=True)"
    with check.running("a group is a value", fix):
        again = copy.deepcopy(group)
        equal = again == group and hash(again) == hash(group) and repr(again) == repr(group)
    check.holds("a group is a value", equal, f"a copy of {group!r} is not equal to it", fix)
    n = group.dimension
    named = isinstance(group.name, str) and group.name != ""
    check.holds("a group has a name", named, f"got {group.name!r}", 'give name = "..."')
    is_natural = isinstance(n, int) and n >= 0
    check.holds("the dimension is a whole number", is_natural, f"got {n!r}", "give dimension, the length of tangents")


def _check_shapes(check: Check, group: Group) -> None:
    n = group.dimension
    for dtype in (jnp.float64, jnp.float32):
        tangent = jax.ShapeDtypeStruct((n,), dtype)
        with check.running("shapes and precision", "let identity take dtype, as in jnp.eye(3, dtype=dtype)"):
            neutral = group.identity(dtype)
        element = jax.tree.map(lambda leaf, dtype=dtype: jax.ShapeDtypeStruct(leaf.shape, dtype), _shape(group))
        matrix = jax.ShapeDtypeStruct((n, n), dtype)
        wanted = {
            "identity": ((), element),
            "exp": ((tangent,), element),
            "log": ((element,), tangent),
            "compose": ((element, element), element),
            "retract": ((element, tangent), element),
            "difference": ((element, element), tangent),
            "bracket": ((tangent, tangent), tangent),
            "right_jacobian_inv_apply": ((tangent, tangent), tangent),
            "defect": ((element,), jax.ShapeDtypeStruct((), dtype)),
            **dict.fromkeys(("inverse", "normalize", "tighten"), ((element,), element)),
            "Ad": ((element,), matrix),
        }
        jacobians = ("left_jacobian", "right_jacobian", "left_jacobian_inv", "right_jacobian_inv")
        wanted |= dict.fromkeys(("ad", *jacobians), ((tangent,), matrix))
        for name, (operands, result) in wanted.items():
            law = f"shape and precision of {name}"
            fix = f"give {name} the shape of twistax.groups.Group.{name}, in the precision of its arguments"
            with check.running(law, fix):
                got = neutral if name == "identity" else jax.eval_shape(getattr(group, name), *operands)
                kinds = jax.tree.map(lambda leaf: (leaf.shape, str(leaf.dtype)), (got, result))
            check.holds(law, kinds[0] == kinds[1], f"got {kinds[0]} for {kinds[1]}", fix)


def _shape(group: Group) -> Any:
    """The shapes of an element as arrays, whose leaves are not tuples."""
    return jax.tree.map(np.zeros, group.shape, is_leaf=lambda node: isinstance(node, tuple))


def _check_products(check: Check, sample: Sample, value: Mapping[str, Any]) -> None:
    at = sample.at
    _same(check, "Exp(2 d) = Exp(d) Exp(d)", value["twice"][0], value["twice"][1], "look at exp and compose", at)
    _same(check, "Exp(-d) = Exp(d)^-1", value["inverse"][0], value["inverse"][1], "look at inverse, and at exp", at)
    for product in value["neutral"][:2]:
        _same(check, "g g^-1 = g^-1 g = e", product, value["neutral"][2], "look at inverse and compose", at)
    for product in value["unchanged"]:
        _same(check, "g e = e g = g", product, value["g"], "look at identity and compose", at)
    _same(check, "(g h) k = g (h k)", value["associated"][0], value["associated"][1], "look at compose", at)
    _same(check, "Exp(Log(g)) = g", value["exp log"], value["g"], "look at log, of turns up to a half one", at)
    if sample.in_reach:
        allowed = 1e-14 + 1e-13 * np.abs(sample.d).max()
        fix = "look at log: near zero it must not lose digits, as arccos and 1 - cos do"
        check.close("Log(Exp(d)) = d", value["log"], sample.d, allowed, fix, at)
    fix = "look at retract: perturbations act on the right"
    _same(check, "g (+) d = g Exp(d)", value["retract"][0], value["retract"][1], fix, at)
    _same(check, "(g (+) e) (-) g = e", value["difference"], sample.e, "look at difference: Log(g^-1 h)", at)


def _check_adjoints(check: Check, sample: Sample, value: Mapping[str, Any]) -> None:
    fix = "look at Ad: the matrix of xi -> (g hat(xi) g^-1)^v"
    _same(check, "Exp(Ad_g e) = g Exp(e) g^-1", value["conjugate"][0], value["conjugate"][1], fix, sample.at)
    fix = "look at ad: the matrix of eta -> [xi, eta], with this sign"
    _same(check, "Ad of Exp(d) is the exponential of ad_d", value["Ad"], expm(value["ad"]), fix, sample.at)
    _same(check, "[d, e] = ad_d e", value["bracket"], value["ad"] @ sample.e, "look at bracket", sample.at)


def _check_jacobians(check: Check, sample: Sample, value: Mapping[str, Any]) -> None:
    at, e = sample.at, sample.e
    for side, sign in (("left", 1.0), ("right", -1.0)):
        J = value[side]
        fix = f"look at {side}_jacobian: {'J_l' if side == 'left' else 'J_r(d) = J_l(-d)'}, near zero too"
        law = f"the {side} Jacobian is sum_k ({'' if sign > 0.0 else '-'}ad_d)^k / (k + 1)!"
        _same(check, law, J, _series(sign * value["ad"]), fix, at)
        law = "Exp(d + e) = Exp(J_l e) Exp(d)" if side == "left" else "Exp(d + e) = Exp(d) Exp(J_r e)"
        slope, size = difference_quotient(value[f"{side} steps"]), max(1.0, np.abs(J).max())
        check.close(law, J @ e, slope, _BY_DIFFERENCES * size, fix, at)
        fix = f"look at {side}_jacobian_inv"
        inverse = value[f"{side} inverse"]
        size = np.abs(inverse).max() * np.abs(J).max()
        check.close(f"the {side} Jacobian times its inverse is I", inverse @ J, np.eye(len(e)), _EXACT * size, fix, at)
    fix = "look at right_jacobian_inv_apply"
    _same(check, "the inverse of J_r, applied", value["applied"], value["right inverse"] @ e, fix, at)


def _series(ad: np.ndarray) -> np.ndarray:
    """sum_k ad^k / (k + 1)!, the upper right block of an exponential."""
    n = len(ad)
    return np.asarray(expm(np.block([[ad, np.eye(n)], [np.zeros((n, 2 * n))]]))[:n, n:])


def _check_drift(check: Check, group: Group, sample: Sample, value: Mapping[str, Any]) -> None:
    g, at = value["g"], sample.at
    size = max(1.0, np.abs(_vector(g)).max(initial=0.0))
    fix = "look at defect: the largest absolute violation of the equations that elements satisfy"
    check.close("elements have no defect", value["defect"], 0.0, _EXACT * size**2, fix, at)
    for name in ("normalize", "tighten"):
        _same(check, f"{name} keeps elements", value[name], g, f"look at {name}", at)
    if _vector(g).size == group.dimension:
        return  # every array is an element
    rng = np.random.default_rng(0)
    noise = jax.tree.map(lambda leaf: rng.uniform(-1.0, 1.0, leaf.shape) * size, g)
    for name, share, left in (("normalize", _DRIFT, _EXACT * size**2), ("tighten", _ROUND_OFF, 1e-12 * size**2)):
        drifted = jax.tree.map(lambda leaf, other, share=share: jnp.asarray(leaf + share * other), g, noise)
        off = float(group.defect(drifted))
        message = f"an element with noise of {share:g} has the defect {off:.3g}"
        check.holds("defect notices drift", off > 1e-3 * share, message, fix)
        repaired = getattr(group, name)(drifted)
        message = f"{name} of an element, off by noise of {share:g}"
        check.close(f"{name} repairs drift", group.defect(repaired), 0.0, left, f"look at {name}: {message}", at)
        far = np.abs(_vector(repaired) - _vector(g)).max()
        check.holds(
            f"{name} moves no further than the drift", far < 20.0 * share * size, f"{message}, moves {far:g}", fix
        )


def _check_parts(check: Check, group: Group, sample: Sample) -> None:
    if isinstance(group.shape, Mapping):
        return
    fix = "look at parts: twistax.groups.ElementPart says what its fields mean"
    entries = sorted(i for part in group.parts for i in part.entries)
    covered = entries == list(range(group.dimension))
    check.holds("each entry of a tangent belongs to one part", covered, f"the parts have the entries {entries}", fix)

    def all_of(d: jax.Array, e: jax.Array) -> Any:
        g, masks = group.exp(d), [np.isin(np.arange(group.dimension), part.entries) for part in group.parts]
        elements = [group.retract(g, jnp.where(mask, 0.0, e)) for mask in masks]
        moved = jax.vmap(lambda s: group.retract(g, s * e))(jnp.asarray([i * STEP for i in STENCIL]))
        rate = group.entry_rate(g, e)
        return g, elements, moved, rate, group.body_velocity(g, rate), group.sizes(g)

    with check.running("parts, entry_rate, body_velocity and sizes", fix):
        g, elements, moved, rate, velocity, sizes = _compiled(all_of)(jnp.asarray(sample.d), jnp.asarray(sample.e))
        size = max(1.0, float(jnp.abs(g).max()))
        for part, element in zip(group.parts, elements, strict=True):
            law = f"what moves other parts leaves the part {part.name!r} as it is"
            check.close(law, element[part.place], g[part.place], _EXACT * size**2, fix, sample.at)
    check.holds("sizes", sizes.shape == (group.dimension,), f"got shape {sizes.shape}", fix)
    law, difference = "entry_rate is g hat(xi)", difference_quotient(moved)
    check.close(law, rate, difference, _BY_DIFFERENCES * size, "look at entry_rate", sample.at)
    law = "body_velocity undoes entry_rate"
    check.close(law, velocity, sample.e, 1e-11 * size**2, "look at body_velocity", sample.at)
