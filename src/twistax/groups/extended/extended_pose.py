"""SE_k(3): a rotation and vectors that move with it, such as attitude, velocity and position of a vehicle.

Every formula is that of SE(3) for each vector: the vectors share the rotation and do not affect one another.

Source: Barrau, Bonnabel, The invariant extended Kalman filter as a stable observer, IEEE TAC 62 (2017), appendix A.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from twistax.errors import ModelError
from twistax.groups import so3
from twistax.groups.annotations import Array, Float
from twistax.groups.arrays import (
    Components,
    Input,
    dot,
    dual_polynomial,
    multiply,
    of_shape,
    rigid_polynomial,
    swept,
    unpack,
    vector,
)
from twistax.groups.group import ElementPart, Group
from twistax.groups.series import exp_coefficients, inverse_coefficients, inverse_derivative, jacobian_coefficients
from twistax.groups.special import SO3


@dataclass(frozen=True)
class ExtendedPose(Group):
    """$SE_k(3)$: a rotation R and k vectors, in one group. With two vectors it is the group of attitude, velocity and
    position.

    An element is the matrix $[R, p_1, ..., p_k; 0, I]$ of shape (3 + k, 3 + k), with the matrix product; a tangent is
    $[w; v_1; ...; v_k]$, (3 + 3 k,), the rotation first. So the rate of a state $[R, v, p]$ with the body angular
    velocity w is $[w; R^T v'; R^T p']$.

    Attributes:
        vectors: a pair (name, unit) for each vector.
    Raises: ModelError for vectors that are not a non-empty tuple of pairs of strings.

    Source: Barrau, Bonnabel, The invariant extended Kalman filter as a stable observer, IEEE TAC 62 (2017), appendix A.

    Example: `tx.State("X", group=tx.ExtendedPose())`; `X[:3, :3]`, `X[:3, 3]` and `X[:3, 4]` are attitude, velocity
    and position.
    """

    vectors: tuple[tuple[str, str], ...] = (("velocity", "m/s"), ("position", "m"))

    @classmethod
    def examples(cls) -> tuple[Group, ...]:
        return cls(), cls((("position", "m"),))

    def __post_init__(self) -> None:
        pairs = self.vectors if isinstance(self.vectors, tuple) else ()
        if not pairs or not all(
            isinstance(pair, tuple) and len(pair) == 2 and all(isinstance(text, str) for text in pair) for pair in pairs
        ):
            raise ModelError(
                f"ExtendedPose expects a pair (name, unit) for each vector, got {self.vectors!r}.\n"
                '  fix: (("velocity", "m/s"), ("position", "m"))'
            )

    @property
    def name(self) -> str:
        return f"SE_{len(self.vectors)}(3)"

    @property
    def shape(self) -> tuple[int, ...]:
        return (3 + len(self.vectors),) * 2

    @property
    def dimension(self) -> int:
        return 3 + 3 * len(self.vectors)

    @cached_property
    def parts(self) -> tuple[ElementPart, ...]:
        parts = [ElementPart("attitude", np.s_[:3, :3], (0, 1, 2), "rad")]
        for k, (name, unit) in enumerate(self.vectors):
            first = 3 + 3 * k
            parts.append(ElementPart(name, np.s_[:3, 3 + k], (first, first + 1, first + 2), unit))
        return tuple(parts)

    def element(self, rotation: Input, *vectors: Input) -> Float[Array, "m m"]:
        """The element with a rotation (3, 3) and the vectors, (3,) each, in their order. Raises ShapeError for other
        shapes.
        """
        shapes = {"rotation": (3, 3), **{name: (3,) for name, _ in self.vectors}}
        R, *columns = of_shape(f"{self.name}.element", shapes, rotation, *vectors)
        return self._matrix(R, columns)

    def _matrix(self, R: Array, columns: list[Array]) -> Array:
        k = len(self.vectors)
        top = jnp.concatenate([R, jnp.stack(columns, axis=1)], axis=1)
        below = jnp.concatenate([jnp.zeros((k, 3), R.dtype), jnp.eye(k, dtype=R.dtype)], axis=1)
        return jnp.concatenate([top, below], axis=0)

    def _taken(self, function: str, *elements: Input) -> list[tuple[Array, list[Array]]]:
        """Rotation and vectors of elements. Raises ShapeError."""
        shapes = {f"element {i}": self.shape for i in range(len(elements))}
        arrays = of_shape(f"{self.name}.{function}", shapes, *elements)
        return [(g[:3, :3], [g[:3, 3 + k] for k in range(len(self.vectors))]) for g in arrays]

    def _tangent(self, function: str, xi: Input) -> tuple[Components, list[Components]]:
        """The components of w and of each v. Raises ShapeError."""
        (xi,) = of_shape(f"{self.name}.{function}", {"xi": (self.dimension,)}, xi)
        numbers = unpack(xi)
        return numbers[:3], [numbers[3 + 3 * k : 6 + 3 * k] for k in range(len(self.vectors))]

    def _blocks(self, diagonal: Array, lower: list[Array]) -> Array:
        """$[D, 0, 0; L_1, D, 0; L_2, 0, D]$."""
        zero, k = jnp.zeros((3, 3), diagonal.dtype), len(lower)
        rows = [[diagonal, *[zero] * k]]
        rows += [[block, *(diagonal if i == j else zero for j in range(k))] for i, block in enumerate(lower)]
        return jnp.concatenate([jnp.concatenate(row, axis=1) for row in rows], axis=0)

    def identity(self, dtype: DTypeLike | None = None) -> Float[Array, "m m"]:
        dtype = jnp.result_type(float) if dtype is None else dtype
        return jnp.asarray(np.eye(self.shape[0], dtype=dtype), dtype)

    def exp(self, xi: Input) -> Float[Array, "m m"]:
        """$[Exp(w), J_l(w) v_1, ...; 0, I]$."""
        w, vectors = self._tangent("exp", xi)
        first, second, third = exp_coefficients(dot(w, w))
        return self._matrix(rigid_polynomial(w, first, second), [vector(swept(w, v, second, third)) for v in vectors])

    def log(self, g: Input) -> Float[Array, "n"]:
        (part,) = self._taken("log", g)
        return self._log(*part)

    def _log(self, R: Array, columns: list[Array]) -> Array:
        rotation = so3.log(R)
        w = unpack(rotation)
        slope = inverse_derivative(0, dot(w, w))
        return jnp.concatenate([rotation, *(vector(swept(w, unpack(p), -0.5, slope)) for p in columns)])

    def compose(self, g: Input, h: Input) -> Float[Array, "m m"]:
        (R, left), (S, right) = self._taken("compose", g, h)
        return self._matrix(multiply(R, S), [multiply(R, q) + p for p, q in zip(left, right, strict=True)])

    def inverse(self, g: Input) -> Float[Array, "m m"]:
        ((R, columns),) = self._taken("inverse", g)
        return self._matrix(R.T, [-multiply(R.T, p) for p in columns])

    def difference(self, g: Input, h: Input) -> Float[Array, "n"]:
        """$Log(g^-1 h)$, with the vectors subtracted first to avoid cancellation of large common positions."""
        (R, left), (S, right) = self._taken("difference", g, h)
        return self._log(multiply(R.T, S), [multiply(R.T, q - p) for p, q in zip(left, right, strict=True)])

    def Ad(self, g: Input) -> Float[Array, "n n"]:
        """$[R, 0; [p_i] R, R]$."""
        ((R, columns),) = self._taken("Ad", g)
        return self._blocks(R, [multiply(so3.hat(p), R) for p in columns])

    def ad(self, xi: Input) -> Float[Array, "n n"]:
        w, vectors = self._tangent("ad", xi)
        return self._blocks(so3.hat(vector(w)), [so3.hat(vector(v)) for v in vectors])

    def left_jacobian(self, xi: Input) -> Float[Array, "n n"]:
        w, vectors = self._tangent("left_jacobian", xi)
        second, third, *slopes = jacobian_coefficients(dot(w, w))
        return self._jacobian(w, vectors, (second, third, *slopes))

    def left_jacobian_inv(self, xi: Input) -> Float[Array, "n n"]:
        w, vectors = self._tangent("left_jacobian_inv", xi)
        d, slope = inverse_coefficients(dot(w, w))
        return self._jacobian(w, vectors, (-0.5, d, 0.0, slope))

    def _jacobian(self, w: Components, vectors: list[Components], coefficients: tuple[Any, ...]) -> Array:
        """I + a W + b W^2 on the diagonal, below it its derivatives in the directions of the vectors."""
        below: Callable[[Components], Array] = lambda v: dual_polynomial(w, v, *coefficients)  # noqa: E731
        return self._blocks(rigid_polynomial(w, *coefficients[:2]), [below(v) for v in vectors])

    def normalize(self, g: Input) -> Float[Array, "m m"]:
        """The nearest rotation (up to the square of the drift) with the same vectors."""
        ((R, columns),) = self._taken("normalize", g)
        return self._matrix(SO3.normalize(R), columns)

    def tighten(self, g: Input) -> Float[Array, "m m"]:
        """One Newton step of the rotation towards the nearest one; the vectors are unchanged."""
        ((R, columns),) = self._taken("tighten", g)
        return self._matrix(SO3.tighten(R), columns)

    def defect(self, g: Input) -> Float[Array, ""]:
        """The larger of the defect of the rotation and the deviation of the last rows from [0, I]."""
        (g,) = of_shape(f"{self.name}.defect", {"g": self.shape}, g)
        rows = jnp.eye(self.shape[0], dtype=g.dtype)[3:]
        return jnp.maximum(SO3.defect(g[:3, :3]), jnp.max(jnp.abs(g[3:] - rows)))
