"""Orders, products, repair of drifted elements, what arguments are taken and how wrong ones are refused."""

import pickle

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from twistax.errors import InputError, ShapeError
from twistax.groups import ANGULAR_FIRST, LINEAR_FIRST, SE3, SO3, Euclidean, Order, Product, SpecialEuclidean, se3, so3

STATE = Product({"z": SE3, "mass": Euclidean(), "a": SO3, "grid": Euclidean((2, 2))})


def close(actual, expected, tolerance=0.0):
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=tolerance)


# --- order


def test_orders_are_values():
    assert repr(LINEAR_FIRST) == "LINEAR_FIRST"
    assert repr(ANGULAR_FIRST) == "ANGULAR_FIRST"
    assert LINEAR_FIRST != ANGULAR_FIRST
    assert pickle.loads(pickle.dumps(ANGULAR_FIRST)) == ANGULAR_FIRST
    assert isinstance(LINEAR_FIRST, Order)
    with pytest.raises(AttributeError):
        LINEAR_FIRST.linear_leads = False


def test_orders_split_and_join():
    v, w = np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])
    close(LINEAR_FIRST.join(v, w), [1, 2, 3, 4, 5, 6])
    close(ANGULAR_FIRST.join(v, w), [4, 5, 6, 1, 2, 3])
    for order in (LINEAR_FIRST, ANGULAR_FIRST):
        first, second = order.split(order.join(v, w))
        close(first, v)
        close(second, w)


def test_orders_permute_vectors_and_matrices():
    a = np.arange(36.0).reshape(6, 6)
    permutation = [3, 4, 5, 0, 1, 2]
    close(ANGULAR_FIRST.from_linear_first(a), a[np.ix_(permutation, permutation)])
    close(ANGULAR_FIRST.from_linear_first(a[0]), a[0][permutation])
    for order in (LINEAR_FIRST, ANGULAR_FIRST):
        close(order.to_linear_first(order.from_linear_first(a)), a)
    close(LINEAR_FIRST.from_linear_first(a), a)
    for wrong in (np.zeros(5), np.zeros((6, 5)), np.zeros(())):
        with pytest.raises(ShapeError, match=r"\(6,\) or \(6, 6\), got"):
            ANGULAR_FIRST.to_linear_first(wrong)


# --- products


def test_tangents_follow_the_declaration_not_the_sorted_keys():
    assert STATE.slices == {"z": slice(0, 6), "mass": slice(6, 7), "a": slice(7, 10), "grid": slice(10, 14)}
    d = np.arange(14.0)
    parts = STATE.split(d)
    assert list(parts) == ["z", "mass", "a", "grid"]
    close(parts["a"], [7, 8, 9])
    close(STATE.join(dict(sorted(parts.items()))), d)
    close(STATE.exp(d)["grid"], [[10, 11], [12, 13]])
    # JAX hands dicts back with sorted keys; the tangent must not notice.
    through_jit = jax.jit(lambda g: STATE.log(g))(STATE.exp(0.1 * d))
    close(through_jit, 0.1 * d, 1e-15)


def test_matrices_are_block_diagonal():
    d = np.linspace(-0.5, 0.8, 14)
    g = STATE.exp(d)
    expected = np.zeros((14, 14))
    expected[:6, :6], expected[6, 6] = SE3.Ad(g["z"]), 1.0
    expected[7:10, 7:10], expected[10:, 10:] = SO3.Ad(g["a"]), np.eye(4)
    close(STATE.Ad(g), expected)


def test_products_are_values():
    again = Product({"z": SE3, "mass": Euclidean(), "a": SpecialEuclidean(), "grid": Euclidean((2, 2))})
    same = Product(dict(STATE.factors))
    other = Product(dict(sorted(STATE.factors.items())))
    assert same == STATE
    assert hash(same) == hash(STATE)
    assert other != STATE
    assert again != STATE
    assert SE3.with_order(ANGULAR_FIRST) != SE3
    assert SpecialEuclidean(LINEAR_FIRST) == SE3
    assert "SpecialOrthogonal" in repr(STATE)
    assert STATE.shape["grid"] == (2, 2)
    with pytest.raises(TypeError):
        STATE.factors["new"] = SO3


def test_the_empty_product():
    nothing = Product({})
    assert nothing.dimension == 0
    assert nothing.exp(np.zeros(0)) == {}
    assert nothing.log({}).shape == (0,)
    assert nothing.ad(np.zeros(0)).shape == (0, 0)


# --- drift


def polar(R):
    """The nearest rotation by Newton's iteration with many digits; SciPy's factors are off by more than is asked."""
    with mpmath.workdps(40):
        X = mpmath.matrix(R.tolist())
        for _ in range(6):
            X = (X + (X.T) ** -1) / 2
        return np.array(X.tolist(), dtype=float)


