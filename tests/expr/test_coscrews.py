"""The tables of docs/coscrews.md, row by row: KSL's functions against matrices written out, and what they cost."""

import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from expr_cases import function_of
from scipy.spatial.transform import Rotation

import twistax as tx
from oracles import skew
from twistax.expr import Constant, Expr, leaves_of
from twistax.jax_inside import all_equations

PAGE = (Path(__file__).parents[2] / "docs" / "coscrews.md").read_text()


def leaves_and_helpers() -> dict[str, Any]:
    """What the page's Python block defines."""
    names: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(block, names)
    return names


NAMES = leaves_and_helpers()
#: function -> (the expression as the page writes it, multiplications or "")
ROWS = {
    match[0]: (match[1], match[2]) for match in re.findall(r"^\| `(ksl_\w+)` \|.*\| `(.+?)` \| (\d*) ?\|$", PAGE, re.M)
}
EXPRS: dict[str, Expr] = {name: eval(code, NAMES) for name, (code, _) in ROWS.items()}

# ---- what KSL computes, written out ------------------------------------------------------------------------------

Oracle = Callable[[SimpleNamespace], np.ndarray]
I3, O3 = np.eye(3), np.zeros((3, 3))
AXES = dict(zip("xyz", range(3), strict=True))


def Ad(R: np.ndarray, r: np.ndarray) -> np.ndarray:
    return np.block([[R, skew(r) @ R], [O3, R]])


def co_Ad(R: np.ndarray, r: np.ndarray) -> np.ndarray:
    return np.block([[R, O3], [skew(r) @ R, R]])


def ad_dual(s: np.ndarray) -> np.ndarray:
    v, w = s[:3], s[3:]
    return np.block([[skew(w), O3], [skew(v), skew(w)]])


def size(first: np.ndarray, second: np.ndarray) -> Any:
    """The length of the first vector; of the second where the first is zero."""
    return np.sqrt(first @ first) if np.max(np.abs(first)) > 1e-9 else np.sqrt(second @ second)


def vector_operations(one: str, kind: str) -> dict[str, Oracle]:
    """What KSL has for both kinds: `one` is s or c, `kind` screw or coscrew."""
    of = lambda n, i="": getattr(n, f"{one}{i}")  # noqa: E731

    def norm(n: SimpleNamespace) -> Any:
        halves = of(n)[:3], of(n)[3:]
        return size(*halves) if kind == "coscrew" else size(*halves[::-1])

    return {
        f"ksl_{kind}": lambda n: np.array([n.m0, n.m1, n.m2, n.m3, n.m4, n.m5]),
        f"ksl_{kind}_alloc": lambda n: np.zeros((3, 6)),
        f"ksl_{kind}_copy": lambda n: of(n),
        f"ksl_{kind}_norm": norm,
        f"ksl_{kind}_normalize": lambda n: of(n) / norm(n),
        f"ksl_{kind}_scale": lambda n: of(n) * n.a,
        f"ksl_product_a{one}": lambda n: np.diag([n.a] * 6) @ of(n),
        f"ksl_{kind}_invert": lambda n: -np.eye(6) @ of(n),
        f"ksl_{kind}_inverted": lambda n: -np.eye(6) @ of(n),
        f"ksl_axpy_{one}{one}": lambda n: np.array([n.a * of(n, 1)[i] + of(n, 2)[i] for i in range(6)]),
        f"ksl_xpy_{one}{one}": lambda n: np.array([of(n, 1)[i] + of(n, 2)[i] for i in range(6)]),
        f"ksl_nxpy_{one}{one}": lambda n: np.array([of(n, 2)[i] - of(n, 1)[i] for i in range(6)]),
        f"ksl_add_{one}{one}": lambda n: np.array([of(n, 1)[i] + of(n, 2)[i] for i in range(6)]),
        f"ksl_subtract_{one}{one}": lambda n: np.array([of(n, 1)[i] - of(n, 2)[i] for i in range(6)]),
        f"ksl_add_{one}{one}t": lambda n: of(n, 1) + np.diag([1.0] * 3 + [0.0] * 3) @ of(n, 2),
    }


def columns(prefix: str, matrix: Callable[..., np.ndarray]) -> dict[str, Oracle]:
    """The columns of a change of frame, and the negative ones: translations t first, rotations r below."""
    return {
        f"ksl_{prefix}{kind}{axis}{end}": lambda n, i=first + i, sign=sign: sign * matrix(n.T[:3, :3], n.T[:3, 3])[:, i]
        for kind, first in (("t", 0), ("r", 3))
        for axis, i in AXES.items()
        for end, sign in (("", 1.0), ("inv", -1.0))
    }


