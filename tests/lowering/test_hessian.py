"""`dynamics.hessian`: against 40 digits, exact solutions, and JAX's own second derivatives."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import twistax as tx
from oracles import skew
from twistax.expr import Expr
from twistax.scenes import SCENES
from twistax.system import hessian as hessians

mp = pytest.importorskip("mpmath")

RNG = np.random.default_rng(0)
BY_JAX = {"xla_backend_optimization_level": 0}


def by_retraction(dynamics: tx.Dynamics, total: Any, x: Any, u: Any) -> jax.Array:
    """jax.hessian of total(x (+) d, u + du) at zero, controls in the order of declaration."""
    x, u = jax.tree.map(jnp.asarray, (x, u))

    def moved(d: jax.Array) -> jax.Array:
        held, at = {}, dynamics.dimension
        for name in [c.name for c in dynamics.controls]:
            held[name] = u[name] + d[at : at + u[name].size].reshape(u[name].shape)
            at += u[name].size
        return total(dynamics.retract(x, d[: dynamics.dimension]), held)

    size = dynamics.dimension + sum(a.size for a in u.values())
    return jax.jit(jax.hessian(moved), compiler_options=BY_JAX)(jnp.zeros(size))


# ---- forty digits --------------------------------------------------------------------------------------------------

#: With an offset centre of mass, kg and kg m2.
INERTIA = np.diag([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
INERTIA[:3, 3:] = -skew([0.2, -0.1, 0.3])
INERTIA[3:, :3] = skew([0.2, -0.1, 0.3])

g, V, F = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,)), tx.Control("F", shape=(6,))


def falling() -> tx.Dynamics:
    """A body in a central field, with drag, and a spring that turns it to its frame: forces depend on the pose."""
    R, p = g[:3, :3], g[:3, 3]
    pull = R.T @ (-3.0 * p / tx.linalg.Norm(p) ** 3)
    turn = -0.7 * tx.lie.SO3Log(R) - 0.3 * tx.linalg.Norm(V[:3]) * V[3:]
    wrench = tx.Concat(pull, turn) + F * p[2]
    rate = tx.linalg.Solve(INERTIA, wrench - tx.lie.AdjointDual(V, INERTIA @ V))
    return tx.compile(tx.System(rates={g: V, V: rate}, outputs={"reach": R @ p}))


FALLING = falling()


def falling_exactly(X: Any, V: Any, F: Any) -> tuple[list[Any], list[Any]]:
    """The rate of V and the output by entries, in mpmath's numbers."""

    def cross(a: Any, b: Any) -> Any:
        return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])

    R, p = X[:3, :3], X[:3, 3]
    cosine = (R[0, 0] + R[1, 1] + R[2, 2] - 1) / 2
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    sine = mp.sqrt(axis.dot(axis))
    log = axis * (mp.atan2(sine, cosine) / sine) if sine else axis
    pull = R.T.dot(p * (-3 / mp.sqrt(p.dot(p)) ** 3))
    turn = mp.mpf(-0.7) * log - mp.mpf(0.3) * mp.sqrt(V[:3].dot(V[:3])) * V[3:]
    momentum = np.vectorize(mp.mpf)(INERTIA).dot(V)
    coadjoint = np.concatenate([cross(V[3:], momentum[:3]), cross(V[:3], momentum[:3]) + cross(V[3:], momentum[3:])])
    wrench = np.concatenate([pull, turn]) + F * p[2] - coadjoint
    return list(mp.lu_solve(mp.matrix(INERTIA.tolist()), mp.matrix(list(wrench)))), list(R.dot(p))


