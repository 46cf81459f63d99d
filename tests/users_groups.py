"""Groups as users write them: turns of the plane, its rigid motions, and these with a scale."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from twistax.groups import ElementPart, Group


def _turn(angle: Any) -> Any:
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.array([[c, -s], [s, c]])


@dataclasses.dataclass(frozen=True)
class SO2(Group):
    """Turns of the plane as matrices (2, 2), as docs/extending.md writes a group: the abstract members alone."""

    name = "SO2"
    shape = (2, 2)
    dimension = 1

    def identity(self, dtype: Any = None) -> Any:
        return jnp.eye(2, dtype=dtype)

    def exp(self, d: Any) -> Any:
        return _turn(d[0])

    def log(self, g: Any) -> Any:
        return jnp.arctan2(g[1, 0], g[0, 0])[None]

    def compose(self, g: Any, h: Any) -> Any:
        return g @ h

    def inverse(self, g: Any) -> Any:
        return g.T

    def Ad(self, g: Any) -> Any:
        return jnp.eye(1, dtype=g.dtype)

    def ad(self, d: Any) -> Any:
        return jnp.zeros((1, 1), d.dtype)

    def left_jacobian(self, d: Any) -> Any:
        return jnp.eye(1, dtype=d.dtype)

    def left_jacobian_inv(self, d: Any) -> Any:
        return jnp.eye(1, dtype=d.dtype)

    def normalize(self, g: Any) -> Any:
        x, y = g[0, 0] + g[1, 1], g[1, 0] - g[0, 1]
        length = jnp.sqrt(x * x + y * y)
        return jnp.array([[x, -y], [y, x]]) / length

    def defect(self, g: Any) -> Any:
        return jnp.maximum(jnp.abs(g.T @ g - jnp.eye(2, dtype=g.dtype)).max(), jnp.abs(_determinant(g) - 1.0))


def _determinant(A: Any) -> Any:
    return A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]


@dataclasses.dataclass(frozen=True)
class Similarity(Group):
    """Motions of the plane with a scale, Sim(2), or without one, SE(2): [A p; 0 1] with A = e^s Rot(w).

    A tangent is [v_x, v_y, w] or [v_x, v_y, w, s]. With complex numbers z = s + i w, Exp has A = e^z and
    p = (e^z - 1)/z v.
    """

    scaled: bool = True

    @property
    def name(self) -> str:
        return "Sim2" if self.scaled else "SE2"

    shape = (3, 3)

    @property
    def dimension(self) -> int:
        return 4 if self.scaled else 3

    @property
    def parts(self) -> tuple[ElementPart, ...]:
        shape = (
            ElementPart("shape", np.s_[:2, :2], (2, 3))
            if self.scaled
            else ElementPart("heading", np.s_[:2, :2], (2,), "rad")
        )
        return ElementPart("position", np.s_[:2, 2], (0, 1), "m"), shape

    def _algebra(self, d: Any) -> Any:
        """The matrix (3, 3) of a tangent."""
        w, s = d[2], d[3] if self.scaled else jnp.zeros_like(d[2])
        o = jnp.zeros_like(w)
        return jnp.stack([jnp.stack([s, -w, d[0]]), jnp.stack([w, s, d[1]]), jnp.stack([o, o, o])])

    def _matrix(self, A: Any, p: Any) -> Any:
        last = jnp.array([[0.0, 0.0, 1.0]], A.dtype)
        return jnp.concatenate([jnp.concatenate([A, p[:, None]], axis=1), last])

    def _exponentials(self, Z: Any) -> tuple[Any, Any]:
        """e^Z and (e^Z - I) Z^-1 of a square matrix: series of an eighth of it, doubled three times."""
        eye, Y = jnp.eye(len(Z), dtype=Z.dtype), Z / 8.0
        ratio = jnp.zeros_like(Z)
        for k in reversed(range(18)):
            ratio = ratio @ Y + eye / float(np.prod(np.arange(1.0, k + 2.0)))
        power = eye + Y @ ratio
        for _ in range(3):
            power, ratio = power @ power, 0.5 * (power + eye) @ ratio
        return power, ratio

    def identity(self, dtype: Any = None) -> Any:
        return jnp.eye(3, dtype=dtype)

    def exp(self, d: Any) -> Any:
        A, B = self._exponentials(self._algebra(d)[:2, :2])
        return self._matrix(A, B @ d[:2])

    def log(self, g: Any) -> Any:
        w = jnp.arctan2(g[1, 0], g[0, 0])
        s = 0.5 * jnp.log(g[0, 0] * g[0, 0] + g[1, 0] * g[1, 0]) if self.scaled else jnp.zeros_like(w)
        _, B = self._exponentials(jnp.stack([jnp.stack([s, -w]), jnp.stack([w, s])]))
        v = jnp.stack([B[0, 0] * g[0, 2] + B[1, 0] * g[1, 2], B[0, 0] * g[1, 2] - B[1, 0] * g[0, 2]])
        v = v / (B[0, 0] ** 2 + B[1, 0] ** 2)
        return jnp.concatenate([v, jnp.stack([w, s] if self.scaled else [w])])

    def compose(self, g: Any, h: Any) -> Any:
        return g @ h

    def inverse(self, g: Any) -> Any:
        A = jnp.array([[g[1, 1], -g[0, 1]], [-g[1, 0], g[0, 0]]]) / _determinant(g)
        return self._matrix(A, -A @ g[:2, 2])

    def Ad(self, g: Any) -> Any:
        x, y = g[0, 2], g[1, 2]
        rest = jnp.stack([jnp.stack([y, -x]), jnp.stack([-x, -y])], axis=1)[:, : self.dimension - 2]
        below = jnp.eye(self.dimension, dtype=g.dtype)[2:]
        return jnp.concatenate([jnp.concatenate([g[:2, :2], rest], axis=1), below])

    def ad(self, d: Any) -> Any:
        rest = jnp.stack([jnp.stack([d[1], -d[0]]), jnp.stack([-d[0], -d[1]])], axis=1)[:, : self.dimension - 2]
        zero = jnp.zeros((self.dimension - 2, self.dimension), d.dtype)
        return jnp.concatenate([jnp.concatenate([self._algebra(d)[:2, :2], rest], axis=1), zero])

    def left_jacobian(self, d: Any) -> Any:
        return self._exponentials(self.ad(d))[1]

    def left_jacobian_inv(self, d: Any) -> Any:
        return jnp.linalg.inv(self.left_jacobian(d))

    def normalize(self, g: Any) -> Any:
        x, y = 0.5 * (g[0, 0] + g[1, 1]), 0.5 * (g[1, 0] - g[0, 1])
        length = jnp.ones_like(x) if self.scaled else jnp.sqrt(x * x + y * y)
        return self._matrix(jnp.array([[x, -y], [y, x]]) / length, g[:2, 2])

    def defect(self, g: Any) -> Any:
        off = jnp.maximum(jnp.abs(g[0, 0] - g[1, 1]), jnp.abs(g[1, 0] + g[0, 1]))
        last = jnp.abs(g[2] - jnp.array([0.0, 0.0, 1.0], g.dtype)).max()
        size = jnp.zeros_like(off) if self.scaled else jnp.abs(_determinant(g) - 1.0)
        return jnp.maximum(jnp.maximum(off, last), size)


SE2, SIM2 = Similarity(scaled=False), Similarity()