def changes_of_frame(name: str, one: str, matrix: Callable[..., np.ndarray]) -> dict[str, Oracle]:
    """Rotations, translations and both: of the vector, of its negative, and by the inverse transform."""
    parts: dict[str, Callable[[SimpleNamespace], tuple[np.ndarray, np.ndarray]]] = {
        "r": lambda n: (n.R, np.zeros(3)),
        "t": lambda n: (I3, n.p),
        "": lambda n: (n.T[:3, :3], n.T[:3, 3]),
    }
    found: dict[str, Oracle] = {}
    for kind, of in parts.items():
        found[f"ksl_product_{name}{kind}{one}"] = lambda n, of=of: matrix(*of(n)) @ getattr(n, one)
        found[f"ksl_product_{name}{kind}{one}inv"] = lambda n, of=of: matrix(*of(n)) @ -getattr(n, one)
        found[f"ksl_product_{name}{kind}inv{one}"] = lambda n, of=of: (
            matrix(of(n)[0].T, -of(n)[0].T @ of(n)[1]) @ getattr(n, one)
        )
    return found


CASES: dict[str, Oracle] = {
    **vector_operations("s", "screw"),
    **vector_operations("c", "coscrew"),
    **columns("hs", Ad),
    **columns("hc", co_Ad),
    **changes_of_frame("Ad", "s", Ad),
    **changes_of_frame("CoAd", "c", co_Ad),
    "ksl_screw_normalized": lambda n: n.s / size(n.s[3:], n.s[:3]),
    "ksl_dot_cs": lambda n: n.c[:3] @ n.s[:3] + n.c[3:] @ n.s[3:],
    "ksl_product_ca": lambda n: n.a * n.c,
    "ksl_cross_ss": lambda n: -ad_dual(n.s1).T @ n.s2,
    "ksl_cross_sst": lambda n: np.r_[np.cross(n.s1[3:], n.s2[:3]), np.zeros(3)],
    "ksl_cross_sc": lambda n: ad_dual(n.s) @ n.c,
    "ksl_cross_sca": lambda n: np.r_[np.zeros(3), np.cross(n.s[3:], n.c[3:])],
    "ksl_cross_cc": lambda n: ad_dual(n.c1) @ n.c2,
}

# ---- values ------------------------------------------------------------------------------------------------------

SAMPLES = 6
LEAVES = {leaf.name: leaf for leaf in leaves_of(*EXPRS.values()) if not isinstance(leaf, Constant)}


def samples() -> dict[str, np.ndarray]:
    """Random values of every leaf; the last sample has a screw without rotation and a coscrew without force."""
    rng = np.random.default_rng(5)
    values = {name: rng.normal(size=(SAMPLES, *leaf.shape)) for name, leaf in sorted(LEAVES.items())}
    turns = Rotation.random(2 * SAMPLES, rng=rng).as_matrix()
    values["R"], values["T"] = turns[:SAMPLES], np.tile(np.eye(4), (SAMPLES, 1, 1))
    values["T"][:, :3, :3], values["T"][:, :3, 3] = turns[SAMPLES:], rng.normal(size=(SAMPLES, 3))
    values["s"][-1, 3:] = values["c"][-1, :3] = 0.0
    return values


VALUES = samples()
NAMED = {name: (expr, expr.canonicalize()) for name, expr in EXPRS.items()}
COMPUTED = jax.jit(
    jax.vmap(function_of(*(expr for pair in NAMED.values() for expr in pair)), axis_size=SAMPLES),
    compiler_options={"xla_backend_optimization_level": 0},
)


@pytest.fixture(scope="module", params=[np.float64, np.float32], ids=["float64", "float32"])
def computed(request: pytest.FixtureRequest) -> tuple[Any, dict[str, list[jax.Array]]]:
    """Every row as written and as canonicalized, in one compiled call for each precision."""
    found = iter(COMPUTED({name: value.astype(request.param) for name, value in VALUES.items()}))
    return request.param, {name: [next(found), next(found)] for name in NAMED}


def test_the_page_and_the_cases_are_the_same() -> None:
    """Every row has a case and every case a row; no function stands in the page twice or without being read."""
    named = re.findall(r"^\| `(ksl_\w+)`", PAGE, re.M)
    assert sorted(named) == sorted(ROWS)
    assert set(ROWS) == set(CASES)
    assert len(ROWS) == 80


@pytest.mark.parametrize("name", CASES)
def test_row(name: str, computed: tuple[Any, dict[str, list[jax.Array]]]) -> None:
    """The page's expression is KSL's function, in both precisions, before and after canonicalize."""
    dtype, rows = computed
    tolerance = 1e-13 if dtype == np.float64 else 4e-6
    wanted = np.stack([CASES[name](SimpleNamespace(**{k: v[i] for k, v in VALUES.items()})) for i in range(SAMPLES)])
    for found in rows[name]:
        assert found.dtype == dtype
        scale = max(1.0, float(np.max(np.abs(wanted))))
        np.testing.assert_allclose(np.asarray(found, np.float64), wanted, rtol=0.0, atol=tolerance * scale)


# ---- cost --------------------------------------------------------------------------------------------------------


def lowered(expr: Expr) -> list[Any]:
    """The equations of an expression over its own leaves."""
    names = {leaf.name: leaf.shape for leaf in leaves_of(expr) if not isinstance(leaf, Constant)}
    return [*all_equations(jax.make_jaxpr(function_of(expr))({n: jnp.ones(s) for n, s in names.items()}).jaxpr)]


