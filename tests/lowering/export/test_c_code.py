"""C code of whole systems: compiled without a warning, run, and compared with the dynamics by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from export_systems import (
    COMPILERS,
    MASS,
    STRICT,
    STRICTER,
    TABLE_POINTS,
    Library,
    body,
    flat,
    needs_compiler,
    point,
    run,
    tables,
)
from scipy.interpolate import CubicSpline, RegularGridInterpolator

import twistax as tx
from twistax.mechanics import ConvexPolytope, signed_distance
from twistax.view import Box, Capsule, Cylinder, Sphere


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the code of the body, in double precision."""
    folder = tmp_path_factory.mktemp("c") / "made" / "for it"
    body().to_c(folder, name="body", points=[point(1), point(2)])
    return folder


@pytest.fixture(scope="module")
def expected() -> dict[str, dict[str, jax.Array]]:
    """All functions of the body at a point, by name and in arrays, as JAX has them."""
    dynamics, (t, x, u, params) = body(), point(5)

    def moved(x: Any, u: Any) -> jax.Array:
        rates = dynamics.functions.as_written("rates", jnp.asarray(t), x, u, params)
        return jnp.concatenate([rates["g"], rates["V"]])

    def by_x(d: jax.Array) -> jax.Array:
        return moved({"g": x["g"] @ tx.lie.se3.exp(d[:6]), "V": x["V"] + d[6:]}, u)

    def by_u(d: jax.Array) -> jax.Array:
        return moved(x, {"wrench": u["wrench"] + d[:6], "b.rake": u["b.rake"] + d[6]})

    def everything(x: Any, u: Any, params: Any) -> Any:
        families = ("rates", "outputs", "constraints")
        found = {family: dynamics.functions.as_written(family, jnp.asarray(t), x, u, params) for family in families}
        return found | {"jacobian": {"x": jax.jacfwd(by_x)(jnp.zeros(12)), "u": jax.jacfwd(by_u)(jnp.zeros(7))}}

    x, u, params = jax.tree.map(jnp.asarray, (x, u, params))
    return jax.jit(everything, compiler_options={"xla_backend_optimization_level": 0})(x, u, params)


@needs_compiler
@pytest.mark.parametrize("compiler", COMPILERS)
def test_functions_give_what_the_dynamics_give(
    written: Path, expected: dict[str, dict[str, jax.Array]], compiler: str
) -> None:
    library, given = Library(written / "body.c", compiler=compiler), flat(point(5))
    results = {
        "rates": {"g": (6,), "V": (6,)},
        "outputs": {"turn": (3, 3), "speed": ()},
        "constraints": {"inequality": (6,), "equality": (1,)},
        "jacobian": {"x": (12, 12), "u": (12, 7)},
    }
    for function, shapes in results.items():
        found = library.call(f"body_{function}", given, list(shapes.values()))
        for name, own in zip(shapes, found, strict=True):
            message = f"{function} {name}"
            np.testing.assert_allclose(own, expected[function][name], rtol=1e-12, atol=1e-13, err_msg=message)


def test_the_header_names_arrays_in_their_order(written: Path) -> None:
    prototype = (written / "body.h").read_text().partition("void body_rates(")[2].partition(");")[0]
    names = [part.split()[-1].lstrip("*") for part in prototype.split(",")]
    assert names == ["t", "x_g", "x_V", "u_wrench", "u_b_rake", "p_M", "p_gain", "rate_g", "rate_V"]


@needs_compiler
def test_long_tables(tmp_path: Path) -> None:
    """Between, at and beyond a hundred breakpoints, and at what is no number."""
    x, knots = tx.State("x"), np.linspace(0.0, 10.0, 100) ** 1.5
    files = tx.compile(tx.System(rates={x: tx.Linterp(x, knots, np.sin(knots))})).to_c(tmp_path, jacobian=())
    library = Library(files.source)
    points = np.array([*knots[:3], knots[-1], -1.0, 99.0, 3.3, 17.2, np.inf, -np.inf, np.nan])
    found = [library.call("dynamics_rates", [0.0, np.array([p])], [()])[0] for p in points]
    np.testing.assert_allclose(found, np.interp(points, knots, np.sin(knots)), rtol=1e-12, atol=1e-13)


