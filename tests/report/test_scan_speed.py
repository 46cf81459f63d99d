"""The report on speed compares the same system, whether or not the other library is there."""

import numpy as np
import pytest

from twistax.report import scan_speed


@pytest.mark.parametrize("solve", [False, True])
def test_contenders_agree_with_newton_and_euler_written_out(solve: bool) -> None:
    found = scan_speed.contenders(solve)
    assert scan_speed.agreement(found) < 1e-12
    ours, state = found[0], scan_speed.start()
    M, (w, x, y, z) = scan_speed.spatial_inertia(), state["q"]
    v, omega = state["V"][:3], state["V"][3:]
    R = 2.0 * np.array([[x * x, x * y, x * z], [x * y, y * y, y * z], [x * z, y * z, z * z]])
    R += 2.0 * w * np.array([[w, -z, y], [z, w, -x], [-y, x, w]]) - np.eye(3)
    momentum = M @ state["V"]
    bias = np.concatenate([np.cross(omega, momentum[:3]), np.cross(omega, momentum[3:]) + np.cross(v, momentum[:3])])
    turn = 0.5 * np.concatenate([[-omega @ state["q"][1:]], w * omega + np.cross(state["q"][1:], omega)])
    expected = np.concatenate([R @ v, turn, np.linalg.solve(M, scan_speed.WRENCH - bias)])
    np.testing.assert_allclose(ours.read(ours.rate(ours.state, ours.wrench, ours.params)), expected, atol=1e-13)


def test_compiling_the_free_body_takes_a_time() -> None:
    assert 0.0 < scan_speed.compile_seconds() < 60.0
