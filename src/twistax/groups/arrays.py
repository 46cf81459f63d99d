"""Arguments of the numeric maps as arrays, and formulas of small vectors.

Small vectors are tuples of their components: XLA compiles scalar arithmetic to a few instructions, while products of
3x3 arrays inside a loop become function calls. The public maps unpack their arguments here and pack the result once.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ParamSpec, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from twistax.checks import real_array
from twistax.errors import InputError, ShapeError, TwistaxError

Input: TypeAlias = ArrayLike | Sequence[Any]

Components: TypeAlias = tuple[Array, ...]

P = ParamSpec("P")
R = TypeVar("R")

_TYPED = (Array, np.ndarray, np.generic)


def floats(*values: Input, names: Sequence[str] = ()) -> tuple[Array, ...]:
    """The values as floating point arrays. Lists and plain numbers have the precision of the other arrays.

    `names` are used in messages. Raises InputError for values that are not real numbers.
    """
    arrays = [
        value if isinstance(value, Array) and jnp.issubdtype(value.dtype, jnp.floating) else real_array(name, value)
        for name, value in zip(names or ["a group's map"] * len(values), values, strict=True)
    ]
    canonical = jax.dtypes.canonicalize_dtype  # float64 becomes float32 where x64 is off, without a warning
    dtypes = [
        canonical(value.dtype) if isinstance(value, _TYPED) and jnp.issubdtype(value.dtype, jnp.floating) else None
        for value in values
    ]
    kinds = [dtype for dtype in dtypes if dtype is not None]
    common = jnp.result_type(*kinds) if kinds else jnp.result_type(float)
    return tuple(jnp.asarray(array, dtype or common) for array, dtype in zip(arrays, dtypes, strict=True))


def of_shape(function: str, shapes: Mapping[str, tuple[int, ...]], *values: Input) -> tuple[Array, ...]:
    """The result of `floats`, with a check that every array has the shape that `shapes` contains for its name, in this
    order.
    """
    arrays = floats(*values, names=[f"{function}: {name}" for name in shapes])
    for (name, expected), array in zip(shapes.items(), arrays, strict=True):
        if array.shape != expected:
            batch = ".\n  fix: map over a batch with jax.vmap" if array.shape[1:] == expected else ""
            raise ShapeError(f"{function} expects {name} with shape {expected}, got {array.shape}{batch}")
    return arrays


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """A map of arrays as one program of XLA. Where it is traced, its operations become part of the surrounding program.

    Without it, a call outside of `jax.jit` would compile and start each operation separately.
    """
    program = jax.jit(function, inline=True)

    @functools.wraps(function)
    def call(*values: Any, **named: Any) -> R:
        with contextlib.suppress(TwistaxError):
            arrays = floats(*values, *named.values())
            return program(*arrays[: len(values)], **dict(zip(named, arrays[len(values) :], strict=True)))
        return function(*values, **named)  # its error names the argument, and has no notes of JAX

    return call


def known(a: Array) -> np.ndarray | None:
    """The array as a NumPy array; None if it is traced."""
    from twistax.jax_inside import is_traced  # not at import: it loads much of JAX that `import jax` does not

    return None if is_traced(a) else np.asarray(a)


def element(function: str, name: str, g: Array, drift: float = 0.1) -> Array:
    """Check a rotation (3, 3) or a pose (4, 4), and return it; a traced matrix that is not an element becomes NaN.

    For a reflection or zeros, the maps would return plausible but meaningless numbers. Raises InputError.
    """
    numbers = known(g)
    if numbers is None:
        return jnp.where((defect(g) <= drift) & (determinant(g) > 0.0), g, jnp.nan)
    off = element_defect(numbers)
    det = np.nan if np.isnan(off) else float(np.linalg.det(numbers[:3, :3]))
    if not (off <= drift and det > 0.0):
        raise InputError(
            f"{function} expects {name} to be {'a rotation' if len(numbers) == 3 else 'a pose'}, R "
            f"orthonormal with determinant +1 up to {drift:.1g}, got\n"
            f"{numbers}, with an error of {off:.3g}, det R = {det:.6g}.\n"
            "  fix: tx.pose(...) builds one; tx.SO3.normalize(R) returns the rotation nearest to a matrix"
        )
    return g


@compiled
def defect(g: Array) -> Array:
    """The largest of max |R^T R - I|, |det R - 1| and, of a pose, the deviation of the last row from (0, 0, 0, 1)."""
    R = g[:3, :3]
    off = jnp.maximum(jnp.max(jnp.abs(multiply(R.T, R) - jnp.eye(3, dtype=R.dtype))), jnp.abs(determinant(g) - 1.0))
    return off if len(g) == 3 else jnp.maximum(off, jnp.max(jnp.abs(g[3] - jnp.eye(4, dtype=g.dtype)[3])))


def determinant(g: Array) -> Array:
    x, y, z = (unpack(g[:3, i]) for i in range(3))
    return dot(x, cross(y, z))


def element_defect(value: np.ndarray) -> float:
    """`defect` of an array of NumPy, without JAX; NaN where it is not finite."""
    # Python's floats: NumPy takes twice as long for so few entries.
    rows = value.tolist()
    (a, b, c), (d, e, f), (g, h, i) = (row[:3] for row in rows[:3])
    off = [a * a + d * d + g * g - 1.0, b * b + e * e + h * h - 1.0, c * c + f * f + i * i - 1.0]
    off += [a * b + d * e + g * h, a * c + d * f + g * i, b * c + e * f + h * i]
    off.append(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) - 1.0)
    if len(rows) == 4:
        off += rows[3][:3] + [rows[3][3] - 1.0]
    if not math.isfinite(sum(off) + sum(row[-1] for row in rows)):
        return np.inf if np.isfinite(value).all() else np.nan
    return float(max(map(abs, off)))


def multiply(a: Array, b: Array) -> Array:
    """a @ b for a small matrix a and a small matrix or a vector b, as a sum of products.

    XLA fuses it with surrounding operations, while a matrix product would be a function call. Accelerators round the
    factors of a float32 matrix product to fewer bits, which does not happen here.
    """
    if b.ndim == 1:
        return jnp.sum(a * b[None, :], axis=1)
    return jnp.sum(a[:, :, None] * b[None, :, :], axis=1)


def unpack(a: Array) -> Components:
    """The scalars of an array of any shape, row by row."""
    return tuple(jnp.unstack(a if a.ndim == 1 else a.reshape(-1)))


def vector(components: Sequence[Array]) -> Array:
    return jnp.stack(list(components))


def matrix(rows: Sequence[Sequence[Array]]) -> Array:
    return jnp.stack([jnp.stack(list(row)) for row in rows])


def dot(a: Components, b: Components) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Components, b: Components) -> Components:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def add(a: Components, *terms: Components) -> Components:
    for b in terms:
        a = tuple(x + y for x, y in zip(a, b, strict=True))
    return a


def scale(s: Array | float, a: Components) -> Components:
    return tuple(s * x for x in a)


# ---- formulas of rotation vectors w and twists [v; w], W = hat(w) ------------------------------------------------


def rigid_polynomial(w: Components, a: Array | float, b: Array) -> Array:
    """I + a W + b W^2 with W = hat(w) and W^2 = w w^T - |w|^2 I, whose diagonal is formed without |w|^2."""
    x, y, z = w
    bx, by, bz = scale(b, w)
    return matrix(turn_rows(scale(a, w), (bx * x, by * y, bz * z, bx * y, bx * z, by * z)))


def turn_rows(a: Components, squares: Components) -> list[list[Array]]:
    """The rows of I + hat(a) + S - tr(S) I, S symmetric with xx, yy, zz, xy, xz, yz."""
    (ax, ay, az), (xx, yy, zz, xy, xz, yz) = a, squares
    return [
        [1.0 - (yy + zz), xy - az, xz + ay],
        [xy + az, 1.0 - (xx + zz), yz - ax],
        [xz - ay, yz + ax, 1.0 - (xx + yy)],
    ]


def swept(w: Components, v: Components, a: Array | float, b: Array) -> Components:
    """(I + a W + b W^2) v: the position of Exp with J_l, a = (1 - cos t) / t^2 and b = (t - sin t) / t^3."""
    once = cross(w, v)
    return add(v, scale(a, once), scale(b, cross(w, once)))


def dual_polynomial(w: Components, v: Components, a: Array | float, b: Array, da: Array | float, db: Array) -> Array:
    """The derivative of I + a(x) W + b(x) W^2, x = |w|^2, in the direction v; da and db are a'(x) and b'(x).

    It is a V + b (W V + V W) + 2 (w . v) (a' W + b' W^2).
    """
    double = 2.0 * dot(w, v)
    k = double * db
    ax, ay, az = add(scale(a, v), scale(double * da, w))
    # b (w v^T + v w^T) + k w w^T = w u^T + v z^T with z = b w, u = b v + k w.
    z = scale(b, w)
    u = add(scale(b, v), scale(k, w))
    xx, yy, zz = (w[i] * u[i] + v[i] * z[i] for i in range(3))
    xy, xz, yz = (w[i] * u[j] + v[i] * z[j] for i, j in ((0, 1), (0, 2), (1, 2)))
    return matrix(
        [
            [-(yy + zz), xy - az, xz + ay],
            [xy + az, -(xx + zz), yz - ax],
            [xz - ay, yz + ax, -(xx + yy)],
        ]
    )


def rotation_rate(w: Components, u: Components, d: Array | float) -> Components:
    """J_r(w)^-1 u = u + w x u / 2 + d w x (w x u), d = (1 - (t/2) cot(t/2)) / t^2; the term with d is omitted if d is
    exactly 0.0.
    """
    if isinstance(d, float) and d == 0.0:
        return add(u, scale(0.5, cross(w, u)))
    return add(u, cross(w, add(scale(0.5, u), scale(d, cross(w, u)))))


def pose_rate(eta: Components, omega: Components, d: Array | float, rise: Array | float) -> Components:
    """J_r(eta)^-1 Omega with J_r^-1 = I + W/2 + d W^2 for rotations, where `rise` is the derivative of d with respect
    to |w|^2.

    Terms with a d or a rise of exactly 0.0 are omitted.
    """
    v, w, y, u = eta[:3], eta[3:], omega[:3], omega[3:]
    turn, shift = cross(w, u), add(cross(w, y), cross(v, u))
    turn_arm, shift_arm = [scale(0.5, u)], [scale(0.5, y)]
    if not (isinstance(d, float) and d == 0.0):
        turn_arm.append(scale(d, turn))
        shift_arm.append(scale(d, shift))
    if not (isinstance(rise, float) and rise == 0.0):
        shift_arm.append(scale(2.0 * rise * dot(w, v), turn))
    arm = add(*turn_arm)
    return (*add(y, cross(w, add(*shift_arm)), cross(v, arm)), *add(u, cross(w, arm)))
