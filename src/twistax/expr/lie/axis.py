"""Rotation about a fixed axis, in closed form.

Source: R. Murray, Z. Li, S. Sastry, A Mathematical Introduction to Robotic Manipulation (1994), chapter 2 (Rodrigues).
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError, ShapeError
from ..fields import Operand
from ..leaves import State
from ..node import Example, Expr, Shape
from ..printing import number_latex
from ..shapes import expect


class AxisRotation(Expr):
    """R = a a^T + sin q [a]x + cos q (I - a a^T): the turn by q about a fixed unit axis a. Shapes: () -> (3, 3).

    The same as SO3Exp(q a) for one sine and one cosine.

    Attributes:
        angle: q in rad.
        axis: three numbers, not all zero; it is normalised.
    Raises:
        ShapeError: angle is no scalar, or axis has not three entries.
        ModelError: axis is zero, not finite or no numbers.
    """

    angle: Operand
    axis: Any

    def validate(self) -> None:
        self.axis = tuple(unit_vector("AxisRotation", "axis", self.axis).tolist())

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "angle", shapes[0], (), "take the entry of a vector: angle[0]" if shapes[0] == (1,) else None)
        return (3, 3)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        (q,) = values
        x, y, z = self.axis
        along = np.outer(self.axis, self.axis)
        turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        constant, sine, cosine = (jnp.asarray(part, q.dtype) for part in (along, turn, np.eye(3) - along))
        return constant + jnp.sin(q) * sine + jnp.cos(q) * cosine

    def makes_group_element(self, *operands: bool) -> bool:
        return True

    def to_latex(self, *operands: str) -> str:
        axis = ", ".join(number_latex(entry, 4) for entry in self.axis)
        return rf"\operatorname{{Rot}}_{{({axis})}}\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        q = State("q")
        return [Example(cls(q, (1.0, -2.0, 2.0)), {"q": 0.7}), Example(cls(q, (0.0, 0.0, 1.0)), {"q": 0.0})]


def unit_vector(owner: str, name: str, value: Any) -> np.ndarray:
    """A direction (3,) as a unit vector.

    Raises:
        ShapeError: it has not three entries.
        ModelError: it is zero, not finite or no numbers.
    """
    try:
        vector = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ModelError(f"{owner} expects {name} to be three numbers, got {value!r}") from None
    if vector.shape != (3,):
        raise ShapeError(f"{owner} expects {name} with shape (3,), got {vector.shape}")
    largest = np.max(np.abs(vector))
    if not np.isfinite(largest) or largest == 0.0:
        raise ModelError(
            f"{owner} expects {name} to be a direction, got {vector.tolist()}.\n"
            "  fix: give three finite numbers, not all zero; the length does not matter"
        )
    # Scaled first: the squares of very large or very small entries leave the range. Adding 0 turns -0 into 0.
    vector = vector / largest
    return vector / np.linalg.norm(vector) + 0.0


__all__ = ["AxisRotation", "unit_vector"]
