"""Operations on single entries as scalars: values and derivatives as JAX has them, at kinks too."""

import functools

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from jax import lax
from scalar_cases import Case, as_jax, evaluate

from twistax.scalar.derivatives import cotangent_program, tangent_program
from twistax.scalar.primitives.table import OPERATIONS
from twistax.scalar.reader import scalarize

_rng = np.random.default_rng(0)
ANY = _rng.normal(size=5) * 2.0
OTHER = _rng.normal(size=5) * 2.0
POSITIVE = _rng.uniform(0.1, 4.0, 5)
INSIDE = _rng.uniform(-0.95, 0.95, 5)
KINKS = np.array([0.0, 1.0, -1.0, 2.5, -0.5])

#: Operations of one argument, where they are defined.
_UNARY = "neg abs sign floor ceil exp exp2 expm1 sin cos tan atan sinh cosh tanh asinh logistic"
_BINARY = "add sub mul div rem max min atan2 eq ne lt le gt ge"
UNARY = {
    **dict.fromkeys(_UNARY.split(), ANY),
    **dict.fromkeys(["sqrt", "cbrt", "log", "log1p", "rsqrt", "square", "is_finite"], POSITIVE),
    **dict.fromkeys(("asin", "acos", "atanh"), INSIDE),
    "acosh": 1.0 + POSITIVE,
}
BINARY = {**dict.fromkeys(_BINARY.split(), (ANY, OTHER)), "pow": (POSITIVE, OTHER)}
TRUTH = np.array([True, True, False, False])
LOGIC = {"and": lax.bitwise_and, "or": lax.bitwise_or, "xor": lax.bitwise_xor}
FLOAT32 = ANY.astype(np.float32)


def _double(a: jax.Array) -> jax.Array:
    return a.astype(np.float64)


