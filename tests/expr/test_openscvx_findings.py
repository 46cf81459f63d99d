"""What docs/openscvx.md says of OpenSCvx beyond the values of its nodes, each sentence shown by running it.

Skipped where OpenSCvx is not installed. A failure here means that the page is out of date.
"""

import importlib
import importlib.metadata
import os
import re
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from expr_cases import value_of
from openscvx_cases import Nodes, pose_matrix, signed
from openscvx_lowering import is_nightly, openscvx

import twistax as tx

PAGE = (Path(__file__).parents[2] / "docs" / "openscvx.md").read_text()


@pytest.fixture(scope="module")
def ox() -> Nodes:
    return openscvx()


@pytest.fixture(autouse=True)
def lenient() -> Iterator[None]:
    """Their code mixes dtypes and ranks and warns, which this suite forbids."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def evaluate(ox: Nodes, expr: Any, **values: Any) -> np.ndarray:
    """The number an expression of theirs amounts to, its leaves being Parameters."""
    return np.asarray(ox.lower_to_jax(expr)(None, None, 0, {k: jnp.asarray(v, float) for k, v in values.items()}))


def parameter(ox: Nodes, name: str, *shape: int) -> Any:
    return ox.Parameter(name, shape=shape, value=np.zeros(shape))


def skew(v: np.ndarray) -> np.ndarray:
    return np.cross(np.eye(3), v)


# ---- formulas -------------------------------------------------------------------------------------------------


def their_sphere(ox: Nodes, mass: float, inertia: float) -> Callable[[jax.Array], jax.Array]:
    """A free sphere as their docs write it: state (p, q, V), M V' = -AdjointDual(V, M V)."""
    p, q, V = ox.State("p", shape=(3,)), ox.State("q", shape=(4,)), ox.State("V", shape=(6,))
    for leaf, place in ((p, slice(0, 3)), (q, slice(3, 7)), (V, slice(7, 13))):
        leaf._slice = place
    M = np.diag([mass] * 3 + [inertia] * 3)
    rate = ox.Concat(
        ox.spatial.QDCM(q) @ V[:3],
        0.5 * ox.spatial.SSMP(V[3:]) @ q,
        np.linalg.inv(M) @ (-ox.lie.AdjointDual(V, M @ V)),
    )
    lowered = ox.lower_to_jax(rate)
    return lambda x: lowered(x, None, 0, {})


