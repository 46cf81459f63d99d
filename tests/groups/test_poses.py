"""Building and reading poses, against SciPy's rotations."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twistax.errors import ShapeError
from twistax.groups import SE3, euler, pose, quaternion, quaternion_product, rotation_from_quaternion, so3

ROTATIONS = Rotation.random(30, np.random.default_rng(2))
HALF_TURNS = [np.diag(d) for d in ([1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0])]


def close(actual, expected, tolerance=2e-15):
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=tolerance)


def test_the_empty_pose_is_the_identity():
    close(pose(), np.eye(4), 0.0)


def test_attitudes():
    p = [1.0, -2.0, 3.0]
    for rotation in ROTATIONS[:5]:
        R = rotation.as_matrix()
        w_last = rotation.as_quat()
        q = 3.0 * np.roll(w_last, 1)
        yaw, pitch, roll = rotation.as_euler("ZYX")
        for attitude in ({"rotation": R}, {"quaternion": q}, {"euler": (roll, pitch, yaw)}):
            T = pose(p, **attitude)
            close(T[:3, :3], R)
            close(T[:3, 3], p, 0.0)
            close(T[3], [0.0, 0.0, 0.0, 1.0], 0.0)


@pytest.mark.parametrize("double", [False, True])
def test_arrays_of_numpy_take_the_precision_that_jax_has_silently(double):
    w, T = np.array([0.1, -0.2, 0.3]), np.eye(4)
    with jax.enable_x64(double), warnings.catch_warnings():
        warnings.simplefilter("error")
        found = (
            pose(position=np.ones(3)),
            so3.exp(w),
            so3.log(T[:3, :3]),
            SE3.compose(T, T),
            SE3.exp(np.ones(6)),
            SE3.Ad(T),
        )
        assert {a.dtype.name for a in found} == {"float64" if double else "float32"}
        assert so3.exp(w.astype(np.float32)).dtype == np.float32


def test_one_angle_at_a_time():
    c, s = np.cos(0.3), np.sin(0.3)
    close(pose(euler=(0.3, 0.0, 0.0))[:3, :3], [[1, 0, 0], [0, c, -s], [0, s, c]])
    close(pose(euler=(0.0, 0.3, 0.0))[:3, :3], [[c, 0, s], [0, 1, 0], [-s, 0, c]])
    close(pose(euler=(0.0, 0.0, 0.3))[:3, :3], [[c, -s, 0], [s, c, 0], [0, 0, 1]])


def test_reading_a_quaternion():
    for R in [*ROTATIONS.as_matrix(), *HALF_TURNS, np.eye(3)]:
        q = np.asarray(quaternion(R))
        close(q @ q, 1.0)
        assert q[np.nonzero(q)[0][0]] > 0.0
        close(rotation_from_quaternion(q), R)
        close(quaternion(pose(rotation=R)), q, 0.0)


def test_quaternion_product():
    for a, b in zip(ROTATIONS[:5], ROTATIONS[5:10], strict=True):
        p, q = np.roll(a.as_quat(), 1), np.roll(b.as_quat(), 1)
        product = np.roll((a * b).as_quat(), 1)
        got = np.asarray(quaternion_product(p, q))
        close(got * np.sign(got @ product), product)


def test_reading_euler_angles():
    for rotation in ROTATIONS:
        close(euler(rotation.as_matrix()), rotation.as_euler("ZYX")[::-1], 3e-15)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_gimbal_lock(pitch):
    R = Rotation.from_euler("ZYX", [0.7, pitch, 0.4]).as_matrix()
    roll, found, yaw = np.asarray(euler(R))
    assert roll == 0.0
    close(found, pitch, 1e-15)
    close(yaw, 0.7 - np.sign(pitch) * 0.4, 1e-15)
    assert np.all(np.isfinite(jax.jacrev(euler)(jnp.asarray(R))))


@pytest.mark.parametrize("gap", [1e-14, 1e-10, 1e-6])
def test_close_to_gimbal_lock_the_angles_still_give_the_rotation(gap):
    R = Rotation.from_euler("ZYX", [0.7, np.pi / 2 - gap, 0.4]).as_matrix()
    close(pose(euler=euler(R))[:3, :3], R)


def test_precision_follows_the_inputs():
    assert pose([1, 2, 3]).dtype == jnp.float64
    assert pose(np.zeros(3, np.float32)).dtype == jnp.float32
    assert pose([1.0, 2.0, 3.0], quaternion=np.float32([1, 1, 0, 0])).dtype == jnp.float32
    assert pose(np.arange(3), euler=np.zeros(3, np.float32)).dtype == jnp.float32
    assert quaternion(np.eye(3, dtype=np.float32)).dtype == jnp.float32
    assert euler(np.eye(3, dtype=np.float32)).dtype == jnp.float32


def test_quaternions_of_any_length():
    for scale in (1e-200, 1.0, 1e200):
        close(pose(quaternion=scale * np.array([1.0, 2.0, -2.0, 4.0]))[:3, :3], pose(quaternion=[1, 2, -2, 4])[:3, :3])


def test_poses_under_transformations():
    angles = np.array([[0.1, 0.2, 0.3], [1.0, -1.0, 2.0]])
    together = jax.jit(jax.vmap(lambda a: pose(a, euler=a)))(angles)
    close(together[1], pose(angles[1], euler=angles[1]))
    assert np.all(np.isfinite(jax.jacfwd(lambda q: pose(quaternion=q))(jnp.array([1.0, 0.0, 0.0, 0.0]))))


def test_wrong_shapes_when_reading():
    for function in (quaternion, euler):
        with pytest.raises(ShapeError, match=r"\(3, 3\) or \(4, 4\), got \(3,\)"):
            function(np.zeros(3))
    with pytest.raises(ShapeError, match=r"q with shape \(4,\), got \(3,\)"):
        rotation_from_quaternion(np.zeros(3))
