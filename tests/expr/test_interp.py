"""Tables over any axes against SciPy and exact polynomials, on every path; and how their cost grows."""

import functools
import itertools
import pickle
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import interpolate

import twistax as tx
from twistax.errors import ModelError

BSpline, Linear, MonotoneCubic = tx.tables.BSpline, tx.tables.Linear, tx.tables.MonotoneCubic
Clamped, Extrapolated, Refused = tx.tables.Clamped, tx.tables.Extrapolated, tx.tables.Refused

RNG = np.random.default_rng(3)
x = tx.State("x", (3,))
EVEN, UNEVEN = np.linspace(-1.0, 1.0, 7), np.array([-1.0, -0.9, -0.2, 0.1, 0.3, 0.8, 1.0])
AXES = {"even": (EVEN, EVEN[::2], EVEN[:5]), "uneven": (UNEVEN, UNEVEN[1:6], UNEVEN[[0, 2, 3, 6]])}
POINTS = np.concatenate([RNG.uniform(-1.3, 1.3, (40, 3)), [[-1.0, -1.0, -1.0], [1.0, 0.8, 1.0], [0.1, 0.1, 0.1]]])


def values(*lengths: int) -> np.ndarray:
    return np.random.default_rng(len(lengths)).normal(size=lengths)


@functools.cache
def tables() -> dict[str, tuple[tx.Expr, Any]]:
    """Expressions of x, each with its values at POINTS by SciPy."""
    found: dict[str, tuple[tx.Expr, Any]] = {}
    for (name, axes), d in itertools.product(AXES.items(), (1, 2, 3)):
        own, table = axes[:d], values(*map(len, axes[:d]))
        inside = np.stack([np.clip(POINTS[:, k], own[k][0], own[k][-1]) for k in range(d)], 1)
        grid = interpolate.RegularGridInterpolator(own, table, bounds_error=False, fill_value=None)
        at = [x[k] for k in range(d)]
        found[f"linear {name} {d}"] = tx.Interp(at, axes=own, values=table), grid(inside)
        beyond = tx.Interp(*at, axes=own, values=table, outside=[Extrapolated()] * d)
        found[f"linear beyond {name} {d}"] = beyond, grid(POINTS[:, :d])
        smooth = tx.Interp(at, axes=own, values=table, kind=BSpline(), outside=Extrapolated())
        found[f"spline {name} {d}"] = smooth, [_product(own, table, point) for point in POINTS]
    monotone = interpolate.PchipInterpolator(UNEVEN, values(7, 2), extrapolate=False)
    node = tx.Interp(x[:2], axes=UNEVEN, values=values(7, 2), kind=MonotoneCubic(), outside=Refused())
    found["monotone"] = node, monotone(POINTS[:, :2])
    lines = interpolate.interp1d(EVEN, values(7, 2, 3), axis=0)(np.clip(POINTS[:, 0], -1.0, 1.0))
    found["of matrices"] = tx.Interp(x[0], axes=[EVEN], values=values(7, 2, 3)), lines
    return found


def _product(axes: Any, table: np.ndarray, point: np.ndarray) -> np.ndarray:
    for points, coordinate in zip(axes, point, strict=False):
        table = interpolate.make_interp_spline(points, table)(coordinate)
    return table


@pytest.mark.parametrize("backend", [tx.JAX(), tx.XLA(), tx.Native()], ids=str)
def test_values_against_scipy(backend: Any) -> None:
    outputs = {name: expr for name, (expr, _) in tables().items()}
    dynamics = tx.compile(tx.System(rates={x: 0.0 * x}, outputs=outputs), backend=backend)
    found = jax.jit(jax.vmap(lambda x: dynamics.outputs(0.0, {"x": x})))(POINTS)
    for name, (_, expected) in tables().items():
        np.testing.assert_allclose(found[name], expected, rtol=1e-12, atol=1e-12, err_msg=name)


