"""Every group of the package, found by itself: by the laws of `tx.testing`, which are of its own maps, and by oracles:
matrix products, commutators and SciPy's exponential."""

import group_oracles as oracle
import jax
import numpy as np
import pytest
from scipy.linalg import expm

from twistax.testing import check_group

CASES = 10
FUNCTIONS_OF_TANGENT = ("exp", "ad", "left_jacobian", "right_jacobian", "left_jacobian_inv", "right_jacobian_inv")


def tangents(group, seed):
    """Tangents of ordinary size, then zero, tiny, small and a single non-zero entry."""
    rng = np.random.default_rng(seed)
    d = rng.uniform(-1.0, 1.0, (CASES, group.dimension))
    d[4:8] *= np.array([0.0, 1e-12, 1e-6, 1e-3])[:, None]
    d[8, 1:] = 0.0
    return d


def laws(group):
    def one(a, b, c):
        g, h, k = group.exp(a), group.exp(b), group.exp(c)
        values = {name: getattr(group, name)(a) for name in FUNCTIONS_OF_TANGENT}
        return values | {
            "h": h,
            "log": group.log(g),
            "product": group.compose(g, h),
            "left": group.compose(group.compose(g, h), k),
            "right": group.compose(g, group.compose(h, k)),
            "inverse": group.inverse(g),
            "Ad": group.Ad(g),
            "retract": group.retract(g, b),
            "difference": group.difference(g, h),
            "back": group.retract(g, group.difference(g, h)),
            "bracket": group.bracket(a, b),
            "defect": group.defect(g),
            "normalize": group.normalize(g),
            "tighten": group.tighten(g),
        }

    # Not jitted: compiling all of it for every group takes longer than running it once, operation by operation.
    return jax.vmap(one)


@pytest.fixture(scope="module", params=oracle.GROUPS, ids=lambda group: group.name)
def case(request):
    """The group, its tangents a, b, c and, for every case, everything the laws speak of."""
    group = request.param
    a, b, c = (tangents(group, seed) for seed in (1, 2, 3))
    batch = laws(group)(a, b, c)
    values = [jax.tree.map(lambda leaf, i=i: np.asarray(leaf[i]), batch) for i in range(CASES)]
    return group, list(zip(a, b, values, strict=True))


def close(actual, expected, tolerance=1e-13):
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=tolerance)


def test_exp_is_the_matrix_exponential(case):
    group, values = case
    for a, _, value in values:
        close(oracle.represent(group, value["exp"]), expm(oracle.hat(group, a)))


def test_log_undoes_exp(case):
    _, values = case
    for a, _, value in values:
        close(value["log"], a, 4e-15 * max(1e-20, np.abs(a).max()))


def test_compose_is_the_matrix_product(case):
    group, values = case
    for _, _, value in values:
        product = oracle.represent(group, value["exp"]) @ oracle.represent(group, value["h"])
        close(oracle.represent(group, value["product"]), product)
        close(oracle.represent(group, value["left"]), oracle.represent(group, value["right"]))


def test_inverse(case):
    group, values = case
    for _, _, value in values:
        g, inverse = oracle.represent(group, value["exp"]), oracle.represent(group, value["inverse"])
        close(g @ inverse, np.eye(len(g)))
        close(inverse, np.linalg.inv(g))


def test_identity(case):
    group, _ = case
    matrix = oracle.represent(group, jax.tree.map(np.asarray, group.identity()))
    close(matrix, np.eye(len(matrix)), 0.0)
    assert group.log(group.identity()).shape == (group.dimension,)
    assert all(leaf.dtype == np.float32 for leaf in jax.tree.leaves(group.identity(np.float32)))


def test_Ad_is_conjugation(case):
    group, values = case
    for _, b, value in values:
        g = oracle.represent(group, value["exp"])
        conjugate = g @ oracle.hat(group, b) @ np.linalg.inv(g)
        close(oracle.hat(group, value["Ad"] @ b), conjugate)


def test_ad_is_the_commutator(case):
    group, values = case
    for a, _, value in values:
        close(value["ad"], oracle.ad(group, a))


def test_the_bracket_is_the_commutator(case):
    group, values = case
    for a, b, value in values:
        close(value["bracket"], oracle.ad(group, a) @ b)


def test_jacobians_are_their_series(case):
    group, values = case
    for a, _, value in values:
        right, left = oracle.right_jacobian(group, a), oracle.right_jacobian(group, -a)
        close(value["right_jacobian"], right)
        close(value["left_jacobian"], left)
        close(value["right_jacobian_inv"], np.linalg.inv(right))
        close(value["left_jacobian_inv"], np.linalg.inv(left))


def test_retract_perturbs_on_the_right(case):
    group, values = case
    for _, b, value in values:
        moved = oracle.represent(group, value["exp"]) @ expm(oracle.hat(group, b))
        close(oracle.represent(group, value["retract"]), moved)


def test_difference_undoes_retract(case):
    group, values = case
    for _, _, value in values:
        close(oracle.represent(group, value["back"]), oracle.represent(group, value["h"]))
        g, h = oracle.represent(group, value["exp"]), oracle.represent(group, value["h"])
        close(expm(oracle.hat(group, value["difference"])), np.linalg.solve(g, h))


def test_elements_lie_in_the_group(case):
    group, values = case
    for _, _, value in values:
        assert value["defect"] < 1e-15
        close(oracle.represent(group, value["normalize"]), oracle.represent(group, value["exp"]), 1e-15)
        close(oracle.represent(group, value["tighten"]), oracle.represent(group, value["exp"]), 1e-15)


def test_groups_are_values(case):
    group, _ = case
    assert group in oracle.GROUPS
    assert len({group, *oracle.GROUPS}) == len(oracle.GROUPS)


@pytest.mark.parametrize("group", oracle.GROUPS, ids=lambda group: group.name)
def test_the_group_keeps_the_laws(group):
    check_group(group)
