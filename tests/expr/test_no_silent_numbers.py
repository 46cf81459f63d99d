"""What was wrong in silence once: each is right now, or refused with a sentence that says how to mend it."""

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.checks import real_array, reals

s, v = tx.State("s"), tx.State("v", shape=(3,))
A, B = tx.State("A", shape=(2, 2)), tx.State("B", shape=(2, 2))
X = {"A": np.array([[1.0, 2.0], [3.0, 4.0]]), "B": np.array([[5.0, 6.0], [7.0, 8.0]])}


def compiled(e: tx.Expr, **x: Any) -> np.ndarray:
    """The value through `tx.compile`, rewrites included."""
    leaves = [node for node in tx.expr.postorder(e) if isinstance(node, tx.State)]
    dynamics = tx.compile(tx.System(rates={leaf: 0.0 * leaf for leaf in leaves}, outputs={"e": e}))
    return np.asarray(dynamics.outputs(0.0, x)["e"])


@pytest.mark.parametrize(
    "index",
    [(1, slice(None), [0, 1]), (1, [0, 1]), ([0, 1], 1), (0, slice(None), [True, False]), (1, 0, [1, 1])],
    ids=str,
)
def test_an_index_of_mixed_kinds_through_a_join(index: Any) -> None:
    e = tx.Stack(A, B)[index]
    expected = np.stack([X["A"], X["B"]])[index]
    np.testing.assert_array_equal(compiled(e, **X), expected)
    np.testing.assert_array_equal(tx.lower(e)(0.0, X), expected)


@pytest.mark.parametrize("limit", [np.inf, -np.inf])
def test_comparisons_of_infinities(limit: float) -> None:
    for condition, holds in ((s >= limit, True), (s <= limit, True), (s == limit, True)):
        assert compiled(tx.Where(condition, 1.0, 2.0) + 0.0 * tx.Time(), s=limit) == (1.0 if holds else 2.0)


class Weighted(tx.Expr):
    """w . x with weights that are static."""

    x: tx.expr.fields.Operand
    w: Any
    takes = ((2000,),)

    def evaluate(self, *values: Any) -> Any:
        return jnp.sum(jnp.asarray(self.w) * values[0])


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray, tuple, lambda w: {"w": w}, lambda w: [w, None]])
def test_long_static_fields_are_told_apart(kind: Callable[[Any], Any]) -> None:
    one, five = np.zeros(2000), np.zeros(2000)
    one[999], five[999] = 1.0, 5.0
    x = tx.State("x", shape=(2000,))
    assert Weighted(x, w=kind(one)).key() != Weighted(x, w=kind(five)).key()
    assert Weighted(x, w=kind(one)).key() == Weighted(x, w=kind(one.copy())).key()


@pytest.mark.parametrize(
    "build",
    [
        lambda c: c + c, lambda c: 2.0 * c, lambda c: tx.Sin(c), lambda c: -c, lambda c: tx.Max(c, 0.5),
        lambda c: c <= 1.0, lambda c: tx.linalg.Sum(c), lambda c: np.eye(3) @ c, lambda c: c**2,
        lambda c: tx.linalg.Norm(c),
    ],
)  # fmt: skip
def test_conditions_are_no_numbers(build: Callable[[tx.Expr], tx.Expr]) -> None:
    with pytest.raises(tx.ModelError, match=r"expects numbers, got the condition .*(?s:.)*fix: .*tx.Where"):
        build(v <= 0.0)


def test_a_condition_chosen_by_a_constant_stays_one() -> None:
    x = {"s": np.array(0.5), "v": np.array([0.0, 2.0, 0.5])}
    np.testing.assert_array_equal(compiled(tx.Cond(tx.Constant(True), s <= 1.0, v <= 1.0), **x), [True] * 3)


def test_conditions_may_lie_deep() -> None:
    e: tx.Expr = s
    for _ in range(3000):
        e = tx.Where(s <= 0.0, 1.0, e)
    assert not (e + 1.0).boolean


