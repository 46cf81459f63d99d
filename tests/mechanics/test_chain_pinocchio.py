"""The arm against Pinocchio, where that is installed."""

import numpy as np
import pytest

import twistax as tx
from twistax.mechanics import chain_models, forward_dynamics, inverse_dynamics, mass_matrix

pin = pytest.importorskip("pinocchio")


def test_panda_moves_as_in_pinocchio() -> None:
    chain, model = chain_models.panda(), pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    at = 0
    for link in chain.links:
        mount = link.mount.value
        at = model.addJoint(at, pin.JointModelRZ(), pin.SE3(mount[:3, :3], mount[:3, 3]), link.joint.name)
        body = pin.Inertia(float(link.body.mass.value), link.body.center_of_mass.value, link.body.inertia.value)
        model.appendBodyToJoint(at, body, pin.SE3.Identity())
    data, rng = model.createData(), np.random.default_rng(6)
    q, qd, x = (tx.State(name, shape=(7,)) for name in ("q", "qd", "x"))
    dynamics = inverse_dynamics(chain, q, qd, x), forward_dynamics(chain, q, qd, x), mass_matrix(chain, q)
    found = tx.lower((*dynamics, chain.energy(q, qd), chain.poses(q)[-1]))
    for _ in range(3):
        values = rng.normal(size=(3, 7))
        forces, accelerations, mass, energy, tip = found(0.0, dict(zip(("q", "qd", "x"), values, strict=True)))
        np.testing.assert_allclose(forces, pin.rnea(model, data, *values), rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(accelerations, pin.aba(model, data, *values), rtol=1e-11, atol=1e-11)
        upper = np.triu(pin.crba(model, data, values[0]))  # it fills one half
        np.testing.assert_allclose(mass, upper + np.triu(upper, 1).T, rtol=0.0, atol=1e-12)
        kinetic = pin.computeKineticEnergy(model, data, *values[:2])
        np.testing.assert_allclose(energy, kinetic + pin.computePotentialEnergy(model, data, values[0]), rtol=1e-13)
        pin.forwardKinematics(model, data, values[0])
        np.testing.assert_allclose(tip, data.oMi[at].homogeneous, atol=1e-14)
