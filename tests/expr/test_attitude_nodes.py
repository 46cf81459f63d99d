"""Euler angles, quaternions and rotation vectors as expressions, both ways, against SciPy and mpmath."""

import functools
import itertools
from typing import Any

import jax
import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import twistax as tx

OWN = ["".join(axes).upper() for axes in itertools.product("xyz", repeat=3) if axes[0] != axes[1] != axes[2]]
SEQUENCES = [*OWN, *(sequence.lower() for sequence in OWN)]
R, a, q, w = tx.State("R", group=tx.SO3), tx.State("a", 3), tx.State("q", 4), tx.State("w", 3)
RNG = np.random.default_rng(5)
ROTATIONS = Rotation.random(40, RNG)
#: Middle angles at both ends of their range, where two axes are one; others nearby.
ENDS = {True: (0.0, np.pi), False: (-np.pi / 2, np.pi / 2)}
GAPS = (0.0, 1e-14, 1e-10, 1e-6)


def proper(sequence: str) -> bool:
    return sequence[0] == sequence[2]


@functools.cache
def dynamics() -> tx.Dynamics:
    """All of them at once: one program."""
    outputs: dict[str, Any] = {f"angles {s}": tx.lie.euler(R, s) for s in SEQUENCES}
    outputs |= {f"pose {s}": tx.pose(position=w, euler=[a[0], a[1], a[2]], sequence=s) for s in SEQUENCES}
    outputs |= {
        "quaternion": tx.lie.quaternion(tx.pose(rotation=R)),
        "from quaternion": tx.pose(quaternion=q, position=[w[0], 2.0, 0.0]),
        "vector": tx.lie.SO3Log(R),
        "from vector": tx.pose(rotation_vector=w),
    }
    rates = {R: np.zeros(3), a: 0.0 * a, q: 0.0 * q, w: 0.0 * w}
    return tx.compile(tx.System(rates=rates, outputs=outputs), backend=tx.XLA())


@functools.cache
def values() -> Any:
    """Of many states side by side."""
    return jax.jit(jax.vmap(lambda x: dynamics().outputs(0.0, x)))


def found(rotations: Rotation, angles: np.ndarray) -> dict[str, np.ndarray]:
    quaternions = np.roll(rotations.as_quat(), 1, axis=1)
    x = {"R": rotations.as_matrix(), "a": angles, "q": 3.0 * quaternions, "w": rotations.as_rotvec()}
    return jax.tree.map(np.asarray, values()(x))


def close(actual: Any, expected: Any, tolerance: float = 4e-15) -> None:
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=tolerance)


def test_all_sequences_both_ways_against_scipy() -> None:
    angles = RNG.uniform(-3.0, 3.0, (len(ROTATIONS), 3))
    got = found(ROTATIONS, angles)
    for s in SEQUENCES:
        expected = ROTATIONS.as_euler(s)
        close(got[f"angles {s}"], expected, 1e-13)
        close([tx.lie.euler(each, s) for each in ROTATIONS[:2].as_matrix()], expected[:2], 1e-13)
        close(got[f"pose {s}"][:, :3, :3], Rotation.from_euler(s, angles).as_matrix())
        close(got[f"pose {s}"][:, :3, 3], ROTATIONS.as_rotvec(), 0.0)
        close(tx.pose(euler=angles[0], sequence=s)[:3, :3], Rotation.from_euler(s, angles[0]).as_matrix())
    signs = np.sign(ROTATIONS.as_quat()[:, 3:])
    close(got["quaternion"], signs * np.roll(ROTATIONS.as_quat(), 1, axis=1))
    close(got["from quaternion"][:, :3, :3], ROTATIONS.as_matrix())
    close(
        got["from quaternion"][:, :3, 3],
        np.stack([ROTATIONS.as_rotvec()[:, 0], *(0.0 * angles[:, 1:].T)], 1) + [0, 2, 0],
    )
    close(got["vector"], ROTATIONS.as_rotvec(), 1e-14)
    close(got["from vector"][:, :3, :3], ROTATIONS.as_matrix())