def hessian_exactly(total: Any, X: Any, V: Any, F: Any, pairs: list[tuple[int, int]]) -> list[float]:
    """Differences of steps of 1e-10 in 40 digits, poses by the power series of Exp."""
    with mp.workdps(40):
        X, V, F = (np.vectorize(mp.mpf)(a) for a in (X, V, F))
        for _ in range(3):  # a rotation in all digits: off the group a logarithm near a half turn is another function
            X[:3, :3] = X[:3, :3].dot(3 * np.eye(3, dtype=int) - X[:3, :3].T.dot(X[:3, :3])) / 2
        step = mp.mpf(10) ** -10

        def at(moves: dict[int, int]) -> Any:
            d = np.array([step * moves.get(k, 0) for k in range(18)])
            twist = np.vectorize(mp.mpf)(np.zeros((4, 4)))
            twist[:3, :3], twist[:3, 3] = skew(d[3:6]), d[:3]
            term = series = np.vectorize(mp.mpf)(np.eye(4))
            for k in range(1, 5):
                term = term.dot(twist) / k
                series = series + term
            return total(X.dot(series), V + d[6:12], F + d[12:])

        second = lambda *places: at(dict.fromkeys(places, 1)) - 2 * here + at(dict.fromkeys(places, -1))  # noqa: E731
        here = at({})
        alone = [second(k) for k in range(18)]
        both = [2 * alone[j] if j == k else second(j, k) - alone[j] - alone[k] for j, k in pairs]
        return [float(value / (2 * step**2)) for value in both]


@pytest.mark.parametrize(
    "turn",
    [
        pytest.param(np.array([0.3, -0.5, 0.9]), id="anywhere"),
        pytest.param(np.array([1e-9, 0.0, -2e-9]), id="identity"),
        pytest.param((np.pi - 1e-5) * np.array([2.0, -1.0, 2.0]) / 3.0, id="half turn"),
        pytest.param(2.5 * np.array([0.6, 0.0, 0.8]), id="large twists"),
    ],
)
def test_forces_that_depend_on_the_pose_to_forty_digits(turn: Any, request: Any) -> None:
    scale = 1e3 if "large" in request.node.callspec.id else 1.0
    X = tx.pose(position=[1.0, -0.4, 0.7], rotation=expm(skew(turn)))
    x, u = {"g": np.asarray(X), "V": scale * RNG.normal(size=6)}, {"F": RNG.normal(size=6)}
    weights = {"V": RNG.normal(size=6), "reach": RNG.normal(size=3), "g": RNG.normal(size=6)}
    found = np.asarray(FALLING.hessian(0.0, x, u, None, weights))

    def total(X: Any, V: Any, F: Any) -> Any:
        rate, reach = falling_exactly(X, V, F)
        terms = zip([*weights["V"], *weights["reach"], *weights["g"]], [*rate, *reach, *V], strict=True)
        return sum(mp.mpf(w) * value for w, value in terms)

    pairs = [(j, k) for j in range(18) for k in range(j + 1) if k < 12]
    expected = hessian_exactly(total, x["g"], x["V"], u["F"], pairs)
    off = [found[j, k] - value for (j, k), value in zip(pairs, expected, strict=True)]
    assert np.linalg.norm(off) < 1e-9 * np.linalg.norm(expected)
    assert np.array_equal(found, found.T)
    assert not found[12:, 12:].any()


# ---- exact solutions -----------------------------------------------------------------------------------------------


def test_energy_and_a_point_of_a_body() -> None:
    """V . M V / 2 has the Hessian M; a . (p + R b) that of the second order of X Exp(d)."""
    a, b = RNG.normal(size=(2, 3))
    point = tx.lie.Act(g, b)
    energy = 0.5 * V @ INERTIA @ V
    system = tx.System(rates={V: F, g: V}, outputs={"energy": energy, "height": a @ point})
    dynamics = tx.compile(system)
    x = {"g": np.asarray(tx.pose(position=[1.0, 2.0, 3.0], euler=[0.4, -0.9, 2.0])), "V": RNG.normal(size=6)}
    u = {"F": np.zeros(6)}
    expected = np.zeros((18, 18))
    expected[:6, :6] = INERTIA
    np.testing.assert_allclose(dynamics.hessian(0.0, x, u, None, {"energy": 1.0}), expected, atol=1e-15)
    own = x["g"][:3, :3].T @ a
    across = np.array([[np.cross(w, v) @ own / 2 for w in np.eye(3)] for v in np.eye(3)])
    twice = np.outer(own, b) + np.outer(b, own)
    expected = np.zeros((12, 12))
    expected[6:, 6:] = np.block([[np.zeros((3, 3)), across], [across.T, twice / 2 - own @ b * np.eye(3)]])
    found = dynamics.hessian(0.0, x, u, None, {"height": np.array(1.0)}, wrt="x")
    np.testing.assert_allclose(found, expected, atol=1e-15)
    pattern = dynamics.hessian_pattern("height", wrt="x")
    assert pattern.sum() == 21
    assert not expected[~pattern].any()
    # v and w of one axis commute: nothing is computed there.
    assert not pattern[[6, 7, 8], [9, 10, 11]].any()