@pytest.mark.parametrize("x", [1e-300, 1e-8, 0.3, 1e8, 1e160, 1e300])
def test_a_rounded_corner_does_not_overflow(x: float) -> None:
    e = tx.SmoothReLU(s, c=1e-8)
    expected = x * (x / (np.hypot(x, 1e-8) + 1e-8))
    np.testing.assert_allclose(tx.lower(e)(0.0, {"s": x}), expected, rtol=1e-14)
    slope = jax.grad(lambda x: tx.lower(e)(0.0, {"s": x}))(x)
    np.testing.assert_allclose(slope, x / np.hypot(x, 1e-8), rtol=1e-14)
    curvature = jax.grad(jax.grad(lambda x: tx.lower(e)(0.0, {"s": x})))(x)
    np.testing.assert_allclose(curvature, (1e-8 / np.hypot(x, 1e-8)) ** 2 / np.hypot(x, 1e-8), rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(tx.lower(tx.SmoothReLU(s))(0.0, {"s": np.float32(2e19)}), np.float32(2e19), rtol=1e-6)


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: np.fmax(v, 1.0), "tx.Max"),
        (lambda: np.fmin(v, 1.0), "tx.Min"),
        (lambda: np.hypot(v, 1.0), "tx.Sqrt"),
        (lambda: np.dot(tx.State("T", shape=(2, 2, 3)), tx.State("C", shape=(2, 3, 3))), "a @ b"),
        (lambda: np.block([tx.State("T", shape=(2, 2, 3))]), "tx.Block"),
    ],
)
def test_functions_of_numpy_that_no_node_means_are_refused(build: Callable[[], Any], said: str) -> None:
    with pytest.raises(TypeError, match=said):
        build()


def test_blocks_are_those_of_numpy() -> None:
    a, m = np.array([1.0, 2.0, 3.0]), X["A"]
    for build in (
        lambda a, s, m: np.block([a, s, a]),
        lambda a, s, m: np.block([[s, a], [s, a]]),
        lambda a, s, m: np.block([m, m]),
        lambda a, s, m: np.block([[m, m], [m, m]]),
    ):
        e = build(v, s, A)
        expected = build(a, np.array(0.5), m)
        assert e.shape == expected.shape
        np.testing.assert_array_equal(
            tx.lower(e)(0.0, {leaf: {"v": a, "s": 0.5, "A": m}[leaf] for leaf in names(e)}), expected
        )


def names(e: tx.Expr) -> list[str]:
    return [node.name for node in tx.expr.postorder(e) if isinstance(node, tx.State)]


BAD = {
    "text": "3.0",
    "a list with text": [1.0, "2"],
    "complex": 1.0 + 2.0j,
    "an object": object(),
    "rows of two lengths": [[1.0], [1.0, 2.0]],
    "a date": np.array("2020-01-01", "datetime64[D]"),
    "None inside": [1.0, None],
}


@pytest.mark.parametrize("value", BAD.values(), ids=BAD)
def test_what_is_no_real_number_is_refused_everywhere(value: Any, unchecked: None) -> None:
    shape = np.shape(np.asarray(value, object)) if not isinstance(value, list) else (2,)
    p = tx.Parameter("p", shape=shape)
    system = tx.System(rates={s: 0.0 * s}, outputs={"p": p})
    said = "numbers"
    for build in (lambda: tx.Constant(value), lambda: tx.Parameter("p", value=value), lambda: s + value):
        with pytest.raises((tx.ModelError, tx.ShapeError), match=said):
            build()
    with pytest.raises((tx.ModelError, tx.ShapeError), match=said):
        tx.compile(system, bake={"p": value})
    with pytest.raises(tx.InputError, match=said):
        tx.compile(system).outputs(0.0, {"s": 0.0}, None, {"p": value})
    if not (isinstance(value, list) and value[-1] is None):  # which is an entry left open
        with pytest.raises((tx.ModelError, tx.ShapeError), match=said):
            tx.State("x", shape=shape, min=value)


def test_a_vector_is_no_matrix() -> None:
    J, x = tx.Parameter("J", shape=(3, 3)), {"v": np.ones(3)}
    system = tx.System({v: J @ v})
    with pytest.raises(tx.ShapeError, match=r"'J': value expects shape \(3, 3\), got \(3,\)"):
        tx.compile(system, bake={"J": [1.0, 2.0, 3.0]})
    with pytest.raises(tx.ShapeError, match=r"\(3, 3\), got \(3,\)"):
        tx.Parameter("J", shape=(3, 3), value=[1.0, 2.0, 3.0])
    with pytest.raises(tx.InputError, match=r"\(3, 3\), got \(3,\)"):
        tx.compile(system)(0.0, x, None, {"J": [1.0, 2.0, 3.0]})