def _cases() -> list[Case]:
    cases = [Case(name, getattr(lax, name), (x,)) for name, x in UNARY.items()]
    cases += [Case(name, getattr(lax, name), xs) for name, xs in BINARY.items()]
    cases += [
        Case(f"{n} in float32", getattr(lax, n), (np.abs(FLOAT32) / 8,)) for n in UNARY if n not in ("acosh", "rsqrt")
    ]
    for n in (-3, -2, -1, 0, 1, 2, 3, 7, 10):
        cases.append(Case(f"power {n}", functools.partial(lax.integer_pow, y=n), (ANY,)))
    ints = np.array([7, -7, 3, 0]), np.array([2, 2, -5, 4])
    for name in ("add", "sub", "mul", "div", "rem", "max", "min", "eq", "lt"):
        cases.append(Case(f"{name} of integers", getattr(lax, name), ints))
    for name, function in LOGIC.items():
        cases.append(Case(f"{name} of truth values", function, (TRUTH, TRUTH[::-1])))
        cases.append(Case(f"{name} of integers", function, (np.array([5, 6]), np.array([3, 10]))))
        cases.append(
            Case(f"{name} with what is known", lambda a, f=function: f(a, jnp.asarray(TRUTH[::2].repeat(2))), (TRUTH,))
        )
    return [
        *cases,
        Case("not", lambda a, b: (~a, ~b), (TRUTH, np.array([3, -8]))),
        Case("abs at zero", jnp.abs, (KINKS,)),
        Case("sign at zero", jnp.sign, (KINKS,)),
        Case("cbrt, negative", lax.cbrt, (-POSITIVE,)),
        Case(
            "max at ties",
            lambda a, b: (jnp.maximum(a, b), jnp.minimum(a, b)),
            (KINKS, np.array([0.0, 1.0, 3.0, 2.5, -2.0])),
        ),
        Case("max of itself", lambda a: jnp.maximum(a, a), (KINKS,)),
        Case("relu", lambda a: jnp.maximum(a, 0.0), (KINKS,)),
        Case("clamp at its limits", lambda lo, x, hi: lax.clamp(lo, x, hi), (np.full(5, -1.0), KINKS, np.ones(5))),
        Case("clip", lambda x: jnp.clip(x, -1.0, 1.0), (KINKS,)),
        Case("clip on one side", lambda x: jnp.clip(x, 0.0), (KINKS,)),
        Case("clamp of integers", lambda x: lax.clamp(2, x, 5), (np.arange(8),)),
        Case(
            "pow to an integer",
            lambda x, n: lax.pow(x, n),
            (np.array([2.0, -3.0, 0.0, 5.0]), np.array([3, 2, 2, 0])),
            forward=False,
            reverse=False,
        ),
        Case("pow at zero", lambda x, n: x**n, (np.array([2.0, 0.0, 0.0, 0.0]), np.array([0.0, 1.0, 2.5, 3.0]))),
        Case("pow of a number", lambda n: 2.0**n, (ANY,)),
        Case("pow to a number", lambda x: x**2.5, (POSITIVE,)),
        Case(
            "atan2 in all quadrants",
            jnp.arctan2,
            (np.array([1.0, 1.0, -1.0, -1.0, 0.0]), np.array([1.0, -1.0, 1.0, -1.0, -2.0])),
        ),
        Case("sinc", jnp.sinc, (KINKS,)),
        Case("logistic, far", lax.logistic, (np.array([-800.0, -40.0, 40.0, 800.0]),)),
        Case("where", lambda a: jnp.where(a > 0.0, jnp.sin(a), a * a), (KINKS,)),
        Case("where of arrays and numbers", lambda c, a: jnp.where(c, a, 0.0), (TRUTH, OTHER[:4])),
        Case(
            "select by an integer",
            lambda i, a, b, c: lax.select_n(i, a, b, c),
            (np.array([2, 0, 1], np.int32), ANY[:3], OTHER[:3], POSITIVE[:3]),
        ),
        Case("select one for all", lambda i, a, b: lax.select_n(i, a, b), (np.array(True), ANY, OTHER)),
        Case("to integers and back", lambda a: (a.astype(int), a.astype(int).astype(float) * a), (ANY,)),
        Case("from truth values", lambda c, a: c.astype(float) * a, (TRUTH, ANY[:4])),
        Case("to truth values", lambda a: a.astype(bool), (KINKS,)),
        Case("float32 inside", lambda a: jnp.sin(a.astype(np.float32)).astype(float) * a, (ANY,), atol=1e-6),
        Case("float64 inside", lambda a: (jnp.sin(a.astype(float)) * 2.0).astype(np.float32) * a, (FLOAT32,)),
        Case("choice of numbers in float64", lambda a: jnp.where(a > 0.0, 0.1, 1.0) * a, (FLOAT32,)),
        Case("sum of choices in float64", lambda a: jnp.mean(_double(a > 0.0) * 0.1).astype(a.dtype) * a, (FLOAT32,)),
        Case("sine of a choice in float64", lambda a: jnp.sin(jnp.where(a > 0.0, 0.1, 0.3) / 3.0) * a, (FLOAT32,)),
        Case(
            "whole parts in float64",
            lambda a: (-0.1 * jnp.maximum(_double(a.astype(int)), 0.5)).astype(a.dtype) * a,
            (FLOAT32,),
        ),
        Case("both precisions", lambda a, b: (a * 2.0, b * b, a.astype(float) * b), (FLOAT32, ANY)),
        Case(
            "reduced precision",
            lambda a: (lax.reduce_precision(a, 5, 10), lax.reduce_precision(a, 11, 52)),
            (ANY,),
            forward=False,
        ),
        Case("round", jnp.round, (ANY,)),
        Case("erf", lambda a: jax.scipy.special.erf(a), (ANY,)),
        Case("gamma", lambda a: jax.scipy.special.gammaln(a), (POSITIVE,)),
        Case("modulo", lambda a, b: a % b, (ANY, OTHER)),
        Case("floor division", lambda a, b: a // b, (np.array([7, -7, 3]), np.array([2, 2, -2]))),
        Case("log of sum of exp", lambda a: jax.nn.logsumexp(a), (ANY,)),
        Case("softplus", lambda a: jax.nn.softplus(a), (ANY,)),
        Case("stopped", lambda a: lax.stop_gradient(a) * a, (ANY,)),
        Case("scaled", lambda a: a / 3.0 + 7.0 / (a - 10.0) - (2.0 - a) / -4.0, (ANY,)),
        Case("hypot", jnp.hypot, (ANY, OTHER)),
        Case("complex inside", lambda a: jnp.real(jnp.exp(lax.complex(0.0 * a, a)) * lax.complex(2.0 + a, a)), (ANY,)),
    ]


CASES = _cases()


test_as_jax = as_jax(CASES)


def test_float64_numbers_of_float32_programs_are_no_calls() -> None:
    """A kernel has no calls of JAX."""
    cases = [case for case in CASES if "float64" in case.name and case.name != "float64 inside"]
    assert len(cases) == 4
    assert not any(case.program.calls for case in cases)


#: Functions near the ends of where they are defined, and in between: JAX's own derivatives lose digits there.
ENDS = {
    "asin": (lax.asin, mpmath.asin, 1.0 - np.array([1e-9, 1e-7, 1e-3, 0.7, 1.9, 2.0 - 1e-8])),
    "acos": (lax.acos, mpmath.acos, 1.0 - np.array([1e-9, 1e-7, 1e-3, 0.7, 1.9, 2.0 - 1e-8])),
    "acosh": (lax.acosh, mpmath.acosh, 1.0 + np.array([1e-9, 1e-7, 1e-3, 1.0, 1e3])),
    "atanh": (lax.atanh, mpmath.atanh, 1.0 - np.array([1e-9, 1e-7, 1e-3, 0.7, 1.9, 2.0 - 1e-8])),
    "log1p": (lax.log1p, mpmath.log1p, np.array([-1.0 + 1e-9, -0.3, 1e-12, 5.0])),
}


@pytest.mark.parametrize("name", ENDS)
def test_values_and_derivatives_near_the_ends(name: str) -> None:
    """Against forty digits."""
    function, exact, points = ENDS[name]
    program = scalarize(lambda x: [function(x)], jax.ShapeDtypeStruct(points.shape, float))
    with mpmath.workdps(40):
        values = [float(exact(mpmath.mpf(float(x)))) for x in points]
        slopes = [float(mpmath.diff(exact, mpmath.mpf(float(x)), h=mpmath.mpf(10) ** -20)) for x in points]
    np.testing.assert_allclose(evaluate(program, points)[0], values, rtol=4e-16)
    for derivative in (tangent_program(program, [0]), cotangent_program(program, [0])):
        np.testing.assert_allclose(evaluate(derivative, points, np.ones_like(points))[0], slopes, rtol=1e-15)


def test_every_operation_is_compared() -> None:
    met = {
        str(g.operation(i)) for case in CASES for g in [case.program.graph] for i in case.program.live if g.operation(i)
    }
    assert set(OPERATIONS) - met == set()