def test_beside_derivatives_of_the_jacobian_along_fields() -> None:
    """E_k E_j f differs from the Hessian by half of the derivative along [E_k, E_j]."""
    x, u = (
        {"g": np.asarray(tx.pose(position=[1.0, 0.2, 3.0], euler=[0.4, -0.9, 2.0])), "V": RNG.normal(size=6)},
        {"F": RNG.normal(size=6)},
    )
    weight = RNG.normal(size=6)

    def slopes(d: jax.Array) -> jax.Array:
        return weight @ FALLING.jacobian(0.0, FALLING.retract(x, d), u)["x"][6:]

    along, slope = jax.jacfwd(slopes)(jnp.zeros(12)), slopes(jnp.zeros(12))  # [j, k] = E_k E_j
    bracket = np.array([[FALLING.group.bracket(k, j) @ slope for k in np.eye(12)] for j in np.eye(12)])
    assert np.abs(bracket).max() > 0.1
    found = FALLING.hessian(0.0, x, u, None, {"V": weight})[:12, :12]
    np.testing.assert_allclose(found, along - bracket / 2.0, rtol=1e-12, atol=1e-12)


# ---- against JAX ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["heavy-top", "rocket", "offset-tumble", "stiff-attitude"])
def test_scenes(name: str) -> None:
    """As forward over reverse through a retraction; what the pattern leaves out is exactly zero there."""
    scene = SCENES[name]
    dynamics = scene.dynamics
    u = {c.name: RNG.normal(size=c.shape) for c in dynamics.controls}
    x = {n: np.asarray(a) for n, a in dynamics.retract(scene.start, 0.3 * RNG.normal(size=dynamics.dimension)).items()}
    params = {p.name: jnp.asarray(scene.params.get(p.name, p.value)) for p in dynamics.parameters}
    rates = {s.name: s for s in dynamics.states}
    weights = {n: RNG.normal(size=np.shape(r)) for n, r in dynamics(0.3, x, u, params).items()}

    def total(x: Any, u: Any) -> Any:
        found = dynamics.functions.as_written("rates", jnp.asarray(0.3), x, u, params)
        return sum(jnp.vdot(weights[n], found[n]) for n in rates)

    found = np.asarray(dynamics.hessian(0.3, x, u, params, weights))
    expected = np.asarray(by_retraction(dynamics, total, x, u))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())
    assert np.array_equal(found, found.T)
    pattern = dynamics.hessian_pattern(weights)
    assert not expected[~pattern].any()
    assert not pattern.all()


