"""The figures measure what they say, here in small, and see what is wrong."""

import math
from pathlib import Path

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.mechanics import screws
from twistax.report.figures import filters, identities, scalars, steps
from twistax.report.harness.expected import Absent
from twistax.report.harness.measurement import MeasuredCase, explained
from twistax.report.harness.page import texts
from twistax.report.harness.timing import Race, Repeats
from twistax.report.registry import FIGURES
from twistax.report.speed.cases import CASES
from twistax.report.stability import invariants
from twistax.scalar.targets.llvm.backend import installed
from twistax.scenes import SCENES

QUICK = [check for section in FIGURES.values() for _, check in explained(section) if not check.slow]
needs_llvmlite = pytest.mark.skipif(not installed(), reason="native kernels need llvmlite")


def test_every_row_has_a_key_of_its_own() -> None:
    for name, section in FIGURES.items():
        keys = [(check.what, check.by) for _, check in explained(section)]
        assert len(set(keys)) == len(keys)
        assert texts("figures")["sections"][name]["about"].endswith(".")


@pytest.mark.slow
@pytest.mark.parametrize(
    "check", [c for section in FIGURES.values() for _, c in explained(section) if not c.slow], ids=lambda c: c.what
)
def test_what_is_quick_is_what_was_asked_for(check: MeasuredCase) -> None:
    row = check.run()
    assert row.holds is not False, f"{row.came}; asked for: {row.bar}"


# ---- identities ------------------------------------------------------------------------------------------------------


def test_a_wrong_formula_stands_out_and_the_others_hold() -> None:
    """Each pair of operators that sources confuse, put in each other's place."""
    z = identities.random_values(5)
    lie, (T, xi, eta, F) = tx.lie, (getattr(identities, f"_{name}") for name in ("T", "xi", "eta", "F"))
    for order in (tx.LINEAR_FIRST, tx.ANGULAR_FIRST):
        confused = {
            "Ad_T eta": lie.SE3AdjointDual(T, order=order) @ eta,
            "Ad*_T F": lie.SE3Adjoint(T, order=order) @ F,
            "J_r^-1": lie.LeftJacobianInverse(xi, order=order),
            "<ad*": tx.linalg.Dot(lie.AdjointDual(xi, F, order=order), eta),
        }
        right = identities.lie_identities(z, order)
        wrong = [
            each._replace(name=f"wrong {each.name}", expression=expression)
            for each in right
            for start, expression in confused.items()
            if each.name.startswith(start)
        ]
        assert len(wrong) == len(confused)
        worst = identities.worst_errors([*right, *wrong], z, order)
        assert all((error > 0.1) == name.startswith("wrong") for name, error in worst.items())
        assert max(error for error in worst.values() if error < 0.1) < 1e-12


@pytest.mark.slow
def test_every_statement_on_joints_holds() -> None:
    z = identities.random_values(10)
    worst = identities.worst_errors(identities.joint_identities(z), z)
    assert len(worst) == 3
    assert max(worst.values()) < 1e-13


def test_wrenches_moved_as_twists_stand_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screws, "SE3AdjointDual", tx.lie.SE3Adjoint)
    monkeypatch.setattr(identities, "JOINTS", identities.JOINTS[:1])
    z = identities.random_values(3)
    worst = identities.worst_errors(identities.joint_identities(z), z)
    for statement in ("h*^T H = I", "reciprocity: H^T H-bar* = 0", "power of an actuator = tau . q'"):
        assert worst[statement] > 0.1


# ---- what is kept ----------------------------------------------------------------------------------------------------


def test_momenta_of_the_exact_motion_stay() -> None:
    kept = invariants.tumble().invariants
    states = [SCENES["offset-tumble"].truth(t) for t in np.linspace(0.0, 10.0, 11)]
    xs = {name: np.stack([state[name] for state in states]) for name in ("g", "V")}
    values, size = kept(xs)["momentum"]
    assert np.abs(values - values[0]).max() < 1e-12
    assert size.min() > 3.0
    for i in range(6):
        off = xs["V"] + 1e-6 * np.outer(np.arange(11.0), np.eye(6)[i])
        values, _ = kept(xs | {"V": off})["momentum"]
        assert np.abs(values - values[0]).max() > 1e-6


@pytest.mark.slow
def test_a_top_keeps_its_vertical_momentum_alone() -> None:
    """The horizontal ones change: what is measured is no constant. Another method loses it."""
    top = invariants.top((1.0, 1.3, 0.5))
    method = tx.Splitting(tx.compositions.SUZUKI4, top.bodies)
    found = invariants.changes(top, method, 1e-2, (2_000,))
    assert found["vertical momentum"].relative[-1] < 1e-13
    assert 1e-14 < found["energy"].relative[-1] < 1e-8
    lost = invariants.changes(top, tx.RKMK(tx.tableaus.RK4), 1e-2, (2_000,))
    assert min(lost[name].relative[-1] for name in ("vertical momentum", "energy")) > 1e-9
    end = tx.integrate(top.dynamics, dict(top.start), t1=20.0, steps=2_000, method=method).xs
    J = np.array([1.0, 1.3, 0.5])
    moved, start = end["R"][-1] @ (J * end["w"][-1]), top.start["R"] @ (J * top.start["w"])
    assert np.abs(np.asarray(moved)[:2] - start[:2]).max() > 0.1


