"""What the report concludes from rows made up for the purpose."""

import dataclasses
import math
from typing import Any

import pytest

from twistax.report.harness.page import render
from twistax.report.harness.rows import ReportRow
from twistax.report.harness.store import Origin
from twistax.report.work_precision.findings import Curve, Findings, bar_rows, doubts
from twistax.report.work_precision.integrators import INTEGRATORS, OURS, QUICK, WHAT, equal_steps, tolerances
from twistax.report.work_precision.page import LONG, STIFF, context, suited
from twistax.scenes import SCENES


def pages(findings: Findings, **more: Any) -> tuple[str, str]:
    """The page as Markdown and as HTML."""
    origin = Origin({"jax": "1"}, "abc", "a machine", dataclasses.asdict(QUICK))
    common = {
        "title": "t",
        "command": "again",
        "origin": origin,
        "pictures": {},
        "drawn": False,
        "bars": bar_rows(findings, "euler-top"),
        "missed": 0,
        "refused": {},
        "kernels": True,
        "empty_call": 1e-5,
    }
    return render("work_precision", common | context(findings) | more)


def said(findings: Findings) -> str:
    return pages(findings)[0]


def row(
    error: float,
    seconds: float,
    scene: str = "euler-top",
    method: str = "dop853",
    setting: float = 1e-8,
    unit: str = "tolerance",
    note: str = "done",
) -> ReportRow:
    numbers = {"setting": setting, "error": error, "compile_seconds": 0.5}
    numbers |= {"evaluations": 100.0, "accepted": 10.0, "rejected": 1.0}
    return ReportRow(
        scene, WHAT, method, f"{unit} {setting:g}", seconds, "s", note=note, sitting="then", numbers=numbers
    )


def runs(scene: str, method: str, scale: float, order: int) -> list[ReportRow]:
    """Time scale * error^(-1 / order), so that time at 1e-6 is scale * 10^(6 / order)."""
    settings = [10.0**-k for k in range(4, 12)]
    return [row(error, scale * error ** (-1.0 / order), scene, method, error) for error in settings]


def found(**scales: float) -> Findings:
    """Eighth-order curves on one scene; names with underscores for dashes."""
    rows = [r for name, scale in scales.items() for r in runs("euler-top", name.replace("_", "-"), scale, 8)]
    return Findings(rows)


@pytest.mark.parametrize("error", [1e-6, 3e-8, 1e-9])
def test_time_at_an_error_lies_on_the_power_law(error: float) -> None:
    curve = Curve.of(runs("euler-top", "dop853", 1e-4, 5)[::3] + [row(1e-11, 1e-4 * 1e11 ** (1 / 5))])
    assert curve.time_at(error) == pytest.approx(1e-4 * error ** (-1 / 5))


def test_runs_that_are_slower_and_worse_do_not_count() -> None:
    good = [row(1e-4, 1e-4), row(1e-8, 1e-3)]
    poor = [row(1e-5, 2e-2), row(1e-7, 5e-3), row(math.nan, 1e-9), row(1e-12, 1e-9, note="no")]
    assert Curve.of(good + poor) == Curve.of(good)


def test_nothing_is_extrapolated() -> None:
    curve = Curve.of([row(1e-7, 1e-4), row(1e-8, 2e-4)])
    assert curve.time_at(1e-6) == pytest.approx(1e-4)
    assert math.isnan(curve.time_at(1e-9))
    assert curve.row_at(1e-9) is None


def test_a_method_that_stays_away_from_the_truth_disagrees() -> None:
    stuck = [row(error, 1e-3, method="tsit5", setting=s) for s, error in ((1e-5, 3e-4), (1e-7, 1e-4), (1e-9, 1e-4))]
    coming = [row(error, 1e-3, method="rk4", setting=s) for s, error in ((1e-5, 1e-2), (1e-7, 1e-3), (1e-9, 1e-4))]
    fine = runs("euler-top", "dop853", 1e-4, 8)
    by_name = {doubt.method: doubt for doubt in doubts([*stuck, *coming, *fine])}
    assert set(by_name) == {"tsit5", "rk4"}
    assert not by_name["tsit5"].excuse
    assert by_name["rk4"].excuse
    assert not Findings([*stuck, *fine]).agreed
    assert Findings([*coming, *fine]).agreed


def test_more_steps_are_finer_and_smaller_tolerances_are() -> None:
    steps = [row(e, 1e-3, setting=n, unit="steps") for n, e in ((64.0, 1e-2), (128.0, 1e-3))]
    assert doubts(steps)[0].excuse
    tolerances = [row(e, 1e-3, setting=1e-9 * n) for n, e in ((64.0, 1e-2), (128.0, 1e-3))]
    assert not doubts(tolerances)[0].excuse


def test_a_method_that_was_stopped_early_may_still_be_right() -> None:
    slow = [row(error, 1e-3, method="tsit5", setting=s) for s, error in ((1e-5, 1.3e-6), (1e-6, 2.4e-6))]
    never = [row(math.nan, 1e-3, method="rk4", setting=1e-6, note="too many steps")]
    found = doubts([*slow, *never])
    assert all(doubt.excuse for doubt in found)
    assert "as close as its tolerance asks" in found[0].sentence
    assert "none of its runs reached the end" in found[1].sentence
    assert not Findings([*slow, *never]).agreed
    theirs = [dataclasses.replace(r, by="diffrax-tsit5") for r in never]
    assert Findings([*slow, *theirs]).agreed


def test_what_disagrees_is_not_compared() -> None:
    wrong = [row(1e-4, 1e-9, method="tsit5", setting=s) for s in (1e-5, 1e-7)]
    findings = Findings([*wrong, *runs("euler-top", "dop853", 1e-4, 8)])
    assert findings.curve("euler-top", INTEGRATORS["tsit5"]) == ()