def test_two_orders_products_and_constraints() -> None:
    """A pose with the angular part first beside a rotation and a matrix; all that can be weighed; params too."""
    h = tx.State("h", group=tx.SE3, order=tx.ANGULAR_FIRST)
    a, m = tx.State("a", group=tx.SO3), tx.State("m", shape=(2, 2))
    k, f = tx.Parameter("k", value=0.5), tx.Control("f", shape=(2,))
    first = tx.lie.SE3Log(h, order=tx.ANGULAR_FIRST)
    system = tx.System(
        rates={m: m @ m * f[0], h: k * first, a: (h[:3, :3] @ a)[0] * tx.Sin(k * f[1])},
        outputs={"far": tx.linalg.Norm(h[:3, 3]) * k**2},
        constraints={"low": h[2, 3] * f <= 0.0, "one": tx.linalg.Norm(m) <= 1.0, "level": a[2, :2] * m[0] == 0.0},
    )
    dynamics = tx.compile(system)
    x = {
        "h": np.asarray(tx.pose(position=[1.0, 2.0, 3.0], euler=[0.4, -0.9, 2.0])),
        "a": np.asarray(tx.lie.so3.exp([0.2, 2.0, 0.1])),
        "m": RNG.normal(size=(2, 2)),
    }
    u, kinds = {"f": RNG.normal(size=2)}, ("x", "params", "u")
    weights = {"h": 6, "a": 3, "m": (2, 2), "far": (), "inequality": 3, "level": 2, "low": 2}
    weights = {name: RNG.normal(size=size) for name, size in weights.items()}
    found = dynamics.hessian(0.0, x, u, None, weights, wrt=kinds)
    functions = dynamics.functions
    weighted = hessians._weighted(functions, weights)
    inputs = functions.prepare(0.0, x, u, reads=("rates", "outputs", "constraints"))

    def total(x: Any, u: Any, p: Any) -> Any:
        rates, outputs, limits = (
            functions.as_written(each, inputs.t, x, u, p) for each in ("rates", "outputs", "constraints")
        )
        rest = weights["low"] @ limits["inequality"][:2] + weights["level"] @ limits["equality"]
        given = sum(jnp.vdot(weights[n], rates[n]) for n in rates) + weights["far"] * outputs["far"]
        return given + weights["inequality"] @ limits["inequality"] + rest

    def moved(d: jax.Array) -> Any:
        x = dynamics.group.retract(dict(inputs.x), d[:13])
        return total(x, {"f": u["f"] + d[14:]}, {"k": inputs.params["k"] + d[13]})

    assert [each.name for each in weighted] == ["m", "h", "a", "far", "low", "level", "inequality"]
    expected = jax.jit(jax.hessian(moved), compiler_options=BY_JAX)(jnp.zeros(16))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_under_transformations() -> None:
    """jit, a batch, further derivatives, float32; other weights trace nothing anew."""
    x = {"g": jnp.asarray(tx.pose(position=[1.0, -0.4, 0.7], euler=[0.4, -0.9, 2.0])), "V": jnp.arange(6.0) / 6.0}
    u, weight, traced = {"F": jnp.ones(6)}, jnp.asarray(RNG.normal(size=6)), []

    @jax.jit
    def own(V: jax.Array, w: jax.Array) -> jax.Array:
        traced.append(0)
        return FALLING.hessian(0.0, {**x, "V": V}, u, None, {"V": w})

    plain = FALLING.hessian(0.0, x, u, None, {"V": weight})
    np.testing.assert_array_equal(own(x["V"], weight), plain)
    np.testing.assert_allclose(own(x["V"], 2.0 * weight), 2.0 * plain, rtol=1e-14)
    assert len(traced) == 1
    Vs = jnp.stack([x["V"], 2.0 * x["V"], -x["V"]])
    batch = jax.jit(jax.vmap(own, in_axes=(0, None)))(Vs, weight)
    np.testing.assert_allclose(batch, jnp.stack([own(V, weight) for V in Vs]), rtol=1e-13, atol=1e-13)
    third = jax.jacfwd(own)(x["V"], weight)[6:12, 6:12]
    np.testing.assert_allclose(third, jnp.moveaxis(third, 2, 0), atol=1e-13)
    assert np.abs(third).max() > 0.1
    slope = jax.grad(lambda V: own(V, weight)[6, 7])(x["V"])
    np.testing.assert_allclose(slope, third[0, 1], atol=1e-13)
    single = FALLING.hessian(0.0, jax.tree.map(np.float32, x), u, None, {"V": weight})
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, plain, rtol=0.0, atol=1e-5 * np.abs(plain).max())
    assert np.array_equal(single, single.T)


def test_as_many_programs_as_sets_of_names() -> None:
    y = tx.State("y", shape=(2,))
    dynamics = tx.compile(tx.System(rates={y: tx.Sin(y) * y[0]}, outputs={"one": y @ y}))
    for scale in (1.0, 2.0):
        dynamics.hessian(0.0, {"y": np.ones(2)}, None, None, {"y": scale * np.ones(2)})
        dynamics.hessian(0.0, {"y": scale * np.ones(2)}, None, None, {"y": np.ones(2), "one": scale})
    programs = [each for each in dynamics.functions.hessians.values() if isinstance(each, hessians.WeightedHessian)]
    assert len(programs) == 2


# ---- what is computed ----------------------------------------------------------------------------------------------