def test_a_free_spinning_sphere_flies_in_a_circle(ox: Nodes) -> None:
    """m = 1 kg, J = 0.1 kg m2, v = 1 m/s across w = 10 rad/s: rate J w / m = 1 rad/s, radius v m / (J w) = 1."""
    rate = their_sphere(ox, mass=1.0, inertia=0.1)
    n = 4000

    @jax.jit
    def fly(x: jax.Array) -> jax.Array:
        h = 2.0 * jnp.pi / n

        def step(x: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
            k1 = rate(x)
            k2 = rate(x + h / 2 * k1)
            k3 = rate(x + h / 2 * k2)
            new = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3))
            return new, new[:3]

        return jax.lax.scan(step, x, None, length=n)[1]

    path = np.asarray(fly(jnp.array([0.0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 10])))
    np.testing.assert_allclose(path[n // 2 - 1], [0.0, 2.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(path[-1], 0.0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(path - [0.0, 1.0, 0.0], axis=1), 1.0, atol=1e-6)


def test_their_coadjoint_is_not_dual_to_the_commutator(ox: Nodes) -> None:
    """<ad*_xi mu, eta> + <mu, [xi, eta]> = 0, the bracket by 4x4 matrices: with a momentum [L; p] it holds."""

    def hat(xi: np.ndarray) -> np.ndarray:
        matrix = np.zeros((4, 4))
        matrix[:3, :3], matrix[:3, 3] = skew(xi[3:]), xi[:3]
        return matrix

    xi, mu, eta = signed(np.random.default_rng(5), (3, 6))
    commutator = hat(xi) @ hat(eta) - hat(eta) @ hat(xi)
    bracket = np.array([*commutator[:3, 3], commutator[2, 1], commutator[0, 2], commutator[1, 0]])
    np.testing.assert_allclose(evaluate(ox, ox.lie.Adjoint(xi, eta)), bracket, rtol=1e-12)
    assert abs(evaluate(ox, ox.lie.AdjointDual(xi, mu)) @ eta + mu @ bracket) > 0.01
    swap = [3, 4, 5, 0, 1, 2]
    mended = evaluate(ox, ox.lie.AdjointDual(xi, mu[swap]))[swap]
    assert abs(mended @ eta + mu @ bracket) < 1e-13


def test_for_linear_first_twists_their_coadjoint_matrix_is_the_adjoint(ox: Nodes) -> None:
    rng = np.random.default_rng(1)
    T, xi, wrench = pose_matrix(rng, ()), signed(rng, (6,)), signed(rng, (6,))
    hat = np.zeros((4, 4))
    hat[:3, :3], hat[:3, 3] = skew(xi[3:]), xi[:3]
    moved = T @ hat @ np.linalg.inv(T)
    expected = np.array([*moved[:3, 3], moved[2, 1], moved[0, 2], moved[1, 0]])
    pose = parameter(ox, "T", 4, 4)
    Ad, dual = (evaluate(ox, node(pose), T=T) for node in (ox.lie.SE3Adjoint, ox.lie.SE3AdjointDual))
    np.testing.assert_allclose(dual @ xi, expected, rtol=1e-12)
    assert np.abs(Ad @ xi - expected).max() > 0.1
    # Ad* = Ad^-T, which maps the way Ad does: power stays as it is only if both go from one frame to the other.
    np.testing.assert_allclose(dual, np.linalg.inv(Ad).T, atol=1e-12)
    np.testing.assert_allclose((dual @ wrench) @ (Ad @ xi), wrench @ xi, rtol=1e-12)
    assert abs((np.linalg.inv(dual) @ wrench) @ (Ad @ xi) - wrench @ xi) > 0.1


def test_the_matrix_of_the_bracket_contradicts_the_bracket(ox: Nodes) -> None:
    xi, eta = signed(np.random.default_rng(2), (2, 6))
    bracket = evaluate(ox, ox.lie.Adjoint(xi, eta))
    v, w = skew(xi[:3]), skew(xi[3:])
    zero = np.zeros((3, 3))
    np.testing.assert_allclose(np.block([[w, v], [zero, w]]) @ eta, bracket, rtol=1e-12)
    assert np.abs(np.block([[w, zero], [v, w]]) @ eta - bracket).max() > 0.1


def test_quaternions_are_scalar_first(ox: Nodes) -> None:
    """A turn of 1 rad about x."""
    R = evaluate(ox, ox.spatial.QDCM(np.array([np.cos(0.5), np.sin(0.5), 0.0, 0.0])))
    np.testing.assert_allclose(R, value_of(tx.lie.SO3Exp(np.array([1.0, 0.0, 0.0]))), atol=1e-12)
    rate = evaluate(ox, ox.spatial.SSMP(np.array([1.0, 2.0, 3.0])))
    np.testing.assert_array_equal(rate @ [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 2.0, 3.0])


def test_huber_is_not_divided_by_delta(ox: Nodes) -> None:
    near, far = evaluate(ox, ox.Huber(np.array([0.1, 2.0]), delta=0.5))
    assert near == pytest.approx(0.5 * 0.1**2)
    assert far == pytest.approx(0.5 * (2.0 - 0.25))


def test_the_exponential_of_a_twist_has_twice_its_derivative_at_zero_angle(ox: Nodes) -> None:
    """d p / d w of Exp([v; w]) at w = 0 is -[v] / 2; jaxlie 1.5.0 gives -[v]."""
    if importlib.metadata.version("jaxlie") != "1.5.0":
        pytest.skip("said of jaxlie 1.5.0")
    v = np.array([1.0, 2.0, 3.0])
    exp = ox.lower_to_jax(ox.lie.SE3Exp(parameter(ox, "xi", 6)))
    here = tx.lower(tx.lie.SE3Exp(tx.Parameter("xi", shape=(6,))))
    xi = jnp.array([*v, 0.0, 0.0, 0.0])
    theirs = jax.jacfwd(lambda xi: exp(None, None, 0, {"xi": xi})[:3, 3])(xi)[:, 3:]
    ours = jax.jacfwd(lambda xi: here(0.0, None, None, {"xi": xi})[:3, 3])(xi)[:, 3:]
    np.testing.assert_allclose(theirs, -skew(v), atol=1e-12)
    np.testing.assert_allclose(ours, -skew(v) / 2.0, atol=1e-12)


# ---- trees ----------------------------------------------------------------------------------------------------


def test_canonicalize_changes_a_log_sum_exp_with_a_constant_vector(ox: Nodes) -> None:
    expr = ox.LogSumExp(parameter(ox, "a", 3), np.array([1.0, 2.0, 3.0]))
    plain, canonical = (evaluate(ox, e, a=np.zeros(3)) for e in (expr, expr.canonicalize()))
    np.testing.assert_allclose(plain, np.log(1.0 + np.exp([1.0, 2.0, 3.0])), rtol=1e-12)
    np.testing.assert_allclose(canonical, np.log(1.0 + np.exp([1.0, 2.0, 3.0]).sum()), rtol=1e-12)


def test_canonicalize_may_lose_the_shape(ox: Nodes) -> None:
    expr = parameter(ox, "s") * np.ones(3)
    assert expr.check_shape() == (3,)
    assert expr.canonicalize().check_shape() == ()
    assert (tx.Parameter("s") * np.ones(3)).canonicalize().check_shape() == (3,)


def test_three_nodes_give_another_shape_than_they_say(ox: Nodes) -> None:
    a, s, cube = parameter(ox, "a", 3), parameter(ox, "s"), parameter(ox, "cube", 2, 3, 4)
    for expr, said, given in (
        (ox.Vstack([a, a]), (6,), (2, 3)),
        (ox.Stack([s, s]), (2,), (2, 1)),
        (cube.T, (2, 4, 3), (4, 3, 2)),
    ):
        assert expr.check_shape() == said
        assert evaluate(ox, expr, a=np.ones(3), s=1.0, cube=np.ones((2, 3, 4))).shape == given


def test_a_matrix_state_is_a_matrix_only_where_it_is_indexed(ox: Nodes) -> None:
    X = ox.State("X", shape=(3, 3))
    X._slice = slice(0, 9)
    numbers = jnp.arange(9.0)
    assert (X @ np.ones(3)).check_shape() == (3,)
    with pytest.raises(TypeError, match="contracting dimensions"):
        ox.lower_to_jax(X @ np.ones(3))(numbers, None, 0, {})
    np.testing.assert_array_equal(ox.lower_to_jax(X[:, :] @ np.ones(3))(numbers, None, 0, {}), [3.0, 12.0, 21.0])


def test_the_gradient_of_a_norm_at_zero_is_nan(ox: Nodes) -> None:
    norm = ox.lower_to_jax(ox.linalg.Norm(parameter(ox, "a", 3)))
    assert np.isnan(jax.grad(lambda a: norm(None, None, 0, {"a": a}))(jnp.zeros(3))).all()


def test_a_chained_comparison_drops_its_first_half(ox: Nodes) -> None:
    a = parameter(ox, "a", 3)
    kept = 0.0 <= a <= 1.0
    assert isinstance(kept, ox.Inequality)
    assert kept.lhs is a  # a <= 1 is left of it
    with pytest.raises(TypeError, match="no truth value"):
        _ = 0.0 <= tx.Parameter("a", shape=(3,)) <= 1.0


def test_what_else_their_expressions_do_not_take(ox: Nodes) -> None:
    a = parameter(ox, "a", 3)
    at_the_top = [hasattr(ox._modules[0], name) for name in ("Square", "PositivePart", "Huber", "SmoothReLU")]
    assert all(at_the_top) if is_nightly() else not any(at_the_top)
    with pytest.raises(TypeError):
        hash(a)
    with pytest.raises(TypeError):
        np.sin(a)
    with pytest.raises(AttributeError):
        ox.Sin(0.5).check_shape()
    with pytest.raises(TypeError):
        ox.All([a == 1.0])
    with pytest.raises(NotImplementedError):
        ox.stl.Eventually(a[0] <= 1.0).over((0, 3))


# ---- problems -------------------------------------------------------------------------------------------------


@pytest.fixture
def restored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A Problem changes settings of the process and writes to a cache."""
    monkeypatch.setenv("OPENSCVX_CACHE_DIR", str(tmp_path))
    logic = importlib.import_module("openscvx.symbolic.lowerers.jax.logic")
    dtype = logic._DEFAULT_FLOAT_DTYPE
    yield
    logic._DEFAULT_FLOAT_DTYPE = dtype
    jax.config.update("jax_enable_x64", True)


def ramp(ox: Nodes, nodes: int, hold: str, **options: Any) -> Any:
    """x' = u over intervals of 1 s, u = 0, 1, 2, ... at the nodes."""
    x = ox.State("x", shape=(1,), min=[-10.0], max=[10.0], initial=[0.0], final=[("free", 1.0)])
    u = ox.Control("u", shape=(1,), min=[-5.0], max=[5.0], parameterization=hold)
    x.guess, u.guess = np.zeros((nodes, 1)), np.arange(nodes, dtype=float)[:, None]
    end = float(nodes - 1)
    time = ox.Time(initial=0.0, final=end, min=0.0, max=end)
    return ox.Problem({"x": 1.0 * u}, states=[x], controls=[u], constraints=[], N=nodes, time=time, **options)


@pytest.mark.usefixtures("restored")
def test_a_problem_sets_the_precision_of_the_process(ox: Nodes) -> None:
    assert jax.config.jax_enable_x64
    ramp(ox, 3, "ZOH")
    assert not jax.config.jax_enable_x64
    ramp(ox, 3, "ZOH", float_dtype="float64")
    assert jax.config.jax_enable_x64
    branch = ox.lower_to_jax(ox.Cond(parameter(ox, "s") <= 0.0, 1.0, 2.0))
    assert branch(None, None, 0, {"s": 1.0}).dtype == np.float64


@pytest.mark.usefixtures("restored")
def test_where_equinox_was_imported_before_no_problem_can_be_initialised(ox: Nodes) -> None:
    """`openscvx()` of this suite imports it first, so that errors of Equinox stay errors in the other tests."""
    with pytest.raises(NotImplementedError, match="host_callbacks"):
        ramp(ox, 3, "FOH", float_dtype="float64").initialize()


def run_alone(program: str, folder: Path) -> list[float]:
    """The numbers that a program in a process of its own prints after the word moved."""
    environment = {k: v for k, v in os.environ.items() if k != "EQX_ON_ERROR"} | {"OPENSCVX_CACHE_DIR": str(folder)}
    command = [sys.executable, "-W", "ignore", "-c", program]
    run = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)
    assert run.returncode == 0, run.stderr
    line = next(line for line in run.stdout.splitlines() if line.startswith("moved"))
    return [float(word) for word in line.split()[1:]]


#: x' = u and y' = w, both 0, 1, 2 at three nodes 1 s apart: how far the discretiser moves x and y in each interval.
HOLDS = """
import os
import numpy as np
import openscvx as ox

assert os.environ["EQX_ON_ERROR"] == "nan"
options = dict(shape=(1,), min=[-10.0], max=[10.0])
x, y = (ox.State(name, initial=[0.0], final=[("free", 1.0)], **options) for name in "xy")
u, w = (ox.Control(name, parameterization=hold, **options) for name, hold in (("u", "FOH"), ("w", "ZOH")))
x.guess = y.guess = np.zeros((3, 1))
u.guess = w.guess = np.array([[0.0], [1.0], [2.0]])
problem = ox.Problem(
    {"x": 1.0 * u, "y": 1.0 * w}, states=[x, y], controls=[u, w], constraints=[], N=3, float_dtype="float64",
    time=ox.Time(initial=0.0, final=2.0, min=0.0, max=2.0),
)
problem.initialize()
solver = getattr(problem, "_discretization_solver", None)
if solver is None:  # the nightly has it where it is used
    solver = problem._discretizer.get_solver(problem._lowered.dynamics, problem.settings)
guess = np.asarray(problem.x_unified.guess), np.asarray(problem.u_unified.guess)
print("moved", *np.ravel(getattr(solver, "call", solver)(*guess, dict(problem.parameters))[3][:, :2].T))
"""


@pytest.mark.usefixtures("ox")
def test_a_first_order_hold_of_n_nodes_was_too_steep_by_n_over_n_minus_1(tmp_path: Path) -> None:
    """Linear between its nodes u moves x by 0.5 and 1.5, which the nightly does; the held w moves y by 0 and 1."""
    found = run_alone(HOLDS, tmp_path)
    moved = [0.5, 1.5, 0.0, 1.0] if is_nightly() else [0.75, 1.75, 0.0, 1.0]
    np.testing.assert_allclose(found, moved, atol=1e-6)


#: The double integrator from rest to rest over 1 m in the least time, abs(u) <= 5 m/s2.
RESTS = """
import numpy as np
import openscvx as ox

x = ox.State("x", shape=(2,), min=[-10.0, -10.0], max=[10.0, 10.0], initial=[0.0, 0.0], final=[1.0, 0.0])
u = ox.Control("u", shape=(1,), min=[-5.0], max=[5.0])
x.guess, u.guess = np.linspace([0.0, 0.0], [1.0, 0.0], 8), np.zeros((8, 1))
problem = ox.Problem(
    {"x": ox.Concat(x[1], 1.0 * u[0])}, states=[x], controls=[u], constraints=[], N=8, float_dtype="float64",
    time=ox.Time(initial=0.0, final=("minimize", 2.0), min=0.0, max=10.0),
)
problem.settings.dev.printing = False
problem.initialize()
result = problem.solve()
print("moved", float(result.converged), result.x[-1, 0], result.x[-1, 2])
"""


@pytest.mark.usefixtures("ox")
def test_converged_is_far_from_optimal(tmp_path: Path) -> None:
    converged, end, seconds = run_alone(RESTS, tmp_path)
    assert (converged, end) == (1.0, pytest.approx(1.0, abs=1e-4))
    assert seconds > 2.0 * (2.0 / np.sqrt(5.0))


def test_two_closures_over_different_functions_have_one_cache_key(ox: Nodes) -> None:
    caching = importlib.import_module("openscvx.utils.caching")

    def rate(f: Callable[[Any], Any]) -> Callable[..., Any]:
        return lambda x, u, node, params: f(x)

    keys = [caching._hash_byof(ox.ByofSpec.model_validate({"dynamics": {"x": rate(f)}})) for f in (jnp.sin, jnp.cos)]
    assert keys[0] == keys[1]


# ---- the model on the page ------------------------------------------------------------------------------------


def test_the_two_models_on_the_page_have_the_same_rates_but_for_the_coadjoint(ox: Nodes) -> None:
    there: dict[str, Any] = {}
    here: dict[str, Any] = {}
    exec(re.findall(r"```py\n(.*?)```", PAGE, re.DOTALL)[0], there)
    exec(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[0], here)
    rng = np.random.default_rng(4)
    x = {"p": signed(rng, (3,)), "q": signed(rng, (4,)), "V": signed(rng, (6,))}
    wrench = signed(rng, (6,))
    for leaf, place in (("p", slice(0, 3)), ("q", slice(3, 7)), ("V", slice(7, 13)), ("F", slice(0, 6))):
        there[leaf]._slice = place
    flat = jnp.concatenate([x["p"], x["q"], x["V"]])
    lowered = {name: ox.lower_to_jax(expr) for name, expr in there["dynamics"].items()}
    found = {name: np.asarray(f(flat, wrench, 0, {"M": here["M0"]})) for name, f in lowered.items()}
    expected = here["dynamics"](0.0, x, {"F": wrench})
    for name in ("p", "q"):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-12)
    momentum = here["M0"] @ x["V"]
    swap = [3, 4, 5, 0, 1, 2]
    right = value_of(tx.lie.AdjointDual(x["V"], momentum))
    published = value_of(tx.lie.AdjointDual(x["V"], momentum[swap]))[swap]
    np.testing.assert_allclose(here["M0"] @ (found["V"] - expected["V"]), right - published, atol=1e-13)