@pytest.mark.parametrize("value", [398600441800000, np.int64(398600441800000), 10**20, np.uint64(2**63)], ids=repr)
def test_long_integers_without_x64(value: Any) -> None:
    with jax.enable_x64(False):
        p = tx.Parameter("p")
        dynamics = tx.compile(tx.System({s: p * s}))
        np.testing.assert_allclose(dynamics(0.0, {"s": 1.0}, None, {"p": value})["s"], float(value), rtol=1e-7)
        with pytest.raises(tx.InputError, match=r"params\['p'\] has 1e\+200, which does not fit in float32"):
            dynamics(0.0, {"s": 1.0}, None, {"p": 1e200})


def test_numbers_of_all_kinds_come_in() -> None:
    kinds = [
        2,
        2.0,
        True,
        np.float16(2),
        np.int8(2),
        np.array(2),
        jnp.array(2),
        jnp.float32(2),
        jnp.bfloat16(2),
        np.True_,
    ]
    dynamics = tx.compile(tx.System({s: tx.Parameter("p") * s}))
    for value in kinds:
        expected = float(value)
        assert float(dynamics(0.0, {"s": 3.0}, None, {"p": value})["s"]) == 3.0 * expected
        assert float(tx.Parameter("p", value=value).value) == expected
        assert float(tx.lower(tx.Constant(value) * s)(0.0, {"s": 3.0})) == 3.0 * expected
    assert float(dynamics(0.0, {"s": np.inf}, None, {"p": 1.0})["s"]) == np.inf


def test_lists_with_traced_entries_come_in() -> None:
    dynamics = tx.compile(tx.System({v: 2.0 * v}))
    found = jax.jit(lambda a: dynamics(0.0, {"v": [a, 1.0, jnp.sin(a)]})["v"])(0.5)
    np.testing.assert_allclose(found, [1.0, 2.0, 2.0 * np.sin(0.5)])


def test_functions_of_others_are_not_numpys() -> None:
    sign = np.frompyfunc(lambda a: 7.0, 1, 1)  # any name may be NumPy's too
    with pytest.raises(TypeError, match="is not a ufunc of NumPy"):
        sign(v)
    special = pytest.importorskip("scipy.special")
    with pytest.raises(TypeError, match="is not a ufunc of NumPy"):
        special.log1p(v)


def test_masked_entries_are_refused() -> None:
    value = np.ma.array([1.0, 2.0], mask=[False, True])
    p = tx.Parameter("p", shape=(2,))
    system = tx.System(rates={s: 0.0 * s}, outputs={"p": p})
    with pytest.raises(tx.ModelError, match="masked entries"):
        tx.Parameter("p", value=value)
    with pytest.raises(tx.InputError, match="masked entries"):
        tx.compile(system).outputs(0.0, {"s": 0.0}, None, {"p": value})
    assert tx.Parameter("p", value=np.ma.array([1.0, 2.0])).shape == (2,)


def test_baking_changes_no_value() -> None:
    p, q = tx.Parameter("p"), tx.Parameter("q")
    quotient = tx.System(rates={s: s * p / p})
    for number in (0.0, 2.0):
        baked = tx.compile(quotient, bake={"p": number})(0.0, {"s": 1.5})["s"]
        np.testing.assert_array_equal(baked, tx.compile(quotient)(0.0, {"s": 1.5}, None, {"p": number})["s"])
    infinite = {"p": np.inf, "q": 1.0}
    for e in (p - p, p * (q - q), 0.0 * p, p + -p, tx.Constant([np.inf, 1.0]) @ np.zeros(2)):
        system = tx.System(rates={s: 0.0 * s}, outputs={"e": e})
        bake = {x.name: np.inf for x in system.parameters if x.name == "p"}
        for backend in (tx.JAX(), tx.XLA(least=0)):
            baked = tx.compile(system, bake=bake, backend=backend)
            expected = tx.lower(e)(0.0, {}, None, {x.name: infinite[x.name] for x in system.parameters})
            given = {x.name: infinite[x.name] for x in baked.parameters}
            np.testing.assert_array_equal(baked.outputs(0.0, {"s": 1e300}, None, given)["e"], expected)
    underflows = 1e-200 * s * 1e-200
    assert tx.lower(underflows.canonicalize())(0.0, {"s": 1e300}) == tx.lower(underflows)(0.0, {"s": 1e300}) > 0.0