def test_a_spline_of_several_axes_is_exact_for_cubics() -> None:
    axes = AXES["uneven"]

    def exact(a: Any, b: Any, c: Any) -> Any:
        return (a**3 - 2.0 * a) * (1.0 + b - b**3) * (c**3 + 0.5 * c**2)

    table = exact(*np.meshgrid(*axes, indexing="ij"))
    smooth = tx.Interp([x[k] for k in range(3)], axes=axes, values=table, kind=BSpline(), outside=Extrapolated())
    value, at = tx.lower(smooth), jnp.asarray(POINTS[0])

    @jax.jit
    def both(z: jax.Array) -> list[jax.Array]:
        own = [lambda z: value(0.0, {"x": z}), lambda z: exact(*z)]
        return [jnp.concatenate([f(z)[None], jax.grad(f)(z), jax.hessian(f)(z).ravel()]) for f in own]

    found, expected = both(at)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_kinks_and_edges_have_the_slopes_that_are_said() -> None:
    s = tx.State("s")

    def slope(at: float, **how: Any) -> float:
        value = tx.lower(tx.Interp(s, axes=[0.0, 1.0, 2.0], values=[0.0, 1.0, 5.0], **how))
        return float(jax.grad(lambda z: value(0.0, {"s": z}))(at))

    assert [slope(at) for at in (-0.1, 0.0, 0.5, 1.0, 2.0, 2.1)] == [0.0, 0.5, 1.0, 4.0, 2.0, 0.0]
    assert [slope(at, outside=Refused()) for at in (0.0, 2.0)] == [1.0, 4.0]
    assert np.isnan([slope(at, outside=Refused()) for at in (-0.1, 2.1, np.nan)]).all()
    assert [slope(at, outside=Extrapolated()) for at in (-0.1, 0.0, 1.0, 2.1)] == [1.0, 1.0, 4.0, 4.0]
    assert np.isnan(tx.lower(tx.Interp(s, axes=[0.0, 1.0], values=[0.0, 1.0], outside=Refused()))(0.0, {"s": 1.1}))


def test_tables_that_are_parameters_give_what_tables_of_numbers_give() -> None:
    names = {"p": UNEVEN, "q": EVEN, "line": values(7), "plane": values(7, 7)}
    p, q, line, plane = (tx.Parameter(name, value=own) for name, own in names.items())
    pairs = [
        (tx.Linterp(x, p, line), tx.Linterp(x, UNEVEN, values(7))),
        (tx.Linterp(x, UNEVEN, plane), tx.Linterp(x, UNEVEN, values(7, 7))),
        (tx.Bilerp(x, x[::-1], p, q, plane), tx.Bilerp(x, x[::-1], UNEVEN, EVEN, values(7, 7))),
    ]
    for changing, fixed in pairs:
        for point in POINTS[[0, 1, -2, -1]]:
            at = {"x": jnp.asarray(point)}
            found = tx.lower(changing)(0.0, at)
            np.testing.assert_allclose(found, tx.lower(fixed)(0.0, at), rtol=1e-13, atol=1e-14)


def test_tables_travel_by_pickle_also_after_they_were_read() -> None:
    for expr, at in ((e, {"x": jnp.asarray(POINTS[0])}) for e, _ in list(tables().values())[:3]):
        value = tx.lower(expr)(0.0, at)
        again = pickle.loads(pickle.dumps(expr))
        assert again.key() == expr.key()
        np.testing.assert_array_equal(tx.lower(again)(0.0, at), value)
    line = tx.Linterp(x[0], EVEN, values(7))
    tx.lower(line)(0.0, {"x": jnp.asarray(POINTS[0])})
    assert pickle.loads(pickle.dumps(line)).key() == line.key()


def test_equal_tables_are_one() -> None:
    node = functools.partial(tx.Interp, x[0], axes=EVEN, values=values(7))
    assert node().key() == node().key() == node(kind=Linear(), outside=Clamped()).key()
    others = [node(kind=BSpline()), node(outside=Refused()), tx.Interp(x[0], axes=EVEN, values=2.0 * values(7))]
    assert len({node().key(), *(other.key() for other in others)}) == 4
    assert repr(node(kind=BSpline())) == "Interp(x[0], 7 points, kind=BSpline())"


@pytest.mark.parametrize("far", [[0.0, 1e308, -1e308, 0.0], [0.0, 1.7e308, 1.7e308, 0.0]])
def test_differences_beyond_all_numbers_are_refused(far: list[float]) -> None:
    with pytest.raises(ModelError, match="differences and slopes are finite"):
        tx.lower(tx.Interp(x[0], axes=np.arange(4.0), values=far, kind=MonotoneCubic()))