def test_zeros_are_not_computed() -> None:
    y, k = tx.State("y", shape=(3,)), tx.Control("k")
    dynamics = tx.compile(tx.System(rates={y: 2.0 * y + k * y[0]}, outputs={"line": y @ [1, 2, 3]}))
    point = {"y": np.ones(3)}, {"k": 2.0}
    assert not dynamics.hessian_pattern("line").any()
    assert not dynamics.hessian(0.0, *point, None, {"line": 2.0}).any()
    expected = np.zeros((4, 4), bool)
    expected[0, 3] = expected[3, 0] = True
    np.testing.assert_array_equal(dynamics.hessian_pattern(["y"]), expected)
    np.testing.assert_array_equal(dynamics.hessian(0.0, *point, None, {"y": np.array([1.0, 2.0, 4.0])}), 7.0 * expected)
    (program,) = [
        each.program
        for each in dynamics.functions.hessians.values()
        if isinstance(each, hessians.WeightedHessian) and each.pattern.any()
    ]
    assert program.counts() == {"add": 2}
    assert dynamics.hessian(0.0, *point, None, {}).shape == (4, 4)


# ---- what the graph does not hold ----------------------------------------------------------------------------------


@jax.custom_vjp
def scaled(x: jax.Array) -> jax.Array:
    return jnp.sin(x) * x


scaled.defvjp(lambda x: (jnp.sin(x) * x, x), lambda x, c: (c * (jnp.cos(x) * x + jnp.sin(x)),))


@jax.custom_jvp
def softened(x: jax.Array) -> jax.Array:
    return jnp.sin(x) * x


@softened.defjvp
def _(primals: Any, tangents: Any) -> Any:
    (x,), (dx,) = primals, tangents
    return softened(x), (jnp.cos(x) * x + jnp.sin(x)) * dx


def looped(x: jax.Array) -> jax.Array:
    """Doubled until it is large: reverse mode has no such loop."""
    return jax.lax.while_loop(lambda c: jnp.max(jnp.abs(c)) < 3.0, lambda c: 2.0 * c, jnp.sin(x) * x)


def by_library(x: jax.Array) -> jax.Array:
    return jnp.sort(jnp.sin(x) * x)


@pytest.mark.parametrize("function", [scaled, softened, looped, by_library])
def test_functions_with_derivatives_of_their_own(function: Any) -> None:
    """Each is c sin(x) x in some order; a half of them are calls, and one has no derivative on the graph."""

    class Own(Expr):
        """A user's node. Shapes: (3,) -> (3,)."""

        a: tx.expr.fields.Operand
        takes, gives = ((3,),), (3,)

        def evaluate(self, *values: jax.Array) -> jax.Array:
            return function(values[0])

    y = tx.State("y", shape=(3,))
    dynamics = tx.compile(tx.System(rates={y: y[0] * Own(y * y[1])}))
    at, weight = np.array([0.4, 1.7, 0.9]), np.array([1.0, 2.0, -0.5])
    found = np.asarray(dynamics.hessian(0.0, {"y": at}, None, None, {"y": weight}))
    scale = 2.0 if function is looped else 1.0  # the largest entry is 1.53
    order = np.argsort(np.sin(at * at[1]) * at * at[1]) if function is by_library else np.arange(3)

    def total(y: jax.Array) -> jax.Array:
        z = (y * y[1])[order]
        return scale * y[0] * weight @ (jnp.sin(z) * z)

    np.testing.assert_allclose(found, jax.hessian(total)(jnp.asarray(at)), rtol=1e-12, atol=1e-13)
    assert np.array_equal(found, found.T)


# ---- errors --------------------------------------------------------------------------------------------------------


def test_wrong_names() -> None:
    y = tx.State("y")
    outputs = {"y": y * y, "up": y >= 0.0, "other": y}
    dynamics = tx.compile(tx.System(rates={y: -y}, outputs=outputs, constraints={"other": y <= 1.0}))
    for name, families in (("y", "rates and outputs"), ("other", "outputs and constraints")):
        with pytest.raises(
            tx.InputError, match=f"{name}.*ambiguous: the system has {families} with that name.*\n.*rename"
        ):
            dynamics.hessian(0.0, {"y": 1.0}, None, None, {name: 1.0})
    with pytest.raises(tx.InputError, match=r"'up'.*is a condition, not a number"):
        dynamics.hessian_pattern("up")
    with pytest.raises(tx.InputError, match="wrt expects names out of 'x', 'u' and 'params', got 'z'"):
        dynamics.hessian(0.0, {"y": 1.0}, None, None, {"inequality": [1.0]}, wrt="z")