def test_an_element_belongs_to_its_vmap() -> None:
    kept: list[tx.Expr] = []
    inner = tx.Vmap(lambda q: tx.Vmap(lambda r: (kept.append(q * r), q * r)[1], v), v)  # both within their functions
    np.testing.assert_allclose(tx.lower(inner)(0.0, {"v": np.arange(3.0)}), np.outer(np.arange(3.0), np.arange(3.0)))
    for use in (lambda: tx.Vmap(lambda q: q * kept[0], v), lambda: tx.lower(kept[0]), lambda: tx.System({s: kept[0]})):
        with pytest.raises(tx.ModelError, match="stands for an element of a Vmap's batch"):
            use()


@pytest.mark.parametrize("log", [tx.lie.so3.log, lambda R: tx.lie.se3.log(tx.lie.se3.transform(R, jnp.zeros(3)))])
def test_a_traced_map_of_no_rotation_is_nan(log: Callable[..., Any]) -> None:
    for R in (np.diag([1.0, 1.0, -1.0]), np.zeros((3, 3)), 3.0 * np.eye(3)):
        assert np.isnan(jax.jit(log)(jnp.asarray(R))).any()
    R = tx.lie.so3.exp([0.3, -0.2, 3.1])
    np.testing.assert_array_equal(jax.jit(log)(R)[-3:], jax.jit(tx.lie.so3.unchecked_log)(R))


def test_half_precision_is_computed_in_single_or_more() -> None:
    for number in (np.float16(0.5), jnp.asarray(0.5, jnp.bfloat16), 1, True):
        found = tx.lower(tx.Exp(s))(0.0, {"s": number})
        assert found.dtype == jnp.float64
        np.testing.assert_allclose(found, np.exp(float(number)), rtol=1e-15)


def test_a_traced_attitude_that_is_none_is_nan() -> None:
    rotation, quaternion = jax.jit(lambda R: tx.pose(rotation=R)), jax.jit(lambda q: tx.pose(quaternion=q))
    np.testing.assert_array_equal(rotation(jnp.eye(3)), np.eye(4))
    for pose in (rotation(2.0 * jnp.eye(3)), rotation(jnp.diag(jnp.array([1.0, 1.0, -1.0]))), quaternion(jnp.zeros(4))):
        assert np.isnan(pose[:3, :3]).all()
    for read in (tx.lie.euler, tx.lie.quaternion):
        assert np.isnan(jax.jit(read)(jnp.zeros((3, 3)))).all()
        np.testing.assert_array_equal(jax.jit(read)(jnp.eye(3)), read(jnp.eye(3)))


_BEYOND = "fit in float64|real numbers"


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (10**400, _BEYOND),
        ([1.0, -(10**400)], _BEYOND),
        (np.timedelta64(3, "s"), "real numbers"),
        ([np.timedelta64(3, "s"), 1.0], "real numbers"),
        ([np.ma.array(1.0, mask=True), 2.0], "masked"),
        (np.ma.array(1.0, mask=True), "masked"),
        (jax.random.key(0), "real numbers"),
    ],
    ids=["integer", "list", "time", "time in a list", "masked in a list", "masked", "key"],
)
def test_what_numpy_would_make_a_number_of(value: Any, words: str) -> None:
    p = tx.Parameter("p", shape=(2,) if isinstance(value, list) else ())
    dynamics = tx.compile(tx.System(rates={s: 0.0 * s}, outputs={"p": p}))
    with pytest.raises(tx.InputError, match=words):
        dynamics.outputs(0.0, {"s": 0.0}, None, {"p": value})
    for declared in (lambda: tx.Parameter("p", value=value), lambda: tx.Constant(value)):
        with pytest.raises(tx.ModelError, match=words):
            declared()
    if not isinstance(value, list):
        with pytest.raises(tx.InputError, match="t1 must be a finite time"):
            tx.integrate(dynamics, {"s": 0.0}, t1=value, steps=2, params={"p": 1.0})


def test_masks_beside_traced_values_are_refused() -> None:
    dynamics = tx.compile(tx.System(rates={v: 2.0 * v}))
    for masked in (np.ma.array(5.0, mask=True), np.ma.masked):
        with pytest.raises(tx.InputError, match="masked entries"):
            jax.jit(lambda a, m=masked: dynamics(0.0, {"v": [a, m, 0.0]})["v"])(1.0)


