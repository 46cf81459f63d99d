"""The distance without kinks: its bound beside the distance, and its derivatives where features change."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import twistax as tx
from twistax.errors import InputError, ModelError
from twistax.mechanics import ConvexPolytope, HalfSpace, signed_distance, soft_distance
from twistax.view import Box, Capsule, Cylinder, Sphere

WIDTH = 0.005
WEDGE = ConvexPolytope([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.5]], radius=0.02)
POSE = tx.Parameter("X", (4, 4))


def poses(count: int) -> np.ndarray:
    rng, T = np.random.default_rng(0), np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.from_quat(rng.normal(size=(count, 4))).as_matrix()
    T[:, :3, 3] = 0.6 * rng.normal(size=(count, 3))
    return T


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("a", "b", "products"),
    [
        (Box((0.4, 0.6, 0.3)), Box((0.2, 0.5, 0.7), at=(0.1, 0.0, 0.2)), 64),
        (Capsule(0.1, 0.4), WEDGE, 8),
    ],
)
def test_bound_and_derivatives(a: tx.view.Shape, b: tx.view.Shape, products: int) -> None:
    soft, hard = (tx.lower(d) for d in (soft_distance(a, b, WIDTH, T_b=POSE), signed_distance(a, b, T_b=POSE)))
    T = poses(200)
    value, distance = (
        np.asarray(jax.jit(jax.vmap(lambda X, f=f: f(0.0, {}, params={"X": X})))(T)) for f in (soft, hard)
    )
    below = (distance - value) / (WIDTH * np.log(products))
    outside = distance > 0.0
    assert below.min() >= -1e-9
    assert below[outside].max() <= 1.0 + 1e-9
    assert np.mean(below[~outside] < 1.5) > 0.9  # inside, the search ends at a local maximum

    def along(s: jax.Array, X: jax.Array) -> jax.Array:
        W = jnp.array([[0.0, 0.3, 0.4], [-0.3, 0.0, -0.7], [-0.4, 0.7, 0.0]])
        R, p = jax.scipy.linalg.expm(s * W) @ X[:3, :3], X[:3, 3] + s * jnp.array([0.3, -0.2, 0.5])
        return soft(0.0, {}, params={"X": X.at[:3, :3].set(R).at[:3, 3].set(p)})

    values, first, second = (
        jax.jit(jax.vmap(f, (None, 0))) for f in (along, jax.grad(along), jax.grad(jax.grad(along)))
    )
    X, h = T[outside], 1e-5
    np.testing.assert_allclose(first(0.0, X), (values(h, X) - values(-h, X)) / (2.0 * h), atol=1e-6)
    bend = second(0.0, X)
    np.testing.assert_allclose(bend, (first(h, X) - first(-h, X)) / (2.0 * h), atol=1e-5 * (1.0 + np.abs(bend).max()))


@pytest.mark.thorough
def test_no_kink_as_a_box_tips_over_another() -> None:
    """Faces that become parallel: the slope of the distance jumps from one side to the other, that of this does not."""
    low, high = Box((0.4, 0.4, 0.1)), Box((0.2, 0.2, 0.1))

    def slopes(distance: tx.Expr) -> np.ndarray:
        f = tx.lower(distance)

        def tipped(angle: jax.Array) -> jax.Array:
            c, s, o = jnp.cos(angle), jnp.sin(angle), jnp.zeros(())
            R = jnp.stack([jnp.stack([c, o, s]), jnp.array([0.0, 1.0, 0.0]), jnp.stack([-s, o, c])])
            return f(0.0, {}, params={"X": jnp.eye(4).at[:3, :3].set(R).at[2, 3].set(0.2)})

        return np.asarray(jax.vmap(jax.grad(tipped))(np.array([-1e-4, 1e-4])))

    assert np.ptp(slopes(signed_distance(low, high, T_b=POSE))) == pytest.approx(0.2, rel=1e-2)
    assert np.ptp(slopes(soft_distance(low, high, WIDTH, T_b=POSE))) < 1e-3


def test_bad_input() -> None:
    box = Box((0.1, 0.1, 0.1))
    for width in (0.0, np.nan, -1.0):
        with pytest.raises(InputError, match="width"):
            soft_distance(box, box, width)
    for solid in (HalfSpace(), Cylinder(0.1, 0.2)):
        with pytest.raises(ModelError, match="ConvexPolytope"):
            soft_distance(box if isinstance(solid, HalfSpace) else Sphere(0.1), solid, 0.01)