@pytest.mark.parametrize("drift", [1e-12, 1e-8, 1e-4])
def test_normalize_gives_the_nearest_rotation(drift):
    rng = np.random.default_rng(8)
    for w in rng.normal(size=(6, 3)) * 2.0:
        R = np.asarray(so3.exp(w)) + drift * rng.normal(size=(3, 3))
        repaired = SO3.normalize(R)
        close(repaired, polar(R), 20.0 * drift**2 + 1e-15)
        assert SO3.defect(repaired) < 2e-15
        assert drift / 10 < SO3.defect(R) < 20 * drift


def test_normalize_repairs_a_pose():
    T = np.array(se3.exp(np.arange(6.0)))
    T[3] += 1e-3
    assert SE3.defect(T) == pytest.approx(1e-3)
    repaired = SE3.normalize(T)
    assert SE3.defect(repaired) < 2e-15
    close(repaired[:3, 3], T[:3, 3])
    skewed = T.copy()
    skewed[0, 1] += 1e-2
    assert SE3.defect(skewed) > 1e-3
    assert STATE.defect({**STATE.identity(), "a": np.diag([1.5, 1.0 / 1.5, 1.0])}) == 1.25


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_pose_somewhere_infinite_is_refused(bad):
    T = np.eye(4)
    T[1, 3] = bad
    with pytest.raises(InputError, match="with an error of nan"):
        SE3.normalize(T)


# --- arguments

SHAPES = {
    "exp": ["xi"],
    "log": ["g"],
    "hat": ["xi"],
    "vee": ["g"],
    "compose": ["g", "g"],
    "inverse": ["g"],
    "ad": ["xi"],
    "ad_dual": ["xi"],
    "Ad": ["g"],
    "Ad_dual": ["g"],
    "bracket": ["xi", "xi"],
    "coad": ["xi", "xi"],
    "left_jacobian": ["xi"],
    "right_jacobian": ["xi"],
    "left_jacobian_inv": ["xi"],
    "right_jacobian_inv": ["xi"],
    "right_jacobian_inv_apply": ["xi", "xi"],
}
MAPS = [(module, name) for module in (so3, se3) for name in SHAPES]


def arguments(module, name, dtype=np.float64):
    n, m = (3, 3) if module is so3 else (6, 4)
    values = {"xi": np.linspace(-1.0, 1.0, n).astype(dtype), "g": np.eye(m, dtype=dtype)}
    return [values[kind] for kind in SHAPES[name]]


@pytest.mark.parametrize(("module", "name"), MAPS, ids=lambda value: value if isinstance(value, str) else "")
def test_maps_take_lists_integers_and_both_precisions(module, name):
    function = getattr(module, name)
    given = arguments(module, name)
    expected = function(*given)
    assert expected.dtype == jnp.float64
    close(function(*(value.tolist() for value in given)), expected)
    single = function(*arguments(module, name, np.float32))
    assert single.dtype == jnp.float32
    close(single, expected, 1e-6)
    whole = function(*(np.round(value).astype(int) for value in given))
    assert whole.dtype == jnp.float64
    close(whole, function(*(np.round(value) for value in given)))
    if len(given) == 2:
        mixed = function(np.float32(given[0]), given[1].tolist())
        assert mixed.dtype == jnp.float32


@pytest.mark.parametrize(("module", "name"), MAPS, ids=lambda value: value if isinstance(value, str) else "")
def test_maps_refuse_wrong_shapes(module, name):
    given = arguments(module, name)
    for i in range(len(given)):
        wrong = list(given)
        wrong[i] = np.zeros(5)
        with pytest.raises(ShapeError, match=r"^\w+\.\w+ expects \w+ with shape \([0-9, ]+\), got \(5,\)"):
            getattr(module, name)(*wrong)


@pytest.mark.parametrize("module", [so3, se3])
def test_act_refuses_wrong_shapes(module):
    g = np.eye(3 if module is so3 else 4)
    with pytest.raises(ShapeError, match=r"points with shape \(3,\) or \(n, 3\), got \(2,\)"):
        module.act(g, np.zeros(2))
    with pytest.raises(ShapeError, match=r"act expects . with shape"):
        module.act(np.eye(2), np.zeros(3))


def test_euclidean_names_itself_when_it_refuses():
    with pytest.raises(ShapeError, match=r"R3\.compose expects h with shape \(3,\), got \(2,\)"):
        Euclidean((3,)).compose(np.zeros(3), np.zeros(2))
    with pytest.raises(ShapeError, match=r"R\(2, 2\)\.exp expects xi with shape \(4,\), got \(2, 2\)"):
        Euclidean((2, 2)).exp(np.zeros((2, 2)))


def test_groups_keep_single_precision():
    for group in (SO3, SE3, SE3.with_order(ANGULAR_FIRST), Euclidean((2,)), STATE):
        d = np.linspace(-0.3, 0.4, group.dimension).astype(np.float32)
        g = group.exp(d)
        results = [g, group.log(g), group.retract(g, d), group.difference(g, g), group.Ad(g), group.normalize(g)]
        results += [group.ad(d), group.left_jacobian(d), group.right_jacobian_inv(d), group.defect(g)]
        assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves(results))