def test_lists_of_different_lengths_are_named_so() -> None:
    with pytest.raises(tx.ModelError, match="a expects real numbers, as many in each list"):
        tx.tableaus.ButcherTableau("mine", 2, [[], [1.0]], [0.5, 0.5], [0.0, 1.0])


@pytest.mark.parametrize("read", [reals, real_array])
def test_a_list_that_holds_itself_is_refused(read: Callable[..., Any]) -> None:
    value: list[Any] = [1.0]
    value.append(value)
    with pytest.raises(tx.InputError, match=r"p expects real numbers, got \[1.0, \[...\]\]"):
        read("p", value, tx.InputError)


def test_an_array_of_objects_is_the_number_it_holds() -> None:
    assert tx.checks.number("p", np.array(Fraction(1, 2), dtype=object)) == 0.5
    for entry in ("abc", "1.5", True, None, np.timedelta64(3, "s")):
        with pytest.raises(tx.InputError, match="p must be a finite number"):
            tx.checks.number("p", np.array(entry, dtype=object))


def test_more_than_double_precision_is_double() -> None:
    dynamics = tx.compile(tx.System(rates={s: 2.0 * s}))
    assert dynamics(0.0, {"s": np.longdouble(1.5)})["s"].dtype == np.float64
    if np.finfo(np.longdouble).max > np.finfo(float).max:
        with pytest.raises(tx.InputError, match="fit in float64"):
            dynamics(0.0, {"s": np.longdouble("1e400")})


def test_nothing_becomes_infinite_in_single_precision() -> None:
    """A parameter of JAX's in double precision beside a state in single; the end of an integration."""
    dynamics = tx.compile(tx.System(rates={s: tx.Parameter("p") * s}))
    x = {"s": np.float32(1.0)}
    with pytest.raises(tx.InputError, match="1e\\+300, which does not fit in float32"):
        dynamics(0.0, x, None, {"p": jnp.asarray(1e300)})
    with pytest.raises(tx.InputError, match="t1 has 1e\\+39, which does not fit in float32"):
        tx.integrate(dynamics, x, t1=1e39, steps=2, params={"p": 0.0})
    for name, value, place in (
        ("dt", 1e39, "dt"),
        ("rtol", 1e39, "rtol"),
        ("atol", 1e39, "atol of state 's'"),
        ("jumps", [0.5, 1e39], "jumps"),
    ):
        given = {"rtol": 1e-3, "atol": 1e-3, name: value}
        with pytest.raises(tx.InputError, match=f"^{place} has 1e\\+39, which does not fit in float32"):
            tx.integrate(dynamics, x, t1=1.0, params={"p": 0.0}, **given)
    pushed = tx.compile(tx.System(rates={s: tx.Control("F") * s}))
    table = tx.ZeroOrderHold(np.array([0.0, 0.5]), np.array([0.0, 1e39]))
    with pytest.raises(
        tx.InputError, match=r"^values of a table of controls has 1e\+39, which does not fit in float32"
    ):
        tx.integrate(pushed, x, t1=1.0, rtol=1e-3, u={"F": table})
    with pytest.raises(tx.InputError, match=r"^what an event compares with has 1e\+39, which does not fit in float32"):
        tx.integrate(dynamics, x, t1=1.0, rtol=1e-3, params={"p": 0.0}, event=tx.Event(s >= 1e39))
    phases = [tx.Phase(dynamics, duration=1.0)] * 2
    with pytest.raises(tx.InputError, match=r"links\[0\]\['s'\] has 1e\+39, which does not fit in float32"):
        tx.integrate_phases(phases, x, links=[{"s": 1e39}], dt=0.5, params={"p": 0.0})
    large = tx.compile(tx.System(rates={tx.State("y", scale=1e39): 0.0}))
    with pytest.raises(tx.InputError, match=r"^scale of state 'y' has 1e\+39, which does not fit in float32"):
        tx.integrate(large, {"y": np.float32(1.0)}, t1=1.0, rtol=1e-3)


def test_steps_that_32_bits_do_not_count() -> None:
    """2^32 + 4 would be 4."""
    with jax.enable_x64(False):
        dynamics = tx.compile(tx.System(rates={s: 1.0 + 0.0 * s}))
        for many in ({"steps": 2**32 + 4}, {"dt": 1.0 / (2**32 + 4)}, {"dt": 1e-320}):
            with pytest.raises(tx.InputError, match="steps are more than the 2147483647"):
                tx.integrate(dynamics, {"s": 0.0}, t1=1.0, **many)