@needs_compiler
def test_tables_of_other_kinds(tmp_path: Path) -> None:
    """A cubic one, one over two axes, and the shortest one."""
    x, y, knots, lines = tx.State("x"), tx.State("y"), np.array([0.0, 1.0, 2.5, 4.0]), np.array([0.0, 2.0])
    values = np.arange(8.0).reshape(4, 2) ** 1.5
    rates = {
        x: tx.Cinterp(x, knots, np.sin(knots)),
        y: tx.Bilerp(x, y, knots, lines, values) + tx.Linterp(x, lines, lines),
    }
    files = tx.compile(tx.System(rates=rates)).to_c(tmp_path, jacobian=())
    library = Library(files.source)
    cubic, plane = CubicSpline(knots, np.sin(knots)), RegularGridInterpolator((knots, lines), values)
    for a, b in [(0.0, 0.0), (0.3, 1.9), (1.0, 2.0), (2.0, 0.5), (3.9, 1.0), (4.0, 2.0)]:
        found = library.call("dynamics_rates", [0.0, np.array([a]), np.array([b])], [(), ()])
        np.testing.assert_allclose(found, [cubic(a), plane((a, b)) + min(a, 2.0)], rtol=1e-12, atol=1e-13)


@needs_compiler
def test_tables_of_vectors_and_in_maps(tmp_path: Path) -> None:
    """Values by plain interpolation; the Jacobian beside that of JAX on arrays."""
    own, (x, M) = tables(), (tx.State("x", shape=(3,)), tx.State("M", shape=(3, 2)))
    rates = {x: tx.linalg.Sum(tx.Concat(*[tx.linalg.Sum(e) for e, _ in own.values()])) * np.ones(3), M: 0.0 * M}
    outputs = {f"o{k}": e for k, (e, _) in enumerate(own.values())}
    dynamics = tx.compile(tx.System(rates, outputs))
    library = Library(dynamics.to_c(tmp_path, jacobian=("x",)).source)
    fp = dynamics.parameters[0].value
    for at in TABLE_POINTS:
        expected = [value(*at) for _, value in own.values()]
        found = library.call("dynamics_outputs", [0.0, *at, fp], [np.shape(value) for value in expected])
        for name, a, b in zip(own, found, expected, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13, err_msg=name)
        (jacobian,) = library.call("dynamics_jacobian", [0.0, *at, fp], [(9, 9)])
        arrays = tx.compile(tx.System(rates), backend=tx.JAX()).jacobian(0.0, {"x": at[0], "M": at[1]})
        np.testing.assert_allclose(jacobian, arrays["x"], rtol=1e-12, atol=1e-13)


@needs_compiler
def test_the_test_main_passes_and_sees_an_error(written: Path) -> None:
    test, source = written / "body_test.c", written / "body.c"
    command = [COMPILERS[0], *STRICT, *STRICTER, "-O1", "-I", str(written)]
    done = run([*command, str(source), str(test), "-lm", "-o", str(written / "good")])
    assert done.returncode == 0, done.stderr
    good = run([str(written / "good")])
    assert good.returncode == 0, good.stdout
    assert "all agree" in good.stdout

    head, mark, tail = source.read_text().rpartition("rate_V[5] = ")
    wrong = written / "wrong.c"
    wrong.write_text(f"{head}{mark}0.5 + {tail}")
    assert run([*command, str(wrong), str(test), "-lm", "-o", str(written / "bad")]).returncode == 0
    bad = run([str(written / "bad")])
    assert bad.returncode == 1
    assert "WRONG" in bad.stdout


@needs_compiler
def test_single_precision(tmp_path: Path, expected: dict[str, dict[str, jax.Array]]) -> None:
    files = body().to_c(tmp_path, name="single", dtype=np.float32, jacobian=(), points=[point(1)])
    assert "double" not in files.header.read_text() + files.source.read_text()
    found = Library(files.source, np.float32).call("single_rates", flat(point(5)), [(6,), (6,)])
    for name, own in zip(("g", "V"), found, strict=True):
        np.testing.assert_allclose(own, expected["rates"][name], rtol=1e-5, atol=1e-6)
    command = [COMPILERS[0], *STRICT, *STRICTER, str(files.source), str(files.test), "-lm", "-o", str(tmp_path / "run")]
    assert run(command).returncode == 0
    assert run([str(tmp_path / "run")]).returncode == 0