def multiplications(found: list[Any]) -> int:
    """Products of two numbers."""
    assert not {"dot_general", "integer_pow", "pow", "div"} & {str(e.primitive) for e in found}
    return sum(int(np.prod(e.outvars[0].aval.shape)) for e in found if str(e.primitive) == "mul")


@pytest.mark.parametrize("name", [name for name, (_, count) in ROWS.items() if count])
def test_cost(name: str) -> None:
    """So many multiplications as the page says, and no 6x6 or 4x4 array."""
    found = lowered(NAMED[name][1])
    assert multiplications(found) == int(ROWS[name][1])
    assert not {(6, 6), (4, 4)} & {tuple(out.aval.shape) for e in found for out in e.outvars}


def test_most_rows_say_what_they_cost() -> None:
    assert sorted({int(count) for _, count in ROWS.values() if count}) == [0, 6, 18, 24]
    assert {name for name, (_, count) in ROWS.items() if not count} == {
        "ksl_screw_alloc", "ksl_screw_norm", "ksl_screw_normalize", "ksl_screw_normalized",
        "ksl_coscrew_alloc", "ksl_coscrew_norm", "ksl_coscrew_normalize",
    }  # fmt: skip


@pytest.mark.parametrize("order", [tx.LINEAR_FIRST, tx.ANGULAR_FIRST], ids=str)
@pytest.mark.parametrize("matrix", [tx.lie.SE3Adjoint, tx.lie.SE3AdjointDual])
def test_cost_in_both_orders(matrix: Any, order: tx.Order) -> None:
    """Also where the pose is a constant, whose 6x6 matrix would be one too."""
    T, R, p, s = (NAMES[name] for name in "TRps")
    translation, rotation = tx.lie.translation(p), tx.lie.rotation(R)
    fixed = ((tx.lie.translation([1.0, -2.0, 3.0]), 6), (tx.lie.rotation(VALUES["R"][0]), 18), (VALUES["T"][0], 24))
    for pose, count in ((translation, 6), (rotation, 18), (T, 24), *fixed):
        for moved in (pose, tx.lie.Inverse(pose)):
            found = lowered((matrix(moved, order=order) @ -s).canonicalize())
            assert multiplications(found) == count
            assert not {(6, 6), (4, 4)} & {tuple(out.aval.shape) for e in found for out in e.outvars}


# ---- the numbers of KSL's own tests ------------------------------------------------------------------------------

TURN = [
    [5.72061402818e-01, -4.15626937777e-01, 7.07106781187e-01, 1.0],
    [7.89312333511e-01, 4.45650105751e-02, -6.12372435696e-01, 2.0],
    [2.23006259046e-01, 9.08442738111e-01, 3.53553390593e-01, 3.0],
    [0.0, 0.0, 0.0, 1.0],
]
MOVED = [1.78557266932e01, 4.84402080578, -6.09911153921, 4.45275160950, -2.94160227256e-01, 7.55555907030]
BACK = [4.69033831505e-01, 3.60988863525, 7.39923721109, 7.57284483310, 4.01097373043, 1.88788528983]
UP, SWAPPED = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [4.0, 5.0, 6.0, 1.0, 2.0, 3.0]
#: function -> (values of the leaves, result). Source: check_screw.c and check_coscrew.c of KSL.
PUBLISHED = {
    "ksl_product_Ads": ({"T": TURN, "s": UP}, MOVED),
    "ksl_product_Adsinv": ({"T": TURN, "s": UP}, np.negative(MOVED)),
    "ksl_product_Adinvs": ({"T": TURN, "s": UP}, BACK),
    "ksl_product_Adtsinv": ({"p": UP[:3], "s": UP}, [2.0, -8.0, 0.0, -4.0, -5.0, -6.0]),
    "ksl_product_CoAdc": ({"T": TURN, "c": SWAPPED}, np.roll(MOVED, 3)),
    "ksl_product_CoAdcinv": ({"T": TURN, "c": SWAPPED}, -np.roll(MOVED, 3)),
    "ksl_product_CoAdinvc": ({"T": TURN, "c": SWAPPED}, np.roll(BACK, 3)),
    "ksl_product_CoAdtcinv": ({"p": UP[:3], "c": SWAPPED}, [-4.0, -5.0, -6.0, 2.0, -8.0, 0.0]),
    "ksl_cross_sc": ({"s": SWAPPED, "c": UP[2::-1] + UP[:2:-1]}, [-4.0, 8.0, -4.0, -14.0, 28.0, -14.0]),
    "ksl_cross_sca": ({"s": SWAPPED, "c": [0.0] * 3 + UP[:2:-1]}, [0.0, 0.0, 0.0, -7.0, 14.0, -7.0]),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_numbers(name: str) -> None:
    """KSL's tests give these results to 1e-9, and so do the matrices written out."""
    values, wanted = PUBLISHED[name]
    arrays = {key: np.array(value) for key, value in values.items()}
    (found,) = function_of(NAMED[name][1])({key: jnp.asarray(value) for key, value in arrays.items()})
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(CASES[name](SimpleNamespace(**arrays)), wanted, rtol=0.0, atol=1e-9)