def test_bars_take_the_better_rival_and_the_better_controller() -> None:
    findings = found(dop853_quaternion=1.0, diffrax_tsit5_call=4.0, diffrax_dopri8_call=2.5, diffrax_dopri8_call_pi=2.0)
    ratios = {(each.setting, each.what): each for each in bar_rows(findings, "euler-top")}
    assert ratios["over diffrax in one call", "Euler top, error 1e-6"].value == pytest.approx(0.5)
    assert ratios["over diffrax in one call", "Euler top, error 1e-6"].verdict == "holds"
    assert ratios["over diffrax as shipped", "Euler top, error 1e-9"].verdict == "not run"
    slower = bar_rows(found(dop853_quaternion=1.0, diffrax_tsit5_call=1.2), "euler-top")
    assert {each.verdict for each in slower if not math.isnan(each.value)} == {"MISSED"}


def test_the_page_names_whoever_is_fastest() -> None:
    refused = {("magnus6", "rates read a pose"): ["rocket", "heavy-top"]}
    for fast, slow in (("dop853", "tsit5"), ("tsit5", "dop853")):
        for text in pages(found(**{fast: 1.0, slow: 3.0}), refused=refused):
            assert f"Fastest: {INTEGRATORS[fast].title} on Euler top." in text
            assert "a machine" in text
            assert "magnus6 does not run rocket, heavy-top: rates read a pose." in text
            assert "they need matplotlib" in text


def test_stiff_scenes_have_their_own_methods_and_their_own_advice() -> None:
    assert {*STIFF, *LONG} < set(SCENES)
    assert all("radau5" in suited(INTEGRATORS, scene) and "dop853" not in suited(INTEGRATORS, scene) for scene in STIFF)
    assert all("dop853" in suited(INTEGRATORS, scene) and "rk4" not in suited(INTEGRATORS, scene) for scene in LONG)
    assert "rk4" in suited(INTEGRATORS, "euler-top")
    assert "radau5" not in suited(INTEGRATORS, "euler-top")
    # What is fast on one kind does not count on the other, and no method has to run both.
    rows = [
        *runs("euler-top", "dop853", 1.0, 8),
        *runs("euler-top", "tsit5", 1.2, 8),
        *runs("stiff-attitude", "radau5", 1.0, 5),
        *runs("stiff-attitude", "diffrax-kvaerno5-pi", 3.0, 5),
        *runs("spinning-satellite", "dopri8", 0.1, 8),
    ]
    text = said(Findings(rows))
    assert "If in doubt, take DOP853" in text
    assert "If the system is stiff, take Radau IIA 5" in text
    assert "If the system is stiff" not in said(found(dop853=1.0))


def test_advice_is_the_smallest_worst_case() -> None:
    rows = [
        *runs("euler-top", "tsit5", 1.0, 8),
        *runs("euler-top", "dop853", 1.5, 8),
        *runs("rocket", "tsit5", 9.0, 8),
        *runs("rocket", "dop853", 1.0, 8),
        # Fastest everywhere, but not to be had by calling a library.
        *runs("euler-top", "diffrax-tsit5-call", 0.1, 8),
        *runs("rocket", "diffrax-tsit5-call", 0.1, 8),
    ]
    text = said(Findings(rows))
    assert "take DOP853" in text
    assert "at worst it takes 1.5 times as long as the fastest (Euler top" in text


def test_a_digit_costs_the_root_of_ten() -> None:
    assert f"{10 ** (1 / 8):.2f} with DOP853" in said(found(dop853=1.0))


def test_what_a_tolerance_gave_is_said() -> None:
    assert "try two of them" in said(found(tsit5=1.0))
    rows = [row(3e-8, 1e-3, setting=1e-9), row(2e-7, 1e-3, "rocket", setting=1e-9), row(1e-3, 1e-3, setting=1e-5)]
    assert "ended with errors from 3e-8 to 2e-7 on these scenes" in said(Findings(rows))
    assert "ended with an error of 3e-8 on this scene" in said(Findings(rows[:1]))


def test_diffrax_is_named_where_it_is_faster() -> None:
    theirs = said(found(dop853=2.0, diffrax_tsit5=1.0))
    assert "diffrax as shipped is faster** at 1e-6 on Euler top (0.50 of our time); at 1e-9 on" in theirs
    ours = said(found(dop853=1.0, diffrax_tsit5=4.0))
    assert "not faster on any scene**: our fastest method takes 0.25 of the time" in ours
    alone = said(found(diffrax_tsit5=4.0))
    assert "none of ours got there" in alone


def test_quaternions_and_exponential_coordinates_are_compared() -> None:
    assert "faster on Euler top" in said(found(dop853=1.0, dop853_quaternion=0.8))
    assert "slower on Euler top" in said(found(dop853=1.0, dop853_quaternion=1.2))
    assert "as fast on Euler top" in said(found(dop853=1.0, dop853_quaternion=1.01))


def test_ladders_go_from_coarse_to_fine() -> None:
    assert tolerances(-4, -6, 2) == (1e-4, 3.16e-5, 1e-5, 3.16e-6, 1e-6)
    assert equal_steps(8, 4.0, most=200) == (8.0, 32.0, 128.0)


def test_every_line_has_a_name_of_its_own() -> None:
    lines = {(each.title, each.code, each.provider, each.style, each.drawn) for each in INTEGRATORS.values()}
    assert len({title for title, *_ in lines}) == len(lines)
    assert all(name == it.name for name, it in INTEGRATORS.items())
    assert sum(provider == OURS for _, _, provider, _, _ in lines) >= 10