@needs_compiler
def test_double_code_without_the_x64_switch(tmp_path: Path) -> None:
    x, third = tx.State("x"), 1.0 / 3.0
    with jax.enable_x64(False):
        files = tx.compile(tx.System(rates={x: third * x})).to_c(tmp_path)
    assert third.hex() in files.source.read_text()
    assert Library(files.source).call("dynamics_rates", [0.0, np.ones(1)], [()])[0] == third


@needs_compiler
def test_parameters_own_values_and_names(tmp_path: Path) -> None:
    x, y, u = tx.State("double", shape=(2,)), tx.State("1 st.?*/"), tx.Control("ω")
    p, time = tx.Parameter("p", value=[0.1, np.pi]), tx.Time()
    system = tx.System(rates={x: p * y * u, y: tx.Sin(x[0]) * time})
    files = tx.compile(system).to_c(tmp_path, jacobian=("params",))
    library = Library(files.source)
    values = np.ctypeslib.as_array((np.ctypeslib.ctypes.c_double * 2).in_dll(library.library, "dynamics_default_p_p"))
    assert values.tolist() == [0.1, np.pi]
    found = library.call("dynamics_rates", [2.0, [0.3, 0.0], 2.0, 3.0, [1.0, 2.0]], [(2,), ()])
    np.testing.assert_allclose(found[0], [6.0, 12.0])
    np.testing.assert_allclose(found[1], 2.0 * np.sin(0.3), rtol=1e-15)
    text = files.header.read_text()
    assert "x_double" in text
    assert "x_1_st___" in text
    assert "u_u03c9" in text


@needs_compiler
def test_headers_of_names_that_differ_in_case_only(tmp_path: Path) -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: -x}))
    one, other = (dynamics.to_c(tmp_path / name, name=name, jacobian=()) for name in ("body", "Body"))
    main = tmp_path / "main.c"
    main.write_text(
        f'#include "{one.header}"\n#include "{other.header}"\nint main(void) {{ return body_rates == Body_rates; }}\n'
    )
    command = [COMPILERS[0], *STRICT, str(main), str(one.source), str(other.source), "-o", str(tmp_path / "main")]
    done = run(command)
    assert done.returncode == 0, done.stderr


@needs_compiler
def test_results_beyond_single_precision_do_not_hide_errors(tmp_path: Path) -> None:
    """A value that is infinite in single precision is no measure of what is allowed elsewhere."""
    x = tx.State("x", shape=(2,))
    system = tx.System(rates={x: x * x})
    files = tx.compile(system).to_c(tmp_path, dtype=np.float32, jacobian=(), points=[(0.0, {"x": [1e30, 2.0]})])
    files.source.write_text(files.source.read_text().replace("rate_x[1] = ", "rate_x[1] = 1.0f + "))
    command = [COMPILERS[0], *STRICT, str(files.source), str(files.test), "-lm", "-o", str(tmp_path / "run")]
    assert run(command).returncode == 0
    assert run([str(tmp_path / "run")]).returncode == 1


def test_names_that_become_one_are_refused(tmp_path: Path) -> None:
    x, y = tx.State("a.b"), tx.State("a b")
    with pytest.raises(tx.ModelError, match=r"'a\.b' and 'a b' would both have the name x_a_b"):
        tx.compile(tx.System(rates={x: y, y: x})).to_c(tmp_path)