def exactly(sequence: str, angles: Any) -> np.ndarray:
    """The rotation matrix in 50 digits, rounded."""
    with mpmath.workdps(50):
        total = mpmath.eye(3)
        for letter, angle in zip(sequence.lower(), angles, strict=True):
            n, turn = "xyz".index(letter), mpmath.eye(3)
            k, m = (n + 1) % 3, (n + 2) % 3
            turn[k, k] = turn[m, m] = mpmath.cos(angle)
            turn[m, k], turn[k, m] = mpmath.sin(angle), -mpmath.sin(angle)
            total = total * turn if sequence.isupper() else turn * total
        return np.array(total.tolist(), float)


def test_at_the_singularity_and_close_to_it() -> None:
    """The middle angle is right, one of the others is zero, and the angles give the rotation back to round-off."""
    for s in SEQUENCES:
        zero, other = (2, 0) if s.isupper() else (0, 2)
        cases = [(end, gap) for end in ENDS[proper(s)] for gap in GAPS]
        inward = [end + gap if end == ENDS[proper(s)][0] else end - gap for end, gap in cases]
        given = [[0.7, middle, 0.4] for middle in inward]
        matrices = np.array([exactly(s, angles) for angles in given])
        read = np.array([tx.lie.euler(matrix, s) for matrix in matrices])
        close(read[:, 1], inward)
        back = np.array([exactly(s, angles) for angles in read])
        close(back, matrices)
        at_end = read[[gap == 0.0 for _, gap in cases]]
        close(at_end[:, zero], 0.0, 0.0)
        # At one end the two turns add up, at the other one is taken from the other.
        ends = [1.0, -1.0] if proper(s) else [-1.0, 1.0]
        even = (("xyz".index(s[1].lower()) - "xyz".index(s[0].lower())) % 3 == 1) == s.isupper()
        signs = ends if proper(s) or even else ends[::-1]
        expected = [given[0][other] + sign * given[0][zero] for sign in signs]
        close(at_end[:, other], expected)


def test_derivatives_along_the_group_against_differences_of_scipy() -> None:
    h = 1e-5
    for s, rotation in zip(("ZYX", "YZX", "ZXZ", "zyz"), ROTATIONS, strict=False):
        matrix = rotation.as_matrix()

        def moved(d: Any, matrix: Any = matrix, s: str = s) -> Any:
            return tx.lie.euler(matrix @ tx.lie.so3.exp(d), s)

        steps = h * np.eye(3)
        ends = [(rotation * Rotation.from_rotvec(sign * steps)).as_euler(s) for sign in (1.0, -1.0)]
        slope = ((ends[0] - ends[1]) / (2.0 * h)).T
        np.testing.assert_allclose(jax.jacfwd(moved)(np.zeros(3)), slope, atol=2e-8 * np.abs(slope).max() ** 2)


@pytest.mark.parametrize("sequence", ["ZYX", "zxz"])
def test_derivatives_at_the_singularity_are_finite_and_as_said(sequence: str) -> None:
    """Those of the middle angle and of the one that is zero are zero; the third turns with the body."""
    zero = 2 if sequence.isupper() else 0
    matrix = exactly(sequence, [0.7, ENDS[proper(sequence)][1], 0.4])
    system = tx.System(rates={R: np.zeros(3)}, outputs={"angles": tx.lie.euler(R, sequence)})
    for backend in (tx.JAX(), tx.XLA()):
        run = tx.compile(system, backend=backend)
        slope = jax.jacfwd(lambda d, run=run: run.outputs(0.0, {"R": matrix @ tx.lie.so3.exp(d)})["angles"])(
            np.zeros(3)
        )
        close([slope[1], slope[zero]], 0.0, 0.0)
        np.testing.assert_allclose(np.linalg.norm(slope[2 - zero]), 1.0, rtol=1e-14)


def test_rewrites_and_printing() -> None:
    turned = tx.lie.EulerRotation(a, "ZXZ")
    assert turned.is_group_element
    assert tx.lie.EulerRotation(tx.lie.EulerAngles(R, "ZXZ"), "ZXZ").canonicalize() is R
    assert isinstance(tx.lie.EulerRotation(tx.lie.EulerAngles(R, "zxz"), "ZXZ").canonicalize(), tx.lie.EulerRotation)
    assert tx.spatial.QDCM(tx.lie.quaternion(R)).canonicalize() is R
    assert repr(turned) == "EulerRotation(a, sequence='ZXZ')"
    assert repr(tx.lie.euler(tx.pose(euler=a))) == "EulerAngles(EulerRotation(a))"