@pytest.mark.slow
def test_quaternions_stay_and_matrices_drift() -> None:
    for motion in (invariants.constant_twist(), invariants.free_body()):
        ends = [
            invariants.changes(motion, tx.RKMK(tx.tableaus.RK4, chart), 1e-2, (1_000, 10_000))["R'R - I"].absolute[-1]
            for chart in (None, invariants.Matrices())
        ]
        assert ends[0] < 4e-15 < 5e-15 < ends[1] < 1e-11


@pytest.mark.slow
def test_changes_shrink_with_the_order() -> None:
    for tableau, factor in ((tx.tableaus.EULER, 2.0), (tx.tableaus.HEUN, 4.0), (tx.tableaus.RK4, 16.0)):
        coarse, fine = (
            invariants.changes(invariants.free_body(), tx.RKMK(tableau), 0.5 / count, (count,))[
                "linear momentum"
            ].absolute[0]
            for count in (25, 50)
        )
        assert 0.6 * factor < coarse / fine < 1.6 * factor


# ---- steps -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_both_loops_end_alike() -> None:
    race = Race(lambda: steps.looped(tx.RKMK(tx.tableaus.HEUN), 200), 1e-12, Repeats(1, 1))
    assert all(it.seconds > 0.0 and it.compile_seconds > 0.0 for it in race.programs.values())


def test_c_steps_the_same_body_and_the_difference_sees_another(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """With another drag the ends are far more than the bar apart; without a compiler it says so."""
    monkeypatch.setattr(steps.shutil, "which", lambda name: None)
    with pytest.raises(Absent, match="no gcc on this machine"):
        steps.beside_c(2_000)
    monkeypatch.undo()
    if steps.shutil.which("gcc") is None:
        pytest.skip("needs gcc")
    race = lambda: Race(lambda: steps.beside_c(2_000), steps.BESIDE_C.bar, Repeats(1, 1), steps.BESIDE_C.read)  # noqa: E731
    assert len(race().programs) == 3
    changed = tmp_path / "rkmk4.c"
    changed.write_text(steps.SOURCE.read_text().replace("DRAG = 0.1;", "DRAG = 0.1001;"))
    monkeypatch.setattr(steps, "SOURCE", changed)
    with pytest.raises(RuntimeError, match="DISAGREES"):
        race().programs  # noqa: B018


@pytest.mark.slow
def test_filters_take_the_same_steps_as_those_of_others(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """With another gravity the ends are far more than the bar apart."""
    assert len(Race(filters.in_batches, 1e-12, Repeats(1, 1), filters.IN_BATCHES.read).programs) == 2
    if steps.shutil.which("gcc") is None:
        pytest.skip("needs gcc")
    race = lambda: Race(lambda: filters.in_c(100), filters.IN_C.bar, Repeats(1, 1))  # noqa: E731
    assert len(race().programs) == 2
    changed = tmp_path / "ins15.c"
    changed.write_text(filters.SOURCE.read_text().replace("9.81", "9.811"))
    monkeypatch.setattr(filters, "SOURCE", changed)
    with pytest.raises(RuntimeError, match="DISAGREES"):
        race().programs  # noqa: B018


# ---- scalars and kernels ---------------------------------------------------------------------------------------------


def test_scalars_agree_with_arrays_and_a_disagreement_is_seen() -> None:
    case = CASES["free-body"]
    function = scalars.in_arrays(case)
    assert scalars.program_of(case).operations <= 230
    assert scalars.disagreement(case) < 1e-13
    off = scalars.disagreement(case, function=lambda *a: [1.0 + 1e-9 + r for r in function(*a)])
    assert math.isfinite(off)
    assert off > 1e-3


@pytest.mark.slow
@needs_llvmlite
def test_integrations_in_a_kernel_end_where_those_by_xla_do() -> None:
    assert scalars.batch_ratio(20, 10) > 0.0


@needs_llvmlite
def test_sine_and_cosine_are_judged_by_the_last_place() -> None:
    x = scalars.angles(100)
    assert 0.3 < scalars.units_off(x, tx.Native()) < 2.0
    assert scalars.units_off(x, tx.XLA(), lambda s: tx.Sin(s * (1.0 + 1e-14))) > 2.0
    assert np.isnan(scalars.units_off(x, tx.XLA(), lambda s: tx.Sin(s + tx.Where(s <= 1.0, 0.0, np.nan))))


def test_what_runs_no_kernel_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RuntimeError, match="no kernel runs the function"):
        scalars._native(jax.jit(lambda x: x + 1.0), np.ones(3))
    monkeypatch.setattr(scalars, "installed", lambda: False)
    rows = [check.run() for _, check in explained(FIGURES["kernels"]) if not check.slow]
    assert all(row.holds is None and "llvmlite is not installed" in row.note for row in rows)