@needs_compiler
def test_loops_of_unknown_length(tmp_path: Path) -> None:
    """One in another, with counts, a table, and zeros that stay; beside loops of Python."""
    s, knots = tx.State("s"), np.arange(300.0)
    square = tx.lower(tx.Linterp(s, knots, knots**2))

    def counted(v: jax.Array) -> jax.Array:
        def outer(state: Any) -> Any:
            k, total, still = state
            halve = lambda s: (s[0] + 1, 0.5 * s[1])  # noqa: E731
            halvings, _ = jax.lax.while_loop(lambda s: s[1] > 1.0, halve, (0, v * k))
            return k + square(0.0, {"s": k}) + 1.0, total + halvings, still @ still

        k, total, still = jax.lax.while_loop(lambda s: s[0] < v, outer, (0.0 * v, 0, jnp.zeros((2, 2))))
        return jnp.stack([k, total.astype(k.dtype), still.sum()])

    v, y = tx.State("v"), tx.State("y", shape=(3,))
    dynamics = tx.compile(tx.System(rates={v: 0.0, y: tx.Function(counted, (3,))(v)}), backend=tx.JAX())
    files = dynamics.to_c(tmp_path, jacobian=(), points=[(0.0, {"v": 7.3, "y": np.zeros(3)})])
    library = Library(files.source)
    for value in (-1.0, 2.0, 7.3, 60.0):
        ks = [0.0]
        while ks[-1] < value:
            ks.append(ks[-1] + ks[-1] ** 2 + 1.0)
        halvings = [max(np.ceil(np.log2(value * k)), 0.0) for k in ks[1:-1]]
        _, counts = library.call("dynamics_rates", [0.0, np.array(value), np.zeros(3)], [(), (3,)])
        np.testing.assert_array_equal(counts, [ks[-1], sum(halvings), 0.0])


@needs_compiler
def test_loops_and_branches_in_each_other(tmp_path: Path) -> None:
    """Entries that swap their places, rows of a scan in reverse, a loop in a branch, and results that nothing reads."""
    weights = jnp.asarray([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])

    def row(carried: Any, row: Any) -> Any:
        a, b, count = carried

        def halved() -> jax.Array:
            return jax.lax.while_loop(lambda s: s > 1.0, lambda s: 0.5 * s, a * row[1])

        new = jax.lax.cond(a > 2.0, halved, lambda: a + row[0])
        return (b, new, count + 1), jnp.stack([a, new])

    def function(v: jax.Array) -> jax.Array:
        def outer(state: Any) -> Any:
            k, a, b, rows, _ = state
            (a, b, _), rows = jax.lax.scan(row, (a, b, 0), weights, reverse=True)
            return k + 1, b, a, rows, a

        start = (0, v, 0.1 * v, jnp.zeros((3, 2)), v)
        _, a, b, rows, _ = jax.lax.while_loop(lambda s: s[0] < 3, outer, start)
        return jnp.concatenate([jnp.stack([a, b]), rows.reshape(-1)])

    v, y = tx.State("v"), tx.State("y", shape=(8,))
    dynamics = tx.compile(tx.System(rates={v: 0.0, y: tx.Function(function, (8,))(v)}), backend=tx.JAX())
    library = Library(dynamics.to_c(tmp_path, jacobian=(), points=[(0.0, {"v": 1.0, "y": np.zeros(8)})]).source)
    for value in (-3.0, 0.7, 2.5, 40.0):
        _, rate = library.call("dynamics_rates", [0.0, np.array(value), np.zeros(8)], [(), (8,)])
        np.testing.assert_allclose(rate, function(jnp.asarray(value)), rtol=1e-14)


HULL = ConvexPolytope(np.random.default_rng(0).normal(0.0, 0.3, (8, 3)))


@needs_compiler
@pytest.mark.parametrize(
    ("other", "dtype"),
    [
        (Capsule(0.1, 0.6), np.float64),
        *(
            pytest.param(other, dtype, marks=pytest.mark.slow)
            for other in (Box((0.3, 0.4, 0.5)), Cylinder(0.3, 0.5), HULL, Sphere(0.1))
            for dtype in (np.float64, np.float32)
        ),
    ],
)
def test_distances(other: Any, dtype: Any, tmp_path: Path) -> None:
    """The search for the nearest features is a function, which values and derivatives call."""
    T, V, rng = tx.State("T", group=tx.SE3), tx.Control("V", shape=(6,)), np.random.default_rng(1)
    distance = signed_distance(HULL if isinstance(other, Sphere) else Cylinder(0.2, 0.7), other, T)
    dynamics = tx.compile(tx.System(rates={T: V * distance}, outputs={"d": distance}))
    moves = [np.concatenate([rng.normal(size=3) * size, rng.normal(size=3)]) for size in (0.15, 0.8) * 2]
    points = [(0.0, {"T": np.asarray(tx.SE3.exp(move))}, {"V": np.ones(6)}) for move in moves]
    tolerance = 1e-12 if dtype == np.float64 else 1e-5
    files = dynamics.to_c(tmp_path, jacobian=("x",), dtype=dtype, points=points, tolerance=tolerance)
    assert files.source.read_text().count("static void function_") == 1
    program = str(tmp_path / "test")
    built = run([COMPILERS[0], *STRICT, *STRICTER, "-O1", str(files.source), str(files.test), "-lm", "-o", program])
    assert built.returncode == 0, built.stderr
    assert run([program]).returncode == 0


