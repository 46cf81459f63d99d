"""Parameters of mechanisms in kernels."""

from pathlib import Path

import jax
import numpy as np
import pytest

import twistax as tx
from twistax import mechanics
from twistax.scalar.targets.llvm import kernel

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_other_numbers_compile_nothing(unchecked: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Masses, lengths and axes as Parameters: a heavier tool runs by the same kernels; and the slope by its mass."""
    names = ["tool_mass", "tool_center_of_mass", "elbow_origin", "elbow_axis"]
    robot = mechanics.load(EXAMPLES / "arm.urdf", parameters=names)
    dynamics = tx.compile(robot.system(), backend=tx.Native(least=0))
    x, u = {"q": np.array([0.3, -0.4, 0.1]), "qd": np.array([0.5, 0.2, -0.3])}, {"tau": np.zeros(3)}
    values = {leaf.name: np.asarray(leaf.value) for leaf in dynamics.parameters}
    assert set(values) == set(names)

    def found(step: float) -> tuple[jax.Array, jax.Array]:
        own = {**values, "tool_mass": values["tool_mass"] + step}
        return dynamics(0.0, x, u, own)["qd"], dynamics.jacobian(0.0, x, u, own, wrt="params")["params"]

    before, slopes = found(0.0)
    monkeypatch.setattr(kernel, "compiled", lambda *a: pytest.fail("a kernel was compiled"))
    with jax.no_tracing():
        after, _ = found(1e-6)
    ends = np.cumsum([value.size for value in values.values()])
    slope = slopes[-3:, ends[list(values).index("tool_mass")] - 1]
    np.testing.assert_allclose((after - before) / 1e-6, slope, rtol=1e-4)
    assert np.max(np.abs(slope)) > 0.1
