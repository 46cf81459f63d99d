"""Identification: values and covariances against closed forms and over seeds, and what data do not determine."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from mechanics_oracles import Cloud, body_of
from test_editing import near

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.errors import InputError, ModelError
from twistax.mechanics import Drive, IdentificationStatus, Link, Mechanism, SpatialInertia, identify, joints

EXAMPLES = Path(__file__).parents[2] / "examples"
Z, Y = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)


def motion(n: int, count: int, seed: int = 0, still: tuple[int, ...] = ()) -> dict[str, np.ndarray]:
    """Sums of sines and their rates; some joints at rest."""
    rng, t = np.random.default_rng(seed), np.linspace(0.0, 10.0, count)[:, None]
    q, qd, qdd = np.zeros((3, count, n))
    for k in range(1, 6):
        w, a, b = 0.5 * np.pi * k, *rng.normal(size=(2, n)) / k
        q, qd = q + a * np.sin(w * t) + b * np.cos(w * t), qd + w * (a * np.cos(w * t) - b * np.sin(w * t))
        qdd = qdd - w**2 * (a * np.sin(w * t) + b * np.cos(w * t))
    for i in still:
        q[:, i], qd[:, i], qdd[:, i] = 0.4, 0.0, 0.0
    return {"q": q, "qd": qd, "qdd": qdd}


def measured(real: Mechanism, records: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """With the forces of the motors, from the inverse form of the mechanism."""
    tau = tx.compile(real.inverse_system(controls=real.joints)).outputs
    one = jax.vmap(lambda q, qd, qdd: tau(0.0, {"q": q, "qd": qd}, {"qdd": qdd})["tau"])
    return {**records, "tau": np.asarray(one(*records.values()))}


def arm(mass: float = 1.0, length: float = 1.0) -> Mechanism:
    """Three links with springs and friction, in a unit of mass and one of length."""
    rng, links = np.random.default_rng(5), list[Link]()
    for i, axis in enumerate((Z, Y, Y)):
        body = body_of(Cloud.random(rng, 6))
        part = SpatialInertia(
            mass=mass * np.asarray(evaluated(body.mass)),
            center_of_mass=0.2 * length * np.asarray(evaluated(body.center_of_mass)),
            inertia=0.04 * mass * length**2 * np.asarray(evaluated(body.inertia)),
        )
        torque = mass * length**2
        drive = Drive(stiffness=3.0 * torque, rest=0.1, damping=0.4 * torque, friction=0.3 * torque, friction_speed=0.2)
        mount = tx.pose(position=[0.0, 0.0, 0.3 * length])
        links.append(Link(joints.Revolute(f"j{i}", axis), part, mount, drive=drive))
    return mechanics.Chain(links, gravity=(0.0, 0.0, -9.81 * length))


@pytest.fixture(scope="module")
def real() -> Mechanism:
    return arm()


@pytest.fixture(scope="module")
def data(real: Mechanism) -> dict[str, np.ndarray]:
    return measured(real, motion(3, 150))


def guess(real: Mechanism) -> Mechanism:
    """Other bodies, without friction."""
    ball = SpatialInertia(mass=3.0, center_of_mass=(0.05, 0.02, 0.1), inertia=0.1 * np.eye(3))
    drives = {name: dataclasses.replace(real.link(name).drive, damping=0.0, friction=0.0) for name in real.joints}
    return real.with_inertia(dict.fromkeys(real.joints, ball)).replace(drives=drives)


def noisy(data: dict[str, np.ndarray], sigma: Any, seed: int = 0) -> dict[str, np.ndarray]:
    noise = np.random.default_rng(seed).normal(size=data["tau"].shape)
    return {**data, "tau": data["tau"] + sigma * noise}


def truth(real: Mechanism, result: mechanics.Identification, drives: list[str]) -> np.ndarray:
    regressor = mechanics.inverse_dynamics_regressor(real, drives=drives)
    theta = dict(zip(regressor.names, np.asarray(evaluated(regressor.parameters)), strict=True))
    return result.combinations @ np.array([theta[name] for name in result.parameters])


def test_a_pendulum_by_hand() -> None:
    body = SpatialInertia(mass=2.0, center_of_mass=(0.4, 0.1, 0.0), inertia=np.diag([0.01, 0.02, 0.03]))
    hinge = Link(joints.Revolute("hinge", Z), body, np.eye(4), drive=Drive(damping=0.5))
    pendulum = Mechanism([hinge], gravity=(0.0, -9.81, 0.0))
    records = motion(1, 80)
    q, qd, qdd = (records[name][:, 0] for name in ("q", "qd", "qdd"))
    W = np.column_stack([9.81 * np.cos(q), -9.81 * np.sin(q), qdd, qd])
    tau = W @ [0.8, 0.2, 0.03 + 2.0 * 0.17, 0.5] + 0.2 * np.random.default_rng(1).normal(size=80)
    result = identify(pendulum, {**records, "tau": tau[:, None]}, drives="damping", noise=0.2)
    assert result.status is IdentificationStatus.IDENTIFIED
    assert result.names == ("hinge.mx", "hinge.my", "hinge.Izz", "hinge.damping")
    assert result.without_effect[:2] == ("hinge.mass", "hinge.mz")
    near(result.values, np.linalg.lstsq(W, tau, rcond=None)[0], 1e-9)
    near(result.covariance, 0.04 * np.linalg.inv(W.T @ W), 1e-9)
    near(result.residuals[:, 0], tau - W @ result.values, 1e-9)
    assert result.misfit == pytest.approx(np.sum(result.residuals**2) / 0.04 / 76.0)


def test_exact_forces_give_exact_parameters(real: Mechanism, data: dict[str, np.ndarray]) -> None:
    drives = ["damping", "friction", "armature"]
    result = identify(guess(real), data, drives=drives, noise=1e-3)
    assert result.status is IdentificationStatus.IDENTIFIED
    assert len(result.names) == mechanics.base_parameters(real, drives=drives).rank
    near(result.values, truth(real, result, drives), 1e-8)
    value, deviation = result.estimate("j1.friction")
    assert value == pytest.approx(0.3)
    assert 0.0 < deviation < 0.01
    # A known link and known friction are taken from the mechanism.
    tip = real.with_inertia({"j2": SpatialInertia(mass=1.0, inertia=np.eye(3))})
    known = identify(tip, data, links=["j2"], noise=1e-3)
    assert known.names[:2] == ("j2.mass", "j2.mx")
    near(known.values, truth(real, known, []), 1e-8)


def test_what_the_data_do_not_determine_is_named_and_has_no_number(real: Mechanism) -> None:
    at_rest = measured(real, motion(3, 150, still=(1,)))
    result = identify(guess(real), at_rest, drives=["damping", "friction"], noise=1e-3)
    full = mechanics.base_parameters(real, drives=["damping", "friction"])
    assert result.status is IdentificationStatus.UNDETERMINED
    assert {"j1.damping", "j1.friction"} <= set(result.undetermined) <= set(full.names)
    assert len(result.names) + len(result.undetermined) == full.rank
    near(result.values, truth(real, result, ["damping", "friction"]), 1e-7)
    for name, match in (
        ("j1.damping", r"do not determine j1.damping. No combination contains it\.\n  fix: record"),
        ("j0.mass", "no joint force depends on j0.mass; `without_effect`"),
        ("j1.mz", r"no motion determines j1.mz: .* within 'j1.mz \+ 0.3 j2.mass'.\n  fix: .*links=\['j1'\]"),
    ):
        with pytest.raises(InputError, match=match):
            result.estimate(name)
    listed = " ".join([*result.inseparable, *result.without_effect, *result.undetermined])
    for name in result.parameters:  # each without an estimate is in a list
        if name not in listed:
            result.estimate(name)
    assert {"j1.mx", "j1.mz", "j2.Izz"} <= set(result.inseparable)
    # Noise in the measured motion of a joint at rest is no excitation.
    rough = {
        **at_rest,
        **{k: at_rest[k] + 1e-5 * np.random.default_rng(2).normal(size=(150, 3)) for k in ("qd", "qdd")},
    }
    again = identify(guess(real), rough, drives=["damping", "friction"], noise=0.01)
    assert {"j1.damping", "j1.friction"} <= set(again.undetermined)
    # Fewer samples than parameters.
    few = identify(guess(real), {name: value[:2] for name, value in at_rest.items()}, noise=1e-3)
    assert len(few.names) <= 6
    assert len(few.names) + len(few.undetermined) == mechanics.base_parameters(real, drives=[]).rank


def test_a_parameter_that_acts_only_in_a_sum_has_a_remedy_that_helps(
    real: Mechanism, data: dict[str, np.ndarray]
) -> None:
    result = identify(guess(real), data, drives=["armature", "damping", "friction"], noise=1e-3)
    assert {"j0.armature", "j0.Izz"} <= set(result.inseparable)
    with pytest.raises(InputError) as raised:
        result.estimate("j0.armature")
    (within,) = [name for name in result.names if "j0.armature" in name]
    text = str(raised.value)
    assert "no motion determines j0.armature" in text
    assert repr(within) in text
    assert result.estimate(within)[0] > 0.0
    # The other remedy of the message, with the true bodies as known.
    assert "identify(..., links=[], drives=['armature'])" in text
    known = identify(real, data, links=[], drives=["armature"], noise=1e-3)
    assert known.inseparable == ()
    assert abs(known.estimate("j0.armature")[0]) < 1e-8


def test_the_measure_has_no_unit(real: Mechanism) -> None:
    # The same arm in grams and in millimetres, of which the forces are measured as well.
    names = list[tuple[str, ...]]()
    for mass, length in ((1.0, 1.0), (1e3, 1e3)):
        model = arm(mass, length)
        records = noisy(measured(model, motion(3, 60, still=(0, 1))), 0.05 * mass * length**2)
        result = identify(model, records, noise=0.05 * mass * length**2)
        assert result.undetermined
        names.append(tuple(name.split(" ")[0] for name in result.names))
    assert len(set(names)) == 1


def test_residuals_that_are_no_noise_are_a_misfit(real: Mechanism, data: dict[str, np.ndarray]) -> None:
    model = guess(real)
    for noise in (0.02, None):  # too large; correlated
        assert identify(model, noisy(data, 0.02), noise=noise).status is IdentificationStatus.MISFIT
    full = identify(model, noisy(data, [0.02, 0.05, 0.01]), drives=["damping", "friction"])
    assert full.status is IdentificationStatus.IDENTIFIED
    near(full.noise, np.array([0.02, 0.05, 0.01]), 0.15)
    assert np.abs((full.values - truth(real, full, ["damping", "friction"])) / full.standard_deviations).max() < 4.0


def test_friction_by_the_sign_of_the_velocity(real: Mechanism, data: dict[str, np.ndarray]) -> None:
    # The law of `Drive` is smooth; a small friction_speed makes it the sign of the velocity.
    difference = 0.3 * (np.sign(data["qd"]) - np.tanh(data["qd"] / 0.2))
    sliding = noisy({**data, "tau": data["tau"] + difference}, 0.02)
    by_speed = {}
    for speed in (0.2, 1e-6):
        drives = {name: dataclasses.replace(real.link(name).drive, friction_speed=speed) for name in real.joints}
        by_speed[speed] = identify(
            guess(real.replace(drives=drives)), sliding, drives=["damping", "friction"], noise=0.02
        )
    assert by_speed[0.2].status is IdentificationStatus.MISFIT
    assert by_speed[1e-6].status is IdentificationStatus.IDENTIFIED
    value, deviation = by_speed[1e-6].estimate("j1.friction")
    assert abs(value - 0.3) < 4.0 * deviation


def test_a_physical_fit(real: Mechanism, data: dict[str, np.ndarray]) -> None:
    sigma = 0.3
    result = identify(guess(real), noisy(data, sigma), drives=["damping", "friction"], noise=sigma, physical=True)
    assert result.mechanism is not None
    assert result.status in (IdentificationStatus.IDENTIFIED, IdentificationStatus.UNDETERMINED)
    assert 0.0 <= result.excess < 20.0
    again = measured(result.mechanism, {name: data[name] for name in ("q", "qd", "qdd")})
    near(again["tau"], noisy(data, sigma)["tau"] - result.residuals, 1e-9)
    near(again["tau"], data["tau"], 0.05)
    near(truth(result.mechanism, result, ["damping", "friction"]), result.values, 1e-9)
    # No body has a principal moment above the sum of the other two.
    rod = SpatialInertia(mass=1.0, inertia=np.diag([0.1, 0.1, 0.22]), physical=False)
    wrong = measured(real.with_inertia({"j2": rod}), {name: data[name] for name in ("q", "qd", "qdd")})
    refused = identify(real, noisy(wrong, 0.3), links=["j2"], noise=0.3, physical=True)
    assert refused.status is IdentificationStatus.UNPHYSICAL


@pytest.mark.slow
def test_deviations_over_seeds_are_the_bound_for_seven_links() -> None:
    panda, drives = mechanics.chain_models.panda(), ["damping", "friction"]
    real = panda.replace(drives={name: Drive(damping=0.5, friction=0.3, friction_speed=0.1) for name in panda.joints})
    model = panda.replace(drives=dict.fromkeys(panda.joints, Drive(friction_speed=0.1)))
    exact = measured(real, motion(7, 300, seed=3))
    sigma = 0.01 * np.abs(exact["tau"]).max(axis=0)
    runs = [identify(model, noisy(exact, sigma, seed), drives=drives) for seed in range(200)]
    assert {run.names for run in runs} == {runs[0].names}
    bound = identify(model, exact, drives=drives, noise=sigma)
    spread = np.std([run.values for run in runs], axis=0, ddof=1)
    assert np.max(spread / bound.standard_deviations) <= 1.15
    assert np.min(spread / bound.standard_deviations) >= 0.85
    base = mechanics.base_parameters(model, drives=drives)
    assert len(bound.names) + len(bound.undetermined) == base.rank == 57
    near(bound.values, truth(real, bound, drives), 1e-8)
    # What is claimed of a run is the same bound, and as many runs are called a misfit as noise makes.
    near(np.mean([run.standard_deviations for run in runs], axis=0) / bound.standard_deviations, np.ones(1), 0.05)
    assert sum(run.status is IdentificationStatus.MISFIT for run in runs) <= 1


def test_bad_input(real: Mechanism, data: dict[str, np.ndarray], unchecked: None) -> None:
    for changed, match in (
        ({"tau": data["tau"][:5]}, "the same number of samples"),
        ({"q": data["q"][:, :2]}, r"'q' with shape \(samples, 3\), got \(150, 2\)"),
        ({"qd": np.where(np.arange(150)[:, None] == 7, np.nan, data["qd"])}, "'qd' at sample 7"),
        ({"tau": 0.0 * data["tau"]}, "not all zero"),
        ({"torque": data["tau"]}, "records by name"),
        ({name: value[:0] for name, value in data.items()}, "samples"),
    ):
        with pytest.raises(InputError, match=match):
            identify(real, {**data, **changed})
    for options, error, match in (
        ({"links": ["elbow"]}, ModelError, "no frame 'elbow'"),
        ({"links": ["base"]}, ModelError, "do not move"),
        ({"links": []}, ModelError, "drive, got none"),
        ({"drives": ["gear"]}, ModelError, "drives among"),
        ({"noise": 0.0}, InputError, "positive"),
        ({"noise": [1.0, 2.0]}, InputError, "noise"),
        ({"size": (0.0, 1.0)}, InputError, "size"),
        ({"tolerance": np.nan}, InputError, "tolerance"),
    ):
        with pytest.raises(error, match=match):
            identify(real, data, **options)
    with pytest.raises(InputError, match=r"records by name(.|\n)*fix: compute 'qd', 'qdd' as scipy"):
        identify(real, {"q": data["q"], "tau": data["tau"]})
    with pytest.raises(InputError, match="are not enough to estimate"):
        identify(real, {name: value[:2] for name, value in data.items()})
    result = identify(real, data, noise=0.1)
    for wanted in ("j0.weight", {"j0.mass": np.nan}, {}, 3):
        with pytest.raises(InputError, match="estimate"):
            result.estimate(wanted)  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="size=\\(kg, m\\)"):
        identify(real.with_inertia(dict.fromkeys(real.joints)), data, links=["j0"])