def test_what_has_no_scalars_is_named(tmp_path: Path) -> None:
    x, A = tx.State("x", shape=(13,)), tx.Parameter("A", value=np.eye(13))
    with pytest.raises(tx.ModelError, match=r"the rates call lu, triangular_solve,[\s\S]* up to 12 x 12"):
        tx.compile(tx.System(rates={x: tx.linalg.Solve(A, x)})).to_c(tmp_path)


def test_arguments_that_are_wrong(tmp_path: Path) -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: -x}))
    with pytest.raises(tx.InputError, match="name expects a letter"):
        dynamics.to_c(tmp_path, name="two words")
    with pytest.raises(tx.InputError, match="float64 or float32, got float16"):
        dynamics.to_c(tmp_path, dtype=np.float16)
    with pytest.raises(tx.InputError, match="got 'z'"):
        dynamics.to_c(tmp_path, jacobian=("z",))
    with pytest.raises(tx.InputError, match="a sequence like"):
        dynamics.to_c(tmp_path, jacobian="x")
    with pytest.raises(tx.InputError, match="expects each of"):
        dynamics.to_c(tmp_path, jacobian=("x", "x"))
    with pytest.raises(tx.InputError, match=r"math\.h is a header of C"):
        dynamics.to_c(tmp_path, name="math")
    with pytest.raises(tx.InputError, match="float64 or float32, got 'real'"):
        dynamics.to_c(tmp_path, dtype="real")
    for points in ([(0.0,)], [(0.0, {"x": 1.0}, {}, {}, {})]):
        with pytest.raises(tx.InputError, match=r"points expects tuples \(t, x, u, params\)"):
            dynamics.to_c(tmp_path, points=points)
    with pytest.raises(tx.InputError, match="points expects at least one"):
        dynamics.to_c(tmp_path, points=[])
    for tolerance in (-1.0, np.nan, np.inf):
        with pytest.raises(tx.InputError, match="tolerance must be"):
            dynamics.to_c(tmp_path, tolerance=tolerance)
    assert not list(tmp_path.iterdir())


def test_files_of_others_are_left_alone(tmp_path: Path) -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: -x}))
    first = dynamics.to_c(tmp_path).source.read_text()
    assert dynamics.to_c(tmp_path).source.read_text() == first  # its own are replaced
    (tmp_path / "dynamics.h").write_text("mine")
    with pytest.raises(tx.InputError, match=r"dynamics\.h' exists and was not written by twistax"):
        dynamics.to_c(tmp_path)
    assert (tmp_path / "dynamics.h").read_text() == "mine"
    with pytest.raises(tx.InputError, match="cannot write C code to"):
        dynamics.to_c(tmp_path / "dynamics.h" / "below")


def test_a_solve_is_pivoted(tmp_path: Path) -> None:
    """A matrix whose leading entries are zero."""
    if not COMPILERS:
        pytest.skip("no C compiler")
    A = MASS[::-1].copy()
    x, M = tx.State("x", shape=(6,)), tx.Parameter("A", shape=(6, 6))
    files = tx.compile(tx.System(rates={x: tx.linalg.Solve(M, x)})).to_c(tmp_path, jacobian=("x",))
    given = np.arange(1.0, 7.0)
    library = Library(files.source)
    np.testing.assert_allclose(
        library.call("dynamics_rates", [0.0, given, A], [(6,)])[0], np.linalg.solve(A, given), rtol=1e-12
    )
    np.testing.assert_allclose(
        library.call("dynamics_jacobian", [0.0, given, A], [(6, 6)])[0], np.linalg.inv(A), rtol=1e-11, atol=1e-13
    )
